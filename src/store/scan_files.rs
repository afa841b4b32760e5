//! The content of raw scans on its way in: bytes come by pieces and end as a whole file with its SHA-256, or as nothing.
//!
//! Pieces are gathered into blocks; a block is hashed and written on a blocking thread while the next one fills. No
//! blocking thread ever waits for another one.

use std::{
    fs,
    io::{self, Read as _, Seek as _, Write as _},
    mem,
    path::Path,
    sync::Arc,
};

use sha2::{Digest, Sha256};
use tokio::task::{JoinHandle, spawn_blocking};

use super::error::StoreError;
use super::folder::{Folder, Temporary};
use super::following::{Growth, ScanTrail};
use super::{Store, hex};

/// What goes to the blocking thread at once, bytes: large against a thread's waking, small against memory.
pub(super) const BLOCK_BYTES: usize = 256 * 1024;

/// A raw scan that is coming in. Dropped before [`ScanWriter::complete`], it leaves nothing behind.
#[derive(Debug)]
pub struct ScanWriter {
    bytes_max: u64,
    bytes_count: u64,
    block: Vec<u8>,
    part: PartState,
    trail: ScanTrail,
}

/// A raw scan that is here as a whole and may be looked into before it is kept. Dropped before it is recorded, it leaves
/// nothing behind.
#[derive(Debug)]
pub struct CompleteScan {
    pub(super) folder: Arc<Folder>,
    pub(super) temporary: Temporary,
    pub(super) file: fs::File,
    pub(super) sha256_hex: String,
    pub(super) bytes_count: u64,
}

/// The file of a scan that is coming in, with the digest of what it holds. All of its calls block. Dropped before
/// [`ScanPart::complete`], it leaves nothing behind.
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
    /// A write failed, or its caller went away in the middle of one.
    Lost,
}

impl Store {
    /// Begins a raw scan of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn begin_scan(&self, bytes_max: u64) -> Result<ScanWriter, StoreError> {
        #[cfg(test)]
        self.commits.check_room()?;
        let folder = Arc::clone(&self.folder);
        let part = blocking(move || ScanPart::create(folder)).await?;
        let (trail, part) = (part.trail(), PartState::Idle(part));
        Ok(ScanWriter { bytes_max, bytes_count: 0, block: Vec::with_capacity(BLOCK_BYTES), part, trail })
    }

    /// The path of the scan of this id, whether it is there or not; `None` for what is not a scan's id.
    #[must_use]
    pub fn scan_path(&self, id: &str) -> Option<std::path::PathBuf> {
        self.folder.scan(id.strip_prefix("s-")?).map(|(_, file)| file)
    }

    /// Opens the raw scan of this id for reading, once its bytes were compared with its id; `None` where there is none.
    ///
    /// # Errors
    /// [`StoreError::ScanDamaged`], [`StoreError::FileUnavailable`].
    pub async fn open_scan(&self, id: &str) -> Result<Option<fs::File>, StoreError> {
        let Some(path) = self.scan_path(id) else { return Ok(None) };
        let id = id.to_owned();
        // It is never closed; should it be, the store is.
        let turn = Arc::clone(&self.comparing).acquire_owned().await.map_err(|_| StoreError::Closed)?;
        blocking(move || {
            let _turn = turn;
            open_verified(&path, &id)
        })
        .await
    }
}

impl ScanWriter {
    /// Where the file can be read, also while it is written; it is there until this or the complete scan is let go.
    #[must_use]
    pub fn trail(&self) -> ScanTrail {
        self.trail.clone()
    }

    /// Takes the next piece, of any size. After an error, or where its future was dropped, only dropping is left.
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

    /// Ends the writing; the file can be read, and has no place yet.
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

    /// The part and an empty block, once the write before is done.
    async fn idle_part(&mut self) -> Result<(ScanPart, Vec<u8>), StoreError> {
        match mem::replace(&mut self.part, PartState::Lost) {
            PartState::Idle(part) => Ok((part, Vec::with_capacity(BLOCK_BYTES))),
            PartState::Writing(task) => task.await.map_err(|_| StoreError::Closed)?,
            PartState::Lost => Err(StoreError::Closed),
        }
    }
}

impl CompleteScan {
    /// The id that it will be stored under.
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

/// The file of a scan, at its beginning, after its bytes were compared with its id; `None` where it is not there.
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

/// The SHA-256 of what is left of a file.
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

/// Runs file work apart from the async threads.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    spawn_blocking(work).await.map_err(|_| StoreError::Closed)?
}
