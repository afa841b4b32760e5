//! The clock of devices and of the cell: tokio's, which tests can pause.

use tokio::time::Instant;

/// The current time.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "the one place that reads this clock")]
pub fn now() -> Instant {
    Instant::now()
}
