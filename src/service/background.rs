//! Tasks that continue when the client that started them disconnects: they follow jobs to their end, or do work that must be
//! completed or not done at all. The shutdown also has one time budget here: each stage may run until its share of the budget is
//! used, and the time that a stage does not need passes to the next one.
//!
//! ```text
//! shutdown begins ── motion stopped ── requests finished ── ends of jobs written ── store closed
//! 0                  1/3               3/4                  11/12                   1
//! ```

use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout};

use super::compute::ComputeError;
use super::error::ServiceError;

/// Tasks that follow jobs to their end, and a notification when a job has ended.
#[derive(Debug)]
pub(in crate::service) struct BackgroundTasks {
    tasks: Mutex<Vec<JoinHandle<()>>>,
    pub(in crate::service) ended: watch::Sender<u64>,
}

impl BackgroundTasks {
    pub(in crate::service) fn new() -> Self {
        Self { tasks: Mutex::new(Vec::new()), ended: watch::Sender::new(0) }
    }

    /// Runs a task to its end, even if the client disconnects.
    pub(in crate::service) fn add(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        tasks.retain(|task| !task.is_finished());
        tasks.push(tokio::spawn(task));
    }

    /// Runs work to its end even if its caller disconnects, so that it is done, recorded and remembered completely or not at all.
    pub(in crate::service) async fn run_detached<T: Send + 'static>(
        &self,
        work: impl Future<Output = Result<T, ServiceError>> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let (sender, outcome) = oneshot::channel();
        self.add(async move {
            // The receiver is gone if the caller disconnected.
            let _ = sender.send(work.await);
        });
        outcome.await.unwrap_or_else(|_| Err(ComputeError::Panicked.into()))
    }

    /// How many tasks were added and have not ended yet.
    #[cfg(test)]
    pub(in crate::service) fn count(&self) -> usize {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// Waits for all tasks and for those that they add, at most for `wait`.
    pub(in crate::service) async fn finish(&self, wait: Duration) {
        let all = async {
            loop {
                let tasks = std::mem::take(&mut *self.tasks.lock().unwrap_or_else(PoisonError::into_inner));
                if tasks.is_empty() {
                    return;
                }
                for task in tasks {
                    // A task that panicked has ended, too.
                    let _ = task.await;
                }
            }
        };
        let _ = timeout(wait, all).await;
    }
}

/// Runs processor-bound work outside the async threads.
pub(in crate::service) async fn run_blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| Err(ComputeError::Panicked.into()))
}

/// The time budget of the shutdown, and when it began.
#[derive(Debug)]
pub(super) struct Shutdown {
    budget: Duration,
    begun_at: OnceLock<Instant>,
    begun: watch::Sender<bool>,
}

/// What must be finished by the end of the stage.
#[derive(Debug, Clone, Copy)]
pub(super) enum Stage {
    /// Nothing moves, and the devices are released.
    Motion,
    /// Requests under way are answered.
    Requests,
    /// The ends of jobs are recorded.
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

impl Shutdown {
    pub(super) fn new(budget: Duration) -> Self {
        Self { budget, begun_at: OnceLock::new(), begun: watch::Sender::new(false) }
    }

    /// Time left for a stage at `now`; the first call starts the budget.
    pub(super) fn left(&self, now: Instant, stage: Stage) -> Duration {
        let begun_at = *self.begun_at.get_or_init(|| now);
        (self.budget * stage.twelfths() / 12).saturating_sub(now.saturating_duration_since(begun_at))
    }

    /// Notifies all waiting tasks that the service is shutting down.
    pub(super) fn begin(&self) {
        self.begun.send_replace(true);
    }

    /// Whether the service is shutting down.
    pub(super) fn has_begun(&self) -> bool {
        *self.begun.borrow()
    }

    /// Becomes true when the service shuts down.
    pub(super) fn watch(&self) -> watch::Receiver<bool> {
        self.begun.subscribe()
    }

    /// Returns when the service shuts down.
    pub(super) async fn wait(&self) {
        // The sender lives as long as `self`.
        let _ = self.begun.subscribe().wait_for(|begun| *begun).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn all_stages_of_the_shutdown_share_one_budget() {
        let shutdown = Shutdown::new(Duration::from_secs(12));
        let begun = crate::cell::now();
        let after = |seconds| begun + Duration::from_secs(seconds);
        let left = |seconds, stage| shutdown.left(after(seconds), stage).as_secs();
        assert_eq!(left(0, Stage::Motion), 4);
        assert_eq!([left(1, Stage::Requests), left(5, Stage::Requests), left(10, Stage::Requests)], [8, 4, 0]);
        assert_eq!([left(9, Stage::Ends), left(11, Stage::Store), left(60, Stage::Store)], [2, 1, 0]);
    }
}
