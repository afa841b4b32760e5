//! Where times and ids come from: the one place of the service that asks the machine. Must not know what they are for.

use jiff::Timestamp;
use std::time::{Duration, Instant};

/// The machine's clock and its source of ids.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock;

#[expect(clippy::disallowed_methods, reason = "service makes the times and ids that everybody else is given")]
impl Clock {
    /// The time now, to the microsecond that the store keeps.
    pub(super) fn now(self) -> Timestamp {
        let now = Timestamp::now();
        Timestamp::from_microsecond(now.as_microsecond()).unwrap_or(now)
    }

    /// A new id that sorts behind all earlier ones.
    pub(super) fn new_id(self, prefix: &str) -> String {
        format!("{prefix}{}", uuid::Uuid::now_v7())
    }

    /// Now on the clock that the cell goes by.
    pub(super) fn instant(self) -> tokio::time::Instant {
        tokio::time::Instant::now()
    }

    /// A moment of the cell's clock on the wall's, to the microsecond.
    pub(super) fn wall(self, at: tokio::time::Instant) -> Timestamp {
        let now = self.instant();
        let (behind, ahead) = (now.saturating_duration_since(at), at.saturating_duration_since(now));
        let micros = |span: Duration| i64::try_from(span.as_micros()).unwrap_or(i64::MAX);
        let there = self.now().as_microsecond().saturating_sub(micros(behind)).saturating_add(micros(ahead));
        Timestamp::from_microsecond(there).unwrap_or_else(|_| self.now())
    }

    /// Begins to measure a duration.
    pub(super) fn start(self) -> Stopwatch {
        Stopwatch(Instant::now())
    }
}

/// A duration that runs.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Time since it was started.
    #[must_use]
    pub fn elapsed(self) -> Duration {
        self.0.elapsed()
    }

    /// The same in whole milliseconds.
    #[must_use]
    pub fn elapsed_ms(self) -> u64 {
        u64::try_from(self.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}
