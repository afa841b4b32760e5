//! NPY, one numpy array: (N, 3) points or (P, M, 3) profiles. From bytes to a cloud.
//!
//! The header is a Python literal with three keys in a fixed spelling, and is read here: the crate for this format
//! recurses into nested brackets and multiplies sizes unchecked, either of which a hostile header turns into an abort.

use super::gather::Gather;
use super::records::{Layout, Place, read_records};
use super::scalar::{Endian, Kind, Scalar};
use super::{DecodeError, Format, Request, ends_early, settle_unit};
use crate::scan::{Cloud, Labels};
use std::io::BufRead;

const FORMAT: Format = Format::Npy;
const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Bytes of a header; numpy itself asks for confirmation beyond this.
const HEADER_MAX: usize = 10_000;
/// Axes of an array; points have two or three.
const AXES_MAX: usize = 32;

/// What the header of an array says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ArrayHeader {
    pub(super) scalar: Scalar,
    pub(super) shape: Vec<u64>,
}

/// Reads an array of points.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let ArrayHeader { scalar, shape } = read_header(reader)?;
    let (count, row_length) = match *shape.as_slice() {
        [points, 3] => (Some(points), None),
        [profiles, points, 3] => (profiles.checked_mul(points), Some(points)),
        _ => return Err(DecodeError::ArrayShape { shape }),
    };
    let limit = request.limits.points_max;
    let within = |count: u64| usize::try_from(count).ok().filter(|count| *count <= limit);
    let count = count.and_then(within).ok_or(DecodeError::TooManyPoints { limit })?;
    // A row that is longer than all points would be one of no rows.
    let row_length = row_length.map(|length| within(length).unwrap_or(limit));

    let size = scalar.kind.size();
    let place = |position| Place { scalar, start: position * size, step: 3 * size };
    let layout = Layout { point: [place(0), place(1), place(2)], label: None, row_length };
    let unit = settle_unit(request.unit, None)?;
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    read_records(reader, &layout, 3 * size, count, &mut gather)?;
    gather.finish(if row_length.is_some() { Labels::Row } else { Labels::None })
}

/// Reads up to the first number of the array.
pub(super) fn read_header(reader: &mut dyn BufRead) -> Result<ArrayHeader, DecodeError> {
    let mut start = [0; 8];
    reader.read_exact(&mut start).map_err(|error| ends_early(error, FORMAT))?;
    let [.., major, _minor] = start;
    if !start.starts_with(MAGIC) {
        return Err(DecodeError::NotThisFormat { format: FORMAT });
    }
    let mut size = [0; 4];
    let size_bytes = size.get_mut(..if major == 1 { 2 } else { 4 }).unwrap_or_default();
    reader.read_exact(size_bytes).map_err(|error| ends_early(error, FORMAT))?;
    let size = usize::try_from(u32::from_le_bytes(size)).unwrap_or(usize::MAX);
    if size > HEADER_MAX {
        return Err(DecodeError::LineTooLong { line: 1, limit: HEADER_MAX });
    }
    let mut header = vec![0; size];
    reader.read_exact(&mut header).map_err(|error| ends_early(error, FORMAT))?;
    let header = String::from_utf8_lossy(&header);
    if value_of(&header, "fortran_order").is_some_and(|value| value.starts_with("True")) {
        let what = "arrays in Fortran order are not read; write numpy.ascontiguousarray(array)";
        return Err(DecodeError::Unsupported { format: FORMAT, what });
    }
    let bad = |field| DecodeError::HeaderLine { format: FORMAT, line: 1, field };
    let scalar = value_of(&header, "descr").and_then(scalar_of).ok_or(bad("descr (a plain integer or float type)"))?;
    let shape = value_of(&header, "shape").and_then(shape_of).ok_or(bad("shape"))?;
    Ok(ArrayHeader { scalar, shape })
}

/// The text that follows a key of the header.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, behind) = header.split_once(key)?;
    let behind = behind.strip_prefix(['\'', '"'])?;
    Some(behind.trim_start().strip_prefix(':')?.trim_start())
}

/// Reads `'<f4'` and the like.
fn scalar_of(value: &str) -> Option<Scalar> {
    let value = value.strip_prefix(['\'', '"'])?;
    let (value, _) = value.split_once(['\'', '"'])?;
    let endian = if value.starts_with('>') { Endian::Big } else { Endian::Little };
    let kind = match value.strip_prefix(['<', '>', '|', '='])? {
        "f4" => Kind::F32,
        "f8" => Kind::F64,
        "i1" => Kind::I8,
        "i2" => Kind::I16,
        "i4" => Kind::I32,
        "i8" => Kind::I64,
        "u1" => Kind::U8,
        "u2" => Kind::U16,
        "u4" => Kind::U32,
        "u8" => Kind::U64,
        _ => return None,
    };
    Some(Scalar { kind, endian })
}

/// Reads `(200, 400, 3)`, `(5,)`, `()`.
fn shape_of(value: &str) -> Option<Vec<u64>> {
    let (inside, _) = value.strip_prefix('(')?.split_once(')')?;
    let inside = inside.trim();
    let inside = inside.strip_suffix(',').unwrap_or(inside);
    if inside.is_empty() {
        return Some(Vec::new());
    }
    // Python 2 wrote long integers with an L.
    let axes = inside.split(',').map(|axis| axis.trim().trim_end_matches('L').parse().ok());
    let shape: Vec<u64> = axes.take(AXES_MAX + 1).collect::<Option<_>>()?;
    (shape.len() <= AXES_MAX).then_some(shape)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::Columns;
    use crate::scan::decode::Limits;

    fn array(header: &str, numbers: &[u8]) -> Vec<u8> {
        let mut bytes = [&MAGIC[..], &[1, 0]].concat();
        bytes.extend(u16::try_from(header.len()).expect("short").to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(numbers);
        bytes
    }

    fn read(header: &str, numbers: &[u8]) -> Result<Cloud, DecodeError> {
        let limits = Limits::default();
        decode(&mut array(header, numbers).as_slice(), &Request { unit: None, profile_column: None, limits: &limits })
    }

    #[test]
    fn every_number_type_and_byte_order_is_read() {
        let big: Vec<u8> = [1.5f32, 2.5, -3.0].iter().flat_map(|v| v.to_be_bytes()).collect();
        let cloud = read("{'descr': '>f4', 'fortran_order': False, 'shape': (1, 3), }", &big).expect("reads");
        assert_eq!((cloud.stripes[0].x, cloud.columns), (1.5, Columns::F32 { y: vec![2.5], z: vec![-3.0] }));
        let cloud = read("{'descr': '|i1', 'fortran_order': False, 'shape': (2, 1, 3), }\n", &[1, 2, 3, 4, 5, 0xff]);
        let cloud = cloud.expect("reads");
        assert_eq!(
            (cloud.labels, cloud.columns),
            (Labels::Row, Columns::F64 { y: vec![2.0, 5.0], z: vec![3.0, -1.0] })
        );
    }

    #[test]
    fn each_wrong_array_has_its_own_reason() {
        for (header, code) in [
            ("{'descr': '<f4', 'fortran_order': True, 'shape': (1, 3), }", "format_unsupported"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }", "array_shape"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }", "array_shape"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }", "file_truncated"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (0, 3), }", "no_points"),
            ("{'descr': '|O', 'fortran_order': False, 'shape': (1, 3), }", "header_invalid"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': ((((", "header_invalid"),
            ("{'descr': '<f4', 'shape': (9999999999999, 9999999999999, 3), }", "too_many_points"),
        ] {
            assert_eq!(read(header, &[0; 12]).expect_err("wrong").code(), code, "{header}");
        }
        let mut other: &[u8] = b"%PDF-1.7 and more";
        let limits = Limits::default();
        let error = decode(&mut other, &Request { unit: None, profile_column: None, limits: &limits });
        assert_eq!(error.expect_err("not numpy").code(), "format_mismatch");
    }
}
