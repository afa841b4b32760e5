//! Source of times and ids: the only file of the service that reads the system clock.

use jiff::Timestamp;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use uuid::{ContextV7, Uuid};

/// The system clock and the generator of ids.
#[derive(Debug, Clone, Copy)]
pub(in crate::service) struct Clock;

#[expect(clippy::disallowed_methods, reason = "the service supplies times and ids to all other layers")]
impl Clock {
    /// The time now, to the microsecond that the store keeps.
    pub(in crate::service) fn now(self) -> Timestamp {
        let now = Timestamp::now();
        Timestamp::from_microsecond(now.as_microsecond()).unwrap_or(now)
    }

    /// A new id that sorts after all earlier ones of this process, even if the clock was set back.
    pub(in crate::service) fn new_id(self, prefix: &str) -> String {
        let ids = IDS.lock().unwrap_or_else(PoisonError::into_inner);
        format!("{prefix}{}", next_id(&ids, self.now()))
    }

    /// The current time on the clock that the cell uses.
    pub(in crate::service) fn instant(self) -> tokio::time::Instant {
        tokio::time::Instant::now()
    }

    /// Converts an instant of the cell's clock to wall-clock time, to the microsecond.
    pub(in crate::service) fn wall(self, at: tokio::time::Instant) -> Timestamp {
        let now = self.instant();
        let (behind, ahead) = (now.saturating_duration_since(at), at.saturating_duration_since(now));
        let micros = |span: Duration| i64::try_from(span.as_micros()).unwrap_or(i64::MAX);
        let there = self.now().as_microsecond().saturating_sub(micros(behind)).saturating_add(micros(ahead));
        Timestamp::from_microsecond(there).unwrap_or_else(|_| self.now())
    }

    /// Starts to measure a duration.
    pub(in crate::service) fn start(self) -> Stopwatch {
        Stopwatch(Instant::now())
    }
}

/// Continues to count while the clock stands still or goes back.
static IDS: Mutex<ContextV7> = Mutex::new(ContextV7::new());

/// An id for a time; times before 1970 are treated as 1970, the first time that an id can encode.
fn next_id(ids: &ContextV7, now: Timestamp) -> Uuid {
    let (seconds, nanos) = (u64::try_from(now.as_second()), u32::try_from(now.subsec_nanosecond()));
    Uuid::new_v7(uuid::Timestamp::from_unix(ids, seconds.unwrap_or(0), nanos.unwrap_or(0)))
}

/// A running duration.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Time since the start.
    #[must_use]
    pub fn elapsed(self) -> Duration {
        self.0.elapsed()
    }

    /// Time since the start in whole milliseconds.
    #[must_use]
    pub fn elapsed_ms(self) -> u64 {
        u64::try_from(self.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_increase_when_the_clock_is_set_back_even_to_before_1970() {
        let ids = ContextV7::new();
        let at = |second| next_id(&ids, Timestamp::from_second(second).expect("a time"));
        let made = [at(1_800_000_000), at(1_700_000_000), at(-3_600), at(1_800_000_001)];
        assert!(made.is_sorted() && made[0] != made[1] && made[1] != made[2], "{made:?}");
        let first = next_id(&ContextV7::new(), Timestamp::from_second(-1).expect("a time"));
        assert_eq!(first.get_version_num(), 7);
    }
}
