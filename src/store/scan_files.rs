//! The content of raw scans: bytes come in by pieces and end as a file named by its SHA-256, complete and durable, or as
//! nothing. Must not know formats or records.
//!
//! Pieces are gathered into blocks; a block is hashed and written on a blocking thread while the next one fills.

use std::{fs, io::Write as _, mem, sync::Arc};

use sha2::{Digest, Sha256};
use tokio::task::{JoinHandle, spawn_blocking};

use super::{
    Store, StoreError,
    folder::{self, Folder, Temporary},
    hex,
};

/// What goes to the blocking thread at once, bytes: large against a thread's waking, small against memory.
const BLOCK_BYTES: usize = 256 * 1024;

/// A raw scan that lies in the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredScan {
    /// `s-` and the digest.
    pub id: String,
    /// SHA-256 of the bytes, 64 lower-case hexadecimal digits.
    pub sha256_hex: String,
    /// Length of the file.
    pub bytes_count: u64,
}

/// A raw scan that is coming in. Dropped before [`ScanWriter::finish`], it leaves nothing behind.
#[derive(Debug)]
pub struct ScanWriter {
    folder: Arc<Folder>,
    bytes_max: u64,
    bytes_count: u64,
    block: Vec<u8>,
    part: PartState,
}

/// A raw scan that is here as a whole and may be looked into before it is kept. Dropped before [`CompleteScan::place`],
/// it leaves nothing behind.
#[derive(Debug)]
pub struct CompleteScan {
    folder: Arc<Folder>,
    temporary: Temporary,
    file: fs::File,
    sha256_hex: String,
    bytes_count: u64,
}

#[derive(Debug)]
enum PartState {
    Idle(Part),
    Writing(JoinHandle<Result<(Part, Vec<u8>), StoreError>>),
    /// A write failed, or its caller went away in the middle of one.
    Lost,
}

impl Store {
    /// Begins a raw scan of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn begin_scan(&self, bytes_max: u64) -> Result<ScanWriter, StoreError> {
        let folder = Arc::clone(&self.folder);
        let part = blocking({
            let folder = Arc::clone(&folder);
            move || Part::create(&folder)
        });
        let part = PartState::Idle(part.await?);
        Ok(ScanWriter { folder, bytes_max, bytes_count: 0, block: Vec::with_capacity(BLOCK_BYTES), part })
    }

    /// The path of the scan of this id, whether it is there or not; `None` for what is not a scan's id.
    #[must_use]
    pub fn scan_path(&self, id: &str) -> Option<std::path::PathBuf> {
        self.folder.scan(id.strip_prefix("s-")?).map(|(_, file)| file)
    }

    /// Opens the raw scan of this id for reading; `None` where there is none.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`].
    pub async fn open_scan(&self, id: &str) -> Result<Option<fs::File>, StoreError> {
        let Some(path) = self.scan_path(id) else { return Ok(None) };
        blocking(move || match fs::File::open(&path) {
            Ok(file) => Ok(Some(file)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(StoreError::of_file(path)(error)),
        })
        .await
    }
}

impl ScanWriter {
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

    /// Gives the file its place. Durable on return.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn finish(self) -> Result<StoredScan, StoreError> {
        self.complete().await?.place().await
    }

    /// Ends the writing; the file can be read, and has no place yet.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn complete(mut self) -> Result<CompleteScan, StoreError> {
        let (mut part, _) = self.idle_part().await?;
        let Self { folder, block, .. } = self;
        blocking(move || {
            part.append(&block)?;
            let Part { temporary, file, digest, bytes_count } = part;
            Ok(CompleteScan { folder, temporary, file, sha256_hex: hex(&digest.finalize()), bytes_count })
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
    async fn idle_part(&mut self) -> Result<(Part, Vec<u8>), StoreError> {
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

    /// Gives the file its place. Durable on return.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub async fn place(self) -> Result<StoredScan, StoreError> {
        blocking(move || self.settle()).await
    }

    /// First the content, then the name: a file under its digest is always whole. A file that is there already stays,
    /// unless its length shows that it was damaged; then these bytes mend it.
    fn settle(self) -> Result<StoredScan, StoreError> {
        let Self { folder, temporary, file, sha256_hex, bytes_count } = self;
        let (shelf, place) = folder.scan(&sha256_hex).ok_or(StoreError::Closed)?;
        let known = fs::metadata(&place).is_ok_and(|there| there.is_file() && there.len() == bytes_count);
        if !known {
            file.sync_all().map_err(StoreError::of_file(temporary.path()))?;
            folder::create(&shelf)?;
            fs::rename(temporary.path(), &place).map_err(StoreError::of_file(&place))?;
        }
        // A known file too: whoever put it there may not have come this far yet.
        folder::sync(&shelf)?;
        folder::sync(&folder.scans())?;
        Ok(StoredScan { id: format!("s-{sha256_hex}"), sha256_hex, bytes_count })
    }
}

/// The file of a scan that is coming in, with the digest of what it holds.
#[derive(Debug)]
struct Part {
    temporary: Temporary,
    file: fs::File,
    digest: Sha256,
    bytes_count: u64,
}

impl Part {
    fn create(folder: &Folder) -> Result<Self, StoreError> {
        let (temporary, file) = folder.create_part()?;
        Ok(Self { temporary, file, digest: Sha256::new(), bytes_count: 0 })
    }

    fn append(&mut self, block: &[u8]) -> Result<(), StoreError> {
        self.digest.update(block);
        self.bytes_count += u64::try_from(block.len()).unwrap_or(u64::MAX);
        self.file.write_all(block).map_err(StoreError::of_file(self.temporary.path()))
    }
}

/// Runs file work apart from the async threads.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    spawn_blocking(work).await.map_err(|_| StoreError::Closed)?
}
