//! Ends of jobs that the store could not record, e.g. because the disk is full. They are kept in memory, shown as if they were
//! recorded, and written as soon as the store accepts them.
//!
//! ```text
//! end ──> store ── failed ──> kept here ──> tried again after 0.25 s, 0.5 s, … 30 s, and once more when the service ends
//! ```

use super::error::ServiceError;
use crate::store::{CompleteScan, EndedJob, Filter, JobRow, MeasurementRow, NewMeasurement};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Maximum number of unwritten ends; at this number, no further job is started.
const UNWRITTEN_MAX: usize = 64;

/// The first pause before an end is tried again; each further one is twice as long.
pub(in crate::service) const PAUSE_FIRST: Duration = Duration::from_millis(250);
/// The longest pause.
pub(in crate::service) const PAUSE_MAX: Duration = Duration::from_secs(30);

/// The end of a job, with everything that belongs to the same transaction.
#[derive(Debug, Clone)]
pub(in crate::service) struct End {
    pub(in crate::service) job: EndedJob,
    /// Whether its request and its plan may be used again, because nothing was sent.
    pub(in crate::service) frees: bool,
    /// The measurement that the job was for.
    pub(in crate::service) measured: Option<MeasuredScan>,
}

/// A measurement by the sensor, to be recorded with the end of its job.
#[derive(Debug, Clone)]
pub(in crate::service) struct MeasuredScan {
    pub(in crate::service) new: NewMeasurement,
    pub(in crate::service) points: Points,
}

/// The raw points of a scan by the sensor.
#[derive(Debug, Clone)]
pub(in crate::service) enum Points {
    /// In the store, with their record.
    Kept,
    /// In a file that is not yet in the store.
    InFile(Arc<CompleteScan>),
    /// In memory, because the store had no space for a file.
    InMemory(Arc<Vec<u8>>),
}

/// The ends that the store has not recorded yet, by the ids of their jobs.
#[derive(Debug, Default)]
pub(in crate::service) struct UnwrittenEnds(Mutex<BTreeMap<String, Arc<End>>>);

impl UnwrittenEnds {
    pub(in crate::service) fn all(&self) -> MutexGuard<'_, BTreeMap<String, Arc<End>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(in crate::service) fn get(&self, id: &str) -> Option<Arc<End>> {
        self.all().get(id).cloned()
    }

    /// Refuses a further job if too many ends wait, and a scan if the points of another one wait, because they use memory.
    pub(in crate::service) fn check_room(&self, for_scan: bool) -> Result<(), ServiceError> {
        let all = self.all();
        let count = all.len();
        let full = count >= UNWRITTEN_MAX || (for_scan && all.values().any(|end| end.measured.is_some()));
        if full { Err(ServiceError::EndsUnwritten { count }) } else { Ok(()) }
    }

    /// A job in its current state: with its end, even if that is not written yet.
    pub(in crate::service) fn complete(&self, row: JobRow) -> JobRow {
        let Some(end) = self.get(&row.id).filter(|_| row.ended_at.is_none()) else { return row };
        let EndedJob { state, ended_at, document, .. } = end.job.clone();
        let row = JobRow { state, ended_at: Some(ended_at), document, ..row };
        if end.frees { JobRow { request: None, plan_id: None, ..row } } else { row }
    }

    /// Ids of the jobs that ended in this state.
    pub(in crate::service) fn ids_in(&self, state: &str) -> Vec<String> {
        self.all().values().filter(|end| end.job.state == state).map(|end| end.job.id.clone()).collect()
    }

    /// The measurement of this id.
    pub(in crate::service) fn measurement(&self, id: &str) -> Option<MeasurementRow> {
        Some(self.get(id)?.measured.as_ref()?.new.row.clone())
    }

    /// Its profiles.
    pub(in crate::service) fn profiles(&self, id: &str) -> Option<Vec<u8>> {
        Some(self.get(id)?.measured.as_ref()?.new.profiles.clone())
    }

    /// The measurements that pass the filter, newest first.
    pub(in crate::service) fn measurements(&self, filter: &Filter) -> Vec<MeasurementRow> {
        let all = self.all();
        let rows = all.values().rev().filter_map(|end| Some(&end.measured.as_ref()?.new.row));
        rows.filter(|row| filter.passes(row)).cloned().collect()
    }
}
