//! Raw scans: receives, records and opens them. The same bytes have one row, however often they are sent.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use sqlx::{FromRow, SqliteConnection, sqlite::SqliteRow};

use super::error::StoreError;
use super::folder::blocking;
use super::page::{self, Listed, Listing, Page};
use super::placing::WithFile;
use super::repository::Store;
use super::rows::{RecordedScan, ScanRow, count, integer, micros, optional_count, optional_text, text, timestamp};
use super::scan_files::{CompleteScan, ScanWriter, open_verified};
use super::statements;
use super::writer::Write;

impl Store {
    /// Begins a raw scan of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn begin_scan(&self, bytes_max: u64) -> Result<ScanWriter, StoreError> {
        #[cfg(test)]
        self.commits.check_room()?;
        ScanWriter::begin(Arc::clone(&self.folder), bytes_max).await
    }

    /// The path of the scan with this id, whether the file exists or not; `None` if this is not the id of a scan.
    #[must_use]
    pub fn scan_path(&self, id: &str) -> Option<PathBuf> {
        self.folder.scan(id.strip_prefix("s-")?).map(|(_, file)| file)
    }

    /// Opens the raw scan with this id for reading, after comparing its bytes with the id; `None` if there is no such scan.
    ///
    /// # Errors
    /// [`StoreError::ScanDamaged`], [`StoreError::FileUnavailable`].
    pub async fn open_scan(&self, id: &str) -> Result<Option<File>, StoreError> {
        let Some(path) = self.scan_path(id) else { return Ok(None) };
        let id = id.to_owned();
        // The semaphore is never closed while the store is open.
        let turn = Arc::clone(&self.comparing).acquire_owned().await.map_err(|_| StoreError::Closed)?;
        blocking(move || {
            let _turn = turn;
            open_verified(&path, &id)
        })
        .await
    }

    /// Records a scan; if it was recorded before, the first row is kept. Durable on return.
    ///
    /// # Errors
    /// The errors of every write: [`StoreError::Full`], [`StoreError::Unavailable`].
    pub async fn record_scan(&self, scan: &ScanRow) -> Result<RecordedScan, StoreError> {
        self.writer.write(scan.clone()).await
    }

    /// Keeps a scan: records it and moves its file to its final place, both or neither. Durable on return.
    ///
    /// # Errors
    /// As [`Store::record_scan`], and [`StoreError::FileUnavailable`].
    pub async fn keep_scan(
        &self,
        row: ScanRow,
        file: impl Into<Arc<CompleteScan>>,
    ) -> Result<RecordedScan, StoreError> {
        self.writer.write(WithFile::new(row, file.into()).await?).await
    }

    /// The record of the scan with this id.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn scan(&self, id: &str) -> Result<Option<ScanRow>, StoreError> {
        Ok(sqlx::query_as(statements::SCAN).bind(id).fetch_optional(&self.readers).await?)
    }

    /// A page of the recorded scans, newest first.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn scans(&self, page: &Page) -> Result<Listing<ScanRow>, StoreError> {
        page::list(&self.readers, &[], page).await
    }
}

/// Inserts the row within the caller's transaction. If there is a row with its id, only the latest arrival is updated.
pub(super) async fn insert(scan: &ScanRow, database: &mut SqliteConnection) -> Result<RecordedScan, StoreError> {
    let insert = sqlx::query(statements::INSERT_SCAN)
        .bind(&scan.id)
        .bind(micros(scan.created_at))
        .bind(integer(scan.bytes_count)?)
        .bind(&scan.format)
        .bind(scan.points_count.map(integer).transpose()?)
        .bind(&scan.description)
        .bind(&scan.arrival);
    if insert.execute(&mut *database).await?.rows_affected() > 0 {
        return Ok(RecordedScan::New);
    }
    if let Some(arrival) = &scan.arrival {
        sqlx::query(statements::SCAN_ARRIVED).bind(&scan.id).bind(arrival).execute(&mut *database).await?;
    }
    Ok(RecordedScan::Known(sqlx::query_as(statements::SCAN).bind(&scan.id).fetch_one(database).await?))
}

impl Write for ScanRow {
    type Outcome = RecordedScan;

    async fn apply(&self, database: &mut SqliteConnection) -> Result<RecordedScan, StoreError> {
        insert(self, database).await
    }
}

impl Listed for ScanRow {
    const LIST: statements::List = statements::SCANS;
}

impl FromRow<'_, SqliteRow> for ScanRow {
    fn from_row(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            id: text(row, "id")?,
            created_at: timestamp(row, "created_at")?,
            bytes_count: count(row, "bytes_count")?,
            format: text(row, "format")?,
            points_count: optional_count(row, "points_count")?,
            description: optional_text(row, "description")?,
            arrival: optional_text(row, "arrival")?,
        })
    }
}
