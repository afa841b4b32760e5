//! What the store keeps, as it goes in and comes out: plain rows. A document is text that service fills and reads; times and
//! ids come from outside.

use jiff::Timestamp;

/// A raw scan, known by its content.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanRow {
    /// `s-` and the SHA-256 of the bytes, 64 lower-case hexadecimal digits.
    pub id: String,
    /// When it was first seen; kept to the microsecond.
    pub created_at: Timestamp,
    /// Length of the file.
    pub bytes_count: u64,
    /// Name of the format it was read as.
    pub format: String,
    /// Points in it, where they were counted.
    pub points_count: Option<u64>,
    /// What whoever sent it says about it, e.g. the name of the file.
    pub description: Option<String>,
    /// When these bytes arrived last, and what had happened by then, in a form of service's choice.
    pub arrival: Option<String>,
}

/// What became of a scan that was to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RecordedScan {
    /// Its row is new.
    New,
    /// The same bytes were recorded before, as this row; of it only the arrival was changed.
    Known(ScanRow),
}

/// A measurement that ran.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeasurementRow {
    /// Its id, made by service.
    pub id: String,
    /// When it was made; kept to the microsecond.
    pub created_at: Timestamp,
    /// Accepted or refused, in service's words.
    pub verdict: String,
    /// Name of the method.
    pub method: String,
    /// The scan it was made from; must be recorded.
    pub scan_id: String,
    /// Name of the recipe, where one was used. The document holds the recipe itself, as it was then.
    pub recipe: Option<String>,
    /// The whole record.
    pub document: String,
}

/// What makes a repeated request recognisable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestKey {
    /// The client's id of the request.
    pub id: String,
    /// Digest of what was asked: the same id with another fingerprint is a mistake of the client.
    pub fingerprint: String,
}

/// A measurement to be inserted, with all that belongs into the same transaction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewMeasurement {
    /// The record.
    pub row: MeasurementRow,
    /// Its scan, to be recorded with it unless it is known; `None` where it was recorded before.
    pub scan: Option<ScanRow>,
    /// Diagnostics of each profile, in a form of service's choice.
    pub profiles: Vec<u8>,
    /// The request that asked for it, where the client gave it an id.
    pub request: Option<RequestKey>,
}

/// What became of a measurement that was to be inserted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Inserted {
    /// It is recorded.
    New,
    /// The request was answered before, by this measurement; nothing was written.
    Replayed(Box<MeasurementRow>),
    /// The request's id was used before for something else; nothing was written.
    RequestMismatch,
}

/// A request that was answered before.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AnsweredRequest {
    /// Digest of what was asked.
    pub fingerprint: String,
    /// The answer.
    pub measurement: MeasurementRow,
}

/// Which measurements a list holds; fields that are set must all hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filter {
    /// Those made from this scan.
    pub scan_id: Option<String>,
    /// Those with this verdict.
    pub verdict: Option<String>,
    /// Those made with the recipe of this name.
    pub recipe: Option<String>,
}

impl Filter {
    /// Whether a list with this filter shows the measurement.
    #[must_use]
    pub fn passes(&self, row: &MeasurementRow) -> bool {
        self.scan_id.as_ref().is_none_or(|id| row.scan_id == *id)
            && self.verdict.as_ref().is_none_or(|verdict| row.verdict == *verdict)
            && (self.recipe.is_none() || row.recipe == self.recipe)
    }
}

/// The current revision of a recipe.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecipeRow {
    /// Its name.
    pub name: String,
    /// Counts up from 1 with every replacement.
    pub revision: u64,
    /// The recipe.
    pub document: String,
    /// When the first revision was put.
    pub created_at: Timestamp,
    /// When this revision was put.
    pub updated_at: Timestamp,
}

impl RecipeRow {
    /// The revision as an opaque tag, without the quotation marks of HTTP: `r3`.
    #[must_use]
    pub fn etag(&self) -> String {
        format!("r{}", self.revision)
    }
}

/// What must hold for a recipe to be put.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Precondition {
    /// Nothing.
    None,
    /// There is a recipe of this name.
    MustExist,
    /// There is none.
    MustNotExist,
    /// The current revision has this [`RecipeRow::etag`].
    Match(String),
}

/// What became of a recipe that was to be put.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PutRecipe {
    /// It is the first of its name.
    Created(RecipeRow),
    /// It took the place of the revision before it.
    Replaced(RecipeRow),
    /// The precondition does not hold; nothing was written.
    PreconditionFailed {
        /// What is there instead.
        current: Option<RecipeRow>,
    },
}

/// The measurement that was recorded last.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewestMeasurement {
    /// Grows with every measurement that is recorded.
    pub sequence: u64,
    /// Its id.
    pub id: String,
    /// See [`MeasurementRow::created_at`].
    pub created_at: Timestamp,
    /// See [`MeasurementRow::verdict`].
    pub verdict: String,
}

/// How much the store holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Recorded scans.
    pub scans_count: u64,
    /// Recorded measurements.
    pub measurements_count: u64,
    /// Recipes.
    pub recipes_count: u64,
}
