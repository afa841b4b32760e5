//! A scan that comes in piece by piece into a file of the store that is not kept yet, and is unpacked once it is whole.
//! Dropped before its end, it leaves nothing behind. Must not know where the pieces come from.
//!
//! Nothing but memory and disk is waited for here, and no thread is held while a client sends: as many uploads as may be
//! under way go on beside each other on however few threads.

use super::answer::READ_BLOCK_BYTES;
use super::{ContentError, Service, ServiceError};
use crate::scan::decode::{Encoding, Limits, inflate};
use crate::store::{CompleteScan, ScanWriter};
use std::io::{self, BufReader, Read};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// First bytes that tell how a body is packed.
const HEAD_BYTES: usize = 4;

/// Places for uploads; each has at most two files that are not kept yet.
#[derive(Debug)]
pub(super) struct Uploads {
    places: Arc<Semaphore>,
    uploads_max: usize,
}

/// A scan that is coming in.
#[derive(Debug)]
pub struct Upload {
    writer: ScanWriter,
    encoding: Option<Encoding>,
    head: Vec<u8>,
    place: OwnedSemaphorePermit,
}

/// A scan that is here as a whole, unpacked and not kept yet. It holds its place among the uploads until it is kept or let
/// go, so that the files that are not kept are as few as the uploads.
#[derive(Debug)]
pub struct Arrived {
    pub(super) scan: CompleteScan,
    pub(super) place: OwnedSemaphorePermit,
}

impl Uploads {
    pub(super) fn new(uploads_max: usize) -> Self {
        let uploads_max = uploads_max.min(Semaphore::MAX_PERMITS);
        Self { places: Arc::new(Semaphore::new(uploads_max)), uploads_max }
    }

    fn take_place(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| ServiceError::UploadsBusy { uploads_max: self.uploads_max })
    }
}

impl Service {
    /// Begins an upload; `encoding` is how its pieces are packed, where that is said. What is packed without a word is
    /// known by its first bytes.
    ///
    /// # Errors
    /// [`ServiceError::UploadsBusy`], [`ServiceError::Store`] where there is no room for it.
    pub async fn begin_upload(&self, encoding: Option<Encoding>) -> Result<Upload, ServiceError> {
        let place = self.uploads.take_place()?;
        let writer = self.store.begin_scan(self.capacity.body_bytes_max).await?;
        Ok(Upload { writer, encoding, head: Vec::with_capacity(HEAD_BYTES), place })
    }

    /// All pieces of an upload were written.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room, [`ServiceError::Content`] where it cannot be unpacked.
    pub async fn complete_upload(&self, upload: Upload) -> Result<Arrived, ServiceError> {
        let Upload { writer, encoding, head, place } = upload;
        let sent = writer.complete().await?;
        let Some(encoding) = encoding.or_else(|| Encoding::sniff(&head)) else {
            return Ok(Arrived { scan: sent, place });
        };
        let limits = self.capacity.scan.clone();
        let scan = self.unpacking.run(move || unpack(&sent, encoding, &limits)).await??;
        Ok(Arrived { scan, place })
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
        Ok(self.writer.write(piece).await?)
    }
}

fn unpack(sent: &CompleteScan, encoding: Encoding, limits: &Limits) -> Result<CompleteScan, ServiceError> {
    let packed = BufReader::with_capacity(READ_BLOCK_BYTES, sent.open_blocking()?);
    let mut unpacked = inflate(encoding, packed, limits).map_err(ContentError::Packing)?;
    let mut part = sent.begin_another()?;
    let mut block = vec![0; READ_BLOCK_BYTES];
    loop {
        match unpacked.read(&mut block) {
            Ok(0) => return Ok(part.complete()),
            Ok(count) => part.append(block.get(..count).unwrap_or_default())?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(ContentError::Packing(error.into()).into()),
        }
    }
}
