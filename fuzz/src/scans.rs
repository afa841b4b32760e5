//! Scan files, from bytes to profiles, on the path of an upload: decompress, detect the format, decode, remove missing points,
//! group into profiles.

use coaxis::scan::decode::{
    Decimal, DecodeError, Encoding, Format, FormatClaims, Grid, Limits, Request, Sent, Unit, decode, find_format,
    inflate,
};
use coaxis::scan::missing::clean;
use coaxis::scan::slice::{Region, SliceRequest, slice};
use coaxis::scan::{Cloud, ProfileRule};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{BufRead, Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Small enough that the memory limit of `fuzz/run` detects memory that is reserved because of a size stated in a file.
fn limits() -> Limits {
    Limits {
        points_max: 200_000,
        profiles_max: 20_000,
        line_bytes_max: 64 << 10,
        inflated_bytes_max: 8 << 20,
        ..Limits::default()
    }
}

/// Numbers that determine the request parameters of a file, from the sum of the bytes, so that the file is unmodified and the same
/// file is always read in the same way.
struct Choice(u32);

impl Choice {
    fn of(bytes: &[u8]) -> Self {
        Self(bytes.iter().fold(0, |sum: u32, byte| sum.wrapping_add(u32::from(*byte))))
    }

    /// One of the values; none in half of the cases.
    fn option<T: Copy>(&mut self, values: &[T]) -> Option<T> {
        let count = u32::try_from(2 * values.len()).expect("few");
        let index = self.0 % count;
        self.0 /= count;
        values.get(index as usize).copied()
    }
}

fn request<'a>(choice: &mut Choice, limits: &'a Limits) -> Request<'a> {
    Request {
        unit: choice.option(&Unit::ALL),
        decimal: choice.option(&Decimal::ALL),
        profile_column: choice.option(&["frame", "x"]),
        ..Request::new(limits)
    }
}

/// A file whose format is known.
pub fn file(format: Format, bytes: &[u8]) {
    let limits = limits();
    let mut choice = Choice::of(bytes);
    let request = request(&mut choice, &limits);
    profiles(decode(format, &mut { bytes }, &request), &mut choice, &limits);
}

/// A matrix of heights, decoded as NPY if it begins like one.
pub fn matrix(bytes: &[u8]) {
    let limits = limits();
    let mut choice = Choice::of(bytes);
    let pitches = [0.5, 1e-9, 1e6];
    let grid = Grid {
        x_pitch_mm: choice.option(&pitches),
        y_pitch_mm: choice.option(&pitches),
        columns_are_profiles: choice.option(&[true]).is_some(),
    };
    let format = if Format::sniff(bytes) == Some(Format::Npy) { Format::Npy } else { Format::Csv };
    let request = Request { grid, ..request(&mut choice, &limits) };
    profiles(decode(format, &mut { bytes }, &request), &mut choice, &limits);
}

/// A scan compressed by gzip or Zstandard; its format is detected from the decompressed bytes.
pub fn packed(bytes: &[u8]) {
    let limits = limits();
    let packed = match Encoding::sniff(bytes) {
        Some(_) => bytes.to_vec(),
        // The files of the tests are not compressed.
        None => {
            let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
            gzip.write_all(bytes).expect("memory takes everything");
            gzip.finish().expect("memory takes everything")
        }
    };
    let encoding = Encoding::sniff(&packed).expect("it is packed");
    let sent = Sent::default();
    let Ok(mut reader) = inflate(encoding, &*packed, &limits, &sent) else { return };
    let Ok(head) = reader.fill_buf() else { return };
    let Ok(format) = find_format(&FormatClaims::default(), head) else { return };
    let mut choice = Choice::of(bytes);
    let request = Request { sent: Some(&sent), ..request(&mut choice, &limits) };
    profiles(decode(format, &mut reader, &request), &mut choice, &limits);
}

/// The detected format of a file, from its bytes and its declared properties.
pub fn format(bytes: &[u8]) {
    let (claim, head) = bytes.split_at(bytes.len().min(32));
    let text = std::str::from_utf8(claim).ok();
    for claims in [
        FormatClaims::default(),
        FormatClaims { media_type: text, ..FormatClaims::default() },
        FormatClaims { file_name: text, ..FormatClaims::default() },
        FormatClaims { parameter: text.and_then(Format::from_name), ..FormatClaims::default() },
    ] {
        if let (Ok(found), Some(parameter)) = (find_format(&claims, head), claims.parameter) {
            assert_eq!(found, parameter, "the parameter has priority");
        }
        let _ = find_format(&claims, bytes);
    }
    let _ = (Encoding::sniff(bytes), text.and_then(Encoding::from_name), text.and_then(Unit::from_name));
    if let Some(Ok(rule)) = text.map(ProfileRule::parse) {
        assert_eq!(ProfileRule::parse(&rule.to_string()), Ok(rule), "a rule reads back as written");
    }
}

/// The bytes as entries of an archive with correct checksums, which mutated archives seldom have: names end at a line end, an
/// entry ends at the next beginning of an NPY file.
pub fn npz_entry(bytes: &[u8]) {
    const MAGIC: &[u8] = b"\x93NUMPY";
    let starts: Vec<_> = (0..bytes.len()).filter(|at| bytes[*at..].starts_with(MAGIC)).take(80).collect();
    let names = bytes.get(..starts.first().copied().unwrap_or(0)).unwrap_or_default();
    let mut names = names.split(|byte| *byte == b'\n').map(String::from_utf8_lossy);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (index, start) in starts.iter().enumerate() {
        let end = starts.get(index + 1).copied().unwrap_or(bytes.len());
        let usual = ["x.npy", "y.npy", "z.npy", "points.npy"][index % 4];
        let name = names.next().filter(|name| !name.is_empty()).map_or(usual.to_owned(), |name| name.into_owned());
        let method = [CompressionMethod::Stored, CompressionMethod::Deflated][index % 2];
        if archive.start_file(name, SimpleFileOptions::default().compression_method(method)).is_err() {
            return;
        }
        archive.write_all(&bytes[*start..end]).expect("memory takes everything");
    }
    let archive = archive.finish().expect("memory takes everything").into_inner();
    file(Format::Npz, &archive);
}

/// Checks the guarantees of every decoder about its points, and groups them into profiles.
fn profiles(decoded: Result<Cloud, DecodeError>, choice: &mut Choice, limits: &Limits) {
    let cloud = match decoded {
        Ok(cloud) => cloud,
        // Messages quote parts of the file.
        Err(error) => return assert!(error.to_string().len() < 4096, "a message must not be long: {error}"),
    };
    let points_count = cloud.columns.len() as u64 + cloud.missing_count;
    assert!(points_count <= limits.points_max as u64, "{points_count} points, {} are allowed", limits.points_max);
    assert_eq!(
        cloud.stripes.last().map_or(0, |stripe| stripe.end),
        cloud.columns.len(),
        "stripes end with the columns"
    );
    for point in cloud.points() {
        assert!(
            point.iter().all(|value| value.abs() <= limits.coordinate_max_mm * (1.0 + 1e-6)),
            "{point:?} is in range"
        );
    }
    let (cloud, removed) = clean(cloud, choice.option(&[&[0.0, -9999.0][..]]));
    assert!(cloud.columns.len() as u64 + removed.missing_count() <= points_count);
    let rules = [ProfileRule::Row, ProfileRule::XValue, ProfileRule::XPitch(None), ProfileRule::Column(None)];
    let rule = choice.option(&[0, 1, 2, 3]).map(|index: usize| rules[index].clone());
    let region = choice.option(&[()]).map(|()| Region { x_mm: Some([-1.0, 1.0]), ..Region::default() });
    if let Ok(scan) = slice(cloud, &SliceRequest { rule, frame: None, region }, limits) {
        assert!(scan.stations().len() <= limits.profiles_max);
        assert!(scan.stations().is_sorted_by(|a, b| a.x <= b.x), "profiles are in the order of x");
    }
}
