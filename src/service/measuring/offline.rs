//! The same measurement without service or store: from a file to the record and the data for pictures. The service and the offline
//! command call the same function for the calculation, so that both give the same bits.

use std::io::{self, BufReader, Cursor, Read};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};

use crate::store::hex;
use sha2::{Digest, Sha256};

use crate::estimation::{Profile, Progress};
use crate::scan::Scan;
use crate::scan::decode::{DecodeError, Encoding, Limits, Sent, inflate};
use crate::service::clock::Clock;

use super::copying_reader::{CopyingReader, READ_BLOCK_BYTES};
use super::order::Origin;
use super::pipeline::{MeasureError, read};
use super::recipe::Resolved;
use super::record::{Identity, Measurement};

/// Number of first bytes that identify the compression of a file.
const HEAD_BYTES: u64 = 4;
/// Blocks that wait to be hashed: 8 MiB, so that reading waits less and memory stays bounded.
const BLOCKS_BEHIND_MAX: usize = 32;

/// Takes a block that is to be hashed, and returns one to be filled.
type HandOn = Box<dyn FnMut(Vec<u8>) -> io::Result<Vec<u8>>>;

/// An offline measurement.
#[derive(Debug, Clone, PartialEq)]
pub struct Offline {
    /// The record, as the service would store it.
    pub measurement: Measurement,
    /// The verdict on every profile, in station order.
    pub profiles: Vec<Profile>,
    /// The profiles' points, for pictures.
    pub scan: Scan,
}

/// Measures the content of `source`; gzip and zstd are decompressed first. The bytes are hashed during reading, on a separate
/// thread.
///
/// # Errors
/// [`MeasureError`] with the cause in the file.
pub fn measure_offline(
    source: Box<dyn Read + '_>,
    origin: &Origin,
    resolved: &Resolved,
    limits: &Limits,
    progress: &Progress,
) -> Result<Offline, MeasureError> {
    let created_at = Clock.now();
    let watch = Clock.start();
    let (digest, hand_on) = hash_along().map_err(DecodeError::from)?;
    let (source, sent) = unpacked(source, limits)?;
    let mut bytes = CopyingReader::new(source, hand_on);
    let decoded = match read(&mut bytes, &origin.claims(), resolved, limits, sent.as_ref()) {
        Ok(decoded) => decoded,
        Err(error) => return Err(bytes.into_failure().map_or(error, DecodeError::from).into()),
    };
    // A decoder may stop after the last point; the SHA-256 is that of the complete file.
    bytes.finish().map_err(DecodeError::from)?;
    let measured = super::pipeline::measure(decoded, resolved, limits, progress)?;
    let scan_sha256 = digest.join().map_err(|_| DecodeError::from(not_hashed()))?;
    let identity = Identity {
        id: Clock.new_id("m-"),
        created_at,
        duration_ms: watch.elapsed_ms(),
        scan_sha256,
        recipe_name: None,
        acquisition: None,
    };
    let (measurement, profiles) = Measurement::record(identity, &measured.prepared, measured.estimate, resolved);
    Ok(Offline { measurement, profiles, scan: measured.prepared.scan })
}

/// The decompressed source if its first bytes identify a compression, with a counter of the compressed bytes read.
pub(in crate::service) fn unpacked<'a>(
    mut source: Box<dyn Read + 'a>,
    limits: &Limits,
) -> Result<(Box<dyn Read + 'a>, Option<Sent>), DecodeError> {
    let mut head = Vec::new();
    source.by_ref().take(HEAD_BYTES).read_to_end(&mut head)?;
    let encoding = Encoding::sniff(&head);
    let whole = Cursor::new(head).chain(source);
    Ok(match encoding {
        Some(encoding) => {
            let (packed, sent) = (BufReader::with_capacity(READ_BLOCK_BYTES, whole), Sent::default());
            (Box::new(inflate(encoding, packed, limits, &sent)?), Some(sent))
        }
        None => (Box::new(whole), None),
    })
}

/// Starts a thread that hashes blocks and returns them: the result is the SHA-256, with the function that passes blocks on.
/// Hashing a large binary scan takes longer than reading it; the thread finishes during the estimation.
fn hash_along() -> io::Result<(JoinHandle<String>, HandOn)> {
    let (to_hash, blocks) = mpsc::sync_channel::<Vec<u8>>(BLOCKS_BEHIND_MAX);
    let (give_back, hashed) = mpsc::channel();
    let work = move || {
        let mut hash = Sha256::new();
        for block in blocks {
            hash.update(&block);
            // The receiver is gone if the reading has ended.
            let _ = give_back.send(block);
        }
        hex(&hash.finalize())
    };
    let digest = thread::Builder::new().name("hash".to_owned()).spawn(work)?;
    let hand_on = move |block| {
        to_hash.send(block).map_err(|_| not_hashed())?;
        Ok(hashed.try_recv().unwrap_or_default())
    };
    Ok((digest, Box::new(hand_on)))
}

fn not_hashed() -> io::Error {
    io::Error::other("the thread that hashes ended early")
}
