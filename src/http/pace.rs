//! The least speed of a transfer. It is judged over windows of the time in which the other side is waited for, so a fast
//! beginning does not pay for a slow end, and time in which this side is busy does not count.

use std::time::Duration;

/// How fast a transfer is, at this moment.
#[derive(Debug, Clone)]
pub(super) struct Pace {
    window: Duration,
    bytes_min: u64,
    waited: Duration,
    bytes_count: u64,
}

impl Pace {
    /// At least `bytes_per_s_min` bytes a second, judged after every `window` of waiting; 0 accepts any speed but
    /// none at all.
    pub(super) fn new(window: Duration, bytes_per_s_min: u64) -> Self {
        let millis = u64::try_from(window.as_millis()).unwrap_or(u64::MAX);
        let bytes_min = (bytes_per_s_min.saturating_mul(millis) / 1000).max(1);
        Self { window, bytes_min, waited: Duration::ZERO, bytes_count: 0 }
    }

    /// How long may be waited until the window is over.
    pub(super) fn remaining(&self) -> Duration {
        self.window.saturating_sub(self.waited)
    }

    /// Notes bytes that came through, after a time of waiting.
    pub(super) fn note(&mut self, bytes_count: u64, waited: Duration) {
        self.bytes_count = self.bytes_count.saturating_add(bytes_count);
        self.waited = self.waited.saturating_add(waited);
    }

    /// Whether a window is over in which fewer bytes came through than must. Begins the next window where one is over.
    pub(super) fn is_too_slow(&mut self) -> bool {
        if self.waited < self.window {
            return false;
        }
        let too_few = self.bytes_count < self.bytes_min;
        self.waited = Duration::ZERO;
        self.bytes_count = 0;
        too_few
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_beginning_does_not_pay_for_a_slow_end() {
        let mut pace = Pace::new(Duration::from_secs(10), 100);
        pace.note(1 << 30, Duration::from_secs(9));
        assert!(!pace.is_too_slow() && pace.remaining() == Duration::from_secs(1));
        pace.note(0, Duration::from_secs(1));
        assert!(!pace.is_too_slow(), "the first window had bytes enough");
        pace.note(999, Duration::from_secs(10));
        assert!(pace.is_too_slow(), "the second had one too few");
        pace.note(1000, Duration::from_secs(10));
        assert!(!pace.is_too_slow());
    }

    #[test]
    fn without_a_least_speed_only_standing_still_is_too_slow() {
        let mut pace = Pace::new(Duration::from_secs(10), 0);
        pace.note(1, Duration::from_secs(10));
        assert!(!pace.is_too_slow());
        pace.note(0, Duration::from_secs(10));
        assert!(pace.is_too_slow());
    }
}
