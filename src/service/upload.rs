//! A scan that comes in piece by piece into a file of the store that is not kept yet. Large ones are read on the way; the rest
//! is unpacked, where it has to be, once it is whole. Dropped before its end, it leaves nothing behind.
//!
//! Nothing but memory and disk is waited for here, and no thread that others need is held while a client sends: as many
//! uploads as may be under way go on beside each other on however few threads.

use super::Service;
use super::answer::Accepted;
use super::error::ServiceError;
use super::memory::Memory;
use super::points::ReadPoints;
use super::reading::{Readers, Reading, Wanted, unpack};
use super::scans::Origin;
use super::tee::READ_BLOCK_BYTES;
use crate::estimation::Stop;
use crate::scan::decode::{Encoding, Limits, Sent};
use crate::store::{CompleteScan, ScanWriter};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// First bytes that tell how a body is packed.
const HEAD_BYTES: usize = 4;

/// Places for uploads; each has at most two files that are not kept yet.
#[derive(Debug)]
pub(super) struct Uploads {
    places: Arc<Semaphore>,
    uploads_max: usize,
    readers: Readers,
}

/// A scan that is coming in.
#[derive(Debug)]
pub struct Upload {
    writer: ScanWriter,
    said: Said,
    head: Vec<u8>,
    bytes_count: usize,
    readers: Readers,
    limits: Limits,
    reading: Option<Reading>,
    place: OwnedSemaphorePermit,
}

/// What was said before the first byte.
#[derive(Debug)]
struct Said {
    encoding: Option<Encoding>,
    bytes_expected: Option<u64>,
    origin: Origin,
    accepted: Accepted,
}

/// A scan that is here as a whole, unpacked and not kept yet. It holds its place among the uploads until it is kept or let
/// go, so that the files that are not kept are as few as the uploads.
#[derive(Debug)]
pub struct Arrived {
    pub(super) scan: CompleteScan,
    /// What it holds, where it was read on the way.
    pub(super) read: Option<ReadPoints>,
    /// How much was sent, where it was unpacked.
    pub(super) sent: Option<Sent>,
    pub(super) origin: Origin,
    pub(super) accepted: Accepted,
    pub(super) place: OwnedSemaphorePermit,
}

impl Uploads {
    pub(super) fn new(uploads_max: usize, readers_max: usize, memory: Memory) -> Self {
        let uploads_max = uploads_max.min(Semaphore::MAX_PERMITS);
        let readers = Readers::new(readers_max.min(uploads_max), memory);
        Self { places: Arc::new(Semaphore::new(uploads_max)), uploads_max, readers }
    }

    /// How many are under way.
    pub(super) fn count(&self) -> usize {
        self.uploads_max.saturating_sub(self.places.available_permits())
    }

    fn take_place(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| ServiceError::UploadsBusy { uploads_max: self.uploads_max })
    }
}

impl Service {
    /// Begins an upload; `encoding` is how its pieces are packed and `bytes_expected` how many bytes they are together, where that
    /// is said. What is packed without a word is known by its first bytes.
    ///
    /// # Errors
    /// [`ServiceError::UploadsBusy`], [`ServiceError::Store`] where there is no room for it.
    pub async fn begin_upload(
        &self,
        encoding: Option<Encoding>,
        bytes_expected: Option<u64>,
        origin: Origin,
        accepted: Accepted,
    ) -> Result<Upload, ServiceError> {
        let place = self.uploads.take_place()?;
        let writer = self.store.begin_scan(self.capacity.body_bytes_max).await?;
        Ok(Upload {
            writer,
            said: Said { encoding, bytes_expected, origin, accepted },
            head: Vec::with_capacity(HEAD_BYTES),
            bytes_count: 0,
            readers: self.uploads.readers.clone(),
            limits: self.capacity.scan.clone(),
            reading: None,
            place,
        })
    }

    /// All pieces of an upload were written.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room, [`ServiceError::Content`] where it cannot be unpacked.
    pub async fn complete_upload(&self, upload: Upload) -> Result<Arrived, ServiceError> {
        let encoding = upload.encoding();
        let Upload { writer, said, reading, limits, place, bytes_count, .. } = upload;
        let trail = writer.trail();
        let sent = writer.complete().await;
        // Its reader ends with it, however that went.
        let read = match reading {
            Some(reading) => Some(reading.outcome().await),
            None => None,
        };
        let (sent, mut read) = (sent?, read.transpose()?);
        let scan = match (&mut read, encoding) {
            (Some(read), _) => read.unpacked.take().unwrap_or(sent),
            (None, Some(encoding)) => {
                let work = move |_: &Stop| {
                    let unpacked = unpack(&trail, encoding, &limits);
                    // What was sent lies there until here.
                    drop(sent);
                    unpacked
                };
                self.unpacking.run(work).await??
            }
            (None, None) => sent,
        };
        let Said { origin, accepted, .. } = said;
        let sent = encoding.map(|_| Sent::of(u64::try_from(bytes_count).unwrap_or(u64::MAX)));
        let read = read.and_then(|read| read.points);
        Ok(Arrived { scan, read, sent, origin, accepted, place })
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
    pub(super) fn is_read(&self) -> bool {
        self.reading.as_ref().is_some_and(Reading::is_over)
    }

    fn encoding(&self) -> Option<Encoding> {
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
