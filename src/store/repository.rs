//! The store of one folder: opens it, checks it for lost records, probes, counts and closes it, and reports its used and free
//! space. Each kind of row has its own file.

use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::thread::available_parallelism;
use std::{fs, io};

use rustix::fs::statvfs;
use sqlx::{Connection as _, SqliteConnection, SqlitePool};
use tokio::sync::Semaphore;

use super::commits::{CommitFile, CommitLog, Counted};
use super::database::{self, StoreLimits};
use super::error::{Loss, StoreError};
use super::folder::{Folder, blocking};
use super::rows::{self, Counts};
use super::writer::{Write, Writer};
use super::{placing, statements};

/// The store of one folder. It is shared behind an `Arc`; every method may be called from many tasks at once.
#[derive(Debug)]
pub struct Store {
    pub(super) folder: Arc<Folder>,
    pub(super) writer: Writer,
    pub(super) readers: SqlitePool,
    pub(super) commits: Arc<CommitLog>,
    /// Limits the number of files whose bytes are compared with their hash at the same time, because this takes a processor and
    /// clients may request many.
    pub(super) comparing: Arc<Semaphore>,
}

impl Store {
    /// Opens the store of a folder without a size limit of its own, so that only the disk limits it.
    ///
    /// # Errors
    /// As [`Store::open_within`].
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        Self::open_within(folder, StoreLimits::default()).await
    }

    /// Opens the store of a folder, and creates or upgrades it if needed. Only one process may do so at a time. A store whose
    /// database lost records can be read, but refuses every write with [`StoreError::RecordsLost`].
    ///
    /// # Errors
    /// [`StoreError::FolderInUse`], [`StoreError::NewerSchema`], [`StoreError::MigrationDiffers`], [`StoreError::Damaged`], or an
    /// error of the folder or the database.
    pub async fn open_within(folder: &Path, limits: StoreLimits) -> Result<Self, StoreError> {
        let root = folder.to_owned();
        let open = move || Folder::open(&root).and_then(|folder| folder.create_database().map(|()| folder));
        let folder = Arc::new(blocking(open).await?);
        let mut connection = database::writer(&folder.database(), limits.database_bytes_max).await?;
        let counts = database::user_version(&mut connection).await? >= database::COUNTS_COMMITS;
        database::migrate(&mut connection, database::MIGRATIONS).await?;
        let commits = Arc::new(compare_commits(&folder, &mut connection, counts).await?);
        if commits.check_loss().is_ok() {
            // If the database lost rows, the files without a row are the only remaining data.
            placing::clear_up_all(&folder, &mut connection).await?;
        }
        let readers = database::readers(&folder.database()).await?;
        let writer = Writer::start(Arc::clone(&folder), limits, connection, Arc::clone(&commits));
        // Half of the processors, so that stops and all other work do not wait for it.
        let comparing = Semaphore::new(available_parallelism().map_or(1, |count| count.get().div_ceil(2)));
        Ok(Self { folder, writer, readers, commits, comparing: Arc::new(comparing) })
    }

    /// Accepts the database in its present state although records were lost; the next start compares with this state.
    ///
    /// # Errors
    /// As [`Store::open`].
    pub async fn accept_loss(folder: &Path) -> Result<(), StoreError> {
        let root = folder.to_owned();
        let folder = Arc::new(blocking(move || Folder::open(&root)).await?);
        let mut connection = database::writer(&folder.database(), None).await?;
        database::migrate(&mut connection, database::MIGRATIONS).await?;
        let found = Counted::of(&mut connection).await?.last;
        connection.close().await?;
        blocking(move || CommitFile::create(folder.commits())?.write(&found)).await
    }

    /// Checks by a durable write whether records and scans can be written.
    ///
    /// # Errors
    /// The reason why they cannot.
    pub async fn probe(&self) -> Result<(), StoreError> {
        let folder = Arc::clone(&self.folder);
        let scans = blocking(move || {
            let (temporary, mut file) = folder.create_part()?;
            file.write_all(&[0; 4096]).and_then(|()| file.sync_all()).map_err(StoreError::of_file(temporary.path()))
        });
        scans.await?;
        self.writer.write(Probe).await
    }

    /// Simulates a full disk, or ends the simulation.
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

    /// The numbers of rows. Counting takes about ten milliseconds for a million rows.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn counts(&self) -> Result<Counts, StoreError> {
        let row = sqlx::query(statements::COUNTS).fetch_one(&self.readers).await?;
        Ok(Counts {
            scans_count: rows::count(&row, "scans_count")?,
            measurements_count: rows::count(&row, "measurements_count")?,
            recipes_count: rows::count(&row, "recipes_count")?,
        })
    }

    /// Finishes the waiting writes, then refuses all further calls with [`StoreError::Closed`].
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

/// Compares the database with the count beside it. `counted` means that an earlier run has counted its commits.
pub(super) async fn compare_commits(
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
                    tracing::warn!("the count of commits beside the database was missing; a new one was created");
                }
                file.write(&found.last)?;
            }
        }
        let last = acknowledged.filter(|_| loss.is_some()).unwrap_or(found.last);
        Ok(CommitLog::new(file, folder.database(), last, loss))
    };
    blocking(compare).await
}

pub(super) struct Probe;

impl Write for Probe {
    type Outcome = ();

    async fn apply(&self, database: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(statements::PROBE).execute(database).await?;
        Ok(())
    }
}

/// Space in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Usage {
    /// The database with its write-ahead log.
    pub database_bytes: u64,
    /// Free space on the disk for this user.
    pub disk_free_bytes: u64,
    /// Size of the disk.
    pub disk_total_bytes: u64,
}

impl Store {
    /// The space that the store uses, and the free space.
    ///
    /// # Errors
    /// An error of the operating system.
    pub async fn usage(&self) -> Result<Usage, StoreError> {
        let folder = Arc::clone(&self.folder);
        blocking(move || {
            let database = folder.database();
            measure(&database).map_err(StoreError::of_file(&database))
        })
        .await
    }
}

fn measure(database: &Path) -> io::Result<Usage> {
    let disk = statvfs(database)?;
    let mut log = database.to_owned().into_os_string();
    log.push("-wal");
    // The log does not exist until something is written.
    let log_bytes = fs::metadata(log).map_or(0, |file| file.len());
    Ok(Usage {
        database_bytes: fs::metadata(database)?.len().saturating_add(log_bytes),
        disk_free_bytes: disk.f_bavail.saturating_mul(disk.f_frsize),
        disk_total_bytes: disk.f_blocks.saturating_mul(disk.f_frsize),
    })
}
