//! What the product remembers: records in an embedded database, raw scans as files named by their content.
//!
//! ```text
//! rows in ───> writer (one task, one transaction for all that wait) ───> coaxis.db ───> readers ───> rows out
//! bytes in ──> scan_files (hash) ──> placing (with its row) ──> scans/ab/abcd… ──> a file to read from
//!                   └──> following: to read from while they come in
//! ```
//!
//! A write is acknowledged when it is durable, not before. Times and ids come in as arguments; documents are text that is
//! stored as it came.

mod checkup;
mod columns;
mod commits;
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

pub use checkup::{Checkup, ScanCheck};
pub use commits::Loss;
pub use error::StoreError;
pub use folder::FolderLock;
pub use following::{ScanFollower, ScanTrail};
pub use jobs::{EndedJob, InsertedJob, JobRow, NewJob};
pub use page::{Cursor, Listing, PAGE_ROWS_MAX, Page};
pub use plans::{InsertedPlan, ListedPlan, PlanRow};
pub use rows::{
    AnsweredRequest, Counts, Filter, Inserted, MeasurementRow, NewMeasurement, NewestMeasurement, Precondition,
    PutRecipe, RecipeRow, RecordedScan, RequestKey, ScanRow,
};
pub use scan_files::{CompleteScan, ScanPart, ScanWriter};
pub use usage::Usage;

use std::{fmt::Write as _, io::Write as _, path::Path, sync::Arc, thread::available_parallelism};

use commits::{CommitFile, CommitLog, Counted};
use error::broken_constraint;
use folder::Folder;
use scan_files::blocking;
use sqlx::{Connection as _, SqliteConnection, SqlitePool};
use tokio::sync::Semaphore;
use writer::{Write, Writer};

/// The store of one folder. Share it behind an `Arc`; every method may be called from many tasks at once.
#[derive(Debug)]
pub struct Store {
    folder: Arc<Folder>,
    writer: Writer,
    readers: SqlitePool,
    commits: Arc<CommitLog>,
    /// One permit for every file whose bytes are compared with their hash: that takes a processor, and clients may ask for many.
    comparing: Arc<Semaphore>,
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

    /// Opens the store of a folder, creating and upgrading what is needed. One process at a time. A store whose database lost
    /// records can be read; it refuses every write with [`StoreError::RecordsLost`].
    ///
    /// # Errors
    /// [`StoreError::FolderInUse`], [`StoreError::NewerSchema`], [`StoreError::MigrationDiffers`],
    /// [`StoreError::Damaged`], or that the folder or the database cannot be used.
    pub async fn open_within(folder: &Path, limits: StoreLimits) -> Result<Self, StoreError> {
        let root = folder.to_owned();
        let open = move || Folder::open(&root).and_then(|folder| folder.create_database().map(|()| folder));
        let folder = Arc::new(blocking(open).await?);
        let mut connection = connection::writer(&folder.database(), limits.database_bytes_max).await?;
        let counts = migration::user_version(&mut connection).await? >= migration::COUNTS_COMMITS;
        migration::migrate(&mut connection, migration::MIGRATIONS).await?;
        let commits = Arc::new(compare_commits(&folder, &mut connection, counts).await?);
        if commits.check_loss().is_ok() {
            // Of a database that lost rows, the files without a row are all that is left.
            placing::clear_up_all(&folder, &mut connection).await?;
        }
        let readers = connection::readers(&folder.database()).await?;
        let writer = Writer::start(Arc::clone(&folder), limits, connection, Arc::clone(&commits));
        // Half of the processors, so that stops and everything else are not behind it.
        let comparing = Semaphore::new(available_parallelism().map_or(1, |count| count.get().div_ceil(2)));
        Ok(Self { folder, writer, readers, commits, comparing: Arc::new(comparing) })
    }

    /// Takes the database as it is, although records were lost: the next start compares with what it holds now.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn accept_loss(folder: &Path) -> Result<(), StoreError> {
        let root = folder.to_owned();
        let folder = Arc::new(blocking(move || Folder::open(&root)).await?);
        let mut connection = connection::writer(&folder.database(), None).await?;
        migration::migrate(&mut connection, migration::MIGRATIONS).await?;
        let found = Counted::of(&mut connection).await?.last;
        connection.close().await?;
        blocking(move || CommitFile::create(folder.commits())?.write(&found)).await
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

    /// Fills the disk, or makes room again, as far as this store can see.
    #[cfg(test)]
    pub(crate) fn set_full(&self, full: bool) {
        self.commits.full.store(full, std::sync::atomic::Ordering::SeqCst);
    }

    /// Whether the database lost records that were acknowledged.
    ///
    /// # Errors
    /// [`StoreError::RecordsLost`].
    pub fn check_loss(&self) -> Result<(), StoreError> {
        self.commits.check_loss()
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

/// Compares the database with the count beside it. `counted`: an earlier run had counted its commits.
async fn compare_commits(
    folder: &Arc<Folder>,
    database: &mut SqliteConnection,
    counted: bool,
) -> Result<CommitLog, StoreError> {
    let found = Counted::of(&mut *database).await?;
    let is_empty = sqlx::query(statements::NEWEST_SCAN).fetch_optional(database).await?.is_none();
    let folder = Arc::clone(folder);
    let compare = move || {
        let (file, acknowledged) = CommitFile::open(folder.commits())?;
        let scans_count = if is_empty { folder.scans_count()? } else { 0 };
        let loss = match &acknowledged {
            Some(acknowledged) => found.check(acknowledged).err(),
            None => (scans_count > 0).then_some(Loss::Empty { scans_count }),
        };
        let loss = loss.map(|loss| if scans_count > 0 { Loss::Empty { scans_count } } else { loss });
        match &loss {
            Some(loss) => tracing::error!("{loss}; nothing is written until `coaxis doctor --accept-loss`"),
            None => {
                if counted && acknowledged.is_none() {
                    tracing::warn!("the count of commits beside the database was missing; it is begun anew");
                }
                file.write(&found.last)?;
            }
        }
        let last = acknowledged.filter(|_| loss.is_some()).unwrap_or(found.last);
        Ok(CommitLog::new(file, folder.database(), last, loss))
    };
    blocking(compare).await
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
