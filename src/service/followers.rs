//! Tasks that go on when whoever asked for them hangs up: those that see jobs to their end, and work that is done as a whole or
//! not at all. The end of the service waits for them.

use super::compute::ComputeError;
use super::error::ServiceError;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Tasks that see jobs to their end, and the news that one has.
#[derive(Debug)]
pub(super) struct Followers {
    tasks: Mutex<Vec<JoinHandle<()>>>,
    pub(super) ended: watch::Sender<u64>,
}

impl Followers {
    pub(super) fn new() -> Self {
        Self { tasks: Mutex::new(Vec::new()), ended: watch::Sender::new(0) }
    }

    /// Has a task run to its end, whoever hangs up.
    pub(super) fn add(&self, task: impl Future<Output = ()> + Send + 'static) {
        let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
        tasks.retain(|task| !task.is_finished());
        tasks.push(tokio::spawn(task));
    }

    /// Work that goes on when its caller hangs up: it is done, recorded and remembered as a whole or not at all.
    pub(super) async fn whole<T: Send + 'static>(
        &self,
        work: impl Future<Output = Result<T, ServiceError>> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let (sender, outcome) = oneshot::channel();
        self.add(async move {
            // Nobody listens any more where the caller hung up.
            let _ = sender.send(work.await);
        });
        outcome.await.unwrap_or_else(|_| Err(ComputeError::Panicked.into()))
    }

    /// How many tasks were added and have not been seen to end.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// Waits for all tasks, and for those that they add; no longer than `wait`.
    pub(super) async fn finish(&self, wait: Duration) {
        let all = async {
            loop {
                let tasks = std::mem::take(&mut *self.tasks.lock().unwrap_or_else(PoisonError::into_inner));
                if tasks.is_empty() {
                    return;
                }
                for task in tasks {
                    // One that panicked has ended, too.
                    let _ = task.await;
                }
            }
        };
        let _ = timeout(wait, all).await;
    }
}

/// Work that takes the processor for a while, beside the threads that answer.
pub(super) async fn aside<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| Err(ComputeError::Panicked.into()))
}
