//! The one task that writes. Writes wait in a queue; the task executes all waiting writes in one transaction and answers each when
//! the commit is on the disk, so that many clients share one wait for the disk and none ever waits for a lock.
//!
//! ```text
//! write ─┐
//! write ─┼─> queue ──> begin, apply, apply, …, commit ──> answers
//! write ─┘                        │ failed
//!                                 └──> roll back, then each write in a transaction of its own
//! ```
//!
//! Every commit is counted beside the database before it is answered, see `commits`.
//!
//! A write continues when its caller is dropped; it is executed completely or not at all.

use std::{future::Future, pin::Pin, sync::Arc};

use sqlx::{Connection, SqliteConnection};
use tokio::sync::{mpsc, oneshot};

use super::commits::{CommitLog, Commits};
use super::database;
use super::database::StoreLimits;
use super::error::StoreError;
use super::folder::{Folder, blocking};

/// An operation that is executed within a transaction.
pub(super) trait Write: Send + Sync + 'static {
    /// The result for the caller once it is durable.
    type Outcome: Send;

    /// Runs its statements. It may run again after a roll-back, so it must not change itself.
    fn apply(&self, database: &mut SqliteConnection) -> impl Future<Output = Result<Self::Outcome, StoreError>> + Send;

    /// Cleans up outside the database, once it is known whether the write was executed or refused.
    fn conclude(&self, _database: &mut SqliteConnection) -> impl Future<Output = ()> + Send {
        std::future::ready(())
    }
}

/// The callers' handle of the queue.
#[derive(Debug, Clone)]
pub(super) struct Writer {
    queue: mpsc::Sender<Order>,
}

/// Greatest number of waiting writes; further callers wait until there is space.
const QUEUE: usize = 256;

/// Greatest number of writes in one commit, which limits the work that is repeated after a failure.
const BATCH: usize = 64;

enum Order {
    Write(Box<dyn Job>),
    Close(oneshot::Sender<()>),
}

impl Writer {
    /// Starts the task on a migrated connection. It keeps the folder, so that its lock outlives the last write.
    pub(super) fn start(
        folder: Arc<Folder>,
        limits: StoreLimits,
        connection: SqliteConnection,
        commits: Arc<CommitLog>,
    ) -> Self {
        let (queue, orders) = mpsc::channel(QUEUE);
        let task = Task { folder, limits, connection: Some(connection), commits };
        tokio::spawn(task.run(orders));
        Self { queue }
    }

    /// Returns when the write is durable.
    pub(super) async fn write<W: Write>(&self, write: W) -> Result<W::Outcome, StoreError> {
        let (answer, answered) = oneshot::channel();
        let job = Pending { write, outcome: None, answer };
        self.queue.send(Order::Write(Box::new(job))).await.map_err(|_| StoreError::Closed)?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// Finishes the waiting writes, then closes the connection; later writes are refused.
    pub(super) async fn close(&self) {
        let (answer, answered) = oneshot::channel();
        if self.queue.send(Order::Close(answer)).await.is_ok() {
            // No answer means that the task has already ended.
            let _ = answered.await;
        }
    }
}

/// A type-erased write, so that different kinds share a queue.
trait Job: Send {
    fn apply<'a>(&'a mut self, database: &'a mut SqliteConnection) -> Applying<'a>;
    fn conclude<'a>(&'a mut self, database: &'a mut SqliteConnection) -> Concluding<'a>;
    fn acknowledge(self: Box<Self>);
    fn refuse(self: Box<Self>, error: StoreError);
}

type Applying<'a> = Pin<Box<dyn Future<Output = Result<(), StoreError>> + Send + 'a>>;
type Concluding<'a> = Pin<Box<dyn Future<Output = ()> + Send + 'a>>;

struct Pending<W: Write> {
    write: W,
    outcome: Option<W::Outcome>,
    answer: oneshot::Sender<Result<W::Outcome, StoreError>>,
}

impl<W: Write> Job for Pending<W> {
    fn apply<'a>(&'a mut self, database: &'a mut SqliteConnection) -> Applying<'a> {
        Box::pin(async move {
            self.outcome = Some(self.write.apply(database).await?);
            Ok(())
        })
    }

    fn conclude<'a>(&'a mut self, database: &'a mut SqliteConnection) -> Concluding<'a> {
        Box::pin(self.write.conclude(database))
    }

    // In both cases a dropped caller needs no answer, and the data of the write are dropped before it is answered.
    fn acknowledge(self: Box<Self>) {
        let Self { write, outcome, answer } = *self;
        drop(write);
        if let Some(outcome) = outcome {
            let _ = answer.send(Ok(outcome));
        }
    }

    fn refuse(self: Box<Self>, error: StoreError) {
        let Self { write, answer, .. } = *self;
        drop(write);
        let _ = answer.send(Err(error));
    }
}

struct Task {
    folder: Arc<Folder>,
    limits: StoreLimits,
    /// `None` after a failure; the next write opens the connection again.
    connection: Option<SqliteConnection>,
    commits: Arc<CommitLog>,
}

impl Task {
    async fn run(mut self, mut orders: mpsc::Receiver<Order>) {
        let mut batch = Vec::with_capacity(BATCH);
        let mut closers = Vec::new();
        while orders.recv_many(&mut batch, BATCH).await > 0 {
            let mut jobs = Vec::with_capacity(batch.len());
            for order in batch.drain(..) {
                match order {
                    Order::Write(job) => jobs.push(job),
                    Order::Close(answer) => {
                        orders.close();
                        closers.push(answer);
                    }
                }
            }
            self.settle(jobs).await;
        }
        if let Some(connection) = self.connection.take() {
            // All acknowledged data are already in the log; only cleaning up can fail here.
            let _ = connection.close().await;
        }
        drop(self);
        for answer in closers {
            let _ = answer.send(());
        }
    }

    /// Executes all in one transaction. If that fails for a reason that one of them may have caused, each is executed in its own.
    async fn settle(&mut self, mut jobs: Vec<Box<dyn Job>>) {
        if jobs.is_empty() {
            return;
        }
        match self.commit(&mut jobs).await {
            Ok(()) => {
                self.conclude(&mut jobs).await;
                jobs.into_iter().for_each(Job::acknowledge);
            }
            Err(Refused::One(_)) if jobs.len() > 1 => {
                for job in jobs {
                    Box::pin(self.settle(vec![job])).await;
                }
            }
            Err(Refused::One(error) | Refused::All(error)) => {
                self.conclude(&mut jobs).await;
                jobs.into_iter().for_each(|job| job.refuse(error.clone()));
            }
        }
    }

    async fn conclude(&mut self, jobs: &mut [Box<dyn Job>]) {
        // Without a database the result is unknown; the next start removes leftover files.
        if let Ok(mut connection) = self.connect().await {
            for job in jobs {
                job.conclude(&mut connection).await;
            }
            self.connection = Some(connection);
        }
    }

    async fn connect(&mut self) -> Result<SqliteConnection, StoreError> {
        match self.connection.take() {
            Some(connection) => Ok(connection),
            None => {
                self.commits.forget_identity();
                database::writer(&self.folder.database(), self.limits.database_bytes_max).await
            }
        }
    }

    /// After a failure the connection is kept only if it is known to be consistent: SQLite ends some transactions by itself, and
    /// then connection and driver disagree about whether one is open.
    async fn commit(&mut self, jobs: &mut [Box<dyn Job>]) -> Result<(), Refused> {
        #[cfg(test)]
        self.commits.check_room().map_err(Refused::All)?;
        let commits = Arc::clone(&self.commits);
        blocking(move || commits.admit()).await.map_err(Refused::All)?;
        let mut connection = self.connect().await.map_err(Refused::All)?;
        match transact(&mut connection, jobs, &self.commits).await {
            Ok(counted) => {
                self.connection = Some(connection);
                let commits = Arc::clone(&self.commits);
                // A committed write must not be repeated, even if its count cannot be written.
                blocking(move || commits.acknowledge(counted)).await.map_err(Refused::All)
            }
            Err(Failure { error, rolled_back }) => {
                if rolled_back && !concerns_all(&error) {
                    self.connection = Some(connection);
                } else {
                    let _ = connection.close().await;
                }
                Err(if concerns_all(&error) { Refused::All(error) } else { Refused::One(error) })
            }
        }
    }
}

/// Why a transaction was not acknowledged.
enum Refused {
    /// One of its writes may have caused it; nothing was written.
    One(StoreError),
    /// The writes have not caused it, or were written.
    All(StoreError),
}

struct Failure {
    error: StoreError,
    rolled_back: bool,
}

impl From<sqlx::Error> for Failure {
    fn from(error: sqlx::Error) -> Self {
        Self { error: error.into(), rolled_back: false }
    }
}

async fn transact(
    connection: &mut SqliteConnection,
    jobs: &mut [Box<dyn Job>],
    commits: &CommitLog,
) -> Result<Commits, Failure> {
    let mut transaction = connection.begin_with(database::BEGIN).await?;
    for job in jobs {
        if let Err(error) = job.apply(&mut transaction).await {
            let rolled_back = transaction.rollback().await.is_ok();
            return Err(Failure { error, rolled_back });
        }
    }
    let counted = match commits.count(&mut transaction).await {
        Ok(counted) => counted,
        Err(error) => {
            let rolled_back = transaction.rollback().await.is_ok();
            return Err(Failure { error, rolled_back });
        }
    };
    transaction.commit().await?;
    Ok(counted)
}

/// Whether trying the writes one by one is pointless. A full disk does not count: a small write may still fit.
fn concerns_all(error: &StoreError) -> bool {
    matches!(
        error,
        StoreError::Unavailable(_) | StoreError::Damaged(_) | StoreError::Closed | StoreError::RecordsLost(_)
    )
}
