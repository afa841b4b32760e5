//! The progress of an estimation and its cancellation; shared by the threads that calculate and those that wait.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Cancels a calculation whose result is no longer needed. The calculation ends soon, with a result that must not be used.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Cancels the calculation.
    pub fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the calculation was cancelled.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Number of profiles processed, and whether to continue.
#[derive(Debug, Default)]
pub struct Progress {
    done_count: AtomicUsize,
    stop: Stop,
}

impl Progress {
    /// The progress of an estimation that ends when `stop` is called.
    #[must_use]
    pub fn until(stop: &Stop) -> Self {
        Self { stop: stop.clone(), ..Self::default() }
    }

    /// The progress of a part of the estimation that is not counted.
    #[must_use]
    pub fn uncounted(&self) -> Self {
        Self::until(&self.stop)
    }

    /// Counts one more processed profile.
    pub fn advance(&self) {
        self.done_count.fetch_add(1, Ordering::Relaxed);
    }

    /// Number of processed profiles.
    #[must_use]
    pub fn done_count(&self) -> usize {
        self.done_count.load(Ordering::Relaxed)
    }

    /// Whether the estimation should end.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stop.is_stopped()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::{Method, Outcome, Settings, estimate};
    use crate::scan::synthetic::Part;
    use crate::scan::synthetic::make;

    #[test]
    fn a_cancelled_estimation_ends_early_with_every_method() {
        let (scan, _) = make(&Part { profiles_count: 60, points_count: 120, ..Part::smooth(3) }).expect("a scan");
        for method in Method::ALL {
            let settings = Settings { method, ..Settings::default() };
            let stop = Stop::default();
            let is_accepted =
                || matches!(estimate(&scan, &settings, &Progress::until(&stop)).outcome, Outcome::Accepted(_));
            assert!(is_accepted(), "{method:?}");
            stop.stop();
            assert!(!is_accepted(), "{method:?}");
        }
    }
}
