//! Examines the store of a folder without changing anything, whether a service is running on it or not.

use std::path::{Path, PathBuf};

use sqlx::{Row, SqlitePool};

use super::commits::{CommitFile, Counted};
use super::database::{self, MIGRATIONS};
use super::error::{Loss, StoreError};
use super::folder::blocking;
use super::jobs::JobRow;
use super::page::{Listing, Page};
use super::plans::ListedPlan;
use super::rows::{MeasurementRow, RecipeRow, ScanRow};
use super::scan_files::open_verified;
use super::{folder, page};

/// A service that writes meanwhile may be between a commit and its count; then both are read again.
const TRIES: usize = 100;

/// The store of a folder that is being examined.
#[derive(Debug)]
pub struct Checkup {
    root: PathBuf,
    database: SqlitePool,
}

/// The result of checking the file of a scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScanCheck {
    /// It matches its record.
    Intact,
    /// It does not exist.
    Missing,
    /// Its length differs.
    Length {
        /// Bytes of the file.
        found: u64,
    },
    /// Its content differs.
    Damaged {
        /// SHA-256 of the file.
        found_sha256: String,
    },
}

impl Checkup {
    /// Opens the database of a folder for reading.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`] if there is none, [`StoreError::NewerSchema`], [`StoreError::OlderSchema`],
    /// [`StoreError::Damaged`].
    pub async fn open(folder: &Path) -> Result<Self, StoreError> {
        let (root, file) = (folder.to_owned(), folder::database(folder));
        std::fs::metadata(&file).map_err(StoreError::of_file(&file))?;
        let database = database::examiner(&file).await?;
        let mut one = database.acquire().await?;
        let found = database::user_version(&mut one).await?;
        let known = MIGRATIONS.last().map_or(0, |step| step.version);
        drop(one);
        match found.cmp(&known) {
            std::cmp::Ordering::Less => Err(StoreError::OlderSchema { found, known }),
            std::cmp::Ordering::Equal => Ok(Self { root, database }),
            std::cmp::Ordering::Greater => Err(StoreError::NewerSchema { found, known }),
        }
    }

    /// The faults that SQLite finds in the database; `thorough` also compares the indexes.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn database_faults(&self, thorough: bool) -> Result<Vec<String>, StoreError> {
        let check = if thorough { "PRAGMA integrity_check" } else { "PRAGMA quick_check" };
        let mut faults = Vec::new();
        for row in sqlx::query(check).fetch_all(&self.database).await? {
            let text: String = row.try_get(0)?;
            if text != "ok" {
                faults.push(text);
            }
        }
        let orphans = sqlx::query("PRAGMA foreign_key_check").fetch_all(&self.database).await?;
        if !orphans.is_empty() {
            faults.push(format!("{} rows refer to rows that are missing", orphans.len()));
        }
        Ok(faults)
    }

    /// The loss of records, if there was one.
    ///
    /// # Errors
    /// An error of the database or of the operating system.
    pub async fn loss(&self) -> Result<Option<Loss>, StoreError> {
        let path = folder::commits(&self.root);
        let mut found = None;
        for _ in 0..TRIES {
            let (before, after) = (path.clone(), path.clone());
            let before = blocking(move || CommitFile::read(&before)).await?;
            let counted = Counted::of(&mut *self.database.acquire().await?).await?;
            let after = blocking(move || CommitFile::read(&after)).await?;
            found = before.as_ref().and_then(|acknowledged| counted.check(acknowledged).err());
            if found.is_none() || before == after {
                break;
            }
        }
        Ok(found)
    }

    /// Compares the file of a scan with its record; `scrub` reads all of its bytes.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`] if it cannot be read.
    pub async fn check_scan(&self, row: &ScanRow, scrub: bool) -> Result<ScanCheck, StoreError> {
        let digest = row.id.strip_prefix("s-").unwrap_or_default();
        let Some((_, path)) = folder::scan(&self.root, digest) else { return Ok(ScanCheck::Missing) };
        let (id, expected) = (row.id.clone(), row.bytes_count);
        blocking(move || {
            let found = match std::fs::metadata(&path) {
                Ok(found) => found.len(),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(ScanCheck::Missing),
                Err(error) => return Err(StoreError::of_file(path)(error)),
            };
            if found != expected {
                return Ok(ScanCheck::Length { found });
            }
            match scrub.then(|| open_verified(&path, &id)) {
                Some(Err(StoreError::ScanDamaged { found_sha256, .. })) => Ok(ScanCheck::Damaged { found_sha256 }),
                Some(Err(error)) => Err(error),
                Some(Ok(None)) => Ok(ScanCheck::Missing),
                Some(Ok(Some(_))) | None => Ok(ScanCheck::Intact),
            }
        })
        .await
    }

    /// A page of the scans.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn scans(&self, page: &Page) -> Result<Listing<ScanRow>, StoreError> {
        page::list(&self.database, &[], page).await
    }

    /// A page of the measurements.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn measurements(&self, page: &Page) -> Result<Listing<MeasurementRow>, StoreError> {
        page::list(&self.database, &[], page).await
    }

    /// A page of the recipes.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn recipes(&self, page: &Page) -> Result<Listing<RecipeRow>, StoreError> {
        page::list(&self.database, &[], page).await
    }

    /// A page of the plans.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn plans(&self, page: &Page) -> Result<Listing<ListedPlan>, StoreError> {
        page::list(&self.database, &[], page).await
    }

    /// A page of the jobs.
    ///
    /// # Errors
    /// An error of the database.
    pub async fn jobs(&self, page: &Page) -> Result<Listing<JobRow>, StoreError> {
        page::list(&self.database, &[], page).await
    }
}
