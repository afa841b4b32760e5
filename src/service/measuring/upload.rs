//! A scan that comes in piece by piece into a file of the store that is not kept yet. Large ones are read on the way; the rest
//! is unpacked, where it has to be, once it is whole. Dropped before its end, it leaves nothing behind.
//!
//! Nothing but memory and disk is waited for here, and no thread that others need is held while a client sends: as many
//! uploads as may be under way go on beside each other on however few threads.

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

/// First bytes that tell how a body is packed.
pub(in crate::service) const HEAD_BYTES: usize = 4;

/// Places for uploads; each has at most two files that are not kept yet.
#[derive(Debug)]
pub(in crate::service) struct Uploads {
    places: Arc<Semaphore>,
    uploads_max: usize,
    pub(in crate::service) readers: Readers,
}

/// A scan that is coming in.
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

/// What was said before the first byte.
#[derive(Debug)]
pub(in crate::service) struct Said {
    pub(in crate::service) encoding: Option<Encoding>,
    pub(in crate::service) bytes_expected: Option<u64>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) accepted: ResolvedOrder,
}

/// A scan that is here as a whole, unpacked and not kept yet. It holds its place among the uploads until it is kept or let
/// go, so that the files that are not kept are as few as the uploads.
#[derive(Debug)]
pub struct ReceivedScan {
    pub(in crate::service) scan: CompleteScan,
    /// What it holds, where it was read on the way.
    pub(in crate::service) read: Option<ReadPoints>,
    /// How much was sent, where it was unpacked.
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

    /// How many are under way.
    pub(in crate::service) fn count(&self) -> usize {
        self.uploads_max.saturating_sub(self.places.available_permits())
    }

    pub(in crate::service) fn take_place(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| ServiceError::UploadsBusy { uploads_max: self.uploads_max })
    }
}

impl Upload {
    /// Takes the next piece. After an error only dropping is left.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room.
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

    /// Lets it go, and waits until nothing is left of it.
    pub async fn abandon(self) {
        let Self { writer, reading, .. } = self;
        drop(writer);
        if let Some(reading) = reading {
            let _ = reading.outcome().await;
        }
    }

    /// Less than a block is read at once when it is whole, and the points of a request that was answered before are not
    /// looked at.
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
