//! Reads a scan while it still comes in, behind the writer of its file: when the last byte is here, the points are, too.
//! Goes out as what the file turned out to hold. Must not know where the bytes come from, nor what is measured.
//!
//! Such a reader waits for a client, so it has a thread of its own and not one of those that calculate; and it holds the
//! points in memory until their turn comes, so there are few. A scan that finds no place is read from its file later.

use super::tee::{READ_BLOCK_BYTES, Tee};
use super::{ComputeError, ContentError, Decoded, Origin, Resolved, ServiceError, read};
use crate::scan::decode::{DecodeError, Encoding, Limits, inflate};
use crate::store::{CompleteScan, ScanPart, ScanTrail, StoreError};
use std::io::{self, BufRead, BufReader};
use std::sync::Arc;
use std::thread;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// Places for scans that are read while they come in.
#[derive(Debug, Clone)]
pub(super) struct Readers {
    places: Arc<Semaphore>,
}

/// What has to be known to read a scan.
#[derive(Debug, Clone)]
pub(super) struct Wanted {
    pub(super) encoding: Option<Encoding>,
    pub(super) origin: Origin,
    pub(super) resolved: Resolved,
    pub(super) limits: Limits,
}

/// A scan that is being read.
#[derive(Debug)]
pub(super) struct Reading {
    outcome: oneshot::Receiver<Result<ReadScan, ServiceError>>,
}

/// A scan that was read while it came in. It holds its place until its points are let go.
#[derive(Debug)]
pub(super) struct ReadScan {
    /// The content, where it came packed.
    pub(super) unpacked: Option<CompleteScan>,
    /// The points. Bytes that are no scan are told when it is their turn, as they would be if they were read then.
    pub(super) decoded: Result<Decoded, DecodeError>,
    pub(super) place: OwnedSemaphorePermit,
}

impl Readers {
    pub(super) fn new(places_count: usize) -> Self {
        Self { places: Arc::new(Semaphore::new(places_count.min(Semaphore::MAX_PERMITS))) }
    }

    /// Begins to read; `None` where there is no place, or no thread.
    pub(super) fn begin(&self, trail: &ScanTrail, wanted: impl FnOnce() -> Wanted) -> Option<Reading> {
        let place = Arc::clone(&self.places).try_acquire_owned().ok()?;
        let (sender, outcome) = oneshot::channel();
        let (trail, wanted) = (trail.clone(), wanted());
        let work = move || {
            let read = take_in(&trail, &wanted);
            // Nobody listens any more where the upload was given up.
            let _ = sender.send(read.map(|(unpacked, decoded)| ReadScan { unpacked, decoded, place }));
        };
        thread::Builder::new().name("read".to_owned()).spawn(work).ok().map(|_| Reading { outcome })
    }
}

impl Reading {
    #[cfg(test)]
    pub(super) fn is_over(&self) -> bool {
        !self.outcome.is_empty()
    }

    /// What was read, once the writer has ended; soon after it where it gave up.
    pub(super) async fn outcome(self) -> Result<ReadScan, ServiceError> {
        self.outcome.await.map_err(|_| ComputeError::Panicked)?
    }
}

/// Bytes to points, and to the file that holds them unpacked, where they came packed.
fn take_in(
    trail: &ScanTrail,
    wanted: &Wanted,
) -> Result<(Option<CompleteScan>, Result<Decoded, DecodeError>), ServiceError> {
    let Wanted { encoding, origin, resolved, limits } = wanted;
    let points_of = |bytes: &mut dyn BufRead| read(bytes, &origin.claims(), resolved, limits);
    let mut sent = BufReader::with_capacity(READ_BLOCK_BYTES, trail.follow()?);
    let Some(encoding) = *encoding else { return Ok((None, points_of(&mut sent))) };
    let (scan, decoded) = unpack_seen(encoding, sent, trail.begin_another()?, limits, points_of)?;
    Ok((Some(scan), decoded))
}

/// Undoes the packing of a scan into a file of its own.
pub(super) fn unpack(trail: &ScanTrail, encoding: Encoding, limits: &Limits) -> Result<CompleteScan, ServiceError> {
    let sent = BufReader::with_capacity(READ_BLOCK_BYTES, trail.follow()?);
    Ok(unpack_seen(encoding, sent, trail.begin_another()?, limits, |_| ())?.0)
}

/// Undoes a packing into `part`, to its end; `look` sees the bytes on the way, as far as it likes.
fn unpack_seen<T>(
    encoding: Encoding,
    packed: impl BufRead,
    mut part: ScanPart,
    limits: &Limits,
    look: impl FnOnce(&mut dyn BufRead) -> T,
) -> Result<(CompleteScan, T), ServiceError> {
    let unpacked = inflate(encoding, packed, limits).map_err(ContentError::Packing)?;
    let mut kept = Tee::new(unpacked, |block: Vec<u8>| match part.append(&block) {
        Ok(()) => Ok(block),
        Err(error) => Err(io::Error::other(error)),
    });
    let seen = look(&mut kept);
    kept.finish().map_err(|error| match error.downcast::<StoreError>() {
        Ok(error) => ServiceError::Store(error),
        Err(error) => ContentError::Packing(error.into()).into(),
    })?;
    Ok((part.complete(), seen))
}
