//! What the product remembers: records in an embedded database, raw scans as files named by their content.
//!
//! ```text
//! rows in ───> writer (one task, one transaction for all that wait) ───> coaxis.db ───> readers ───> rows out
//! bytes in ──> scan_files (hash) ──> placing (with its row) ──> scans/ab/abcd… ──> a file to read from
//!                   └──> following: to read from while they come in
//! ```
//!
//! A write is acknowledged when it is durable, not before. Times and ids come in as arguments; documents are text that is
//! stored as it came. Must not know any other room.

mod columns;
mod connection;
mod error;
mod folder;
mod following;
mod jobs;
mod measurements;
mod migration;
mod page;
mod placing;
mod plans;
mod recipes;
mod rows;
mod scan_files;
mod scans;
mod statements;
#[cfg(test)]
mod tests;
mod usage;
mod writer;

pub use error::StoreError;
pub use folder::FolderLock;
pub use following::{ScanFollower, ScanTrail};
pub use jobs::{EndedJob, InsertedJob, JobRow, NewJob};
pub use page::{Cursor, Listing, PAGE_ROWS_MAX, Page};
pub use plans::{InsertedPlan, PlanRow};
pub use rows::{
    AnsweredRequest, Counts, Filter, Inserted, MeasurementRow, NewMeasurement, Precondition, PutRecipe, RecipeRow,
    RecordedScan, RequestKey, ScanRow,
};
pub use scan_files::{CompleteScan, ScanPart, ScanWriter};
pub use usage::Usage;

use std::{fmt::Write as _, io::Write as _, path::Path, sync::Arc};

use error::broken_constraint;
use folder::Folder;
use scan_files::blocking;
use sqlx::{SqliteConnection, SqlitePool};
use writer::{Write, Writer};

/// The store of one folder. Share it behind an `Arc`; every method may be called from many tasks at once.
#[derive(Debug)]
pub struct Store {
    folder: Arc<Folder>,
    writer: Writer,
    readers: SqlitePool,
}

/// How far the store may grow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StoreLimits {
    /// Size of the database file beyond which writes meet [`StoreError::Full`]; the write-ahead log comes on top, and so do
    /// the raw scans.
    pub database_bytes_max: Option<u64>,
}

impl Store {
    /// Opens the store of a folder without a limit of its own: it may grow as far as the disk reaches.
    ///
    /// # Errors
    /// As [`Store::open_within`].
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        Self::open_within(folder, StoreLimits::default()).await
    }

    /// Opens the store of a folder, creating and upgrading what is needed. One process at a time.
    ///
    /// # Errors
    /// [`StoreError::FolderInUse`], [`StoreError::NewerSchema`], [`StoreError::MigrationDiffers`],
    /// [`StoreError::Damaged`], or that the folder or the database cannot be used.
    pub async fn open_within(folder: &Path, limits: StoreLimits) -> Result<Self, StoreError> {
        let root = folder.to_owned();
        let folder = Arc::new(blocking(move || Folder::open(&root)).await?);
        let mut connection = connection::writer(&folder.database(), limits.database_bytes_max).await?;
        migration::migrate(&mut connection, migration::MIGRATIONS).await?;
        placing::clear_up_all(&folder, &mut connection).await?;
        let readers = connection::readers(&folder.database()).await?;
        let writer = Writer::start(Arc::clone(&folder), limits, connection);
        Ok(Self { folder, writer, readers })
    }

    /// Whether records and scans can be written, found out by writing durably.
    ///
    /// # Errors
    /// Why not.
    pub async fn probe(&self) -> Result<(), StoreError> {
        let folder = Arc::clone(&self.folder);
        let scans = blocking(move || {
            let (temporary, mut file) = folder.create_part()?;
            file.write_all(&[0; 4096]).and_then(|()| file.sync_all()).map_err(StoreError::of_file(temporary.path()))
        });
        scans.await?;
        self.writer.write(Probe).await
    }

    /// How much the store holds. Counts rows: some ten milliseconds at a million of them.
    ///
    /// # Errors
    /// What the database says.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        let row = sqlx::query(statements::COUNTS).fetch_one(&self.readers).await?;
        Ok(Counts {
            scans_count: columns::count(&row, "scans_count")?,
            measurements_count: columns::count(&row, "measurements_count")?,
            recipes_count: columns::count(&row, "recipes_count")?,
        })
    }

    /// Finishes the writes that wait, then refuses all further calls with [`StoreError::Closed`].
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

struct Probe;

impl Write for Probe {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(statements::PROBE).execute(database).await?;
        Ok(())
    }
}

/// Lower-case hexadecimal digits.
fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(bytes.len() * 2), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
