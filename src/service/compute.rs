//! The way to the processor: a pool of threads of its own behind doors, one for each kind of work; a door lets a few
//! calculations run at a time, has a short queue, and answers at once when both are full. Async threads never calculate. Must not know what is calculated.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// A door: a pool of threads behind a bounded queue.
#[derive(Debug, Clone)]
pub struct Compute {
    pool: Arc<rayon::ThreadPool>,
    /// One permit for everybody who waits or runs.
    places: Arc<Semaphore>,
    /// One permit for everybody who runs.
    turns: Arc<Semaphore>,
    running_max: usize,
    queue_max: usize,
}

/// Why a calculation was not made, or not finished.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ComputeError {
    /// As many run and wait as may.
    #[error("{running_max} calculations run and {queue_max} wait, which is as many as may")]
    Busy {
        /// Calculations that may run at a time.
        running_max: usize,
        /// Calculations that may wait.
        queue_max: usize,
    },
    /// The calculation panicked; the pool goes on.
    #[error("a calculation panicked")]
    Panicked,
}

/// How much the pool has to do right now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load {
    /// Calculations that run.
    pub running_count: usize,
    /// Calculations that wait for their turn.
    pub queued_count: usize,
}

impl Compute {
    /// A pool of `threads` threads (0: one a core) that runs `running_max` calculations at a time and lets
    /// `queue_max` wait.
    ///
    /// # Errors
    /// Where the threads cannot be started.
    pub fn start(threads: usize, running_max: usize, queue_max: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("compute-{i}")).build()?;
        Ok(Self::to(Arc::new(pool), running_max, queue_max))
    }

    /// A further door to the same pool, with places of its own: neither is refused for what goes through the other.
    #[must_use]
    pub fn beside(&self, running_max: usize, queue_max: usize) -> Self {
        Self::to(Arc::clone(&self.pool), running_max, queue_max)
    }

    fn to(pool: Arc<rayon::ThreadPool>, running_max: usize, queue_max: usize) -> Self {
        Self {
            pool,
            places: Arc::new(Semaphore::new(running_max + queue_max)),
            turns: Arc::new(Semaphore::new(running_max)),
            running_max,
            queue_max,
        }
    }

    /// Runs `work` on the pool. Whoever stops waiting while queued gives up the place; what runs, runs to its end.
    ///
    /// # Errors
    /// [`ComputeError::Busy`] at once where there is no place; [`ComputeError::Panicked`] where `work` panicked.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Result<T, ComputeError> {
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| self.busy())?;
        self.run_at(place, work).await
    }

    /// The same for what cannot be asked for again: where there is no place, it gets the next one that is free.
    ///
    /// # Errors
    /// [`ComputeError::Panicked`] where `work` panicked.
    pub async fn run_queued<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ComputeError> {
        let place = Arc::clone(&self.places).acquire_owned().await.map_err(|_| self.busy())?;
        self.run_at(place, work).await
    }

    async fn run_at<T: Send + 'static>(
        &self,
        place: OwnedSemaphorePermit,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ComputeError> {
        // The semaphores are never closed; should they be, nobody can be served.
        let turn = Arc::clone(&self.turns).acquire_owned().await.map_err(|_| self.busy())?;
        let (sender, receiver) = oneshot::channel();
        self.pool.spawn(move || work_and_answer(work, sender, (place, turn)));
        receiver.await.map_err(|_| ComputeError::Panicked)?
    }

    /// Refuses where a calculation asked for now would be refused, so that nobody sends a large body in vain.
    ///
    /// # Errors
    /// [`ComputeError::Busy`].
    pub fn check_free(&self) -> Result<(), ComputeError> {
        if self.places.available_permits() == 0 { Err(self.busy()) } else { Ok(()) }
    }

    /// What runs and waits right now.
    #[must_use]
    pub fn load(&self) -> Load {
        let running_count = self.running_max.saturating_sub(self.turns.available_permits());
        let taken = (self.running_max + self.queue_max).saturating_sub(self.places.available_permits());
        Load { running_count, queued_count: taken.saturating_sub(running_count) }
    }

    const fn busy(&self) -> ComputeError {
        ComputeError::Busy { running_max: self.running_max, queue_max: self.queue_max }
    }
}

fn work_and_answer<T>(
    work: impl FnOnce() -> T,
    sender: oneshot::Sender<Result<T, ComputeError>>,
    permits: (OwnedSemaphorePermit, OwnedSemaphorePermit),
) {
    // A panic must not take the pool's thread with it. Nothing that `work` borrows is used again after one.
    let result = catch_unwind(AssertUnwindSafe(work)).map_err(|_| ComputeError::Panicked);
    drop(permits);
    // Nobody listens any more where the client hung up.
    let _ = sender.send(result);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    /// Starts a calculation that runs until told to end; returns once it runs.
    async fn occupy(compute: &Compute) -> (mpsc::Sender<()>, tokio::task::JoinHandle<Result<(), ComputeError>>) {
        let (end, ended) = mpsc::channel::<()>();
        let (start, started) = oneshot::channel();
        let compute = compute.clone();
        let task = tokio::spawn(async move {
            compute
                .run(move || {
                    let _ = start.send(());
                    let _ = ended.recv();
                })
                .await
        });
        started.await.expect("it runs");
        (end, task)
    }

    #[tokio::test]
    async fn beyond_running_and_queue_the_answer_is_busy_at_once_and_a_hung_up_client_frees_its_place() {
        let compute = Compute::start(1, 1, 1).expect("threads");
        let (end, running) = occupy(&compute).await;

        let mut queued = Box::pin(compute.run(|| 1));
        assert!(futures_poll_once(&mut queued).await.is_none(), "it waits for its turn");
        assert_eq!(compute.load(), Load { running_count: 1, queued_count: 1 });
        assert_eq!(compute.check_free(), Err(ComputeError::Busy { running_max: 1, queue_max: 1 }));
        assert_eq!(compute.run(|| 2).await, Err(ComputeError::Busy { running_max: 1, queue_max: 1 }));

        drop(queued);
        assert_eq!(compute.load(), Load { running_count: 1, queued_count: 0 });
        end.send(()).expect("it still runs");
        running.await.expect("joined").expect("no panic");
        assert_eq!(compute.run(|| 3).await, Ok(3));
    }

    #[tokio::test]
    async fn a_panic_is_an_error_of_its_own_calculation_only() {
        let compute = Compute::start(1, 1, 0).expect("threads");
        let panicked: Result<(), _> = compute.run(|| panic!("made to")).await;
        assert_eq!(panicked, Err(ComputeError::Panicked));
        assert_eq!(compute.run(|| 4).await, Ok(4));
    }

    async fn futures_poll_once<F: Future + Unpin>(future: &mut F) -> Option<F::Output> {
        std::future::poll_fn(|context| match std::pin::Pin::new(&mut *future).poll(context) {
            std::task::Poll::Ready(output) => std::task::Poll::Ready(Some(output)),
            std::task::Poll::Pending => std::task::Poll::Ready(None),
        })
        .await
    }
}
