//! The errors of the store: every failure of the database and of the files is mapped to one of a few reasons. Also the ways in
//! which records can be lost.

use sqlx::error::{DatabaseError, ErrorKind};
use std::path::PathBuf;
use std::sync::Arc;
use std::{fmt, io};

/// An error of the store. It is cheap to clone, since one failed commit answers many writers.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StoreError {
    /// The disk, the quota or the database's own limit is exhausted. Reading still works, and so does writing once there is space.
    #[error("the store is full")]
    Full,
    /// The database cannot be used now: it is read-only, locked by another program, or has an I/O error. Trying again may help.
    #[error("the database is not available")]
    Unavailable(#[source] Arc<sqlx::Error>),
    /// A file or folder of the store cannot be used now. Trying again may help.
    #[error("the store's file {} is not available", path.display())]
    FileUnavailable {
        /// The file or folder.
        path: PathBuf,
        /// The error of the operating system.
        source: Arc<io::Error>,
    },
    /// The file is not a database, or its content is invalid.
    #[error("the database is damaged")]
    Damaged(#[source] Arc<sqlx::Error>),
    /// A later program has written this database.
    #[error("the database has schema {found}, this program knows schemas up to {known}")]
    NewerSchema {
        /// Version in the file.
        found: i64,
        /// The last version that this program knows.
        known: i64,
    },
    /// An earlier program has written this database, and it was opened for reading only.
    #[error(
        "the database has schema {found}, this program reads schema {known}; start the service once, which upgrades it"
    )]
    OlderSchema {
        /// Version in the file.
        found: i64,
        /// The version that this program reads.
        known: i64,
    },
    /// The migration in the database has another text than the one in the program.
    #[error("migration {version} of the database is not the one that this program knows")]
    MigrationDiffers {
        /// Version of the migration.
        version: i64,
    },
    /// The database lost acknowledged records; nothing is written until an operator has decided.
    #[error("{0}")]
    RecordsLost(Loss),
    /// The content of the file of a scan differs from the recorded one.
    #[error("the file of scan {id} is damaged: its SHA-256 is {found_sha256}")]
    ScanDamaged {
        /// The scan's id, with the SHA-256 that the file should have.
        id: String,
        /// The SHA-256 of the file.
        found_sha256: String,
    },
    /// Another process has this folder open.
    #[error("the folder {} is in use by another process", folder.display())]
    FolderInUse {
        /// The store's folder.
        folder: PathBuf,
    },
    /// The store was closed before or during the call.
    #[error("the store is closed")]
    Closed,
    /// The scan has more bytes than allowed.
    #[error("the scan is larger than {bytes_max} bytes")]
    ScanTooLarge {
        /// The limit that was given.
        bytes_max: u64,
    },
    /// The measurement names a scan that was never recorded.
    #[error("no scan {scan_id} is recorded")]
    ScanUnknown {
        /// The scan's id.
        scan_id: String,
    },
    /// The measurement's id is already in use.
    #[error("a measurement {id} is recorded already")]
    IdTaken {
        /// The measurement's id.
        id: String,
    },
    /// The cursor did not come from a list of this store.
    #[error("the cursor did not come from a list of this store")]
    CursorMalformed,
    /// A count or a time is too large for the database.
    #[error("the number {number} is too large for the database")]
    NumberTooLarge {
        /// The number.
        number: u64,
    },
}

/// SQLite's primary result codes that are distinguished; an extended code carries its primary one in the lowest byte.
mod sqlite {
    /// A statement does not match the schema: the tables were not created by this program.
    pub(super) const ERROR: u32 = 1;
    pub(super) const CORRUPT: u32 = 11;
    pub(super) const FULL: u32 = 13;
    pub(super) const NOT_A_DATABASE: u32 = 26;
}

impl StoreError {
    /// A stable short name in lower snake case.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::Full => "store_full",
            Self::Unavailable(_) | Self::FileUnavailable { .. } => "store_unavailable",
            Self::Damaged(_) => "store_damaged",
            Self::NewerSchema { .. } => "store_schema_newer",
            Self::OlderSchema { .. } => "store_schema_older",
            Self::MigrationDiffers { .. } => "store_migration_differs",
            Self::RecordsLost(_) => "store_records_lost",
            Self::ScanDamaged { .. } => "scan_file_damaged",
            Self::FolderInUse { .. } => "store_folder_in_use",
            Self::Closed => "store_closed",
            Self::ScanTooLarge { .. } => "scan_too_large",
            Self::ScanUnknown { .. } => "scan_unknown",
            Self::IdTaken { .. } => "id_taken",
            Self::CursorMalformed => "cursor_malformed",
            Self::NumberTooLarge { .. } => "number_too_large",
        }
    }

    /// Whether the same call may succeed later.
    #[must_use]
    pub fn is_transient(&self) -> bool {
        match self {
            Self::Full | Self::Unavailable(_) | Self::FileUnavailable { .. } | Self::FolderInUse { .. } => true,
            Self::Damaged(_)
            | Self::RecordsLost(_)
            | Self::ScanDamaged { .. }
            | Self::NewerSchema { .. }
            | Self::OlderSchema { .. }
            | Self::MigrationDiffers { .. }
            | Self::Closed
            | Self::ScanTooLarge { .. }
            | Self::ScanUnknown { .. }
            | Self::IdTaken { .. }
            | Self::CursorMalformed
            | Self::NumberTooLarge { .. } => false,
        }
    }

    /// Converts an error of a file or folder.
    pub(super) fn of_file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |error| match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Self::Full,
            _ => Self::FileUnavailable { path, source: Arc::new(error) },
        }
    }
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        use sqlx::Error as E;
        match &error {
            E::Database(refusal) => match primary_code(refusal.as_ref()) {
                Some(sqlite::FULL) => Self::Full,
                Some(sqlite::ERROR | sqlite::CORRUPT | sqlite::NOT_A_DATABASE) => Self::Damaged(Arc::new(error)),
                _ => Self::Unavailable(Arc::new(error)),
            },
            E::PoolClosed => Self::Closed,
            E::ColumnDecode { .. } | E::Decode(_) | E::ColumnNotFound(_) | E::RowNotFound => {
                Self::Damaged(Arc::new(error))
            }
            _ => Self::Unavailable(Arc::new(error)),
        }
    }
}

/// The kind of constraint that a statement violated, if it did.
pub(super) fn broken_constraint(error: &sqlx::Error) -> Option<ErrorKind> {
    error.as_database_error().map(DatabaseError::kind)
}

fn primary_code(refusal: &dyn DatabaseError) -> Option<u32> {
    refusal.code()?.parse::<u32>().ok().map(|extended| extended & 0xff)
}

/// How acknowledged records were lost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Loss {
    /// The database is missing or empty, although scans are kept.
    Empty {
        /// Scans in the folder.
        scans_count: u64,
    },
    /// The database has fewer commits than were acknowledged.
    Behind {
        /// Commits of the database.
        found: u64,
        /// Commits that were acknowledged.
        acknowledged: u64,
    },
    /// The commits of the database differ from those that were acknowledged.
    Foreign {
        /// Commits of the database.
        found: u64,
        /// Commits that were acknowledged.
        acknowledged: u64,
    },
    /// The database file was removed or replaced while the service was running.
    Replaced {
        /// The file.
        file: PathBuf,
    },
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty { scans_count } => {
                write!(f, "the database is missing or empty, although the folder holds {scans_count} scans")
            }
            Self::Behind { found, acknowledged } => {
                write!(f, "the database lost records: it holds {found} commits, and {acknowledged} were acknowledged")
            }
            Self::Foreign { found, acknowledged } => write!(
                f,
                "the database is not the one that was written last: its {found} commits do not continue the {acknowledged} \
                 that were acknowledged"
            ),
            Self::Replaced { file } => {
                write!(f, "the database file {} was removed or replaced while it was in use", file.display())
            }
        }
    }
}
