//! Lets only so many clients wait for something to happen at a time, by a stream of events or by a long poll, so that they
//! cannot fill all connections.

use super::peer::Peer;
use super::problem::{Code, Problem};
use super::shares::{Full, Place, Shares};
use crate::config::Limits;
use axum::http::{HeaderValue, header};
use std::time::Duration;

/// A client that finds no place may ask again after this, seconds.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Places for clients that wait.
#[derive(Debug, Clone)]
pub(super) struct Listeners {
    places: Shares,
    most: u64,
}

impl Listeners {
    /// As many as is configured, but never more than half of the connections.
    pub(super) fn new(limits: &Limits) -> Self {
        let most = limits.listeners_max.min(limits.connections_max / 2).max(1);
        Self { places: Shares::new(most, limits.peer_share_percent), most }
    }

    /// A place, held until it is dropped.
    ///
    /// # Errors
    /// [`Code::Busy`] where all are taken, or the peer's share is.
    pub(super) fn place(&self, peer: Peer) -> Result<Place, Problem> {
        self.places.take(peer).map_err(|full| {
            let (most, whose, keys) = match full {
                Full::All { places_max } => (places_max, "", "limits.listeners_max"),
                Full::Peer { peer_max } => {
                    (peer_max, " of this address", "limits.listeners_max, limits.peer_share_percent")
                }
            };
            let detail = format!(
                "{most} clients{whose} wait for events or ends, and no more may ({keys}); ask again later, or without wait_s"
            );
            Problem::new(Code::Busy, detail)
                .with("listeners_max_count", most)
                .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
        })
    }

    /// A place for a request that waits; one that does not needs none.
    ///
    /// # Errors
    /// As [`Listeners::place`].
    pub(super) fn place_for(&self, peer: Peer, wait: Duration) -> Result<Option<Place>, Problem> {
        if wait.is_zero() { Ok(None) } else { self.place(peer).map(Some) }
    }

    /// How many may wait.
    pub(super) const fn most(&self) -> u64 {
        self.most
    }

    /// How many wait at this moment.
    pub(super) fn count(&self) -> u64 {
        self.places.taken_count()
    }
}
