//! NPZ, numpy arrays in a zip archive: x, y and z of equal shape, or one array as in NPY. From bytes to a cloud.
//!
//! What the archive's directory says about sizes is not believed; bytes are counted as they inflate.

use super::gather::Gather;
use super::inflate::Capped;
use super::npy::{self, ArrayHeader};
use super::scalar::{Kind, Scalar};
use super::{DecodeError, Limits, Precision, Request, settle_unit};
use crate::scan::{Cloud, Labels};
use std::io::{BufRead, BufReader, Cursor, Read};
use zip::ZipArchive;

/// An archive and its size.
struct Archive {
    zip: ZipArchive<Cursor<Vec<u8>>>,
    bytes: u64,
}

/// Reads an archive.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let limits = request.limits;
    let mut bytes = Vec::new();
    reader.take(limits.inflated_bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limits.inflated_bytes_max {
        return Err(DecodeError::InflatedTooLarge { limit: limits.inflated_bytes_max });
    }
    let size = bytes.len() as u64;
    let zip = ZipArchive::new(Cursor::new(bytes)).map_err(|_| DecodeError::DamagedArchive)?;
    if zip.len() > limits.npz_entries_max {
        return Err(DecodeError::TooManyEntries { found: zip.len(), limit: limits.npz_entries_max });
    }
    let mut archive = Archive { zip, bytes: size };
    let names =
        archive.zip.file_names().map(|name| name.map(|name| name.into_owned())).collect::<Result<Vec<String>, _>>();
    let names = names.map_err(|_| DecodeError::DamagedArchive)?;
    let has = |axis: &str| names.iter().any(|name| name == axis);
    if ["x.npy", "y.npy", "z.npy"].into_iter().all(has) {
        return read_axes(&mut archive, request);
    }
    match names.as_slice() {
        [only] => npy::decode(&mut open(&mut archive, only, limits)?, request),
        _ => {
            let found = names.iter().map(|name| name.chars().filter(|c| !c.is_control()).take(40).collect()).collect();
            Err(DecodeError::ArraysMissing { found })
        }
    }
}

/// One entry as it inflates, within the limits.
fn open<'a>(archive: &'a mut Archive, name: &str, limits: &Limits) -> Result<impl BufRead + 'a, DecodeError> {
    // The ratio is judged against the whole archive: x that repeats along a profile shrinks to almost nothing.
    let packed = archive.bytes;
    let entry = archive.zip.by_name(name).map_err(|_| DecodeError::DamagedArchive)?;
    Ok(BufReader::with_capacity(1 << 16, Capped::new(entry, limits, move |_: &_| packed)))
}

/// One axis of all points.
struct AxisArray {
    scalar: Scalar,
    shape: Vec<u64>,
    bytes: Vec<u8>,
}

fn read_axis(archive: &mut Archive, name: &str, limits: &Limits) -> Result<AxisArray, DecodeError> {
    let mut reader = open(archive, name, limits)?;
    let ArrayHeader { scalar, shape } = npy::read_header(&mut reader)?;
    let limit = limits.points_max;
    let count =
        shape.iter().try_fold(1u64, |count, axis| count.checked_mul(*axis)).filter(|count| *count <= limit as u64);
    let count = count.ok_or(DecodeError::TooManyPoints { limit })?;
    let size = scalar.kind.size() as u64;
    let mut bytes = Vec::new();
    reader.take(count * size).read_to_end(&mut bytes)?;
    if (bytes.len() as u64) < count * size {
        return Err(DecodeError::Truncated { expected: count, found: bytes.len() as u64 / size });
    }
    Ok(AxisArray { scalar, shape, bytes })
}

/// Reads x, y and z: (N) points or (P, M) profiles.
fn read_axes(archive: &mut Archive, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let x = read_axis(archive, "x.npy", request.limits)?;
    let y = read_axis(archive, "y.npy", request.limits)?;
    let z = read_axis(archive, "z.npy", request.limits)?;
    for other in [&y, &z] {
        if other.shape != x.shape {
            return Err(DecodeError::ArrayShape { shape: other.shape.clone() });
        }
    }
    let row_length = match *x.shape.as_slice() {
        [_] => None,
        [_, points] => Some(points.max(1)),
        _ => return Err(DecodeError::ArrayShape { shape: x.shape }),
    };
    let single = [&x, &y, &z].iter().all(|axis| axis.scalar.kind == Kind::F32);
    let precision = if single { Precision::Single } else { Precision::Double };
    let mut gather = Gather::new(settle_unit(request.unit, None)?, precision, request.limits);
    let at = |axis: &AxisArray, index: usize| axis.scalar.read(&axis.bytes, index * axis.scalar.kind.size());
    let mut index = 0;
    while let (Some(x), Some(y), Some(z)) = (at(&x, index), at(&y, index), at(&z, index)) {
        let label = row_length.map_or(0.0, |length| (index as u64 / length) as f64);
        gather.push(label, [x, y, z])?;
        index += 1;
    }
    gather.finish(if row_length.is_some() { Labels::Row } else { Labels::None })
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
        let request = Request { unit: None, profile_column: None, limits: &limits };
        decode(&mut archive(entries).as_slice(), &request)
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    #[test]
    fn three_arrays_or_one_are_read_and_others_beside_three_do_not_matter() {
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
        ] {
            assert_eq!(read(&entries).expect_err("wrong").code(), code);
        }
        let limits = Limits::default();
        let request = Request { unit: None, profile_column: None, limits: &limits };
        assert_eq!(decode(&mut &b"PK\x03\x04"[..], &request).expect_err("damaged").code(), "file_damaged");
    }
}
