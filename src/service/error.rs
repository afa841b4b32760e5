//! Why the service could not do what it was asked.

use super::acquisition::Stale;
use super::compute::ComputeError;
use super::measuring::pipeline::MeasureError;
use super::measuring::recipe::RecipeError;
use super::operating::equipment::EquipmentError;
use super::operating::job::JobStatus;
use crate::cell::Refusal;
use crate::motion::MotionRefusal;
use crate::scan::decode::DecodeError;
use crate::store::StoreError;
use std::sync::Arc;
use std::time::Duration;

/// A reason of the service.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The pool is full, or a calculation panicked.
    #[error(transparent)]
    Compute(#[from] ComputeError),
    /// As many uploads are under way as may be.
    #[error("{uploads_max} uploads are under way, which are all that are allowed")]
    UploadsBusy {
        /// Uploads that may be under way.
        uploads_max: usize,
    },
    /// The points of earlier scans by the sensor, which are still calculated with, take the memory for those.
    #[error(
        "a scan by the sensor is being taken or calculated, and its points may take all the memory for such scans (limits.memory_max_mb)"
    )]
    ScansBusy,
    /// The store did not do its part.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The content of an upload cannot be used.
    #[error(transparent)]
    Content(#[from] ContentError),
    /// The recipe cannot be used, or not with what the request says over it.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// What the request says cannot be, whatever the recipe.
    #[error(transparent)]
    Option(RecipeError),
    /// Nothing is kept under the id of this scan.
    #[error("there is no scan {id}")]
    ScanUnknown {
        /// The id asked for.
        id: String,
    },
    /// The record of a scan is there and its file is not.
    #[error("the file of scan {id} is missing in the data folder")]
    ScanFileMissing {
        /// The scan's id.
        id: String,
    },
    /// Nothing is kept under the id of this measurement.
    #[error("there is no measurement {id}")]
    MeasurementUnknown {
        /// The id asked for.
        id: String,
    },
    /// The scan of this measurement is being taken or measured.
    #[error("the measurement {id} is not over: the sensor scans, or the pose is calculated")]
    MeasurementRunning {
        /// Its id.
        id: String,
    },
    /// This measurement by the sensor failed.
    #[error("the measurement {id} failed: {text}")]
    MeasurementFailed {
        /// Its id.
        id: String,
        /// How it ended.
        standing: JobStatus,
        /// Why, in a short word.
        reason: String,
        /// Why, as an operator would say it.
        text: String,
    },
    /// Nothing is kept under the name of this recipe.
    #[error("there is no recipe {name}")]
    RecipeUnknown {
        /// The name asked for.
        name: String,
    },
    /// The recipe is not at the revision that the caller knows.
    #[error("the recipe {name} is at another revision than the one named")]
    RecipeChanged {
        /// Its name.
        name: String,
        /// Its current revision.
        current_etag: String,
    },
    /// A recipe was to be replaced that is not there.
    #[error("there is no recipe {name} to be replaced")]
    RecipeAbsent {
        /// The name.
        name: String,
    },
    /// This service has no cell.
    #[error("this service has no cell; nothing can be moved or scanned")]
    CellAbsent,
    /// The cell refuses.
    #[error(transparent)]
    Cell(#[from] Refusal),
    /// The cell's task has ended, so nothing is known of the devices any more.
    #[error("the cell has ended, and told every device to halt; nothing is known of it any more")]
    CellGone,
    /// A lease was named that is not the one that is held.
    #[error("the lease_id that was given is not that of the lease: {holder} holds it for another {} ms", remaining.as_millis())]
    LeaseOfAnother {
        /// Who holds the lease.
        holder: String,
        /// How long it lasts unless it is renewed.
        remaining: Duration,
    },
    /// The motion is not allowed.
    #[error(transparent)]
    Motion(#[from] MotionRefusal),
    /// A pose, or a plan made from it, no longer holds.
    #[error(transparent)]
    Stale(#[from] Stale),
    /// A manipulator has not answered yet, so nobody knows where it is.
    #[error("a manipulator has not answered yet, so where it is is not known")]
    PositionsUnknown,
    /// Nothing is kept under the id of this move.
    #[error("there is no move {id}")]
    MoveUnknown {
        /// The id asked for.
        id: String,
    },
    /// Nothing is kept under the id of this plan.
    #[error("there is no plan {id}")]
    PlanUnknown {
        /// The id asked for.
        id: String,
    },
    /// The measurement has no pose to plan from, or several.
    #[error("the measurement {measurement_id} has no pose that a plan could begin at, or more than one; name the part")]
    PoseMissing {
        /// Its id.
        measurement_id: String,
    },
    /// A request value is out of range.
    #[error("{field} must be {allowed}")]
    Value {
        /// Which.
        field: &'static str,
        /// What it may be.
        allowed: String,
    },
    /// A device of the configuration cannot be made.
    #[error("the cell cannot be set up")]
    Equipment(#[source] Arc<EquipmentError>),
    /// The request's id was used for another request.
    #[error("the request id {request_id} was used for another request")]
    RequestIdReused {
        /// The id.
        request_id: String,
    },
    /// The measurement has no such part.
    #[error("there is no part {part} in the measurement; {}", parts_in_words(.names))]
    PartUnknown {
        /// What was asked for.
        part: String,
        /// Its parts, in order of x.
        names: Vec<String>,
    },
    /// The measurement has fewer profiles.
    #[error("the measurement has {profiles_count} profiles, there is no profile {index}")]
    ProfileUnknown {
        /// The index asked for, from 0.
        index: u64,
        /// Profiles that there are.
        profiles_count: u64,
    },
    /// A stored document cannot be read back.
    #[error("the stored {what} {id} cannot be read: {cause}")]
    RecordUnreadable {
        /// Kind of record.
        what: &'static str,
        /// Its id.
        id: String,
        /// Why not.
        cause: Unreadable,
    },
    /// The ends of jobs are not written yet, so nothing further is begun.
    #[error("the ends of {count} jobs could not be written yet; nothing new is begun until the store takes them")]
    EndsUnwritten {
        /// How many.
        count: usize,
    },
    /// A record cannot be written down.
    #[error("the {what} cannot be written down")]
    RecordUnwritable {
        /// Kind of record.
        what: &'static str,
        /// Why not.
        source: Arc<serde_json::Error>,
    },
    /// The threads that calculate cannot be started.
    #[error("the threads that calculate cannot be started")]
    Threads(#[source] Arc<rayon::ThreadPoolBuildError>),
    /// The threads of the cell cannot be started.
    #[error("cannot start the threads of the cell")]
    CellThreads(#[source] Arc<std::io::Error>),
}

fn parts_in_words(names: &[String]) -> String {
    if names.is_empty() {
        return "it was not asked for parts, or none were found".to_owned();
    }
    format!("there are {}, numbered from 1", names.join(", "))
}

/// Why the content of an upload cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ContentError {
    /// It is not a scan, or not one that can be cut into profiles as asked.
    #[error(transparent)]
    Scan(#[from] MeasureError),
    /// It cannot be unpacked.
    #[error(transparent)]
    Packing(DecodeError),
}

impl From<MeasureError> for ServiceError {
    fn from(error: MeasureError) -> Self {
        Self::Content(ContentError::Scan(error))
    }
}

/// Why a stored document cannot be read.
#[derive(Debug, Clone, thiserror::Error)]
pub enum Unreadable {
    /// A later program has written it.
    #[error("it was written by a later version of coaxis (document version {found}; this one reads up to {known})")]
    Later {
        /// Version of the document.
        found: u64,
        /// The latest version that is read.
        known: u64,
    },
    /// It is no document, or not of the kind that it should be.
    #[error("it is damaged, or another version of coaxis has written it: {0}")]
    Damaged(Arc<serde_json::Error>),
}
