//! The one place of this adaptor that asks what time it is. Tokio's clock, which tests can stop.

use tokio::time::Instant;

/// The time now.
#[expect(
    clippy::disallowed_methods,
    reason = "the age of a heartbeat is measured here, on the clock that tests can stop"
)]
pub(super) fn now() -> Instant {
    Instant::now()
}
