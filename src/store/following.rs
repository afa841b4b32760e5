//! Reads the file of a scan while it is still being written: never beyond what its writer has finished, and to the end once
//! there is one. All calls block.
//!
//! ```text
//! ScanPart --grow--> Extent --wait--> ScanFollower
//!    \__ append ________ the file ________ read __/
//! ```
//!
//! What was just written lies in memory, so reading it again is a copy. In return nothing is kept for the reader: it may
//! lag as far as it likes, and its writer never waits for it.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, PoisonError},
};

use super::error::StoreError;
use super::folder::Folder;
use super::scan_files::ScanPart;

/// How far a file has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Extent {
    /// So many bytes are there, and there may be more.
    Open(u64),
    /// All bytes are there.
    Whole(u64),
    /// The writer went away before the end.
    Lost,
}

#[derive(Debug)]
struct Shared {
    extent: Mutex<Extent>,
    changed: Condvar,
}

/// The writer's end of an extent. Dropped before the end is told, it tells that there will be none.
#[derive(Debug)]
pub(super) struct Growth(Arc<Shared>);

/// Where a scan that is coming in can be read. Not opened yet, and cheap to hand over.
#[derive(Debug, Clone)]
pub struct ScanTrail {
    folder: Arc<Folder>,
    path: PathBuf,
    shared: Arc<Shared>,
}

/// The reader behind a writer; waits where it has caught up.
#[derive(Debug)]
pub struct ScanFollower {
    file: File,
    read_count: u64,
    shared: Arc<Shared>,
}

impl Growth {
    /// Of a file without a byte.
    pub(super) fn new() -> Self {
        Self(Arc::new(Shared { extent: Mutex::new(Extent::Open(0)), changed: Condvar::new() }))
    }

    /// For whoever wants to read along.
    pub(super) fn trail(&self, folder: &Arc<Folder>, path: PathBuf) -> ScanTrail {
        ScanTrail { folder: Arc::clone(folder), path, shared: Arc::clone(&self.0) }
    }

    /// So many bytes are in the file now.
    pub(super) fn grow_to(&self, bytes_count: u64) {
        self.0.set(Extent::Open(bytes_count));
    }

    /// There will be no more than these.
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

    /// Waits until that many bytes are there, or all: how many there are.
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
    /// Opens the file, to be read from its beginning.
    ///
    /// # Errors
    /// [`StoreError::FileUnavailable`], also where the scan was given up meanwhile.
    pub fn follow(&self) -> Result<ScanFollower, StoreError> {
        let file = File::open(&self.path).map_err(StoreError::of_file(&self.path))?;
        Ok(ScanFollower { file, read_count: 0, shared: Arc::clone(&self.shared) })
    }

    /// Begins a scan that is made from this one.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::FileUnavailable`].
    pub fn begin_another(&self) -> Result<ScanPart, StoreError> {
        ScanPart::create(Arc::clone(&self.folder))
    }
}

impl Read for ScanFollower {
    /// Fills as much as is asked for, up to a block of the writer, so that a buffer holds the same bytes whether the file
    /// is followed or was whole before.
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let wanted = into.len().min(super::scan_files::BLOCK_BYTES);
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
