//! A scan that comes in piece by piece, unpacked on the way, into a file of the store that is not kept yet.
//! Dropped before its end, it leaves nothing behind. Must not know where the pieces come from.

use super::{ContentError, Service, ServiceError};
use crate::scan::decode::{DecodeError, Encoding, inflate};
use crate::store::{CompleteScan, ScanWriter};
use std::io::{self, BufReader, Read};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Pieces that may wait for the thread that unpacks.
const PIECES_WAITING: usize = 4;

/// What the thread that unpacks hands on at once, bytes.
const BLOCK_BYTES: usize = 256 << 10;

/// A scan that is coming in.
#[derive(Debug)]
pub struct Upload(Kind);

#[derive(Debug)]
enum Kind {
    Plain(ScanWriter),
    Packed { pieces: mpsc::Sender<Vec<u8>>, unpacking: JoinHandle<Result<ScanWriter, ServiceError>> },
}

impl Service {
    /// Begins an upload; `encoding` is how its pieces are packed.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room for it.
    pub async fn begin_upload(&self, encoding: Option<Encoding>) -> Result<Upload, ServiceError> {
        let limits = &self.capacity.scan;
        let Some(encoding) = encoding else {
            return Ok(Upload(Kind::Plain(self.store.begin_scan(self.capacity.body_bytes_max).await?)));
        };
        let writer = self.store.begin_scan(limits.inflated_bytes_max).await?;
        let (pieces, arriving) = mpsc::channel(PIECES_WAITING);
        let (limits, handle) = (limits.clone(), Handle::current());
        let unpacking = tokio::task::spawn_blocking(move || {
            let packed = BufReader::new(Arriving { pieces: arriving, piece: io::Cursor::default() });
            let mut unpacked = inflate(encoding, packed, &limits).map_err(ContentError::Packing)?;
            unpack(&mut unpacked, writer, &handle)
        });
        Ok(Upload(Kind::Packed { pieces, unpacking }))
    }
}

impl Upload {
    /// Takes the next piece. After an error only dropping is left.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room, [`ServiceError::Content`] where it cannot be unpacked.
    pub async fn write(&mut self, piece: &[u8]) -> Result<(), ServiceError> {
        match &mut self.0 {
            Kind::Plain(writer) => Ok(writer.write(piece).await?),
            Kind::Packed { pieces, unpacking } => match pieces.send(piece.to_vec()).await {
                Ok(()) => Ok(()),
                // The thread gave up, and its result says why; or it is done, and what follows is no part of the scan.
                Err(_) => Err(match joined(unpacking).await {
                    Ok(_) => ContentError::Packing(DecodeError::BadCompression).into(),
                    Err(reason) => reason,
                }),
            },
        }
    }

    /// All pieces were written.
    ///
    /// # Errors
    /// [`ServiceError::Store`] where there is no room, [`ServiceError::Content`] where it cannot be unpacked.
    pub async fn complete(self) -> Result<CompleteScan, ServiceError> {
        let writer = match self.0 {
            Kind::Plain(writer) => writer,
            Kind::Packed { pieces, mut unpacking } => {
                drop(pieces);
                joined(&mut unpacking).await?
            }
        };
        Ok(writer.complete().await?)
    }
}

async fn joined(unpacking: &mut JoinHandle<Result<ScanWriter, ServiceError>>) -> Result<ScanWriter, ServiceError> {
    unpacking.await.map_err(|_| super::ComputeError::Panicked)?
}

fn unpack(packed: &mut dyn Read, mut writer: ScanWriter, handle: &Handle) -> Result<ScanWriter, ServiceError> {
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        match packed.read(&mut block) {
            Ok(0) => return Ok(writer),
            Ok(count) => handle.block_on(writer.write(block.get(..count).unwrap_or_default()))?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(ContentError::Packing(error.into()).into()),
        }
    }
}

/// The pieces as one stream for a thread that may block.
struct Arriving {
    pieces: mpsc::Receiver<Vec<u8>>,
    piece: io::Cursor<Vec<u8>>,
}

impl Read for Arriving {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.piece.read(buffer)? {
                0 if !buffer.is_empty() => match self.pieces.blocking_recv() {
                    Some(piece) => self.piece = io::Cursor::new(piece),
                    // The end, or the client hung up: then nobody waits for what comes of it.
                    None => return Ok(0),
                },
                count => return Ok(count),
            }
        }
    }
}
