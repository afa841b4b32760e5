//! Places that clients occupy for a while, such as connections, uploads and waits. Their number is limited in total and for each
//! peer, so that no single client can take all of them. The peer is the address of the connection.

use std::collections::HashMap;
use std::convert::Infallible;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderValue, header};

use crate::config::Limits;
use crate::http::wire::problem::{Code, Problem};

/// A number of places. Inexpensive to clone.
#[derive(Debug, Clone)]
pub(in crate::http) struct Shares {
    taken: Arc<Mutex<Taken>>,
    places_max: u64,
    peer_max: u64,
}

#[derive(Debug, Default)]
struct Taken {
    count: u64,
    by_peer: HashMap<Peer, u64>,
}

/// A place, occupied until it is dropped.
#[derive(Debug)]
pub(in crate::http) struct Place {
    taken: Arc<Mutex<Taken>>,
    peer: Peer,
}

/// Why no place could be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::http) enum Full {
    /// All places are occupied.
    All {
        /// Number of places.
        places_max: u64,
    },
    /// The peer has used its share.
    Peer {
        /// The share.
        peer_max: u64,
    },
}

impl Shares {
    /// `places_max` places, of which one peer may take `share_percent`, but always one.
    pub(in crate::http) fn new(places_max: u64, share_percent: u64) -> Self {
        let peer_max = (places_max.saturating_mul(share_percent) / 100).max(1);
        Self { taken: Arc::default(), places_max, peer_max }
    }

    /// Takes a place for a peer.
    ///
    /// # Errors
    /// [`Full`] if all are occupied, or if the peer has used its share.
    pub(in crate::http) fn take(&self, peer: Peer) -> Result<Place, Full> {
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

    /// Number of occupied places.
    pub(in crate::http) fn taken_count(&self) -> u64 {
        lock(&self.taken).count
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = lock(&self.taken);
        taken.count = taken.count.saturating_sub(1);
        // A peer without a place is removed, so that the table has at most as many entries as there are places.
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

/// Seconds after which a client without a place may retry.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Places for waiting clients.
#[derive(Debug, Clone)]
pub(in crate::http) struct Listeners {
    places: Shares,
    most: u64,
}

impl Listeners {
    /// The configured number, but at most half of the connections.
    pub(in crate::http) fn new(limits: &Limits) -> Self {
        let most = limits.listeners_max.min(limits.connections_max / 2).max(1);
        Self { places: Shares::new(most, limits.peer_share_percent), most }
    }

    /// A place, occupied until it is dropped.
    ///
    /// # Errors
    /// [`Code::Busy`] if all are occupied, or if the peer has used its share.
    pub(in crate::http) fn place(&self, peer: Peer) -> Result<Place, Problem> {
        self.places.take(peer).map_err(|full| {
            let (most, whose, keys) = match full {
                Full::All { places_max } => (places_max, "", "limits.listeners_max"),
                Full::Peer { peer_max } => {
                    (peer_max, " of this address", "limits.listeners_max, limits.peer_share_percent")
                }
            };
            let detail = format!(
                "{most} clients{whose} wait for events or ends, which is the maximum ({keys}); retry later, or without wait_s"
            );
            Problem::new(Code::Busy, detail)
                .with("listeners_max_count", most)
                .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
        })
    }

    /// A place for a request that waits; a request that does not wait needs none.
    ///
    /// # Errors
    /// As [`Listeners::place`].
    pub(in crate::http) fn place_for(&self, peer: Peer, wait: Duration) -> Result<Option<Place>, Problem> {
        if wait.is_zero() { Ok(None) } else { self.place(peer).map(Some) }
    }

    /// Maximum number of waiting clients.
    pub(in crate::http) const fn most(&self) -> u64 {
        self.most
    }

    /// Present number of waiting clients.
    pub(in crate::http) fn count(&self) -> u64 {
        self.places.taken_count()
    }
}

/// The network address that counts as one client: an IPv4 address, or the /64 network of an IPv6 address, because one host
/// can use every address of its /64.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(in crate::http) enum Peer {
    /// An IPv4 address, also if it is mapped to IPv6.
    V4(Ipv4Addr),
    /// The first 64 bits of an IPv6 address.
    V6([u16; 4]),
}

/// The connection of a request, an extension of every request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::http) struct ConnectionInfo {
    /// Address of the client.
    pub(in crate::http) peer: Peer,
    /// All other places were occupied, so only urgent requests are answered on this connection.
    pub(in crate::http) reserved: bool,
}

impl From<IpAddr> for Peer {
    fn from(address: IpAddr) -> Self {
        match address.to_canonical() {
            IpAddr::V4(address) => Self::V4(address),
            IpAddr::V6(address) => {
                let [a, b, c, d, ..] = address.segments();
                Self::V6([a, b, c, d])
            }
        }
    }
}

impl ConnectionInfo {
    /// The connection of a request. A request that did not come through a listener counts for the unspecified address.
    pub(in crate::http) fn of(extensions: &axum::http::Extensions) -> Self {
        let unspecified = Self { peer: Peer::V4(Ipv4Addr::UNSPECIFIED), reserved: false };
        extensions.get().copied().unwrap_or(unspecified)
    }
}

impl<S: Sync> FromRequestParts<S> for Peer {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(ConnectionInfo::of(&parts.extensions).peer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{IpAddr, Ipv4Addr};

    fn peer(number: u8) -> Peer {
        IpAddr::V4(Ipv4Addr::new(192, 0, 2, number)).into()
    }

    #[test]
    fn a_peer_gets_at_most_its_share_and_the_others_get_the_rest() {
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
    fn the_share_of_a_peer_is_at_least_one_place() {
        assert!(Shares::new(1, 50).take(peer(1)).is_ok());
    }
}

#[cfg(test)]
mod peer_tests {
    use super::*;

    #[test]
    fn all_addresses_of_one_ipv6_network_are_one_peer_and_mapped_addresses_are_ipv4() {
        let peer = |text: &str| Peer::from(text.parse::<IpAddr>().expect("an address"));
        assert_eq!(peer("2001:db8:1:2::1"), peer("2001:db8:1:2:ffff::9"));
        assert_ne!(peer("2001:db8:1:2::1"), peer("2001:db8:1:3::1"));
        assert_eq!(peer("::ffff:192.0.2.7"), peer("192.0.2.7"));
        assert_ne!(peer("192.0.2.7"), peer("192.0.2.8"));
    }
}
