//! Receives a scan piece by piece into a file that is not stored yet. Large scans are decoded during the upload; the others
//! are decompressed, if necessary, when they are complete. An upload that is dropped before its end is deleted.
//!
//! An upload waits only for memory and disk and blocks no shared thread while a client sends: the maximum number of
//! uploads can be under way on any number of threads.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::order::Origin;
use crate::scan::decode::{Encoding, Limits, Sent};
use crate::service::error::ServiceError;
use crate::service::memory::Memory;
use crate::store::{CompleteScan, ScanWriter};

use super::copying_reader::READ_BLOCK_BYTES;
use super::order::ResolvedOrder;
use super::points::ReadPoints;
use super::reading::{Readers, Reading, Wanted};

/// Number of first bytes that identify the compression of a body.
pub(in crate::service) const HEAD_BYTES: usize = 4;

/// Places for uploads; each has at most two files that are not stored yet.
#[derive(Debug)]
pub(in crate::service) struct Uploads {
    places: Arc<Semaphore>,
    uploads_max: usize,
    pub(in crate::service) readers: Readers,
}

/// A scan that is being received.
#[derive(Debug)]
pub struct Upload {
    pub(in crate::service) writer: ScanWriter,
    pub(in crate::service) said: Said,
    pub(in crate::service) head: Vec<u8>,
    pub(in crate::service) bytes_count: usize,
    pub(in crate::service) readers: Readers,
    pub(in crate::service) limits: Limits,
    pub(in crate::service) reading: Option<Reading>,
    pub(in crate::service) place: OwnedSemaphorePermit,
}

/// Parameters that are known before the first byte.
#[derive(Debug)]
pub(in crate::service) struct Said {
    pub(in crate::service) encoding: Option<Encoding>,
    pub(in crate::service) bytes_expected: Option<u64>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) accepted: ResolvedOrder,
}

/// A complete scan, decompressed and not stored yet. It keeps its place among the uploads until it is stored or dropped, so that
/// the number of uploads limits the number of temporary files.
#[derive(Debug)]
pub struct ReceivedScan {
    pub(in crate::service) scan: CompleteScan,
    /// Its content, if it was decoded during the upload.
    pub(in crate::service) read: Option<ReadPoints>,
    /// The number of bytes sent, if it was decompressed.
    pub(in crate::service) sent: Option<Sent>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) accepted: ResolvedOrder,
    pub(in crate::service) place: OwnedSemaphorePermit,
}

impl Uploads {
    pub(in crate::service) fn new(uploads_max: usize, readers_max: usize, memory: Memory) -> Self {
        let uploads_max = uploads_max.min(Semaphore::MAX_PERMITS);
        let readers = Readers::new(readers_max.min(uploads_max), memory);
        Self { places: Arc::new(Semaphore::new(uploads_max)), uploads_max, readers }
    }

    /// Number of uploads under way.
    pub(in crate::service) fn count(&self) -> usize {
        self.uploads_max.saturating_sub(self.places.available_permits())
    }

    pub(in crate::service) fn take_place(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| ServiceError::UploadsBusy { uploads_max: self.uploads_max })
    }
}

impl Upload {
    /// Takes the next piece. After an error the upload can only be dropped.
    ///
    /// # Errors
    /// [`ServiceError::Store`] if the store has no space.
    pub async fn write(&mut self, piece: &[u8]) -> Result<(), ServiceError> {
        let wanting = HEAD_BYTES.saturating_sub(self.head.len());
        self.head.extend(piece.iter().take(wanting));
        self.bytes_count = self.bytes_count.saturating_add(piece.len());
        self.writer.write(piece).await?;
        if self.reading.is_none() && self.is_worth_reading() {
            self.reading = self.readers.begin(&self.writer.trail(), || self.wanted());
        }
        Ok(())
    }

    /// Drops the upload and waits until its files are deleted.
    pub async fn abandon(self) {
        let Self { writer, reading, .. } = self;
        drop(writer);
        if let Some(reading) = reading {
            let _ = reading.outcome().await;
        }
    }

    /// Whether decoding during the upload is useful: content of less than a block is decoded quickly at its end, and the points of
    /// a request that was answered before are not needed.
    fn is_worth_reading(&self) -> bool {
        self.bytes_count >= READ_BLOCK_BYTES && !self.said.accepted.answered
    }

    #[cfg(test)]
    pub(in crate::service) fn is_read(&self) -> bool {
        self.reading.as_ref().is_some_and(Reading::is_over)
    }

    pub(in crate::service) fn encoding(&self) -> Option<Encoding> {
        self.said.encoding.or_else(|| Encoding::sniff(&self.head))
    }

    fn wanted(&self) -> Wanted {
        let Said { bytes_expected, origin, accepted, .. } = &self.said;
        let (origin, resolved) = (origin.clone(), accepted.resolved.clone());
        Wanted {
            encoding: self.encoding(),
            origin,
            resolved,
            limits: self.limits.clone(),
            bytes_expected: *bytes_expected,
        }
    }
}
