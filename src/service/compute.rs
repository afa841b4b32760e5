//! The single entry point to the processor: a pool of threads behind bounded queues, one for each kind of work. A few calculations
//! of a queue run at a time, a few wait, and a further one is refused at once. A calculation has a deadline; it is stopped
//! when the deadline passes or its client disconnects. Async threads never calculate.

use crate::estimation::Stop;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio::time::timeout;

/// A bounded queue in front of a pool of threads.
#[derive(Debug, Clone)]
pub struct Compute {
    pool: Arc<rayon::ThreadPool>,
    /// One permit for each request that waits or runs.
    places: Arc<Semaphore>,
    /// One permit for each request that runs.
    turns: Arc<Semaphore>,
    limits: QueueLimits,
}

/// Capacity of a queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueueLimits {
    /// Calculations that may run at a time.
    pub running_max: usize,
    /// Calculations that may wait.
    pub queue_max: usize,
    /// Time limit of a calculation, counted from its start.
    pub deadline: Duration,
}

/// A place in the queue for one request, kept until its calculation has ended even if its client disconnects.
#[derive(Debug, Clone)]
pub struct Place {
    _permit: Arc<OwnedSemaphorePermit>,
}

/// The permission of a queued request to run.
#[derive(Debug)]
pub struct Turn {
    _place: Place,
    _permit: OwnedSemaphorePermit,
}

/// Why a calculation was not started or not finished.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ComputeError {
    /// The queue is full.
    #[error("{running_max} calculations run and {queue_max} wait, which is the maximum")]
    Busy {
        /// Calculations that may run at a time.
        running_max: usize,
        /// Calculations that may wait.
        queue_max: usize,
    },
    /// The calculation exceeded its deadline and was stopped.
    #[error("the calculation did not end within {deadline_ms} ms and was stopped")]
    TooLong {
        /// The time limit, counted from its start.
        deadline_ms: u64,
    },
    /// The calculation panicked; the pool continues.
    #[error("a calculation panicked")]
    Panicked,
}

/// The current load of the pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load {
    /// Calculations that run.
    pub running_count: usize,
    /// Calculations that wait for their turn.
    pub queued_count: usize,
}

/// Stops a calculation when its result is no longer wanted.
struct StopWhenDropped(Stop);

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.0.stop();
    }
}

impl Compute {
    /// Starts a pool of `threads` threads (0: one per core) with a queue.
    ///
    /// # Errors
    /// If the threads cannot be started.
    pub fn start(threads: usize, limits: QueueLimits) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("compute-{i}")).build()?;
        Ok(Self::to(Arc::new(pool), limits))
    }

    /// A further queue for the same pool, with its own places: a full queue does not block the other one.
    #[must_use]
    pub fn beside(&self, running_max: usize, queue_max: usize) -> Self {
        Self::to(Arc::clone(&self.pool), QueueLimits { running_max, queue_max, ..self.limits })
    }

    fn to(pool: Arc<rayon::ThreadPool>, limits: QueueLimits) -> Self {
        let places_count = limits.running_max.saturating_add(limits.queue_max).min(Semaphore::MAX_PERMITS);
        let (places, turns) = (Semaphore::new(places_count), Semaphore::new(limits.running_max));
        Self { pool, places: Arc::new(places), turns: Arc::new(turns), limits }
    }

    /// Takes a place in the queue.
    ///
    /// # Errors
    /// [`ComputeError::Busy`] at once if the queue is full.
    pub fn take_place(&self) -> Result<Place, ComputeError> {
        let place = Arc::clone(&self.places).try_acquire_owned().map_err(|_| self.busy())?;
        Ok(Place { _permit: Arc::new(place) })
    }

    /// Runs `work` on the pool when it is its turn. If the caller stops waiting or the deadline passes, the work is asked to stop
    /// and its result is dropped.
    ///
    /// # Errors
    /// [`ComputeError::Busy`] at once if the queue is full; [`ComputeError::TooLong`], [`ComputeError::Panicked`].
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
    ) -> Result<T, ComputeError> {
        let turn = self.take_turn(&self.take_place()?).await?;
        self.run_in(turn, work).await
    }

    /// Waits until a place in the queue may run.
    ///
    /// # Errors
    /// [`ComputeError::Busy`] if the semaphore is closed, which never happens.
    pub async fn take_turn(&self, place: &Place) -> Result<Turn, ComputeError> {
        let permit = Arc::clone(&self.turns).acquire_owned().await.map_err(|_| self.busy())?;
        Ok(Turn { _place: place.clone(), _permit: permit })
    }

    /// Runs `work` on the pool in a turn that was taken before. The deadline counts from the moment at which a thread starts it.
    ///
    /// # Errors
    /// [`ComputeError::TooLong`], [`ComputeError::Panicked`].
    pub async fn run_in<T: Send + 'static>(
        &self,
        turn: Turn,
        work: impl FnOnce(&Stop) -> T + Send + 'static,
    ) -> Result<T, ComputeError> {
        let (begin, begun) = oneshot::channel();
        let (sender, receiver) = oneshot::channel();
        let stop = Stop::default();
        let _stopped = StopWhenDropped(stop.clone());
        let work = move || {
            // The receiver is gone if the client disconnected.
            let _ = begin.send(());
            work(&stop)
        };
        self.pool.spawn(move || work_and_answer(work, sender, turn));
        begun.await.map_err(|_| ComputeError::Panicked)?;
        let outcome = timeout(self.limits.deadline, receiver).await.map_err(|_| self.too_long())?;
        outcome.map_err(|_| ComputeError::Panicked)?
    }

    /// Refuses if a calculation requested now would be refused, before the client sends a large body in vain.
    ///
    /// # Errors
    /// [`ComputeError::Busy`].
    pub fn check_free(&self) -> Result<(), ComputeError> {
        if self.places.available_permits() == 0 { Err(self.busy()) } else { Ok(()) }
    }

    /// The current load.
    #[must_use]
    pub fn load(&self) -> Load {
        let QueueLimits { running_max, queue_max, .. } = self.limits;
        let running_count = running_max.saturating_sub(self.turns.available_permits());
        let taken = running_max.saturating_add(queue_max).saturating_sub(self.places.available_permits());
        Load { running_count, queued_count: taken.saturating_sub(running_count) }
    }

    const fn busy(&self) -> ComputeError {
        ComputeError::Busy { running_max: self.limits.running_max, queue_max: self.limits.queue_max }
    }

    fn too_long(&self) -> ComputeError {
        ComputeError::TooLong { deadline_ms: u64::try_from(self.limits.deadline.as_millis()).unwrap_or(u64::MAX) }
    }
}

fn work_and_answer<T>(work: impl FnOnce() -> T, sender: oneshot::Sender<Result<T, ComputeError>>, turn: Turn) {
    // A panic must not end the pool's thread. Nothing that `work` borrows is used again after a panic.
    let result = catch_unwind(AssertUnwindSafe(work)).map_err(|_| ComputeError::Panicked);
    drop(turn);
    // The receiver is gone if the client disconnected.
    let _ = sender.send(result);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    fn limits(queue_max: usize) -> QueueLimits {
        QueueLimits { running_max: 1, queue_max, deadline: Duration::from_secs(60) }
    }

    /// Starts a calculation that runs until it receives a message; returns once it runs.
    async fn occupy(compute: &Compute) -> (mpsc::Sender<()>, tokio::task::JoinHandle<Result<(), ComputeError>>) {
        let (end, ended) = mpsc::channel::<()>();
        let (start, started) = oneshot::channel();
        let compute = compute.clone();
        let task = tokio::spawn(async move {
            compute
                .run(move |_| {
                    let _ = start.send(());
                    let _ = ended.recv();
                })
                .await
        });
        started.await.expect("it runs");
        (end, task)
    }

    #[tokio::test]
    async fn a_full_queue_answers_busy_at_once_and_a_disconnected_client_frees_its_place() {
        let compute = Compute::start(1, limits(1)).expect("threads");
        let (end, running) = occupy(&compute).await;

        let mut queued = Box::pin(compute.run(|_| 1));
        assert!(futures_poll_once(&mut queued).await.is_none(), "it waits for its turn");
        assert_eq!(compute.load(), Load { running_count: 1, queued_count: 1 });
        assert_eq!(compute.check_free(), Err(ComputeError::Busy { running_max: 1, queue_max: 1 }));
        assert_eq!(compute.run(|_| 2).await, Err(ComputeError::Busy { running_max: 1, queue_max: 1 }));

        drop(queued);
        assert_eq!(compute.load(), Load { running_count: 1, queued_count: 0 });
        end.send(()).expect("it still runs");
        running.await.expect("joined").expect("no panic");
        assert_eq!(compute.run(|_| 3).await, Ok(3));
    }

    #[tokio::test]
    async fn a_panic_fails_only_its_own_calculation() {
        let compute = Compute::start(1, limits(0)).expect("threads");
        let panicked: Result<(), _> = compute.run(|_| panic!("made to")).await;
        assert_eq!(panicked, Err(ComputeError::Panicked));
        assert_eq!(compute.run(|_| 4).await, Ok(4));
    }

    #[tokio::test]
    async fn a_calculation_past_its_deadline_is_stopped_and_keeps_its_place_until_it_has_ended() {
        let deadline = Duration::from_millis(20);
        let compute = Compute::start(1, QueueLimits { running_max: 1, queue_max: 0, deadline }).expect("threads");
        let (end, ended) = mpsc::channel::<()>();
        let (told, was_told) = oneshot::channel();
        let outcome: Result<(), _> = compute
            .run(move |stop| {
                while !stop.is_stopped() {
                    std::thread::yield_now();
                }
                let _ = told.send(());
                let _ = ended.recv();
            })
            .await;
        assert_eq!(outcome, Err(ComputeError::TooLong { deadline_ms: 20 }));
        was_told.await.expect("it was asked to stop");
        assert!(matches!(compute.run(|_| 1).await, Err(ComputeError::Busy { .. })), "it still runs");
        end.send(()).expect("it waits for this");
        while compute.load().running_count > 0 {
            tokio::task::yield_now().await;
        }
        assert_eq!(compute.run(|_| 2).await, Ok(2));
    }

    #[tokio::test]
    async fn a_calculation_whose_client_disconnected_is_stopped() {
        let compute = Compute::start(1, limits(0)).expect("threads");
        let (told, was_told) = oneshot::channel();
        let mut running = Box::pin(compute.run(move |stop| {
            while !stop.is_stopped() {
                std::thread::yield_now();
            }
            let _ = told.send(());
        }));
        assert!(futures_poll_once(&mut running).await.is_none(), "it runs");
        drop(running);
        was_told.await.expect("it was asked to stop");
    }

    async fn futures_poll_once<F: Future + Unpin>(future: &mut F) -> Option<F::Output> {
        std::future::poll_fn(|context| match std::pin::Pin::new(&mut *future).poll(context) {
            std::task::Poll::Ready(output) => std::task::Poll::Ready(Some(output)),
            std::task::Poll::Pending => std::task::Poll::Ready(None),
        })
        .await
    }
}
