//! The rows that the store keeps, and how numbers, times and texts are written to the columns of the database and read back. A
//! document is text that the service writes and reads; times and ids are arguments.

use std::fmt::Write as _;

use jiff::Timestamp;
use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use super::error::StoreError;

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
    /// The sender's description, e.g. the name of the file.
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
    /// Name of the recipe, if one was used. The document contains the recipe itself, as it was then.
    pub recipe: Option<String>,
    /// The whole record.
    pub document: String,
}

/// Identifies a repeated request.
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

/// Which measurements are listed: those that match all given fields.
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

/// The precondition for putting a recipe.
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
    /// The precondition is not fulfilled; nothing was written.
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

/// The numbers of rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Recorded scans.
    pub scans_count: u64,
    /// Recorded measurements.
    pub measurements_count: u64,
    /// Recipes.
    pub recipes_count: u64,
}

/// A time as microseconds since 1970; finer digits are dropped.
pub(super) fn micros(time: Timestamp) -> i64 {
    time.as_microsecond()
}

/// A count as the database's widest integer.
pub(super) fn integer(number: u64) -> Result<i64, StoreError> {
    i64::try_from(number).map_err(|_| StoreError::NumberTooLarge { number })
}

/// A text from its column. Bytes that are not UTF-8 are replaced, so that a damaged text does not hide the row it stands in.
pub(super) fn text(row: &SqliteRow, column: &str) -> Result<String, sqlx::Error> {
    Ok(String::from_utf8_lossy(&row.try_get::<Vec<u8>, _>(column)?).into_owned())
}

/// A text from a column that may be empty, read as [`text`] reads it.
pub(super) fn optional_text(row: &SqliteRow, column: &str) -> Result<Option<String>, sqlx::Error> {
    let bytes = row.try_get::<Option<Vec<u8>>, _>(column)?;
    Ok(bytes.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()))
}

/// A time from its column. A number that is no time is read as the nearest one, for the same reason as a damaged text.
pub(super) fn timestamp(row: &SqliteRow, column: &str) -> Result<Timestamp, sqlx::Error> {
    Ok(nearest(row.try_get(column)?))
}

/// A time from a column that may be empty, read as [`timestamp`] reads it.
pub(super) fn optional_timestamp(row: &SqliteRow, column: &str) -> Result<Option<Timestamp>, sqlx::Error> {
    Ok(row.try_get::<Option<i64>, _>(column)?.map(nearest))
}

fn nearest(micros: i64) -> Timestamp {
    let bound = if micros < 0 { Timestamp::MIN } else { Timestamp::MAX };
    Timestamp::from_microsecond(micros).unwrap_or(bound)
}

/// A count from its column.
pub(super) fn count(row: &SqliteRow, column: &str) -> Result<u64, sqlx::Error> {
    u64::try_from(row.try_get::<i64, _>(column)?).map_err(undecodable(column))
}

/// A count from a column that may be empty.
pub(super) fn optional_count(row: &SqliteRow, column: &str) -> Result<Option<u64>, sqlx::Error> {
    row.try_get::<Option<i64>, _>(column)?.map(|number| u64::try_from(number).map_err(undecodable(column))).transpose()
}

fn undecodable<E: std::error::Error + Send + Sync + 'static>(column: &str) -> impl FnOnce(E) -> sqlx::Error {
    let index = column.to_owned();
    |source| sqlx::Error::ColumnDecode { index, source: Box::new(source) }
}

/// Lower-case hexadecimal digits.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(bytes.len() * 2), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
