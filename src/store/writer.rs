//! The one task that writes. Writes wait in a queue; the task takes all that wait into one transaction and answers each
//! when the commit is on the disk, so that many clients share one wait for the disk and none ever meets a lock.
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
//! A caller that goes away does not stop its write: a write is done or not done, never half.

use std::{future::Future, pin::Pin, sync::Arc};

use sqlx::{Connection, SqliteConnection};
use tokio::sync::{mpsc, oneshot};

use super::commits::{CommitLog, Commits};
use super::database;
use super::database::StoreLimits;
use super::error::StoreError;
use super::folder::{Folder, blocking};

/// Something that is written within a transaction.
pub(super) trait Write: Send + Sync + 'static {
    /// The result for the caller once it is durable.
    type Outcome: Send;

    /// Runs its statements. May run again after a roll-back, so it must not change itself.
    fn apply(&self, database: &mut SqliteConnection) -> impl Future<Output = Result<Self::Outcome, StoreError>> + Send;

    /// Cleans up beside the database, once it is known whether the write was done or refused.
    fn conclude(&self, _database: &mut SqliteConnection) -> impl Future<Output = ()> + Send {
        std::future::ready(())
    }
}

/// The callers' end of the queue.
#[derive(Debug, Clone)]
pub(super) struct Writer {
    queue: mpsc::Sender<Order>,
}

/// Writes that wait at most; beyond that callers wait to get in.
const QUEUE: usize = 256;

/// Writes that share a commit at most: bounds what one failure makes us repeat.
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

    /// Finishes what waits, then closes the connection; later writes are refused.
    pub(super) async fn close(&self) {
        let (answer, answered) = oneshot::channel();
        if self.queue.send(Order::Close(answer)).await.is_ok() {
            // No answer means that the task has ended by itself.
            let _ = answered.await;
        }
    }
}

/// A write whose kind is forgotten, so that different ones share a queue.
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

    // In both cases a caller that has gone away needs no answer; and the data of the write are dropped before it is answered.
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
    /// `None` after a failure; the next write opens it again.
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
            // Everything acknowledged is in the log already; what fails here is only its tidying up.
            let _ = connection.close().await;
        }
        drop(self);
        for answer in closers {
            let _ = answer.send(());
        }
    }

    /// All in one transaction; if that fails for a reason that one of them may have brought in, each in its own.
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
        // Without a database it is unknown what was done; the next start cleans up what was left.
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

    /// After a failure the connection is kept only where it is known to be in order: SQLite ends some transactions by
    /// itself, and then connection and driver disagree about whether one is open.
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
    /// One of its writes may have brought it in; nothing was written.
    One(StoreError),
    /// The writes have nothing to do with it, or were written.
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

/// Whether trying the writes one by one is pointless. A full disk is not among these: a small write may still fit.
fn concerns_all(error: &StoreError) -> bool {
    matches!(
        error,
        StoreError::Unavailable(_) | StoreError::Damaged(_) | StoreError::Closed | StoreError::RecordsLost(_)
    )
}
