//! Measurements: inserts them once per request, reads and lists them.

use std::sync::Arc;

use sqlx::{FromRow, SqliteConnection, error::ErrorKind, sqlite::SqliteRow};

use super::error::{StoreError, broken_constraint};
use super::page::{self, Listed, Listing, Page};
use super::placing::WithFile;
use super::repository::Store;
use super::rows::{
    AnsweredRequest, Filter, Inserted, MeasurementRow, NewMeasurement, NewestMeasurement, RequestKey, count, micros,
    optional_text, text, timestamp,
};
use super::scan_files::CompleteScan;
use super::writer::Write;
use super::{scans, statements};

impl Store {
    /// Records a measurement with its profiles, its request and, if given, its scan, in one transaction. Durable on return.
    ///
    /// # Errors
    /// [`StoreError::ScanUnknown`], [`StoreError::IdTaken`], and the errors of every write: [`StoreError::Full`],
    /// [`StoreError::Unavailable`]. After these two the record may exist nevertheless; repeating the request under the same id
    /// settles it.
    pub async fn insert_measurement(&self, new: NewMeasurement) -> Result<Inserted, StoreError> {
        self.writer.write(new).await
    }

    /// As [`Store::insert_measurement`], with the file of the scan, which is moved to its final place together with the row.
    ///
    /// # Errors
    /// As [`Store::insert_measurement`], and [`StoreError::FileUnavailable`].
    pub async fn insert_measurement_of(&self, new: NewMeasurement, file: CompleteScan) -> Result<Inserted, StoreError> {
        self.writer.write(WithFile::new(new, Arc::new(file)).await?).await
    }

    /// The measurement with this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn measurement(&self, id: &str) -> Result<Option<MeasurementRow>, StoreError> {
        Ok(sqlx::query_as(statements::MEASUREMENT).bind(id).fetch_optional(&self.readers).await?)
    }

    /// The answer to the request with this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn measurement_by_request(&self, request_id: &str) -> Result<Option<AnsweredRequest>, StoreError> {
        Ok(sqlx::query_as(statements::ANSWERED_REQUEST).bind(request_id).fetch_optional(&self.readers).await?)
    }

    /// A page of the measurements that pass the filter, newest first.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn measurements(&self, filter: &Filter, page: &Page) -> Result<Listing<MeasurementRow>, StoreError> {
        let conditions = [
            ("scan_id", filter.scan_id.as_deref()),
            ("verdict", filter.verdict.as_deref()),
            ("recipe", filter.recipe.as_deref()),
        ];
        page::list(&self.readers, &conditions, page).await
    }

    /// The measurement that was recorded last; `None` if there is none.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn newest_measurement(&self) -> Result<Option<NewestMeasurement>, StoreError> {
        let row = sqlx::query(statements::NEWEST_MEASUREMENT).fetch_optional(&self.readers).await?;
        let newest = row.map(|row| {
            Ok::<_, sqlx::Error>(NewestMeasurement {
                sequence: count(&row, "sequence")?,
                id: text(&row, "id")?,
                created_at: timestamp(&row, "created_at")?,
                verdict: text(&row, "verdict")?,
            })
        });
        Ok(newest.transpose()?)
    }

    /// The diagnostics that were inserted with the measurement of this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn profiles(&self, id: &str) -> Result<Option<Vec<u8>>, StoreError> {
        Ok(sqlx::query_scalar(statements::PROFILES).bind(id).fetch_optional(&self.readers).await?)
    }
}

impl Write for NewMeasurement {
    type Outcome = Inserted;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<Inserted, StoreError> {
        if let Some(request) = &self.request
            && let Some(earlier) = answer_to(request, database).await?
        {
            return Ok(earlier);
        }
        if let Some(scan) = &self.scan {
            scans::insert(scan, database).await?;
        }
        insert_row(&self.row, database).await?;
        let id = &self.row.id;
        sqlx::query(statements::INSERT_PROFILES).bind(id).bind(&self.profiles).execute(&mut *database).await?;
        if let Some(RequestKey { id: request_id, fingerprint }) = &self.request {
            let insert = sqlx::query(statements::INSERT_REQUEST).bind(request_id).bind(fingerprint).bind(id);
            insert.execute(database).await?;
        }
        Ok(Inserted::New)
    }
}

async fn answer_to(request: &RequestKey, database: &mut SqliteConnection) -> Result<Option<Inserted>, StoreError> {
    let earlier: Option<AnsweredRequest> =
        sqlx::query_as(statements::ANSWERED_REQUEST).bind(&request.id).fetch_optional(database).await?;
    Ok(earlier.map(|earlier| {
        if earlier.fingerprint == request.fingerprint {
            Inserted::Replayed(Box::new(earlier.measurement))
        } else {
            Inserted::RequestMismatch
        }
    }))
}

async fn insert_row(row: &MeasurementRow, database: &mut SqliteConnection) -> Result<(), StoreError> {
    let insert = sqlx::query(statements::INSERT_MEASUREMENT)
        .bind(&row.id)
        .bind(micros(row.created_at))
        .bind(&row.verdict)
        .bind(&row.method)
        .bind(&row.scan_id)
        .bind(&row.recipe)
        .bind(&row.document);
    match insert.execute(database).await {
        Ok(_) => Ok(()),
        Err(error) => Err(match broken_constraint(&error) {
            Some(ErrorKind::ForeignKeyViolation) => StoreError::ScanUnknown { scan_id: row.scan_id.clone() },
            Some(ErrorKind::UniqueViolation) => StoreError::IdTaken { id: row.id.clone() },
            _ => error.into(),
        }),
    }
}

impl Listed for MeasurementRow {
    const LIST: statements::List = statements::MEASUREMENTS;
}

impl FromRow<'_, SqliteRow> for MeasurementRow {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            id: text(row, "id")?,
            created_at: timestamp(row, "created_at")?,
            verdict: text(row, "verdict")?,
            method: text(row, "method")?,
            scan_id: text(row, "scan_id")?,
            recipe: optional_text(row, "recipe")?,
            document: text(row, "document")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for AnsweredRequest {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self { fingerprint: text(row, "fingerprint")?, measurement: MeasurementRow::from_row(row)? })
    }
}
