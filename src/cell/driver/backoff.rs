//! How long to wait before a connection is tried again: doubles from a first to a longest wait. No chance in it: each device
//! has one client here, so nobody tries in step.

use std::time::Duration;

/// The next wait.
#[derive(Debug, Clone, Copy)]
pub(super) struct Backoff {
    first: Duration,
    last: Duration,
    next: Duration,
}

impl Backoff {
    pub(super) const fn new(first: Duration, last: Duration) -> Self {
        Self { first, last, next: first }
    }

    /// The connection is good again.
    pub(super) const fn relax(&mut self) {
        self.next = self.first;
    }

    /// How long to wait now.
    pub(super) fn wait(&mut self) -> Duration {
        let wait = self.next;
        self.next = (wait * 2).min(self.last);
        wait
    }
}
