//! Compressed transfer, gzip and zstd, undone within limits: a stream in, a longer stream out.
//! Must not know what the stream holds.

use super::{DecodeError, Limits};
use flate2::bufread::MultiGzDecoder;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};

/// Bytes out before the ratio is judged: a short file of equal lines may well shrink to a hundredth.
const RATIO_FROM: u64 = 1 << 20;
/// Window of zstd, as a power of two: 8 MiB, the most that levels below "ultra" use. A frame may ask for 2 GiB.
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
    /// The encoding that the first bytes give away.
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

/// Undoes a compression. The stream fails with a [`DecodeError`] inside its `io::Error`, which
/// [`decode`](super::decode) takes out again, as soon as it is too long, too long for what went in, or damaged.
///
/// # Errors
/// [`DecodeError::Io`] where the decoder cannot be set up.
pub fn inflate<'a, R: BufRead + 'a>(
    encoding: Encoding,
    reader: R,
    limits: &Limits,
) -> Result<impl BufRead + use<'a, R>, DecodeError> {
    let reader = Counted { inner: reader, count: 0 };
    let inflater = match encoding {
        Encoding::Gzip => Inflater::Gzip(Box::new(MultiGzDecoder::new(reader))),
        Encoding::Zstd => {
            let mut decoder = zstd::Decoder::with_buffer(reader)?;
            decoder.window_log_max(WINDOW_LOG_MAX)?;
            Inflater::Zstd(Box::new(decoder))
        }
    };
    Ok(BufReader::with_capacity(1 << 16, Capped::new(inflater, limits, Inflater::packed)))
}

enum Inflater<'a, R: BufRead> {
    Gzip(Box<MultiGzDecoder<Counted<R>>>),
    Zstd(Box<zstd::Decoder<'a, Counted<R>>>),
}

impl<R: BufRead> Inflater<'_, R> {
    fn packed(&self) -> u64 {
        match self {
            Self::Gzip(decoder) => decoder.get_ref().count,
            Self::Zstd(decoder) => decoder.get_ref().count,
        }
    }
}

impl<R: BufRead> Read for Inflater<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Gzip(decoder) => decoder.read(buffer),
            Self::Zstd(decoder) => decoder.read(buffer),
        }
    }
}

/// Counts what is taken from a reader.
struct Counted<R> {
    inner: R,
    count: u64,
}

impl<R: BufRead> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        self.count += read as u64;
        Ok(read)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.inner.fill_buf()
    }

    fn consume(&mut self, used: usize) {
        self.count += used as u64;
        self.inner.consume(used);
    }
}

/// A decompressor whose output is counted against the limits. `packed` says how much has gone in so far.
pub(super) struct Capped<R, F> {
    inner: R,
    packed: F,
    out: u64,
    bytes_max: u64,
    ratio_max: u64,
}

impl<R: Read, F: Fn(&R) -> u64> Capped<R, F> {
    pub(super) fn new(inner: R, limits: &Limits, packed: F) -> Self {
        Self { inner, packed, out: 0, bytes_max: limits.inflated_bytes_max, ratio_max: limits.inflate_ratio_max }
    }
}

impl<R: Read, F: Fn(&R) -> u64> Read for Capped<R, F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer).map_err(name_damage)?;
        self.out += read as u64;
        if self.out > self.bytes_max {
            return Err(DecodeError::InflatedTooLarge { limit: self.bytes_max }.into());
        }
        if self.out > RATIO_FROM && self.out / self.ratio_max.max(1) > (self.packed)(&self.inner) {
            return Err(DecodeError::InflateRatio { limit: self.ratio_max }.into());
        }
        Ok(read)
    }
}

/// Tells damage, which decompressors report under these kinds, from a source that failed.
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
        inflate(encoding, packed, limits)?.read_to_end(&mut out)?;
        Ok(out)
    }

    #[test]
    fn both_encodings_come_back_whole() {
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
    fn a_reader_that_meets_a_bomb_gives_its_reason() {
        let limits = Limits::default();
        let request = crate::scan::decode::Request::new(&limits);
        let packed = gzip(&b"0 1 2\n".repeat(1 << 20));
        for (format, code) in [(Format::Csv, "inflate_ratio"), (Format::Npz, "inflate_ratio")] {
            let mut reader = inflate(Encoding::Gzip, packed.as_slice(), &limits).expect("begins");
            assert_eq!(decode(format, &mut reader, &request).expect_err("bomb").code(), code, "{format}");
        }
        let mut reader = inflate(Encoding::Gzip, &packed[..20], &limits).expect("begins");
        assert_eq!(decode(Format::Csv, &mut reader, &request).expect_err("cut").code(), "compression_invalid");
    }
}
