//! Lets only so many clients wait for something to happen at a time, by a stream of events or by a long poll, so that they
//! cannot fill all connections and a stop finds one. Must not know what is waited for.

use super::problem::{Code, Problem};
use crate::config::Limits;
use axum::http::{HeaderValue, header};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Whoever finds no place may ask again after this, seconds.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Places for those that wait.
#[derive(Debug, Clone)]
pub(super) struct Listeners {
    places: Arc<Semaphore>,
    most: u64,
}

impl Listeners {
    /// As many as is configured, but never more than half of the connections.
    pub(super) fn new(limits: &Limits) -> Self {
        let most = limits.listeners_max.min(limits.connections_max / 2).max(1);
        let places = usize::try_from(most).unwrap_or(usize::MAX).min(Semaphore::MAX_PERMITS);
        Self { places: Arc::new(Semaphore::new(places)), most }
    }

    /// A place, held until it is dropped.
    ///
    /// # Errors
    /// [`Code::Busy`] where all are taken.
    pub(super) fn place(&self) -> Result<OwnedSemaphorePermit, Problem> {
        Arc::clone(&self.places).try_acquire_owned().map_err(|_| {
            let most = self.most;
            let detail = format!("{most} clients wait for events or ends, as many as may (limits.listeners_max); ask again later, or without wait_s");
            Problem::new(Code::Busy, detail)
                .with("listeners_max_count", most)
                .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
        })
    }

    /// A place for a request that waits; one that does not needs none.
    ///
    /// # Errors
    /// As [`Listeners::place`].
    pub(super) fn place_for(&self, wait: Duration) -> Result<Option<OwnedSemaphorePermit>, Problem> {
        if wait.is_zero() { Ok(None) } else { self.place().map(Some) }
    }
}
