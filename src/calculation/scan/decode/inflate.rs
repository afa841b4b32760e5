//! Compressed transfer, gzip and zstd, decompressed within limits: a stream in, a longer stream out.

use super::error::DecodeError;
use super::limits::Limits;
use flate2::bufread::MultiGzDecoder;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Decompressed bytes before the ratio is checked: a short file of equal lines may well compress to a hundredth.
const RATIO_FROM: u64 = 1 << 20;
/// Window of zstd, as a power of two: 8 MiB, the largest of the levels below "ultra". A frame may ask for 2 GiB.
const WINDOW_LOG_MAX: u32 = 23;

/// A compression of the transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// RFC 1952.
    Gzip,
    /// RFC 8878.
    Zstd,
}

impl Encoding {
    /// The encoding that the first bytes show.
    #[must_use]
    pub fn sniff(head: &[u8]) -> Option<Self> {
        if head.starts_with(b"\x1f\x8b\x08") {
            Some(Self::Gzip)
        } else if head.starts_with(b"\x28\xb5\x2f\xfd") {
            Some(Self::Zstd)
        } else {
            None
        }
    }

    /// The encoding of a `Content-Encoding`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name.trim().to_ascii_lowercase().as_str() {
            "gzip" | "x-gzip" => Some(Self::Gzip),
            "zstd" => Some(Self::Zstd),
            _ => None,
        }
    }
}

/// Number of bytes of a file as it was sent, counted as they arrive. Formats with their own compression are checked against this
/// number, because several layers of compression multiply their ratios.
#[derive(Debug, Clone, Default)]
pub struct Sent(Arc<AtomicU64>);

impl Sent {
    /// A file that is completely in memory.
    #[must_use]
    pub fn of(bytes_count: u64) -> Self {
        Self(Arc::new(AtomicU64::new(bytes_count)))
    }

    /// Bytes so far.
    #[must_use]
    pub fn bytes_count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    fn add(&self, bytes_count: usize) {
        self.0.fetch_add(bytes_count as u64, Ordering::Relaxed);
    }
}

/// Decompresses a stream, and counts the input in `sent`. The stream fails with a [`DecodeError`] inside its `io::Error`, which
/// [`decode`](super::decode) extracts again, as soon as it is too long, too long for its input, or damaged.
///
/// # Errors
/// [`DecodeError::Io`] if the decoder cannot be set up.
pub fn inflate<'a, R: BufRead + 'a>(
    encoding: Encoding,
    reader: R,
    limits: &Limits,
    sent: &Sent,
) -> Result<impl BufRead + use<'a, R>, DecodeError> {
    let reader = Counted { inner: reader, sent: sent.clone() };
    let inflater = match encoding {
        Encoding::Gzip => Inflater::Gzip(Box::new(MultiGzDecoder::new(reader))),
        Encoding::Zstd => {
            let mut decoder = zstd::Decoder::with_buffer(reader)?;
            decoder.window_log_max(WINDOW_LOG_MAX)?;
            Inflater::Zstd(Box::new(decoder))
        }
    };
    let sent = sent.clone();
    Ok(BufReader::with_capacity(1 << 16, Capped::new(inflater, limits, move || sent.bytes_count())))
}

enum Inflater<'a, R: BufRead> {
    Gzip(Box<MultiGzDecoder<Counted<R>>>),
    Zstd(Box<zstd::Decoder<'a, Counted<R>>>),
}

impl<R: BufRead> Read for Inflater<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Gzip(decoder) => decoder.read(buffer),
            Self::Zstd(decoder) => decoder.read(buffer),
        }
    }
}

/// Counts the bytes that are read from a reader.
struct Counted<R> {
    inner: R,
    sent: Sent,
}

impl<R: BufRead> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.sent.add(read);
        Ok(read)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.inner.fill_buf()
    }

    fn consume(&mut self, used: usize) {
        self.sent.add(used);
        self.inner.consume(used);
    }
}

/// A decompressor whose output is checked against the limits. `packed` counts its input so far.
pub(super) struct Capped<R, F> {
    inner: R,
    packed: F,
    out: u64,
    bytes_max: u64,
    ratio_max: u64,
}

impl<R: Read, F: Fn() -> u64> Capped<R, F> {
    pub(super) fn new(inner: R, limits: &Limits, packed: F) -> Self {
        Self { inner, packed, out: 0, bytes_max: limits.inflated_bytes_max, ratio_max: limits.inflate_ratio_max }
    }
}

impl<R: Read, F: Fn() -> u64> Read for Capped<R, F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer).map_err(name_damage)?;
        self.out += read as u64;
        if self.out > self.bytes_max {
            return Err(DecodeError::InflatedTooLarge { limit: self.bytes_max }.into());
        }
        check_ratio(self.out, (self.packed)(), self.ratio_max)?;
        Ok(read)
    }
}

/// Refuses a ratio of decompressed to sent bytes beyond the limit.
pub(super) fn check_ratio(unpacked: u64, packed: u64, ratio_max: u64) -> Result<(), DecodeError> {
    if unpacked > RATIO_FROM && unpacked / ratio_max.max(1) > packed {
        return Err(DecodeError::InflateRatio { limit: ratio_max });
    }
    Ok(())
}

/// Distinguishes damaged data, which decompressors report under these kinds, from a failed source.
fn name_damage(error: io::Error) -> io::Error {
    match error.kind() {
        ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::UnexpectedEof | ErrorKind::Other => {
            DecodeError::BadCompression.into()
        }
        _ => error,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Format, decode};
    use std::io::Write;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(bytes).expect("writes");
        encoder.finish().expect("writes")
    }

    fn zstd(bytes: &[u8]) -> Vec<u8> {
        zstd::encode_all(bytes, 3).expect("writes")
    }

    fn read(packed: &[u8], limits: &Limits) -> Result<Vec<u8>, DecodeError> {
        let encoding = Encoding::sniff(packed).expect("a known encoding");
        let mut out = Vec::new();
        inflate(encoding, packed, limits, &Sent::default())?.read_to_end(&mut out)?;
        Ok(out)
    }

    #[test]
    fn both_encodings_are_decompressed_completely() {
        let text = b"0 1 2\n".repeat(1000);
        for packed in [gzip(&text), zstd(&text)] {
            assert_eq!(read(&packed, &Limits::default()).expect("inflates"), text);
        }
    }

    #[test]
    fn a_bomb_is_refused_for_its_ratio_and_a_long_file_for_its_length() {
        let zeros = vec![0; 4 << 20];
        let short = Limits { inflated_bytes_max: 1000, ..Limits::default() };
        for packed in [gzip(&zeros), zstd(&zeros)] {
            assert_eq!(read(&packed, &Limits::default()).expect_err("bomb").code(), "inflate_ratio");
            assert_eq!(read(&packed, &short).expect_err("long").code(), "inflated_too_large");
        }
    }

    #[test]
    fn damage_and_an_early_end_are_named() {
        let text: Vec<u8> = (0..20_000u32).flat_map(|i| (i.wrapping_mul(2_654_435_761)).to_le_bytes()).collect();
        for packed in [gzip(&text), zstd(&text)] {
            let error = read(&packed[..packed.len() / 2], &Limits::default()).expect_err("ends early");
            assert_eq!(error.code(), "compression_invalid");
        }
    }

    #[test]
    fn a_reader_of_a_bomb_reports_its_reason() {
        let limits = Limits::default();
        let request = crate::scan::decode::request::Request::new(&limits);
        let packed = gzip(&b"0 1 2\n".repeat(1 << 20));
        for (format, code) in [(Format::Csv, "inflate_ratio"), (Format::Npz, "inflate_ratio")] {
            let mut reader = inflate(Encoding::Gzip, packed.as_slice(), &limits, &Sent::default()).expect("begins");
            assert_eq!(decode(format, &mut reader, &request).expect_err("bomb").code(), code, "{format}");
        }
        let mut reader = inflate(Encoding::Gzip, &packed[..20], &limits, &Sent::default()).expect("begins");
        assert_eq!(decode(Format::Csv, &mut reader, &request).expect_err("cut").code(), "compression_invalid");
    }
}
