//! How much room the database takes, and how much is left on the disk of the data folder.

use super::Store;
use super::error::StoreError;
use super::scan_files::blocking;
use rustix::fs::statvfs;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Room in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Usage {
    /// The database with its write-ahead log.
    pub database_bytes: u64,
    /// What is left on the disk for this user.
    pub disk_free_bytes: u64,
    /// Size of the disk.
    pub disk_total_bytes: u64,
}

impl Store {
    /// How much room the store takes and has left.
    ///
    /// # Errors
    /// Where the operating system does not say.
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
    // The log is absent until something is written.
    let log_bytes = fs::metadata(log).map_or(0, |file| file.len());
    Ok(Usage {
        database_bytes: fs::metadata(database)?.len().saturating_add(log_bytes),
        disk_free_bytes: disk.f_bavail.saturating_mul(disk.f_frsize),
        disk_total_bytes: disk.f_blocks.saturating_mul(disk.f_frsize),
    })
}
