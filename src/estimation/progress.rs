//! How far an estimation has come, for whoever waits. Must not know who looks.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Profiles done so far; shared between the threads that calculate and one that shows it.
#[derive(Debug, Default)]
pub struct Progress(AtomicUsize);

impl Progress {
    /// One more profile is done.
    pub fn advance(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// Profiles done.
    #[must_use]
    pub fn done_count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}
