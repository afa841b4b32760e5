//! Whether a device's heartbeat counts. A communication processor may answer for a program that has stopped; its registers then
//! stay as they are.

use std::time::Duration;
use tokio::time::Instant;

/// The heartbeat as it was seen last, and since when it has been that. Lives across connections.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pulse {
    stale: Duration,
    seen: Option<(u16, Instant)>,
}

impl Pulse {
    pub(super) const fn new(stale: Duration) -> Self {
        Self { stale, seen: None }
    }

    /// For how long it has stood, where that is too long.
    pub(super) fn stands(&mut self, heartbeat: u16, now: Instant) -> Option<Duration> {
        match self.seen {
            Some((last, since)) if last == heartbeat => Some(now - since).filter(|age| *age > self.stale),
            _ => {
                self.seen = Some((heartbeat, now));
                None
            }
        }
    }
}
