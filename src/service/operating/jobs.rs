//! Jobs of the cell in the store: recorded before the cell begins them, and ended when the cell has reported the end. Writing
//! the end is retried until the store accepts it.

use std::sync::Arc;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::time::{sleep, timeout};

use crate::service::background::run_blocking;
use crate::service::document;
use crate::service::document::Entry;
use crate::service::error::ServiceError;
use crate::service::unwritten::{End, MeasuredScan, PAUSE_FIRST, PAUSE_MAX, Points};
use crate::store::{CompleteScan, EndedJob, InsertedJob, JobRow, Listing, NewJob, Page, RequestKey, StoreError};

use super::job::{EndReason, JobRecord, JobStatus, Kind, StartedJob};
use super::state::Operating;

/// The document of a job in the store.
#[derive(Debug, Serialize, Deserialize)]
struct Document<T> {
    #[serde(flatten)]
    order: T,
    ending: Option<EndReason>,
}

/// The row of a job that begins.
pub(in crate::service) struct Beginning<'a, T> {
    pub(in crate::service) kind: Kind,
    pub(in crate::service) id: String,
    pub(in crate::service) plan_id: Option<String>,
    pub(in crate::service) request: Option<RequestKey>,
    pub(in crate::service) order: &'a T,
}

fn document_of<T: Serialize>(order: &T, ending: Option<&EndReason>) -> Result<String, ServiceError> {
    document::write("job", &Document { order, ending: ending.cloned() })
}

/// The job of a row.
pub(in crate::service) fn read_back<T: DeserializeOwned>(row: &JobRow) -> Result<JobRecord<T>, ServiceError> {
    let Document { order, ending } = document::read("job", &row.id, &row.document)?;
    let standing = JobStatus::of(row);
    let ending = match (standing, ending) {
        (JobStatus::Interrupted, None) => Some(EndReason {
            code: "interrupted".to_owned(),
            text: "the service ended while this was under way; nothing was resumed".to_owned(),
        }),
        (_, ending) => ending,
    };
    let JobRow { id, created_at, ended_at, plan_id, .. } = row.clone();
    Ok(JobRecord { id, created_at, ended_at, standing, plan_id, order, ending })
}

impl Operating {
    /// Records a job before it begins.
    ///
    /// # Errors
    /// [`ServiceError::RequestIdReused`], and errors of the store.
    pub(in crate::service) async fn write_down<T: Serialize + DeserializeOwned + Clone + Send + 'static>(
        &self,
        beginning: Beginning<'_, T>,
    ) -> Result<StartedJob<T>, ServiceError> {
        let Beginning { kind, id, plan_id, request, order } = beginning;
        self.shared.unwritten.check_room(kind == Kind::Scan)?;
        let created_at = self.shared.clock.now();
        let request_id = request.as_ref().map(|request| request.id.clone()).unwrap_or_default();
        let order = order.clone();
        let (order, document) =
            run_blocking(move || document_of(&order, None).map(|document| (order, document))).await?;
        let row = JobRow {
            id: id.clone(),
            kind: kind.name().to_owned(),
            created_at,
            state: JobStatus::Running.name().to_owned(),
            ended_at: None,
            plan_id: plan_id.clone(),
            request,
            document,
        };
        match self.shared.store.insert_job(NewJob { row }).await? {
            InsertedJob::New => {
                let standing = JobStatus::Running;
                let job = JobRecord { id, created_at, ended_at: None, standing, plan_id, order, ending: None };
                Ok(StartedJob { job, replayed: false })
            }
            InsertedJob::Replayed(row) | InsertedJob::PlanUsed(row) => {
                Ok(StartedJob { job: read_back(&self.shared.unwritten.complete(*row))?, replayed: true })
            }
            InsertedJob::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }

    /// The end of a job as the store expects it.
    pub(in crate::service) fn ended<T: Serialize>(
        &self,
        job: &JobRecord<T>,
        standing: JobStatus,
        ending: Option<&EndReason>,
    ) -> Result<EndedJob, ServiceError> {
        Ok(EndedJob {
            id: job.id.clone(),
            state: standing.name().to_owned(),
            ended_at: self.shared.clock.now(),
            document: document_of(&job.order, ending)?,
        })
    }

    /// Records how a job ended, now or as soon as the store accepts it.
    pub(in crate::service) async fn conclude<T: Serialize>(
        self: &Arc<Self>,
        job: &JobRecord<T>,
        standing: JobStatus,
        ending: Option<&EndReason>,
    ) {
        match self.ended(job, standing, ending) {
            Ok(end) => self.end_job(End { job: end, frees: standing == JobStatus::Refused, measured: None }).await,
            // Every order was serialised once, so it can be serialised again.
            Err(error) => tracing::error!(job = job.id, %error, "the end of job {} cannot be written", job.id),
        }
    }

    /// Called when the record of a job shows its end.
    pub(in crate::service) fn has_ended(&self) {
        self.shared.advance();
        self.shared.background.ended.send_modify(|count| *count += 1);
    }

    /// The job of this id and kind; waits for its end, at most for `wait` and until the service shuts down.
    pub(in crate::service) async fn job<T: DeserializeOwned + Send + 'static>(
        &self,
        kind: Kind,
        id: &str,
        wait: Duration,
    ) -> Result<Option<JobRecord<T>>, ServiceError> {
        let mut ended = self.shared.background.ended.subscribe();
        let mut closing = self.shared.shutdown.watch();
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
        run_blocking(move || read_back(&row).map(Some)).await
    }

    async fn job_row(&self, id: &str) -> Result<Option<JobRow>, StoreError> {
        Ok(self.shared.store.job(id).await?.map(|row| self.shared.unwritten.complete(row)))
    }

    /// A page of the jobs of a kind, optionally of one status, newest first.
    pub(in crate::service) async fn list_jobs<T: DeserializeOwned + Send + 'static>(
        &self,
        kind: Kind,
        standing: Option<JobStatus>,
        page: &Page,
    ) -> Result<Listing<Entry<JobRecord<T>>>, ServiceError> {
        let state = standing.map(JobStatus::name);
        let Listing { rows, next } = self.shared.store.jobs(kind.name(), state, page).await?;
        let mut rows: Vec<JobRow> = rows.into_iter().map(|row| self.shared.unwritten.complete(row)).collect();
        if let Some(state) = state {
            rows.retain(|row| row.state == state);
            // Jobs whose end is not written yet are still running according to the store.
            let ids = if page.before.is_none() { self.shared.unwritten.ids_in(state) } else { Vec::new() };
            for id in ids {
                rows.extend(self.job_row(&id).await?.filter(|row| row.kind == kind.name() && row.state == state));
            }
        }
        let read = move || rows.iter().map(|row| Entry::of(read_back(row), row.created_at)).collect();
        Ok(Listing { rows: run_blocking(read).await?, next })
    }

    /// Records jobs that an earlier process left unfinished as interrupted.
    pub(in crate::service) async fn interrupt_jobs(&self) -> Result<(), ServiceError> {
        if self.shared.store.check_loss().is_err() {
            // A store in this state accepts no writes; the readiness check reports it.
            return Ok(());
        }
        let interrupted =
            self.shared.store.interrupt_jobs(JobStatus::Interrupted.name(), self.shared.clock.now()).await?;
        for JobRow { id, kind, .. } in interrupted {
            tracing::warn!(
                job = id,
                "{kind} {id} was under way when the service ended; it is interrupted, nothing is resumed"
            );
        }
        Ok(())
    }
}

impl Operating {
    /// Writes the end of a job, or keeps it until the store accepts it.
    pub(in crate::service) async fn end_job(self: &Arc<Self>, end: End) {
        if let Err(error) = self.write_end(&end).await {
            let (id, state) = (end.job.id.clone(), end.job.state.clone());
            tracing::error!(job = id, %error, "the end of job {id} ({state}) is not written yet; writing is retried");
            self.shared.unwritten.all().insert(id.clone(), Arc::new(end));
            let service = Arc::clone(self);
            self.shared.background.add(async move { service.write_later(id).await });
        }
        self.has_ended();
    }

    async fn write_later(&self, id: String) {
        let mut pause = PAUSE_FIRST;
        while let Some(end) = self.shared.unwritten.get(&id) {
            let last_try = tokio::select! {
                () = sleep(pause) => false,
                () = self.shared.shutdown.wait() => true,
            };
            match self.write_end(&end).await {
                Ok(()) => {
                    self.shared.unwritten.all().remove(&id);
                    tracing::info!(job = id, "the end of job {id} is written now");
                    self.has_ended();
                }
                Err(error) if last_try => {
                    tracing::error!(job = id, %error, "the end of job {id} is lost; the next start records it as interrupted");
                    return;
                }
                Err(_) => pause = (pause * 2).min(PAUSE_MAX),
            }
        }
    }

    async fn write_end(&self, end: &End) -> Result<(), ServiceError> {
        let End { job, frees, measured } = end;
        match measured {
            None if *frees => self.shared.store.refuse_job(job.clone()).await?,
            None => self.shared.store.end_job(job.clone()).await?,
            Some(MeasuredScan { new, points }) => {
                let file = self.file_of(points).await?;
                match self.shared.store.end_job_with(job.clone(), new.clone(), file).await {
                    // It was committed at the previous attempt, and only its acknowledgement failed.
                    Ok(_) | Err(StoreError::IdTaken { .. }) => self.measuring.remember_last().await,
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(())
    }

    /// The file of raw points that are not stored yet; `None` if they are stored.
    async fn file_of(&self, points: &Points) -> Result<Option<Arc<CompleteScan>>, StoreError> {
        match points {
            Points::Kept => Ok(None),
            Points::InFile(file) => Ok(Some(Arc::clone(file))),
            Points::InMemory(bytes) => Ok(Some(Arc::new(self.file_with(bytes).await?))),
        }
    }

    /// A file of these bytes that is not in the store yet.
    pub(in crate::service) async fn file_with(&self, bytes: &[u8]) -> Result<CompleteScan, StoreError> {
        let mut writer = self.shared.store.begin_scan(u64::MAX).await?;
        writer.write(bytes).await?;
        writer.complete().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Refusal;

    #[test]
    fn only_refused_jobs_get_the_status_refused() {
        for refusal in [Refusal::LeaseRequired, Refusal::Closing] {
            assert_eq!(EndReason::of_refusal(&refusal).0, JobStatus::Refused, "{refusal}");
        }
        assert_eq!(EndReason::of_refusal(&Refusal::Unanswered).0, JobStatus::Unknown, "it may have been begun");
    }
}
