//! Places that clients take for a while, such as connections, uploads and waits. Their number is limited in all and for each
//! peer, so that no single client can take all of them.

use super::peer::Peer;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A number of places. Cheap to clone.
#[derive(Debug, Clone)]
pub(super) struct Shares {
    taken: Arc<Mutex<Taken>>,
    places_max: u64,
    peer_max: u64,
}

#[derive(Debug, Default)]
struct Taken {
    count: u64,
    by_peer: HashMap<Peer, u64>,
}

/// A place, held until it is dropped.
#[derive(Debug)]
pub(super) struct Place {
    taken: Arc<Mutex<Taken>>,
    peer: Peer,
}

/// Why no place could be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Full {
    /// All places are taken.
    All {
        /// How many there are.
        places_max: u64,
    },
    /// The peer holds its share already.
    Peer {
        /// The share.
        peer_max: u64,
    },
}

impl Shares {
    /// `places_max` places, of which one peer may take `share_percent`, but always one.
    pub(super) fn new(places_max: u64, share_percent: u64) -> Self {
        let peer_max = (places_max.saturating_mul(share_percent) / 100).max(1);
        Self { taken: Arc::default(), places_max, peer_max }
    }

    /// Takes a place for a peer.
    ///
    /// # Errors
    /// [`Full`] where all are taken, or the peer's share is.
    pub(super) fn take(&self, peer: Peer) -> Result<Place, Full> {
        let mut taken = lock(&self.taken);
        if taken.count >= self.places_max {
            return Err(Full::All { places_max: self.places_max });
        }
        if taken.by_peer.get(&peer).is_some_and(|count| *count >= self.peer_max) {
            return Err(Full::Peer { peer_max: self.peer_max });
        }
        taken.count += 1;
        *taken.by_peer.entry(peer).or_default() += 1;
        Ok(Place { taken: Arc::clone(&self.taken), peer })
    }

    /// How many places are taken.
    pub(super) fn taken_count(&self) -> u64 {
        lock(&self.taken).count
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = lock(&self.taken);
        taken.count = taken.count.saturating_sub(1);
        // A peer without a place is forgotten, so that the table is never longer than the places are many.
        if let Some(count) = taken.by_peer.get_mut(&self.peer) {
            *count = count.saturating_sub(1);
            if *count == 0 {
                taken.by_peer.remove(&self.peer);
            }
        }
    }
}

fn lock(taken: &Mutex<Taken>) -> MutexGuard<'_, Taken> {
    taken.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{IpAddr, Ipv4Addr};

    fn peer(number: u8) -> Peer {
        IpAddr::V4(Ipv4Addr::new(192, 0, 2, number)).into()
    }

    #[test]
    fn one_peer_takes_its_share_and_the_others_take_the_rest() {
        let shares = Shares::new(4, 50);
        let held: Vec<_> = (0..2).map(|_| shares.take(peer(1)).expect("a place")).collect();
        assert_eq!(shares.take(peer(1)).err(), Some(Full::Peer { peer_max: 2 }));
        let others: Vec<_> = (2..4).map(|number| shares.take(peer(number)).expect("a place")).collect();
        assert_eq!(shares.take(peer(4)).err(), Some(Full::All { places_max: 4 }));
        drop(held);
        assert_eq!(shares.taken_count(), 2);
        shares.take(peer(1)).expect("its places are free again");
        drop(others);
        assert!(shares.taken_count() == 0 && lock(&shares.taken).by_peer.is_empty());
    }

    #[test]
    fn the_share_of_a_single_place_is_that_place() {
        assert!(Shares::new(1, 50).take(peer(1)).is_ok());
    }
}
