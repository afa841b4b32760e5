//! Ends of jobs that the store could not take, e.g. because the disk is full: kept in memory, shown as if they were written, and
//! written as soon as the store takes them.
//!
//! ```text
//! end ──> store ── failed ──> kept here ──> tried again after 0.25 s, 0.5 s, … 30 s, and once more when the service ends
//! ```

use super::Service;
use super::error::ServiceError;
use crate::store::{CompleteScan, EndedJob, Filter, JobRow, MeasurementRow, NewMeasurement, StoreError};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::sleep;

/// Ends that may be unwritten; with as many, nothing new is begun.
const UNWRITTEN_MAX: usize = 64;

/// The first pause before an end is tried again; each further one is twice as long.
pub(super) const PAUSE_FIRST: Duration = Duration::from_millis(250);
/// The longest pause.
pub(super) const PAUSE_MAX: Duration = Duration::from_secs(30);

/// The end of a job with all that belongs into the same transaction.
#[derive(Debug, Clone)]
pub(super) struct End {
    pub(super) job: EndedJob,
    /// Its request and its plan may be tried again, since nothing was sent.
    pub(super) frees: bool,
    /// The measurement that the job was for.
    pub(super) measured: Option<MeasuredScan>,
}

/// A measurement by the sensor, to be recorded with the end of its job.
#[derive(Debug, Clone)]
pub(super) struct MeasuredScan {
    pub(super) new: NewMeasurement,
    pub(super) points: Points,
}

/// Where the raw points of a scan by the sensor are.
#[derive(Debug, Clone)]
pub(super) enum Points {
    /// In the store, with their record.
    Kept,
    /// In a file that has no place yet.
    InFile(Arc<CompleteScan>),
    /// In memory, since the store had no room for a file.
    InMemory(Arc<Vec<u8>>),
}

/// The ends that the store has not taken yet, by the ids of their jobs.
#[derive(Debug, Default)]
pub(super) struct UnwrittenEnds(Mutex<BTreeMap<String, Arc<End>>>);

impl UnwrittenEnds {
    fn all(&self) -> MutexGuard<'_, BTreeMap<String, Arc<End>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, id: &str) -> Option<Arc<End>> {
        self.all().get(id).cloned()
    }

    /// Refuses to begin a further job where too many ends wait; a scan where the points of another one do, since they take memory.
    pub(super) fn check_room(&self, for_scan: bool) -> Result<(), ServiceError> {
        let all = self.all();
        let count = all.len();
        let full = count >= UNWRITTEN_MAX || (for_scan && all.values().any(|end| end.measured.is_some()));
        if full { Err(ServiceError::EndsUnwritten { count }) } else { Ok(()) }
    }

    /// A job as it is now: with its end, where that is not written yet.
    pub(super) fn complete(&self, row: JobRow) -> JobRow {
        let Some(end) = self.get(&row.id).filter(|_| row.ended_at.is_none()) else { return row };
        let EndedJob { state, ended_at, document, .. } = end.job.clone();
        let row = JobRow { state, ended_at: Some(ended_at), document, ..row };
        if end.frees { JobRow { request: None, plan_id: None, ..row } } else { row }
    }

    /// Ids of the jobs that ended like this.
    pub(super) fn ids_in(&self, state: &str) -> Vec<String> {
        self.all().values().filter(|end| end.job.state == state).map(|end| end.job.id.clone()).collect()
    }

    /// The measurement of this id.
    pub(super) fn measurement(&self, id: &str) -> Option<MeasurementRow> {
        Some(self.get(id)?.measured.as_ref()?.new.row.clone())
    }

    /// Its profiles.
    pub(super) fn profiles(&self, id: &str) -> Option<Vec<u8>> {
        Some(self.get(id)?.measured.as_ref()?.new.profiles.clone())
    }

    /// The measurements that pass the filter, newest first.
    pub(super) fn measurements(&self, filter: &Filter) -> Vec<MeasurementRow> {
        let all = self.all();
        let rows = all.values().rev().filter_map(|end| Some(&end.measured.as_ref()?.new.row));
        rows.filter(|row| filter.passes(row)).cloned().collect()
    }
}

impl Service {
    /// Writes the end of a job, or keeps it until the store takes it.
    pub(super) async fn end_job(self: &Arc<Self>, end: End) {
        if let Err(error) = self.write_end(&end).await {
            let (id, state) = (end.job.id.clone(), end.job.state.clone());
            tracing::error!(job = id, %error, "the end of job {id} ({state}) is not written yet; it is tried again");
            self.unwritten.all().insert(id.clone(), Arc::new(end));
            let service = Arc::clone(self);
            self.followers.add(async move { service.write_later(id).await });
        }
        self.has_ended();
    }

    async fn write_later(&self, id: String) {
        let mut pause = PAUSE_FIRST;
        while let Some(end) = self.unwritten.get(&id) {
            let last_try = tokio::select! {
                () = sleep(pause) => false,
                () = self.closing.wait() => true,
            };
            match self.write_end(&end).await {
                Ok(()) => {
                    self.unwritten.all().remove(&id);
                    tracing::info!(job = id, "the end of job {id} is written now");
                    self.has_ended();
                }
                Err(error) if last_try => {
                    tracing::error!(job = id, %error, "the end of job {id} is lost; the next start calls it interrupted");
                    return;
                }
                Err(_) => pause = (pause * 2).min(PAUSE_MAX),
            }
        }
    }

    async fn write_end(&self, end: &End) -> Result<(), ServiceError> {
        let End { job, frees, measured } = end;
        match measured {
            None if *frees => self.store.refuse_job(job.clone()).await?,
            None => self.store.end_job(job.clone()).await?,
            Some(MeasuredScan { new, points }) => {
                let file = self.file_of(points).await?;
                match self.store.end_job_with(job.clone(), new.clone(), file).await {
                    // It was committed the time before, and only its acknowledgement failed.
                    Ok(_) | Err(StoreError::IdTaken { .. }) => self.remember_last().await,
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(())
    }

    /// The file of raw points that have no place yet; `None` where they are kept.
    async fn file_of(&self, points: &Points) -> Result<Option<Arc<CompleteScan>>, StoreError> {
        match points {
            Points::Kept => Ok(None),
            Points::InFile(file) => Ok(Some(Arc::clone(file))),
            Points::InMemory(bytes) => Ok(Some(Arc::new(self.file_with(bytes).await?))),
        }
    }

    /// A file of these bytes that has no place yet.
    pub(super) async fn file_with(&self, bytes: &[u8]) -> Result<CompleteScan, StoreError> {
        let mut writer = self.store.begin_scan(u64::MAX).await?;
        writer.write(bytes).await?;
        writer.complete().await
    }
}
