//! The content of raw scans while it is received: bytes arrive in pieces, and the result is a complete file with its SHA-256, or
//! nothing. Pieces are collected into blocks; a blocking thread hashes and writes a block while the next one fills. No blocking
//! thread ever waits for another one.
//!
//! A [`ScanFollower`] reads the file while it is still being written: never beyond the bytes that the writer has finished, and to
//! the end once the file is complete. Its calls block.
//!
//! ```text
//! ScanPart --grow--> Extent --wait--> ScanFollower
//!     \__ append ________ the file ________ read __/
//! ```
//!
//! The operating system still has the recently written bytes in memory, so reading them again is a copy. The writer never waits for
//! a follower.

use super::folder::blocking;
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::{fs, mem};

use sha2::{Digest, Sha256};
use tokio::task::{JoinHandle, spawn_blocking};

use super::error::StoreError;
use super::folder::{Folder, Temporary};
use super::rows::hex;

/// Size of a block, bytes: large enough that waking a thread costs little, small compared with memory.
pub(super) const BLOCK_BYTES: usize = 256 * 1024;

/// A raw scan that is being received. If it is dropped before [`ScanWriter::complete`], its file is removed.
#[derive(Debug)]
pub struct ScanWriter {
    bytes_max: u64,
    bytes_count: u64,
    block: Vec<u8>,
    part: PartState,
    trail: ScanTrail,
}

/// A raw scan that was received completely and can be read before it is kept. If it is dropped before it is recorded, its file is
/// removed.
#[derive(Debug)]
pub struct CompleteScan {
    pub(super) folder: Arc<Folder>,
    pub(super) temporary: Temporary,
    pub(super) file: fs::File,
    pub(super) sha256_hex: String,
    pub(super) bytes_count: u64,
}

/// The file of a scan that is being received, with the digest of its content. All of its calls block. If it is dropped before
/// [`ScanPart::complete`], the file is removed.
#[derive(Debug)]
pub struct ScanPart {
    folder: Arc<Folder>,
    temporary: Temporary,
    file: fs::File,
    digest: Sha256,
    bytes_count: u64,
    growth: Growth,
}

#[derive(Debug)]
enum PartState {
    Idle(ScanPart),
    Writing(JoinHandle<Result<(ScanPart, Vec<u8>), StoreError>>),
    /// A write failed, or its future was dropped during one.
    Lost,
}

impl ScanWriter {
    /// Begins a raw scan of at most `bytes_max` bytes.
    pub(super) async fn begin(folder: Arc<Folder>, bytes_max: u64) -> Result<Self, StoreError> {
        let part = blocking(move || ScanPart::create(folder)).await?;
        let (trail, part) = (part.trail(), PartState::Idle(part));
        Ok(Self { bytes_max, bytes_count: 0, block: Vec::with_capacity(BLOCK_BYTES), part, trail })
    }

    /// The handle of a reader of the file, also while it is written. The file exists until this or the complete scan is dropped.
    #[must_use]
    pub fn trail(&self) -> ScanTrail {
        self.trail.clone()
    }

    /// Takes the next piece, of any size. After an error, or if its future was dropped, the writer can only be dropped.
    ///
    /// # Errors
    /// [`StoreError::ScanTooLarge`], [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn write(&mut self, piece: &[u8]) -> Result<(), StoreError> {
        self.bytes_count = self.bytes_count.saturating_add(u64::try_from(piece.len()).unwrap_or(u64::MAX));
        if self.bytes_count > self.bytes_max {
            self.part = PartState::Lost;
            return Err(StoreError::ScanTooLarge { bytes_max: self.bytes_max });
        }
        let mut rest = piece;
        while let Some((fits, beyond)) = rest.split_at_checked(BLOCK_BYTES.saturating_sub(self.block.len())) {
            self.block.extend_from_slice(fits);
            self.hand_over().await?;
            rest = beyond;
        }
        self.block.extend_from_slice(rest);
        Ok(())
    }

    /// Ends the writing. The file can be read, but is not yet in its final place.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn complete(mut self) -> Result<CompleteScan, StoreError> {
        let (mut part, _) = self.idle_part().await?;
        let Self { block, .. } = self;
        blocking(move || {
            part.append(&block)?;
            Ok(part.complete())
        })
        .await
    }

    async fn hand_over(&mut self) -> Result<(), StoreError> {
        let (mut part, empty) = self.idle_part().await?;
        let mut block = mem::replace(&mut self.block, empty);
        self.part = PartState::Writing(spawn_blocking(move || {
            part.append(&block)?;
            block.clear();
            Ok((part, block))
        }));
        Ok(())
    }

    /// The part and an empty block, after the previous write has ended.
    async fn idle_part(&mut self) -> Result<(ScanPart, Vec<u8>), StoreError> {
        match mem::replace(&mut self.part, PartState::Lost) {
            PartState::Idle(part) => Ok((part, Vec::with_capacity(BLOCK_BYTES))),
            PartState::Writing(task) => task.await.map_err(|_| StoreError::Closed)?,
            PartState::Lost => Err(StoreError::Closed),
        }
    }
}

impl CompleteScan {
    /// The id under which the scan will be stored.
    #[must_use]
    pub fn id(&self) -> String {
        format!("s-{}", self.sha256_hex)
    }

    /// Length of the file.
    #[must_use]
    pub const fn bytes_count(&self) -> u64 {
        self.bytes_count
    }

    /// Opens the file for reading, from its beginning.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`].
    pub async fn open(&self) -> Result<fs::File, StoreError> {
        let path = self.temporary.path().to_owned();
        blocking(move || fs::File::open(&path).map_err(StoreError::of_file(path))).await
    }
}

impl ScanPart {
    pub(super) fn create(folder: Arc<Folder>) -> Result<Self, StoreError> {
        let (temporary, file) = folder.create_part()?;
        Ok(Self { folder, temporary, file, digest: Sha256::new(), bytes_count: 0, growth: Growth::new() })
    }

    fn trail(&self) -> ScanTrail {
        self.growth.trail(&self.folder, self.temporary.path().to_owned())
    }

    /// Takes the next bytes.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub fn append(&mut self, block: &[u8]) -> Result<(), StoreError> {
        self.digest.update(block);
        self.bytes_count += u64::try_from(block.len()).unwrap_or(u64::MAX);
        self.file.write_all(block).map_err(StoreError::of_file(self.temporary.path()))?;
        self.growth.grow_to(self.bytes_count);
        Ok(())
    }

    /// Ends the writing.
    #[must_use]
    pub fn complete(self) -> CompleteScan {
        let Self { folder, temporary, file, digest, bytes_count, growth } = self;
        growth.end_at(bytes_count);
        CompleteScan { folder, temporary, file, sha256_hex: hex(&digest.finalize()), bytes_count }
    }
}

/// Opens the file of a scan at its beginning, after comparing its bytes with its id; `None` if it does not exist.
pub(super) fn open_verified(path: &Path, id: &str) -> Result<Option<fs::File>, StoreError> {
    let mut file = match fs::File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(StoreError::of_file(path)(error)),
    };
    let found_sha256 = digest_of(&mut file).map_err(StoreError::of_file(path))?;
    if id.strip_prefix("s-") != Some(&found_sha256) {
        return Err(StoreError::ScanDamaged { id: id.to_owned(), found_sha256 });
    }
    file.rewind().map_err(StoreError::of_file(path))?;
    Ok(Some(file))
}

/// The SHA-256 of the remaining bytes of a file.
pub(super) fn digest_of(file: &mut fs::File) -> io::Result<String> {
    let mut digest = Sha256::new();
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hex(&digest.finalize())),
            count => digest.update(block.get(..count).unwrap_or_default()),
        }
    }
}

/// The number of bytes of a file that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Extent {
    /// This number of bytes can be read, and more may follow.
    Open(u64),
    /// All bytes can be read.
    Whole(u64),
    /// The writer was dropped before the end.
    Lost,
}

#[derive(Debug)]
struct Shared {
    extent: Mutex<Extent>,
    changed: Condvar,
}

/// The writer's handle of an extent. If it is dropped before the end is reported, readers get an error.
#[derive(Debug)]
pub(super) struct Growth(Arc<Shared>);

/// Gives readers of a scan that is being received access to its file. It has not opened the file, and is cheap to clone.
#[derive(Debug, Clone)]
pub struct ScanTrail {
    folder: Arc<Folder>,
    path: PathBuf,
    shared: Arc<Shared>,
}

/// The reader of a file that is being written. It waits for the writer when it has read all available bytes.
#[derive(Debug)]
pub struct ScanFollower {
    file: File,
    read_count: u64,
    shared: Arc<Shared>,
}

impl Growth {
    /// The extent of an empty file.
    pub(super) fn new() -> Self {
        Self(Arc::new(Shared { extent: Mutex::new(Extent::Open(0)), changed: Condvar::new() }))
    }

    /// The handle for readers.
    pub(super) fn trail(&self, folder: &Arc<Folder>, path: PathBuf) -> ScanTrail {
        ScanTrail { folder: Arc::clone(folder), path, shared: Arc::clone(&self.0) }
    }

    /// Reports that this number of bytes is in the file.
    pub(super) fn grow_to(&self, bytes_count: u64) {
        self.0.set(Extent::Open(bytes_count));
    }

    /// Reports that the file is complete with this number of bytes.
    pub(super) fn end_at(self, bytes_count: u64) {
        self.0.set(Extent::Whole(bytes_count));
    }
}

impl Drop for Growth {
    fn drop(&mut self) {
        if matches!(self.0.get(), Extent::Open(_)) {
            self.0.set(Extent::Lost);
        }
    }
}

impl Shared {
    fn get(&self) -> Extent {
        *self.extent.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, extent: Extent) {
        *self.extent.lock().unwrap_or_else(PoisonError::into_inner) = extent;
        self.changed.notify_all();
    }

    /// Waits until that number of bytes, or the complete file, can be read, and returns the number of readable bytes.
    fn wait_for(&self, bytes_count: u64) -> io::Result<u64> {
        let extent = self.extent.lock().unwrap_or_else(PoisonError::into_inner);
        let short = |extent: &mut Extent| matches!(extent, Extent::Open(there) if *there < bytes_count);
        let extent = self.changed.wait_while(extent, short).unwrap_or_else(PoisonError::into_inner);
        match *extent {
            Extent::Open(there) | Extent::Whole(there) => Ok(there),
            Extent::Lost => Err(io::Error::new(ErrorKind::ConnectionAborted, "the scan will not be whole")),
        }
    }
}

impl ScanTrail {
    /// Opens the file for reading from its beginning.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`], also if the scan was abandoned meanwhile.
    pub fn follow(&self) -> Result<ScanFollower, StoreError> {
        let file = File::open(&self.path).map_err(StoreError::of_file(&self.path))?;
        Ok(ScanFollower { file, read_count: 0, shared: Arc::clone(&self.shared) })
    }

    /// Begins a new scan that is derived from this one.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub fn begin_another(&self) -> Result<ScanPart, StoreError> {
        ScanPart::create(Arc::clone(&self.folder))
    }
}

impl Read for ScanFollower {
    /// Fills the whole buffer, up to a block of the writer, so that a reader gets the same bytes whether the file is still being
    /// written or was complete before.
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let wanted = into.len().min(BLOCK_BYTES);
        let there = self.shared.wait_for(self.read_count.saturating_add(wide(wanted)))?;
        let left = usize::try_from(there.saturating_sub(self.read_count)).unwrap_or(usize::MAX);
        let (into, _) = into.split_at_mut(left.min(into.len()));
        let count = self.file.read(into)?;
        self.read_count += wide(count);
        Ok(count)
    }
}

fn wide(count: usize) -> u64 {
    u64::try_from(count).unwrap_or(u64::MAX)
}
