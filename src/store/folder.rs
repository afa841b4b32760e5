//! The store's folder on the disk: what lies where, who may use it, and how a name in it is made durable. All calls block.
//!
//! ```text
//! coaxis.lock      held by the process that has the store open
//! coaxis.db        records, with -wal and -shm beside it
//! scans/ab/abcd…   a raw scan by the SHA-256 of its content
//! scans/tmp/7      a scan that is still coming in; what lies here at start-up is swept away
//! scans/tmp/abcd…  a mark: the scan of this digest may have its place and not its row yet
//! ```
//!
//! Must not know the database's tables.

use std::{
    ffi::OsString,
    fs::{self, File, OpenOptions, TryLockError},
    io,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
};

use super::StoreError;

/// Keeps every other process from opening the store of a folder, until it is dropped.
#[derive(Debug)]
pub struct FolderLock(#[expect(dead_code, reason = "the lock lasts as long as the file is open")] File);

impl FolderLock {
    /// Takes the lock of a folder; `None` where there is no such folder, and so no store.
    ///
    /// # Errors
    /// [`StoreError::FolderInUse`] where another process has the store open.
    pub fn take(root: &Path) -> Result<Option<Self>, StoreError> {
        if root.is_dir() { lock(root).map(Self).map(Some) } else { Ok(None) }
    }
}

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
        let shelf = self.scans().join(sha256_hex.get(..2).filter(|_| is_digest(sha256_hex))?);
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

    /// Where scans come in.
    pub(super) fn incoming(&self) -> PathBuf {
        self.scans().join("tmp")
    }

    /// Where the mark of this digest lies, if it is one.
    pub(super) fn mark(&self, sha256_hex: &str) -> Option<PathBuf> {
        is_digest(sha256_hex).then(|| self.incoming().join(sha256_hex))
    }

    /// The digests that are marked.
    pub(super) fn marked(&self) -> Result<Vec<String>, StoreError> {
        let names = self.names_incoming()?.into_iter().filter_map(|name| name.into_string().ok());
        Ok(names.filter(|name| is_digest(name)).collect())
    }

    fn names_incoming(&self) -> Result<Vec<OsString>, StoreError> {
        let incoming = self.incoming();
        let entries = fs::read_dir(&incoming).map_err(StoreError::of_file(&incoming))?;
        entries.map(|entry| Ok(entry.map_err(StoreError::of_file(&incoming))?.file_name())).collect()
    }

    fn sweep(&self) -> Result<(), StoreError> {
        for name in self.names_incoming()?.iter().filter(|name| !name.to_str().is_some_and(is_digest)) {
            let path = self.incoming().join(name);
            fs::remove_file(&path).map_err(StoreError::of_file(&path))?;
        }
        Ok(())
    }
}

/// Whether a text is a SHA-256 as we write it.
fn is_digest(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
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
