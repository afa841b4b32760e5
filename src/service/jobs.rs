//! Jobs of the cell as they are kept: what was commanded by whom, and what became of it. Written before the cell is told, ended
//! when the cell has told the end.

use super::document::Entry;
use super::error::ServiceError;
use super::followers::aside;
use super::unwritten::End;
use super::{Service, document};
use crate::cell::{JobEnd, Lease, Refusal, StopCause};
use crate::store::{EndedJob, InsertedJob, JobRow, Listing, NewJob, Page, RequestKey, StoreError};
use jiff::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// What kind of job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// The manipulators move.
    Move,
    /// The sensor scans.
    Scan,
    /// A single command to one device, or to all.
    Act,
}

impl Kind {
    /// The word in the store.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Move => "move",
            Self::Scan => "scan",
            Self::Act => "act",
        }
    }
}

/// How a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobStanding {
    /// Under way.
    Running,
    /// Everything was reached and read back.
    Done,
    /// It was stopped before its end, and every device was seen at rest.
    Stopped,
    /// It could not go on.
    Failed,
    /// It could not go on, and what the devices did is not known.
    Unknown,
    /// The service ended while it was under way; nothing was resumed.
    Interrupted,
    /// The cell refused to begin it; nothing was sent.
    Refused,
}

impl JobStanding {
    const ENDS: [Self; 6] = [Self::Done, Self::Stopped, Self::Failed, Self::Unknown, Self::Interrupted, Self::Refused];

    /// The word in documents, for jobs that are over.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Unknown => "unknown",
            Self::Interrupted => "interrupted",
            Self::Refused => "refused",
        }
    }

    /// What a row says; what it says in a word of a later version was no success.
    fn of(row: &JobRow) -> Self {
        match row.ended_at {
            None => Self::Running,
            Some(_) => Self::ENDS.into_iter().find(|end| end.name() == row.state).unwrap_or(Self::Unknown),
        }
    }
}

/// Why a job ended as it did.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ending {
    /// A short word.
    pub code: String,
    /// What happened, as an operator would say it.
    pub text: String,
}

/// A job that was written down, with what it says.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded<T> {
    /// Its id.
    pub id: String,
    /// When it was asked for.
    pub created_at: Timestamp,
    /// When it was over.
    pub ended_at: Option<Timestamp>,
    /// How it stands.
    pub standing: JobStanding,
    /// The plan that it executes.
    pub plan_id: Option<String>,
    /// What was commanded.
    pub order: T,
    /// Why it ended, where there is more to say than that it is done.
    pub ending: Option<Ending>,
}

/// A job, and whether it was begun by an earlier request of the same id, or of the same plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Started<T> {
    /// The job.
    pub job: Recorded<T>,
    /// Whether nothing was begun for this answer.
    pub replayed: bool,
}

/// Who commands.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commander {
    /// Who holds the lease; none where the command needs none.
    pub holder: Option<String>,
    /// Its fence.
    pub fence: Option<u64>,
}

impl Commander {
    /// A command that needs no lease, such as a stop.
    pub(super) const NOBODY: Self = Self { holder: None, fence: None };

    /// The holder of a lease.
    pub(super) fn by(lease: &Lease) -> Self {
        Self { holder: Some(lease.holder.clone()), fence: Some(lease.fence) }
    }
}

/// The document of a job in the store.
#[derive(Debug, Serialize, Deserialize)]
struct Document<T> {
    #[serde(flatten)]
    order: T,
    ending: Option<Ending>,
}

impl Ending {
    /// How the cell says that a job ended.
    pub(super) fn of(end: &JobEnd) -> (JobStanding, Option<Self>) {
        let say = |code: &str| Some(Self { code: code.to_owned(), text: end.to_string() });
        match end {
            JobEnd::Done => (JobStanding::Done, None),
            JobEnd::Stopped(cause) => (JobStanding::Stopped, say(stop_code(*cause))),
            JobEnd::Failed(failure) => (JobStanding::Failed, say(failure.code())),
            JobEnd::Unknown(failure) => (JobStanding::Unknown, say(failure.code())),
        }
    }

    /// How a job stands that the cell did not say it had begun.
    pub(super) fn of_refusal(refusal: &Refusal) -> (JobStanding, Self) {
        let (standing, code) = match refusal {
            Refusal::Unanswered => (JobStanding::Unknown, "cell_failed"),
            Refusal::Closing => (JobStanding::Refused, "service_stopping"),
            _ => (JobStanding::Refused, "refused"),
        };
        (standing, Self { code: code.to_owned(), text: refusal.to_string() })
    }
}

/// A stable short word for what stopped a job.
#[must_use]
pub const fn stop_code(cause: StopCause) -> &'static str {
    match cause {
        StopCause::Requested => "stop_requested",
        StopCause::LeaseOver => "lease_over",
        StopCause::LeaseReleased => "lease_released",
        StopCause::Closing => "service_stopping",
    }
}

/// The row of a job that begins.
pub(super) struct Beginning<'a, T> {
    pub(super) kind: Kind,
    pub(super) id: String,
    pub(super) plan_id: Option<String>,
    pub(super) request: Option<RequestKey>,
    pub(super) order: &'a T,
}

impl Service {
    /// Writes a job down before it begins.
    ///
    /// # Errors
    /// [`ServiceError::RequestIdReused`], and what the store says.
    pub(super) async fn write_down<T: Serialize + DeserializeOwned + Clone + Send + 'static>(
        &self,
        beginning: Beginning<'_, T>,
    ) -> Result<Started<T>, ServiceError> {
        let Beginning { kind, id, plan_id, request, order } = beginning;
        self.unwritten.check_room(kind == Kind::Scan)?;
        let created_at = self.clock.now();
        let request_id = request.as_ref().map(|request| request.id.clone()).unwrap_or_default();
        let order = order.clone();
        let (order, document) = aside(move || document_of(&order, None).map(|document| (order, document))).await?;
        let row = JobRow {
            id: id.clone(),
            kind: kind.name().to_owned(),
            created_at,
            state: JobStanding::Running.name().to_owned(),
            ended_at: None,
            plan_id: plan_id.clone(),
            request,
            document,
        };
        match self.store.insert_job(NewJob { row }).await? {
            InsertedJob::New => {
                let standing = JobStanding::Running;
                let job = Recorded { id, created_at, ended_at: None, standing, plan_id, order, ending: None };
                Ok(Started { job, replayed: false })
            }
            InsertedJob::Replayed(row) | InsertedJob::PlanUsed(row) => {
                Ok(Started { job: read_back(&self.unwritten.complete(*row))?, replayed: true })
            }
            InsertedJob::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }

    /// The end of a job as the store takes it.
    pub(super) fn ended<T: Serialize>(
        &self,
        job: &Recorded<T>,
        standing: JobStanding,
        ending: Option<&Ending>,
    ) -> Result<EndedJob, ServiceError> {
        Ok(EndedJob {
            id: job.id.clone(),
            state: standing.name().to_owned(),
            ended_at: self.clock.now(),
            document: document_of(&job.order, ending)?,
        })
    }

    /// Writes down how a job ended, now or as soon as the store takes it.
    pub(super) async fn conclude<T: Serialize>(
        self: &Arc<Self>,
        job: &Recorded<T>,
        standing: JobStanding,
        ending: Option<&Ending>,
    ) {
        match self.ended(job, standing, ending) {
            Ok(end) => self.end_job(End { job: end, frees: standing == JobStanding::Refused, measured: None }).await,
            // Every order was written once, so it can be written again.
            Err(error) => tracing::error!(job = job.id, %error, "the end of job {} cannot be written", job.id),
        }
    }

    /// A job is over, which its record shows from now on.
    pub(super) fn has_ended(&self) {
        self.advance();
        self.followers.ended.send_modify(|count| *count += 1);
    }

    /// The job of an id, of a kind; waits for its end, no longer than `wait` and no longer than the service runs.
    pub(super) async fn job<T: DeserializeOwned + Send + 'static>(
        &self,
        kind: Kind,
        id: &str,
        wait: Duration,
    ) -> Result<Option<Recorded<T>>, ServiceError> {
        let mut ended = self.followers.ended.subscribe();
        let mut closing = self.closing.watch();
        let until_over = async {
            loop {
                ended.borrow_and_update();
                match self.job_row(id).await {
                    Ok(Some(row)) if row.ended_at.is_none() && row.kind == kind.name() => {}
                    found => return found,
                }
                let closing = tokio::select! {
                    _ = ended.changed() => false,
                    _ = closing.wait_for(|closing| *closing) => true,
                };
                if closing {
                    return self.job_row(id).await;
                }
            }
        };
        let found = match timeout(wait, until_over).await {
            Ok(found) => found?,
            Err(_) => self.job_row(id).await?,
        };
        let Some(row) = found.filter(|row| row.kind == kind.name()) else { return Ok(None) };
        aside(move || read_back(&row).map(Some)).await
    }

    async fn job_row(&self, id: &str) -> Result<Option<JobRow>, StoreError> {
        Ok(self.store.job(id).await?.map(|row| self.unwritten.complete(row)))
    }

    /// A page of the jobs of a kind, of one standing where it is given, newest first.
    pub(super) async fn list_jobs<T: DeserializeOwned + Send + 'static>(
        &self,
        kind: Kind,
        standing: Option<JobStanding>,
        page: &Page,
    ) -> Result<Listing<Entry<Recorded<T>>>, ServiceError> {
        let state = standing.map(JobStanding::name);
        let Listing { rows, next } = self.store.jobs(kind.name(), state, page).await?;
        let mut rows: Vec<JobRow> = rows.into_iter().map(|row| self.unwritten.complete(row)).collect();
        if let Some(state) = state {
            rows.retain(|row| row.state == state);
            // Those whose end is not written yet are among the running ones to the store.
            let ids = if page.before.is_none() { self.unwritten.ids_in(state) } else { Vec::new() };
            for id in ids {
                rows.extend(self.job_row(&id).await?.filter(|row| row.kind == kind.name() && row.state == state));
            }
        }
        let read = move || rows.iter().map(|row| Entry::of(read_back(row), row.created_at)).collect();
        Ok(Listing { rows: aside(read).await?, next })
    }

    /// Ends what an earlier process left under way.
    pub(super) async fn interrupt_jobs(&self) -> Result<(), ServiceError> {
        if self.store.check_loss().is_err() {
            // Such a store takes nothing; it is told by the readiness.
            return Ok(());
        }
        let interrupted = self.store.interrupt_jobs(JobStanding::Interrupted.name(), self.clock.now()).await?;
        for JobRow { id, kind, .. } in interrupted {
            tracing::warn!(
                job = id,
                "{kind} {id} was under way when the service ended; it is interrupted, nothing is resumed"
            );
        }
        Ok(())
    }
}

fn document_of<T: Serialize>(order: &T, ending: Option<&Ending>) -> Result<String, ServiceError> {
    document::write("job", &Document { order, ending: ending.cloned() })
}

/// The job from its row.
pub(super) fn read_back<T: DeserializeOwned>(row: &JobRow) -> Result<Recorded<T>, ServiceError> {
    let Document { order, ending } = document::read("job", &row.id, &row.document)?;
    let standing = JobStanding::of(row);
    let ending = match (standing, ending) {
        (JobStanding::Interrupted, None) => Some(Ending {
            code: "interrupted".to_owned(),
            text: "the service ended while this was under way; nothing was resumed".to_owned(),
        }),
        (_, ending) => ending,
    };
    let JobRow { id, created_at, ended_at, plan_id, .. } = row.clone();
    Ok(Recorded { id, created_at, ended_at, standing, plan_id, order, ending })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_refused_is_called_so() {
        for refusal in [Refusal::LeaseRequired, Refusal::Closing] {
            assert_eq!(Ending::of_refusal(&refusal).0, JobStanding::Refused, "{refusal}");
        }
        assert_eq!(Ending::of_refusal(&Refusal::Unanswered).0, JobStanding::Unknown, "it may have been begun");
    }
}
