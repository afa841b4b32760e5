//! Opens the database file with its SQLite settings, and migrates its schema to the version that this program knows: one numbered
//! step at a time, each in one transaction, so that a step that fails leaves the file unchanged.

use std::path::Path;

use std::time::Duration;

use sha2::{Digest, Sha256};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row, SqliteConnection, SqlitePool};

use super::error::StoreError;

use super::rows::hex;
use super::statements;

/// Takes the write lock at once, because a transaction that reads first and requests the lock later could fail to get it.
pub(super) const BEGIN: &str = "BEGIN IMMEDIATE";

/// Readers of the write-ahead log never wait, so a few of them serve many clients.
const READERS: u32 = 4;

/// Only another program on the same file (a backup, a shell) can make the service wait.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// The write-ahead log is truncated to this size after a burst, bytes.
const LOG_BYTES_KEPT: &str = "67108864";

/// Page size of SQLite, bytes; its default.
const PAGE_BYTES: u32 = 4096;

/// Opens the connection that writes, to a file that may not grow beyond `bytes_max`. The caller ensures that there is only one.
pub(super) async fn writer(file: &Path, bytes_max: Option<u64>) -> Result<SqliteConnection, StoreError> {
    let mut options = options(file).create_if_missing(true).page_size(PAGE_BYTES);
    if let Some(bytes_max) = bytes_max {
        // SQLite applies the limit to this connection only, and raises a limit below the present size to the present size.
        let pages_max = (bytes_max / u64::from(PAGE_BYTES)).clamp(1, u64::from(u32::MAX - 1));
        options = options.pragma("max_page_count", pages_max.to_string());
    }
    Ok(options.connect().await?)
}

/// Connections that only read.
pub(super) async fn readers(file: &Path) -> Result<SqlitePool, StoreError> {
    let pool = SqlitePoolOptions::new()
        .min_connections(READERS)
        .max_connections(READERS)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
        .acquire_timeout(BUSY_TIMEOUT);
    Ok(pool.connect_with(options(file).pragma("query_only", "ON")).await?)
}

/// Opens connections that only examine the database and change nothing, not even the settings of the file.
pub(super) async fn examiner(file: &Path) -> Result<SqlitePool, StoreError> {
    let options = SqliteConnectOptions::new()
        .filename(file)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging();
    Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
}

/// FULL: a commit returns when the data are on the disk, not merely with the operating system.
fn options(file: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(file)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
        .pragma("journal_size_limit", LOG_BYTES_KEPT)
        .disable_statement_logging()
}

/// Limits of the size of the store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StoreLimits {
    /// Size of the database file beyond which writes fail with [`StoreError::Full`]; the write-ahead log and the raw scans are not
    /// included.
    pub database_bytes_max: Option<u64>,
}

/// A step of the schema. Its text never changes after a release, because databases record its checksum.
#[derive(Debug, Clone, Copy)]
pub(super) struct Migration {
    pub(super) version: i64,
    pub(super) sql: &'static str,
}

/// From this version on the database counts its commits.
pub(super) const COUNTS_COMMITS: i64 = 3;

/// All steps, counting up from 1.
pub(super) const MIGRATIONS: &[Migration] = &[
    Migration { version: 1, sql: include_str!("migrations/0001_records.sql") },
    Migration { version: 2, sql: include_str!("migrations/0002_cell.sql") },
    Migration { version: COUNTS_COMMITS, sql: include_str!("migrations/0003_order_and_commits.sql") },
];

/// Applies the steps that have not been applied to the database yet.
///
/// # Errors
/// [`StoreError::NewerSchema`], [`StoreError::MigrationDiffers`], or an error of the database.
pub(super) async fn migrate(database: &mut SqliteConnection, steps: &'static [Migration]) -> Result<(), StoreError> {
    let found = user_version(database).await?;
    let known = steps.last().map_or(0, |step| step.version);
    if found > known {
        return Err(StoreError::NewerSchema { found, known });
    }
    if found > 0 {
        compare_checksums(database, steps).await?;
    }
    for step in steps.iter().filter(|step| step.version > found) {
        apply(database, *step).await?;
    }
    Ok(())
}

/// The version of the last step that was applied; 0 for a new database.
pub(super) async fn user_version(database: &mut SqliteConnection) -> Result<i64, StoreError> {
    Ok(sqlx::query_scalar("PRAGMA user_version").fetch_one(database).await?)
}

async fn compare_checksums(database: &mut SqliteConnection, steps: &[Migration]) -> Result<(), StoreError> {
    for row in sqlx::query(statements::MIGRATIONS).fetch_all(database).await? {
        let (version, checksum): (i64, String) = (row.try_get("version")?, row.try_get("checksum")?);
        let known = steps.iter().find(|step| step.version == version).map(checksum_of);
        if known.as_deref() != Some(&checksum) {
            return Err(StoreError::MigrationDiffers { version });
        }
    }
    Ok(())
}

async fn apply(database: &mut SqliteConnection, step: Migration) -> Result<(), StoreError> {
    let mut transaction = database.begin_with(BEGIN).await?;
    sqlx::raw_sql(statements::CREATE_MIGRATIONS).execute(&mut *transaction).await?;
    sqlx::raw_sql(step.sql).execute(&mut *transaction).await?;
    sqlx::query(statements::INSERT_MIGRATION)
        .bind(step.version)
        .bind(checksum_of(&step))
        .execute(&mut *transaction)
        .await?;
    // A pragma takes no placeholder; the number comes from this program.
    let mark = AssertSqlSafe(format!("PRAGMA user_version = {}", step.version));
    sqlx::raw_sql(mark).execute(&mut *transaction).await?;
    Ok(transaction.commit().await?)
}

fn checksum_of(step: &Migration) -> String {
    hex(&Sha256::digest(step.sql.as_bytes()))
}
