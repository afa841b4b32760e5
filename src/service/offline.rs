//! The same measurement without service or store: a file in, the record and what pictures need out. What both calculate
//! is one function, so that both give the same bits. Must not know who asks.

use super::clock::Clock;
use super::{Identity, MeasureError, Measurement, Origin, Resolved, measure};
use crate::estimation::{Profile, Progress};
use crate::scan::Scan;
use crate::scan::decode::{Encoding, Limits, inflate};
use sha2::{Digest, Sha256};
use std::io::{self, BufRead, Read};

/// A measurement that was made offline.
#[derive(Debug, Clone, PartialEq)]
pub struct Offline {
    /// The record, as the service would keep it.
    pub measurement: Measurement,
    /// What became of every profile, in station order.
    pub profiles: Vec<Profile>,
    /// The profiles' points, for pictures.
    pub scan: Scan,
}

/// Measures what `reader` holds; gzip and zstd are undone first. The bytes are hashed on the way.
///
/// # Errors
/// [`MeasureError`] with what is wrong with the file.
pub fn measure_offline(
    mut reader: Box<dyn BufRead + '_>,
    origin: &Origin,
    resolved: &Resolved,
    limits: &Limits,
    progress: &Progress,
) -> Result<Offline, MeasureError> {
    let created_at = Clock.now();
    let watch = Clock.start();
    let encoding = Encoding::sniff(reader.fill_buf().map_err(crate::scan::decode::DecodeError::from)?);
    let reader: Box<dyn BufRead + '_> = match encoding {
        Some(encoding) => Box::new(inflate(encoding, reader, limits)?),
        None => reader,
    };
    let mut hashed = Hashed { inner: reader, hash: Sha256::new() };
    let measured = measure(&mut hashed, &origin.claims(), resolved, limits, progress)?;
    // A reader may stop behind the last point; the file's identity is all of it.
    io::copy(&mut hashed, &mut io::sink()).map_err(crate::scan::decode::DecodeError::from)?;
    let scan_sha256 = hashed.hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let identity = Identity {
        id: Clock.new_id("m-"),
        created_at,
        duration_ms: watch.elapsed_ms(),
        scan_sha256,
        recipe_name: None,
    };
    let (measurement, profiles) = Measurement::record(identity, &measured.prepared, measured.estimate, resolved);
    Ok(Offline { measurement, profiles, scan: measured.prepared.scan })
}

/// Hashes whatever is taken from it.
struct Hashed<R> {
    inner: R,
    hash: Sha256,
}

impl<R: BufRead> Read for Hashed<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(into)?;
        self.hash.update(into.get(..count).unwrap_or_default());
        Ok(count)
    }
}

impl<R: BufRead> BufRead for Hashed<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.inner.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        // The buffer is there already: nothing waits and nothing fails here.
        if let Ok(bytes) = self.inner.fill_buf() {
            self.hash.update(bytes.get(..count).unwrap_or_default());
        }
        self.inner.consume(count);
    }
}
