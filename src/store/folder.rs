//! The store's folder on the disk: what lies where, who may use it, and how a name in it is made durable. All calls block.
//!
//! ```text
//! coaxis.lock      held by the process that has the store open
//! coaxis.db        records, with -wal and -shm beside it
//! scans/ab/abcd…   a raw scan by the SHA-256 of its content
//! scans/tmp/7      a scan that is still coming in; whatever lies here at start-up is swept away
//! ```
//!
//! Must not know the database's tables.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use super::StoreError;

/// A folder that this process alone uses, until the last holder lets it go.
#[derive(Debug)]
pub(super) struct Folder {
    root: PathBuf,
    parts_count: AtomicU64,
    _lock: File,
}

impl Folder {
    /// Creates what is missing, takes the lock, sweeps away what an earlier process left unfinished.
    pub(super) fn open(root: &Path) -> Result<Self, StoreError> {
        let scans = root.join("scans");
        let missing: Vec<&Path> = root.ancestors().take_while(|folder| !folder.exists()).collect();
        fs::create_dir_all(scans.join("tmp")).map_err(StoreError::of_file(root))?;
        let folder = Self { root: root.to_owned(), parts_count: AtomicU64::new(0), _lock: lock(root)? };
        folder.sweep()?;
        sync(&scans)?;
        sync(root)?;
        for parent in missing.into_iter().filter_map(Path::parent) {
            sync(if parent.as_os_str().is_empty() { Path::new(".") } else { parent })?;
        }
        Ok(folder)
    }

    /// The database file.
    pub(super) fn database(&self) -> PathBuf {
        self.root.join("coaxis.db")
    }

    /// Where the scan of this digest lies: its folder and its file. `None` for anything but 64 hexadecimal digits.
    pub(super) fn scan(&self, sha256_hex: &str) -> Option<(PathBuf, PathBuf)> {
        let well_formed = sha256_hex.len() == 64 && sha256_hex.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
        let shelf = self.scans().join(sha256_hex.get(..2).filter(|_| well_formed)?);
        let file = shelf.join(sha256_hex);
        Some((shelf, file))
    }

    /// The folder of all scans.
    pub(super) fn scans(&self) -> PathBuf {
        self.root.join("scans")
    }

    /// A new, empty file for a scan that comes in. The lock makes the counter unique.
    pub(super) fn create_part(&self) -> Result<(Temporary, File), StoreError> {
        let number = self.parts_count.fetch_add(1, Ordering::Relaxed);
        let path = self.incoming().join(number.to_string());
        let file = OpenOptions::new().write(true).create_new(true).open(&path).map_err(StoreError::of_file(&path))?;
        Ok((Temporary { path }, file))
    }

    fn incoming(&self) -> PathBuf {
        self.scans().join("tmp")
    }

    fn sweep(&self) -> Result<(), StoreError> {
        let incoming = self.incoming();
        for entry in fs::read_dir(&incoming).map_err(StoreError::of_file(&incoming))? {
            let path = entry.map_err(StoreError::of_file(&incoming))?.path();
            fs::remove_file(&path).map_err(StoreError::of_file(&path))?;
        }
        Ok(())
    }
}

/// A file that is removed when it is let go before it has been given its place.
#[derive(Debug)]
pub(super) struct Temporary {
    path: PathBuf,
}

impl Temporary {
    /// Where it lies.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // Fails where the file has its place already; what else may fail, the sweep at the next start makes good.
        let _ = fs::remove_file(&self.path);
    }
}

/// Makes the names in a folder durable.
pub(super) fn sync(folder: &Path) -> Result<(), StoreError> {
    File::open(folder).and_then(|handle| handle.sync_all()).map_err(StoreError::of_file(folder))
}

/// Creates a folder unless it is there.
pub(super) fn create(folder: &Path) -> Result<(), StoreError> {
    match fs::create_dir(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(StoreError::of_file(folder)(error)),
        _ => Ok(()),
    }
}

/// The operating system drops the lock with the process, however that ends.
fn lock(root: &Path) -> Result<File, StoreError> {
    let path = root.join("coaxis.lock");
    let file =
        OpenOptions::new().write(true).create(true).truncate(false).open(&path).map_err(StoreError::of_file(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::FolderInUse { folder: root.to_owned() }),
        Err(TryLockError::Error(error)) => Err(StoreError::of_file(path)(error)),
    }
}
