//! Reads a scan while it still comes in, behind the writer of its file: when the last byte is here, the points are, too. Goes
//! out as what the file turned out to hold.
//!
//! Such a reader waits for a client, so it has a thread of its own and not one of those that calculate; and it holds the
//! points in memory until their turn comes, so there are few. A scan that finds no place is read from its file later.
//!
//! A reader that somebody else reads along with: every block that was read through is handed on, in order, and all of them once
//! it is finished.

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

/// Points that are expected of a body whose length is not announced: an eighth of what the readers may hold by default.
const POINTS_UNANNOUNCED: usize = 1_000_000;
/// What a packed scan is expected to unpack to, times its size: text shrinks to a third or a quarter, binary numbers less.
const PACKED_TO: u64 = 4;

/// Places for scans that are read while they come in, and memory for their points.
#[derive(Debug, Clone)]
pub(in crate::service) struct Readers {
    places: Arc<Semaphore>,
    memory: Memory,
}

/// What has to be known to read a scan.
#[derive(Debug, Clone)]
pub(in crate::service) struct Wanted {
    pub(in crate::service) encoding: Option<Encoding>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) resolved: Resolved,
    pub(in crate::service) limits: Limits,
    /// Bytes that will come, where that was said.
    pub(in crate::service) bytes_expected: Option<u64>,
}

/// A scan that is being read.
#[derive(Debug)]
pub(in crate::service) struct Reading {
    outcome: oneshot::Receiver<Result<ReadScan, ServiceError>>,
}

/// A scan that was read while it came in.
#[derive(Debug)]
pub(in crate::service) struct ReadScan {
    /// The content, where it came packed.
    pub(in crate::service) unpacked: Option<CompleteScan>,
    /// The points; `None` where they need more memory than was set aside for them. Bytes that are no scan are told when it is
    /// their turn, as they would be if they were read then.
    pub(in crate::service) points: Option<ReadPoints>,
}

impl Readers {
    pub(in crate::service) fn new(places_count: usize, memory: Memory) -> Self {
        Self { places: Arc::new(Semaphore::new(places_count.min(Semaphore::MAX_PERMITS))), memory }
    }

    /// Begins to read; `None` where there is no place, no memory, or no thread.
    pub(in crate::service) fn begin(&self, trail: &ScanTrail, wanted: impl FnOnce() -> Wanted) -> Option<Reading> {
        let place = Arc::clone(&self.places).try_acquire_owned().ok()?;
        let (trail, wanted) = (trail.clone(), wanted());
        let claim = self.memory.try_claim(wanted.points_expected())?;
        let (sender, outcome) = oneshot::channel();
        let work = move || {
            let read = take_in(&trail, &wanted, claim);
            drop(place);
            // Nobody listens any more where the upload was given up.
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

    /// What was read, once the writer has ended; soon after it where it gave up.
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

/// Bytes to points, and to the file that holds them unpacked, where they came packed.
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

/// Undoes the packing of a scan into a file of its own.
pub(in crate::service) fn unpack(
    trail: &ScanTrail,
    encoding: Encoding,
    limits: &Limits,
) -> Result<CompleteScan, ServiceError> {
    let bytes = BufReader::with_capacity(READ_BLOCK_BYTES, trail.follow()?);
    Ok(unpack_seen(encoding, bytes, trail.begin_another()?, limits, &Sent::default(), |_| ())?.0)
}

/// Undoes a packing into `part`, to its end; `look` sees the bytes on the way, as far as it likes.
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
