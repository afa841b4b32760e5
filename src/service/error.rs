//! Why the service could not do what was requested.

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

/// An error of the service.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The pool is full, or a calculation panicked.
    #[error(transparent)]
    Compute(#[from] ComputeError),
    /// The maximum number of uploads is under way.
    #[error("{uploads_max} uploads are under way, which is the maximum")]
    UploadsBusy {
        /// Maximum number of simultaneous uploads.
        uploads_max: usize,
    },
    /// The points of earlier scans by the sensor, which are still being processed, use the memory for those scans.
    #[error(
        "a scan by the sensor is being taken or calculated, and its points may use all the memory for such scans (limits.memory_max_mb)"
    )]
    ScansBusy,
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The content of an upload cannot be used.
    #[error(transparent)]
    Content(#[from] ContentError),
    /// The recipe cannot be used, alone or with the values of the request.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// A value of the request is invalid, whatever the recipe.
    #[error(transparent)]
    Option(RecipeError),
    /// No scan is stored under this id.
    #[error("there is no scan {id}")]
    ScanUnknown {
        /// The id asked for.
        id: String,
    },
    /// The scan has a record, but its file is missing.
    #[error("the file of scan {id} is missing in the data folder")]
    ScanFileMissing {
        /// The scan's id.
        id: String,
    },
    /// No measurement is stored under this id.
    #[error("there is no measurement {id}")]
    MeasurementUnknown {
        /// The id asked for.
        id: String,
    },
    /// The measurement is still being taken or calculated.
    #[error("the measurement {id} is still running: the sensor scans, or the pose is being calculated")]
    MeasurementRunning {
        /// Its id.
        id: String,
    },
    /// This measurement by the sensor failed.
    #[error("the measurement {id} failed: {text}")]
    MeasurementFailed {
        /// Its id.
        id: String,
        /// Its final status.
        standing: JobStatus,
        /// The reason, as a short code.
        reason: String,
        /// The reason, as text for an operator.
        text: String,
    },
    /// No recipe is stored under this name.
    #[error("there is no recipe {name}")]
    RecipeUnknown {
        /// The name asked for.
        name: String,
    },
    /// The recipe's revision differs from the one that the caller expects.
    #[error("the recipe {name} has a different revision than the one given")]
    RecipeChanged {
        /// Its name.
        name: String,
        /// Its current revision.
        current_etag: String,
    },
    /// The recipe to be replaced does not exist.
    #[error("there is no recipe {name} to be replaced")]
    RecipeAbsent {
        /// The name.
        name: String,
    },
    /// This service has no cell.
    #[error("this service has no cell; nothing can be moved or scanned")]
    CellAbsent,
    /// The cell refused the request.
    #[error(transparent)]
    Cell(#[from] Refusal),
    /// The cell's task has ended, so the state of the devices is unknown.
    #[error("the cell has ended after commanding every device to halt; its state is unknown")]
    CellGone,
    /// The given lease id is not that of the current lease.
    #[error("the lease_id that was given is not that of the current lease, which {holder} has for another {} ms", remaining.as_millis())]
    LeaseOfAnother {
        /// Holder of the current lease.
        holder: String,
        /// Time until it expires unless it is renewed.
        remaining: Duration,
    },
    /// The motion is not allowed.
    #[error(transparent)]
    Motion(#[from] MotionRefusal),
    /// A pose, or a plan made from it, is no longer valid.
    #[error(transparent)]
    Stale(#[from] Stale),
    /// A manipulator has not answered yet, so its position is unknown.
    #[error("a manipulator has not answered yet, so its position is unknown")]
    PositionsUnknown,
    /// No move is stored under this id.
    #[error("there is no move {id}")]
    MoveUnknown {
        /// The id asked for.
        id: String,
    },
    /// No plan is stored under this id.
    #[error("there is no plan {id}")]
    PlanUnknown {
        /// The id asked for.
        id: String,
    },
    /// The measurement has no pose to plan from, or several.
    #[error("the measurement {measurement_id} has no pose, or more than one; name the part")]
    PoseMissing {
        /// Its id.
        measurement_id: String,
    },
    /// A request value is out of range.
    #[error("{field} must be {allowed}")]
    Value {
        /// The field.
        field: &'static str,
        /// The allowed values.
        allowed: String,
    },
    /// A configured device cannot be created.
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
        /// The part asked for.
        part: String,
        /// The names of its parts, in order of x.
        names: Vec<String>,
    },
    /// The measurement has fewer profiles than the index asked for.
    #[error("the measurement has {profiles_count} profiles, there is no profile {index}")]
    ProfileUnknown {
        /// The index asked for, from 0.
        index: u64,
        /// Number of profiles.
        profiles_count: u64,
    },
    /// A stored document cannot be read.
    #[error("the stored {what} {id} cannot be read: {cause}")]
    RecordUnreadable {
        /// Kind of record.
        what: &'static str,
        /// Its id.
        id: String,
        /// The reason.
        cause: Unreadable,
    },
    /// The ends of jobs are not recorded yet, so no further job is started.
    #[error("the ends of {count} jobs could not be written yet; no new job is started until the store accepts them")]
    EndsUnwritten {
        /// Number of ends that are not recorded.
        count: usize,
    },
    /// A record cannot be serialised.
    #[error("the {what} cannot be written down")]
    RecordUnwritable {
        /// Kind of record.
        what: &'static str,
        /// The reason.
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
        return "no parts were requested, or none were found".to_owned();
    }
    format!("there are {}, numbered from 1", names.join(", "))
}

/// Why the content of an upload cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ContentError {
    /// It is not a scan, or it cannot be cut into profiles as requested.
    #[error(transparent)]
    Scan(#[from] MeasureError),
    /// It cannot be decompressed.
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
    /// It was written by a later program version.
    #[error("it was written by a later version of coaxis (document version {found}; this one reads up to {known})")]
    Later {
        /// Version of the document.
        found: u64,
        /// The latest version that this program reads.
        known: u64,
    },
    /// It is not a document, or not of the expected kind.
    #[error("it is damaged, or another version of coaxis has written it: {0}")]
    Damaged(Arc<serde_json::Error>),
}
