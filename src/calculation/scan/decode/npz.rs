//! NPZ, numpy arrays in a zip archive: x, y and z of equal shape or x along the rows and y along the columns of z, or one array as
//! in NPY.
//!
//! The sizes in the directory of the archive are not trusted; bytes are counted while they are decompressed. Every entry that is
//! used is read to its end, where its checksum is compared.

use super::error::DecodeError;
use super::format::Format;
use super::gather::Gather;
use super::hints::shorten;
use super::inflate::Capped;
use super::limits::Limits;
use super::npy::{self, Array, read_header};
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels};
use std::io::{self, BufRead, BufReader, Cursor, Read};
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

const FORMAT: Format = Format::Npz;
/// Names that a message lists.
const NAMES_SHOWN_MAX: usize = 16;

/// An archive, and the number of bytes that were sent for it.
struct Archive {
    zip: ZipArchive<Cursor<Vec<u8>>>,
    sent_bytes: u64,
}

/// Reads an archive.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut archive = open(reader, request)?;
    let names = archive.zip.file_names().map(|name| name.map(|name| name.into_owned()));
    let names = names.collect::<Result<Vec<String>, _>>().map_err(|error| refuse(&error))?;
    check_places(&mut archive)?;
    let has = |axis: &str| names.iter().any(|name| name == axis);
    if ["x.npy", "y.npy", "z.npy"].into_iter().all(has) {
        return read_axes(&mut archive, request);
    }
    let is_array = |name: &String| name.to_ascii_lowercase().ends_with(".npy");
    match names.as_slice() {
        [only] if is_array(only) => {
            read_entry(&mut archive, only, request.limits, |reader| npy::decode(reader, request))
        }
        _ => {
            let found = names.iter().take(NAMES_SHOWN_MAX).map(|name| shorten(name.as_bytes())).collect();
            Err(match names.iter().any(is_array) {
                true => DecodeError::ArraysMissing { found },
                false => DecodeError::ZippedFile { found },
            })
        }
    }
}

fn open(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Archive, DecodeError> {
    let limits = request.limits;
    let mut bytes = Vec::new();
    reader.take(limits.inflated_bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limits.inflated_bytes_max {
        return Err(DecodeError::InflatedTooLarge { limit: limits.inflated_bytes_max });
    }
    let sent_bytes = request.sent_bytes(bytes.len() as u64);
    let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| refuse(&error))?;
    if zip.len() > limits.npz_entries_max {
        return Err(DecodeError::TooManyEntries { found: zip.len(), limit: limits.npz_entries_max });
    }
    Ok(Archive { zip, sent_bytes })
}

/// An error of the archive reader as a decode error: the archive is in memory, so the store is never the cause.
fn refuse(error: &ZipError) -> DecodeError {
    let unsupported = |what| DecodeError::Unsupported { format: FORMAT, what };
    match error {
        ZipError::UnsupportedArchive(what) if *what == ZipError::PASSWORD_REQUIRED => unsupported(ENCRYPTED),
        ZipError::InvalidPassword => unsupported(ENCRYPTED),
        ZipError::CompressionMethodNotSupported(_) => unsupported(NOT_DEFLATED),
        ZipError::UnsupportedArchive(_) => {
            unsupported("the archive uses a part of zip that is not read; write it with numpy.savez_compressed")
        }
        _ => DecodeError::DamagedArchive { what: "its directory or an entry's header is not whole" },
    }
}

const ENCRYPTED: &str = "encrypted entries are not read; write the archive without a password";
const NOT_DEFLATED: &str = "entries packed by LZMA, bzip2, Zstandard or the like are not read; pack them by deflate (numpy.savez_compressed) or not at all";

/// Refuses entries that are packed with an unsupported method, that extend beyond the archive, or that share bytes: in a valid
/// archive every file is written once, one after the other.
fn check_places(archive: &mut Archive) -> Result<(), DecodeError> {
    let end_of_entries = archive.zip.central_directory_start();
    let mut places = Vec::new();
    for index in 0..archive.zip.len() {
        let entry = archive.zip.by_index_raw(index).map_err(|error| refuse(&error))?;
        let unsupported = |what| Err(DecodeError::Unsupported { format: FORMAT, what });
        if entry.encrypted() {
            return unsupported(ENCRYPTED);
        }
        if !matches!(entry.compression(), CompressionMethod::Stored | CompressionMethod::Deflated) {
            return unsupported(NOT_DEFLATED);
        }
        let start = entry.data_start().unwrap_or(u64::MAX);
        places.push((start, start.saturating_add(entry.compressed_size())));
    }
    places.sort_unstable();
    let ends_early = places.iter().any(|(_, end)| *end > end_of_entries);
    let overlap = places.windows(2).any(|pair| matches!(pair, [(_, end), (next, _)] if end > next));
    match (ends_early, overlap) {
        (true, _) => Err(DecodeError::DamagedArchive { what: "an entry is longer than the space it has" }),
        (_, true) => Err(DecodeError::DamagedArchive { what: "two entries share bytes" }),
        (false, false) => Ok(()),
    }
}

/// The result of `read` for an entry, after the checksum of the entry has been verified.
fn read_entry<T>(
    archive: &mut Archive,
    name: &str,
    limits: &Limits,
    read: impl FnOnce(&mut dyn BufRead) -> Result<T, DecodeError>,
) -> Result<T, DecodeError> {
    // The ratio is checked for the complete archive: x that repeats along a profile compresses to almost nothing.
    let packed = archive.sent_bytes;
    let entry = archive.zip.by_name(name).map_err(|error| refuse(&error))?;
    let mut reader = BufReader::with_capacity(1 << 16, Capped::new(entry, limits, move || packed));
    let outcome = read(&mut reader).map_err(name_damage);
    let rest = io::copy(&mut reader, &mut io::sink()).map_err(|error| name_damage(error.into()));
    match (outcome, rest) {
        (Ok(value), Ok(_)) => Ok(value),
        // Damage explains any other error.
        (_, Err(error @ DecodeError::DamagedArchive { .. })) | (Err(error), _) | (Ok(_), Err(error)) => Err(error),
    }
}

fn name_damage(error: DecodeError) -> DecodeError {
    match error {
        DecodeError::BadCompression | DecodeError::DamagedFile | DecodeError::Io(_) => {
            DecodeError::DamagedArchive { what: "an entry does not unpack to its CRC-32" }
        }
        error => error,
    }
}

fn read_axis(archive: &mut Archive, name: &str, limits: &Limits) -> Result<Array, DecodeError> {
    read_entry(archive, name, limits, |mut reader| {
        let header = read_header(&mut reader)?;
        Array::read(&mut reader, &header, limits.points_max)
    })
}

/// The rows and columns along which the numbers of an axis vary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Along {
    /// One number a point.
    Both,
    /// One number a row.
    Rows,
    /// One number a column.
    Columns,
}

/// Reads x, y and z: (N) points or (P, M) profiles; of the latter x may be given once for each profile, and y once for each column.
fn read_axes(archive: &mut Archive, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    request.grid.check_unused(FORMAT)?;
    let x = read_axis(archive, "x.npy", request.limits)?;
    let y = read_axis(archive, "y.npy", request.limits)?;
    let z = read_axis(archive, "z.npy", request.limits)?;
    let (rows, columns, labels) = match *z.shape.as_slice() {
        [points] => (1, points, Labels::None),
        [profiles, points] => (profiles, points, Labels::Row),
        _ => return Err(shape_of(&z)),
    };
    let along = |array: &Array, one_dimensional: Along| match *array.shape.as_slice() {
        _ if array.shape == z.shape => Ok(Along::Both),
        [count] | [count, 1] if labels == Labels::Row && count == rows && one_dimensional == Along::Rows => {
            Ok(Along::Rows)
        }
        [count] | [1, count] if labels == Labels::Row && count == columns && one_dimensional == Along::Columns => {
            Ok(Along::Columns)
        }
        _ => Err(shape_of(array)),
    };
    let (along_x, along_y) = (along(&x, Along::Rows)?, along(&y, Along::Columns)?);
    let at = |array: &Array, along: Along, row: usize, column: usize| match (along, array.shape.len()) {
        (Along::Both, 1) => array.at(&[column]),
        (Along::Both, _) => array.at(&[row, column]),
        (Along::Rows, 1) => array.at(&[row]),
        (Along::Rows, _) => array.at(&[row, 0]),
        (Along::Columns, 1) => array.at(&[column]),
        (Along::Columns, _) => array.at(&[0, column]),
    };
    let precision = npy::precision_of(&[&x, &y, &z]);
    let mut gather = Gather::new(settle_unit(request.unit, None)?, precision, request.limits);
    for row in 0..rows {
        for column in 0..columns {
            let point = [at(&x, along_x, row, column), at(&y, along_y, row, column), at(&z, Along::Both, row, column)];
            let [x, y, z] = point.map(|value| value.unwrap_or(f64::NAN));
            gather.push(row as f64, [x, y, z])?;
        }
    }
    gather.finish(labels)
}

fn shape_of(array: &Array) -> DecodeError {
    DecodeError::ArrayShape { shape: array.shape.iter().map(|axis| *axis as u64).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Columns;
    use std::io::Write;
    use zip::write::SimpleFileOptions;

    fn array(shape: &str, bytes: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
        let length = u16::try_from(header.len()).expect("short").to_le_bytes();
        [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), bytes].concat()
    }

    fn archive(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in entries {
            zip.start_file(*name, SimpleFileOptions::default()).expect("starts");
            zip.write_all(bytes).expect("writes");
        }
        zip.finish().expect("ends").into_inner()
    }

    fn read(entries: &[(&str, Vec<u8>)]) -> Result<Cloud, DecodeError> {
        let limits = Limits::default();
        let request = Request::new(&limits);
        decode(&mut archive(entries).as_slice(), &request)
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn three_arrays_or_one_are_read_and_further_arrays_are_ignored() {
        let axis = |values: [f32; 4]| array("(2, 2)", &floats(&values));
        let nan = f32::NAN;
        let three = [
            ("z.npy", axis([5.0, 6.0, nan, 8.0])),
            ("intensity.npy", array("(1,)", &[0; 4])),
            ("x.npy", axis([1.0, 1.0, 2.0, 2.0])),
            ("y.npy", axis([1.5, 2.5, 3.5, 4.5])),
        ];
        let one = floats(&[1.0, 1.5, 5.0, 1.0, 2.5, 6.0, nan, nan, nan, 2.0, 4.5, 8.0]);
        for cloud in [read(&three), read(&[("scan.npy", array("(2, 2, 3)", &one))])] {
            let cloud = cloud.expect("reads");
            assert_eq!((cloud.labels, cloud.missing_count, cloud.stripes.len()), (Labels::Row, 1, 2));
            assert_eq!(cloud.columns, Columns::F32 { y: vec![1.5, 2.5, 4.5], z: vec![5.0, 6.0, 8.0] });
        }
    }

    #[test]
    fn each_wrong_archive_has_its_own_reason() {
        let axis = |shape| array(shape, &[0; 16]);
        let many: Vec<_> = (0..65).map(|i| format!("{i}.npy")).collect();
        let many: Vec<_> = many.iter().map(|name| (name.as_str(), Vec::new())).collect();
        for (entries, code) in [
            (vec![("x.npy", axis("(4,)")), ("y.npy", axis("(4,)"))], "arrays_missing"),
            (vec![("x.npy", axis("(4,)")), ("y.npy", axis("(4,)")), ("z.npy", axis("(3,)"))], "array_shape"),
            (vec![("x.npy", axis("(5,)")), ("y.npy", axis("(5,)")), ("z.npy", axis("(5,)"))], "file_truncated"),
            (vec![("a.npy", vec![0; 16 << 20])], "format_mismatch"),
            (vec![("a.npy", array("(1000000, 3)", &vec![0; 12_000_000]))], "inflate_ratio"),
            (many, "too_many_entries"),
            (vec![("scan.csv", b"x,y,z\n1,2,3\n".to_vec())], "format_unsupported"),
        ] {
            assert_eq!(read(&entries).expect_err("wrong").code(), code);
        }
        let limits = Limits::default();
        let request = Request::new(&limits);
        assert_eq!(decode(&mut &b"PK\x03\x04"[..], &request).expect_err("damaged").code(), "file_damaged");
    }

    #[test]
    fn x_of_the_profiles_and_y_of_the_columns_are_spread_over_z() {
        let z = || ("z.npy", array("(2, 2)", &floats(&[5.0, 6.0, 7.0, 8.0])));
        let whole = [
            ("x.npy", array("(2, 2)", &floats(&[1.0, 1.0, 2.0, 2.0]))),
            ("y.npy", array("(2, 2)", &floats(&[3.0, 4.0, 3.0, 4.0]))),
            z(),
        ];
        let expected = read(&whole).expect("whole");
        for (x, y) in [("(2,)", "(2,)"), ("(2, 1)", "(1, 2)")] {
            let spread = [("x.npy", array(x, &floats(&[1.0, 2.0]))), ("y.npy", array(y, &floats(&[3.0, 4.0]))), z()];
            assert_eq!(read(&spread).expect("spread"), expected);
        }
        let three = [("x.npy", array("(3,)", &floats(&[1.0; 3]))), ("y.npy", array("(2,)", &floats(&[1.0; 2]))), z()];
        assert_eq!(read(&three).expect_err("three of two").code(), "array_shape");
    }

    /// An archive of one stored array, and the offset of its bytes.
    fn stored() -> (Vec<u8>, usize) {
        let content = array("(2, 3)", &floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        zip.start_file("a.npy", options).expect("starts");
        zip.write_all(&content).expect("writes");
        let bytes = zip.finish().expect("ends").into_inner();
        let start = bytes.windows(6).position(|window| window == b"\x93NUMPY").expect("an array");
        (bytes, start)
    }

    #[test]
    fn an_entry_with_a_wrong_checksum_is_damaged() {
        let limits = Limits::default();
        let (mut bytes, start) = stored();
        assert!(decode(&mut bytes.as_slice(), &Request::new(&limits)).is_ok());
        let last = start + array("(2, 3)", &floats(&[0.0; 6])).len() - 1;
        bytes[last] ^= 1;
        assert_eq!(decode(&mut bytes.as_slice(), &Request::new(&limits)).expect_err("damaged").code(), "file_damaged");
    }

    #[test]
    fn entries_that_overlap_or_are_truncated_are_damaged() {
        let limits = Limits::default();
        let code = |bytes: &[u8]| decode(&mut &*bytes, &Request::new(&limits)).map(|_| ()).expect_err("damaged").code();
        let (bytes, _) = stored();
        assert_eq!(code(&bytes[..bytes.len() - 30]), "file_damaged");
        // The size of the packed bytes in directory and header, beyond the directory.
        let directory = bytes.windows(4).position(|window| window == b"PK\x01\x02").expect("a directory");
        let mut long = bytes;
        long[directory + 21] = 1;
        long[18 + 1] = 1;
        assert_eq!(code(&long), "file_damaged");
        // The same entry under two names.
        let mut twice = archive(&[("x.npy", vec![1; 40]), ("y.npy", vec![2; 40])]);
        let second = twice.windows(4).enumerate().filter(|(_, window)| *window == b"PK\x01\x02").nth(1).expect("two").0;
        twice[second + 42..second + 46].copy_from_slice(&[0; 4]);
        assert_eq!(code(&twice), "file_damaged");
    }

    #[test]
    fn every_other_compression_or_encryption_is_unsupported_and_named() {
        let (bytes, _) = stored();
        let limits = Limits::default();
        let directory = bytes.windows(4).position(|window| window == b"PK\x01\x02").expect("a directory");
        // Deflate64, bzip2, LZMA, Zstandard, xz, PPMd, AES.
        for method in [9, 12, 14, 93, 95, 98, 99] {
            let mut other = bytes.clone();
            (other[8], other[directory + 10]) = (method, method);
            let error = decode(&mut other.as_slice(), &Request::new(&limits)).expect_err("another method");
            assert_eq!(error.code(), "format_unsupported", "{method}: {error}");
        }
        let mut encrypted = bytes;
        encrypted[6] |= 1;
        encrypted[directory + 8] |= 1;
        let error = decode(&mut encrypted.as_slice(), &Request::new(&limits)).expect_err("encrypted");
        assert_eq!(error.code(), "format_unsupported", "{error}");
        assert!(error.to_string().contains("password"), "{error}");
    }
}
