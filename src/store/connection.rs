//! How the database file is opened: the one place that knows SQLite's settings.

use std::{path::Path, time::Duration};

use sqlx::{
    ConnectOptions, SqliteConnection, SqlitePool,
    sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous},
};

use super::error::StoreError;

/// Takes the write lock at once: a transaction that reads first and asks for the lock later could be refused it.
pub(super) const BEGIN: &str = "BEGIN IMMEDIATE";

/// Readers of the write-ahead log wait for nobody, so few of them serve many clients.
const READERS: u32 = 4;

/// Only another program on the same file (a backup, a shell) can make us wait.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// The write-ahead log is cut back to this after a burst, bytes.
const LOG_BYTES_KEPT: &str = "67108864";

/// SQLite's unit of allocation, bytes; the one that it takes by itself.
const PAGE_BYTES: u32 = 4096;

/// The connection that writes, to a file that does not grow beyond `bytes_max`. The caller sees to it that there is only
/// one.
pub(super) async fn writer(file: &Path, bytes_max: Option<u64>) -> Result<SqliteConnection, StoreError> {
    let mut options = options(file).create_if_missing(true).page_size(PAGE_BYTES);
    if let Some(bytes_max) = bytes_max {
        // SQLite holds a limit against this connection only, and takes one below the present size as the present size.
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

/// Connections that find out what is there and change nothing, not even the settings of the file.
pub(super) async fn examiner(file: &Path) -> Result<SqlitePool, StoreError> {
    let options = SqliteConnectOptions::new()
        .filename(file)
        .read_only(true)
        .busy_timeout(BUSY_TIMEOUT)
        .disable_statement_logging();
    Ok(SqlitePoolOptions::new().max_connections(1).connect_with(options).await?)
}

/// FULL: a commit returns when the disk has it, not when the operating system does.
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
