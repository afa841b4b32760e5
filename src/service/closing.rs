//! The end of the service within one budget of time: every stage may take until a share of it is over, and what a stage leaves
//! goes to the next one.
//!
//! ```text
//! told to end ── motion stopped ── requests finished ── ends of jobs written ── store closed
//! 0              1/3               3/4                  11/12                   1
//! ```

use std::sync::OnceLock;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// The budget, and when it began.
#[derive(Debug)]
pub(super) struct Closing {
    budget: Duration,
    begun_at: OnceLock<Instant>,
    told: watch::Sender<bool>,
}

/// What has to be over by then.
#[derive(Debug, Clone, Copy)]
pub(super) enum Stage {
    /// Nothing moves, and the devices are let go.
    Motion,
    /// Requests under way are answered.
    Requests,
    /// The ends of jobs are written down.
    Ends,
    /// The store is closed.
    Store,
}

impl Stage {
    /// Twelfths of the budget.
    const fn twelfths(self) -> u32 {
        match self {
            Self::Motion => 4,
            Self::Requests => 9,
            Self::Ends => 11,
            Self::Store => 12,
        }
    }
}

impl Closing {
    pub(super) fn new(budget: Duration) -> Self {
        Self { budget, begun_at: OnceLock::new(), told: watch::Sender::new(false) }
    }

    /// What is left for a stage at `now`; the budget begins with the first call.
    pub(super) fn left(&self, now: Instant, stage: Stage) -> Duration {
        let begun_at = *self.begun_at.get_or_init(|| now);
        (self.budget * stage.twelfths() / 12).saturating_sub(now.saturating_duration_since(begun_at))
    }

    /// Tells everybody who waits that the service ends.
    pub(super) fn tell(&self) {
        self.told.send_replace(true);
    }

    /// Whether the service ends.
    pub(super) fn is_told(&self) -> bool {
        *self.told.borrow()
    }

    /// Becomes true when the service ends.
    pub(super) fn watch(&self) -> watch::Receiver<bool> {
        self.told.subscribe()
    }

    /// Returns when the service ends.
    pub(super) async fn wait(&self) {
        // The sender lives as long as this.
        let _ = self.told.subscribe().wait_for(|told| *told).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn all_stages_of_the_end_share_one_budget() {
        let closing = Closing::new(Duration::from_secs(12));
        let begun = crate::cell::now();
        let after = |seconds| begun + Duration::from_secs(seconds);
        let left = |seconds, stage| closing.left(after(seconds), stage).as_secs();
        assert_eq!(left(0, Stage::Motion), 4);
        assert_eq!([left(1, Stage::Requests), left(5, Stage::Requests), left(10, Stage::Requests)], [8, 4, 0]);
        assert_eq!([left(9, Stage::Ends), left(11, Stage::Store), left(60, Stage::Store)], [2, 1, 0]);
    }
}
