//! The folder of the store on the disk: its layout, its permissions, and how a file name in it is made durable. All calls block,
//! except [`blocking`], which runs them apart from the async threads.
//!
//! ```text
//! coaxis.lock      locked by the process that has the store open
//! coaxis.db        the database, with -wal and -shm beside it
//! coaxis.commits   the number of its commits, see `commits`
//! scans/ab/abcd…   a raw scan under the SHA-256 of its content
//! scans/tmp/7      a scan that is being received; removed at the next start if it is left over
//! scans/tmp/abcd…  a mark: the scan of this digest may have its file but not yet its row
//! ```
//!
//! Only the user and the group of the service have access.

use std::ffi::OsString;
use std::fs::{self, DirBuilder, File, OpenOptions, Permissions, TryLockError};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use std::io;
use tokio::task::spawn_blocking;

use super::error::StoreError;

/// Permissions of every file.
pub(super) const FILE_MODE: u32 = 0o640;

/// Permissions of every folder.
const FOLDER_MODE: u32 = 0o750;

/// Prevents every other process from opening the store of a folder, until it is dropped.
#[derive(Debug)]
pub struct FolderLock(#[expect(dead_code, reason = "the lock lasts as long as the file is open")] File);

impl FolderLock {
    /// Takes the lock of a folder. Returns `None` if the folder does not exist, so that there is no store.
    ///
    /// # Errors
    /// [`StoreError::FolderInUse`] if another process has the store open.
    pub fn take(root: &Path) -> Result<Option<Self>, StoreError> {
        if root.is_dir() { lock(root).map(Self).map(Some) } else { Ok(None) }
    }
}

/// A folder that only this process uses, until the last handle is dropped.
#[derive(Debug)]
pub(super) struct Folder {
    root: PathBuf,
    parts_count: AtomicU64,
    _lock: File,
}

impl Folder {
    /// Creates missing folders, takes the lock, and removes the unfinished files of an earlier process.
    pub(super) fn open(root: &Path) -> Result<Self, StoreError> {
        let scans = root.join("scans");
        let missing: Vec<&Path> = root.ancestors().take_while(|folder| !folder.exists()).collect();
        let mut builder = DirBuilder::new();
        builder.recursive(true).mode(FOLDER_MODE).create(scans.join("tmp")).map_err(StoreError::of_file(root))?;
        let folder = Self { root: root.to_owned(), parts_count: AtomicU64::new(0), _lock: lock(root)? };
        folder.sweep()?;
        folder.close_to_others();
        sync(&scans)?;
        sync(root)?;
        for parent in missing.into_iter().filter_map(Path::parent) {
            sync(if parent.as_os_str().is_empty() { Path::new(".") } else { parent })?;
        }
        Ok(folder)
    }

    /// The database file.
    pub(super) fn database(&self) -> PathBuf {
        database(&self.root)
    }

    /// The file that counts the commits.
    pub(super) fn commits(&self) -> PathBuf {
        commits(&self.root)
    }

    /// Creates an empty database file if there is none. SQLite gives the files beside it the same permissions.
    pub(super) fn create_database(&self) -> Result<(), StoreError> {
        let path = self.database();
        let mut options = OpenOptions::new();
        options.write(true).create(true).truncate(false).mode(FILE_MODE);
        options.open(&path).map(drop).map_err(StoreError::of_file(path))
    }

    /// The number of scan files in their final place.
    pub(super) fn scans_count(&self) -> Result<u64, StoreError> {
        let (scans, mut count) = (self.scans(), 0);
        for shelf in fs::read_dir(&scans).map_err(StoreError::of_file(&scans))? {
            let shelf = shelf.map_err(StoreError::of_file(&scans))?.path();
            if !shelf.is_dir() || shelf == self.incoming() {
                continue;
            }
            let names = fs::read_dir(&shelf).map_err(StoreError::of_file(&shelf))?.filter_map(Result::ok);
            let digests = names.filter(|entry| entry.file_name().to_str().is_some_and(is_digest));
            count += u64::try_from(digests.count()).unwrap_or(u64::MAX);
        }
        Ok(count)
    }

    /// Removes excess permissions from files of earlier versions. Other files are protected by the folder of the scans.
    fn close_to_others(&self) {
        let files = ["coaxis.lock", "coaxis.db", "coaxis.db-wal", "coaxis.db-shm", "coaxis.commits"];
        let files = files.map(|name| (self.root.join(name), FILE_MODE));
        for (path, mode) in files.into_iter().chain([(self.scans(), FOLDER_MODE)]) {
            let Ok(found) = fs::metadata(&path) else { continue };
            let found = found.permissions().mode() & 0o777;
            if found & !mode != 0
                && let Err(error) = fs::set_permissions(&path, Permissions::from_mode(found & mode))
            {
                tracing::warn!(path = %path.display(), %error, "the permissions {found:o} cannot be restricted to {mode:o}");
            }
        }
    }

    /// Folder and file of the scan with this digest; `None` for anything but 64 hexadecimal digits.
    pub(super) fn scan(&self, sha256_hex: &str) -> Option<(PathBuf, PathBuf)> {
        scan(&self.root, sha256_hex)
    }

    /// The folder of all scans.
    pub(super) fn scans(&self) -> PathBuf {
        self.root.join("scans")
    }

    /// A new, empty file for a scan that is being received.
    pub(super) fn create_part(&self) -> Result<(Temporary, File), StoreError> {
        let path = self.new_name();
        let mut options = OpenOptions::new();
        options.write(true).create_new(true).mode(FILE_MODE);
        let file = options.open(&path).map_err(StoreError::of_file(&path))?;
        Ok((Temporary { path }, file))
    }

    /// An unused path in the folder of incoming scans. The lock makes the counter unique.
    pub(super) fn new_name(&self) -> PathBuf {
        self.incoming().join(self.parts_count.fetch_add(1, Ordering::Relaxed).to_string())
    }

    /// The folder of incoming scans.
    pub(super) fn incoming(&self) -> PathBuf {
        self.scans().join("tmp")
    }

    /// The path of the mark of this digest; `None` if it is not a digest.
    pub(super) fn mark(&self, sha256_hex: &str) -> Option<PathBuf> {
        is_digest(sha256_hex).then(|| self.incoming().join(sha256_hex))
    }

    /// The digests of all marks.
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

/// The database file of a folder.
pub(super) fn database(root: &Path) -> PathBuf {
    root.join("coaxis.db")
}

/// The file of a folder that counts the commits.
pub(super) fn commits(root: &Path) -> PathBuf {
    root.join("coaxis.commits")
}

/// Folder and file of the scan with this digest in a folder; `None` for anything but 64 hexadecimal digits.
pub(super) fn scan(root: &Path, sha256_hex: &str) -> Option<(PathBuf, PathBuf)> {
    let shelf = root.join("scans").join(sha256_hex.get(..2).filter(|_| is_digest(sha256_hex))?);
    let file = shelf.join(sha256_hex);
    Some((shelf, file))
}

/// Whether a text is a SHA-256 in the form that the store writes.
fn is_digest(text: &str) -> bool {
    text.len() == 64 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
}

/// A file that is removed on drop, unless it was moved to its final place.
#[derive(Debug)]
pub(super) struct Temporary {
    path: PathBuf,
}

impl Temporary {
    /// Its path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // This fails if the file was moved to its final place. After any other failure, the next start removes the file.
        let _ = fs::remove_file(&self.path);
    }
}

/// Makes the file names in a folder durable.
pub(super) fn sync(folder: &Path) -> Result<(), StoreError> {
    File::open(folder).and_then(|handle| handle.sync_all()).map_err(StoreError::of_file(folder))
}

/// Creates a folder unless it exists.
pub(super) fn create(folder: &Path) -> Result<(), StoreError> {
    match DirBuilder::new().mode(FOLDER_MODE).create(folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(StoreError::of_file(folder)(error)),
        _ => Ok(()),
    }
}

/// Takes the lock. The operating system releases it when the process ends for any reason.
fn lock(root: &Path) -> Result<File, StoreError> {
    let path = root.join("coaxis.lock");
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false).mode(FILE_MODE);
    let file = options.open(&path).map_err(StoreError::of_file(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::FolderInUse { folder: root.to_owned() }),
        Err(TryLockError::Error(error)) => Err(StoreError::of_file(path)(error)),
    }
}

/// Runs file work apart from the async threads.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    spawn_blocking(work).await.map_err(|_| StoreError::Closed)?
}
