//! Decodes a scan during its upload, from the file that is being written, so that the points are available with the last byte.
//!
//! A reader waits for its client, so it has its own thread and does not use one of those that calculate. It keeps the
//! points in memory until their turn comes, so the number of readers is small. A scan without a reader is read from its file
//! later.

use super::copying_reader::{CopyingReader, READ_BLOCK_BYTES};
use std::io::{self, BufRead, BufReader};
use std::sync::Arc;
use std::thread;

use tokio::sync::{Semaphore, oneshot};

use super::order::Origin;
use super::points::ReadPoints;
use crate::scan::decode::{Encoding, Limits, Sent, inflate};
use crate::service::compute::ComputeError;
use crate::service::error::{ContentError, ServiceError};
use crate::service::memory::{Claim, Memory, points_expected};
use crate::store::{CompleteScan, ScanPart, ScanTrail, StoreError};

use super::pipeline::read;
use super::recipe::Resolved;

/// Points expected of a body whose length is not announced: an eighth of the points that the readers may keep by default.
const POINTS_UNANNOUNCED: usize = 1_000_000;
/// Assumed ratio of decompressed to compressed size: text shrinks to a third or a quarter, binary numbers less.
const PACKED_TO: u64 = 4;

/// Places for scans that are read during their upload, and memory for their points.
#[derive(Debug, Clone)]
pub(in crate::service) struct Readers {
    places: Arc<Semaphore>,
    memory: Memory,
}

/// Parameters for reading a scan.
#[derive(Debug, Clone)]
pub(in crate::service) struct Wanted {
    pub(in crate::service) encoding: Option<Encoding>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) resolved: Resolved,
    pub(in crate::service) limits: Limits,
    /// Announced number of bytes.
    pub(in crate::service) bytes_expected: Option<u64>,
}

/// A scan that is being read.
#[derive(Debug)]
pub(in crate::service) struct Reading {
    outcome: oneshot::Receiver<Result<ReadScan, ServiceError>>,
}

/// A scan that was read during its upload.
#[derive(Debug)]
pub(in crate::service) struct ReadScan {
    /// The decompressed content, if the upload was compressed.
    pub(in crate::service) unpacked: Option<CompleteScan>,
    /// The points; `None` if they need more memory than was reserved. Bytes that are not a scan are reported at their turn, as if
    /// they were read then.
    pub(in crate::service) points: Option<ReadPoints>,
}

impl Readers {
    pub(in crate::service) fn new(places_count: usize, memory: Memory) -> Self {
        Self { places: Arc::new(Semaphore::new(places_count.min(Semaphore::MAX_PERMITS))), memory }
    }

    /// Starts to read; `None` if no place, memory or thread is available.
    pub(in crate::service) fn begin(&self, trail: &ScanTrail, wanted: impl FnOnce() -> Wanted) -> Option<Reading> {
        let place = Arc::clone(&self.places).try_acquire_owned().ok()?;
        let (trail, wanted) = (trail.clone(), wanted());
        let claim = self.memory.try_claim(wanted.points_expected())?;
        let (sender, outcome) = oneshot::channel();
        let work = move || {
            let read = take_in(&trail, &wanted, claim);
            drop(place);
            // The receiver is gone if the upload was abandoned.
            let _ = sender.send(read);
        };
        thread::Builder::new().name("read".to_owned()).spawn(work).ok().map(|_| Reading { outcome })
    }
}

impl Reading {
    #[cfg(test)]
    pub(in crate::service) fn is_over(&self) -> bool {
        !self.outcome.is_empty()
    }

    /// The result, once the writer has ended, or soon after it was abandoned.
    pub(in crate::service) async fn outcome(self) -> Result<ReadScan, ServiceError> {
        self.outcome.await.map_err(|_| ComputeError::Panicked)?
    }
}

impl Wanted {
    fn points_expected(&self) -> usize {
        let Some(bytes_count) = self.bytes_expected else { return POINTS_UNANNOUNCED };
        points_expected(if self.encoding.is_some() { bytes_count.saturating_mul(PACKED_TO) } else { bytes_count })
    }
}

/// Decodes bytes to points, and writes the decompressed file if they were compressed.
fn take_in(trail: &ScanTrail, wanted: &Wanted, mut claim: Claim) -> Result<ReadScan, ServiceError> {
    let Wanted { encoding, origin, resolved, limits, .. } = wanted;
    let within = claim.limits(limits);
    let counted = Sent::default();
    let sent = encoding.map(|_| &counted);
    let points_of = |bytes: &mut dyn BufRead| read(bytes, &origin.claims(), resolved, &within, sent);
    let mut bytes = BufReader::with_capacity(READ_BLOCK_BYTES, trail.follow()?);
    let (unpacked, decoded) = match *encoding {
        None => (None, points_of(&mut bytes)),
        Some(encoding) => {
            let (scan, decoded) = unpack_seen(encoding, bytes, trail.begin_another()?, limits, &counted, points_of)?;
            (Some(scan), decoded)
        }
    };
    let points = match decoded {
        Err(error) if claim.is_outgrown(&error) => None,
        decoded => {
            claim.keep_for(decoded.as_ref().map_or(0, |decoded| decoded.cloud.columns.len()));
            Some(ReadPoints { decoded, claim })
        }
    };
    Ok(ReadScan { unpacked, points })
}

/// Decompresses a scan into a separate file.
pub(in crate::service) fn unpack(
    trail: &ScanTrail,
    encoding: Encoding,
    limits: &Limits,
) -> Result<CompleteScan, ServiceError> {
    let bytes = BufReader::with_capacity(READ_BLOCK_BYTES, trail.follow()?);
    Ok(unpack_seen(encoding, bytes, trail.begin_another()?, limits, &Sent::default(), |_| ())?.0)
}

/// Decompresses all of `packed` into `part`; `look` may read any number of the decompressed bytes on the way.
fn unpack_seen<T>(
    encoding: Encoding,
    packed: impl BufRead,
    mut part: ScanPart,
    limits: &Limits,
    sent: &Sent,
    look: impl FnOnce(&mut dyn BufRead) -> T,
) -> Result<(CompleteScan, T), ServiceError> {
    let unpacked = inflate(encoding, packed, limits, sent).map_err(ContentError::Packing)?;
    let mut kept = CopyingReader::new(unpacked, |block: Vec<u8>| match part.append(&block) {
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
