//! NPY, one numpy array: (N, 3) points, (P, M, 3) profiles, records with fields x, y, z, or a matrix (P, M) of heights with
//! declared pitches; in either order of the axes.
//!
//! The header is a Python literal with three keys in a fixed spelling, and is parsed here: the crate for this format recurses into
//! nested brackets and multiplies sizes unchecked, and a hostile header can use either to cause an abort.

use super::error::{DecodeError, ends_early};
use super::format::Format;
use super::gather::{Gather, Precision};
use super::matrix::Matrix;
use super::names;
use super::records::{Endian, Kind, Layout, Place, Scalar, read_records};
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels};
use std::io::{BufRead, Read};

const FORMAT: Format = Format::Npy;

/// Reads an array of points.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let header = read_header(&mut *reader)?;
    match &header.element {
        Element::Record(fields, stride) => decode_records(reader, &header, fields, *stride, request),
        Element::Plain(scalar) => decode_numbers(reader, &header, *scalar, request),
    }
}

fn decode_numbers(
    reader: &mut dyn BufRead,
    header: &ArrayHeader,
    scalar: Scalar,
    request: &Request<'_>,
) -> Result<Cloud, DecodeError> {
    let (count, row_length) = match *header.shape.as_slice() {
        [_, columns] if request.grid.is_declared() || columns > 3 => return decode_matrix(reader, header, request),
        [points, 3] => (Some(points), None),
        [profiles, points, 3] => (profiles.checked_mul(points), Some(points)),
        _ => return Err(DecodeError::ArrayShape { shape: header.shape.clone() }),
    };
    request.grid.check_unused(FORMAT)?;
    let limit = request.limits.points_max;
    let within = |count: u64| usize::try_from(count).ok().filter(|count| *count <= limit);
    let count = count.and_then(within).ok_or(DecodeError::TooManyPoints { limit })?;
    // A row longer than all points means an array without rows.
    let row_length = row_length.map(|length| within(length).unwrap_or(limit));
    let labels = if row_length.is_some() { Labels::Row } else { Labels::None };
    let unit = settle_unit(request.unit, None)?;
    let size = scalar.kind.size();
    let place = |position| Place { scalar, start: position * size, step: 3 * size };
    let layout = Layout { point: [place(0), place(1), place(2)], label: None, row_length };
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    if header.is_fortran {
        let array = Array::read(reader, header, limit.saturating_mul(3))?;
        for index in 0..count {
            let row = row_length.map_or(0, |length| index / length.max(1));
            let point = [0, 1, 2].map(|axis| match row_length {
                None => array.at(&[index, axis]),
                Some(length) => array.at(&[row, index % length.max(1), axis]),
            });
            let [Some(x), Some(y), Some(z)] = point else { break };
            gather.push(row as f64, [x, y, z])?;
        }
    } else {
        read_records(reader, &layout, 3 * size, count, &mut gather)?;
    }
    gather.finish(labels)
}

/// Reads an array of records whose fields are named like the columns of a table.
fn decode_records(
    reader: &mut dyn BufRead,
    header: &ArrayHeader,
    fields: &[Field],
    stride: usize,
    request: &Request<'_>,
) -> Result<Cloud, DecodeError> {
    request.grid.check_unused(FORMAT)?;
    let row_length = match *header.shape.as_slice() {
        [_] => None,
        [_, points] if !header.is_fortran => Some(usize::try_from(points).unwrap_or(request.limits.points_max)),
        _ => return Err(DecodeError::ArrayShape { shape: header.shape.clone() }),
    };
    let count = header.count(request.limits.points_max)?;
    let names: Vec<String> = fields.iter().map(|field| field.name.clone()).collect();
    let map = names::map_columns(&names, request)?;
    let place = |position: usize| {
        let field = fields.get(position).and_then(|field| Some((field.scalar?, field.start)));
        let (scalar, start) =
            field.ok_or(DecodeError::HeaderMissing { format: FORMAT, field: "a number type of x, y, z" })?;
        Ok::<_, DecodeError>(Place { scalar, start, step: stride })
    };
    let [x, y, z] = map.point;
    let label = map.label.as_ref().map(|(position, _)| place(*position)).transpose()?;
    let layout = Layout { point: [place(x)?, place(y)?, place(z)?], label, row_length };
    let unit = settle_unit(request.unit, map.unit)?;
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    read_records(reader, &layout, stride, count, &mut gather)?;
    gather.finish(match (map.label, row_length) {
        (Some((_, name)), _) => Labels::Column(name),
        (None, Some(_)) => Labels::Row,
        (None, None) => Labels::None,
    })
}

fn decode_matrix(reader: &mut dyn BufRead, header: &ArrayHeader, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let array = Array::read(reader, header, request.limits.points_max)?;
    let [rows, columns] = *array.shape.as_slice() else {
        return Err(DecodeError::ArrayShape { shape: header.shape.clone() });
    };
    let cell = |index: usize| array.at(&[index / columns.max(1), index % columns.max(1)]);
    let cells = (0..rows.saturating_mul(columns)).map_while(cell).collect();
    Matrix { format: FORMAT, columns, cells, unit: None }.into_cloud(request)
}

/// A complete array of numbers.
pub(super) struct Array {
    pub(super) scalar: Scalar,
    pub(super) shape: Vec<usize>,
    is_fortran: bool,
    bytes: Vec<u8>,
}

impl Array {
    /// Reads the array that the header announces, at most `count_max` numbers.
    pub(super) fn read(reader: &mut dyn Read, header: &ArrayHeader, count_max: usize) -> Result<Self, DecodeError> {
        let scalar = header.scalar()?;
        let (count, size) = (header.count(count_max)? as u64, scalar.kind.size() as u64);
        let mut bytes = Vec::new();
        reader.take(count.saturating_mul(size)).read_to_end(&mut bytes)?;
        let found = bytes.len() as u64 / size;
        if found < count {
            return Err(DecodeError::Truncated { expected: count, found });
        }
        let shape = header.shape.iter().map(|axis| usize::try_from(*axis).unwrap_or(usize::MAX)).collect();
        Ok(Self { scalar, shape, is_fortran: header.is_fortran, bytes })
    }

    /// The number at a position, one index an axis.
    pub(super) fn at(&self, position: &[usize]) -> Option<f64> {
        let step = |index: usize, (axis, length): (&usize, &usize)| {
            index.checked_mul(*length)?.checked_add(*axis).filter(|_| axis < length)
        };
        let mut axes = position.iter().zip(&self.shape);
        // The axis that varies fastest comes last.
        let index = if self.is_fortran { axes.rev().try_fold(0, step)? } else { axes.try_fold(0, step)? };
        self.scalar.read(&self.bytes, index.checked_mul(self.scalar.kind.size())?)
    }
}

/// The common precision of arrays of these kinds.
pub(super) fn precision_of(arrays: &[&Array]) -> Precision {
    let is_single = arrays.iter().all(|array| array.scalar.kind == Kind::F32);
    if is_single { Precision::Single } else { Precision::Double }
}

pub(super) const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Largest number of bytes of a header; numpy itself asks for confirmation beyond this.
const HEADER_MAX: usize = 10_000;
/// Largest number of axes of an array; points have two or three.
const AXES_MAX: usize = 32;
/// Largest number of bytes of one field, more than any usual attribute of a point has.
const FIELD_BYTES_MAX: usize = 1 << 16;

/// A field of a structured array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: String,
    /// `None` if it is not a single number.
    pub(super) scalar: Option<Scalar>,
    pub(super) start: usize,
}

/// The elements of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Element {
    /// Numbers.
    Plain(Scalar),
    /// Records of fields, with their size in bytes.
    Record(Vec<Field>, usize),
}

/// The header of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ArrayHeader {
    pub(super) element: Element,
    /// Whether the first axis varies fastest instead of the last.
    pub(super) is_fortran: bool,
    pub(super) shape: Vec<u64>,
}

impl ArrayHeader {
    /// The kind of its numbers.
    ///
    /// # Errors
    /// [`DecodeError::Unsupported`] if it has fields.
    pub(super) fn scalar(&self) -> Result<Scalar, DecodeError> {
        match self.element {
            Element::Plain(scalar) => Ok(scalar),
            Element::Record(..) => {
                let what = "an array with fields is read alone, not as one of x, y, z; save one array";
                Err(DecodeError::Unsupported { format: FORMAT, what })
            }
        }
    }

    /// Number of elements of the array, if it is not larger than `limit`.
    pub(super) fn count(&self, limit: usize) -> Result<usize, DecodeError> {
        let count = self.shape.iter().try_fold(1u64, |count, axis| count.checked_mul(*axis));
        let count = count.and_then(|count| usize::try_from(count).ok()).filter(|count| *count <= limit);
        count.ok_or(DecodeError::TooManyPoints { limit })
    }
}

/// Reads up to the first element of the array.
pub(super) fn read_header(reader: &mut dyn Read) -> Result<ArrayHeader, DecodeError> {
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
    let is_fortran = value_of(&header, "fortran_order").is_some_and(|value| value.starts_with("True"));
    let bad = |field| DecodeError::HeaderLine { format: FORMAT, line: 1, field };
    let descr = value_of(&header, "descr").ok_or(bad("descr"))?;
    let element = match descr.strip_prefix('[') {
        Some(fields) => record_of(fields)?,
        None => Element::Plain(scalar_of(descr).ok_or(bad("descr (an integer or float type, or fields of such)"))?),
    };
    let shape = value_of(&header, "shape").and_then(shape_of).ok_or(bad("shape"))?;
    Ok(ArrayHeader { element, is_fortran, shape })
}

/// The text that follows a key of the header.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, behind) = header.split_once(key)?;
    let behind = behind.strip_prefix(['\'', '"'])?;
    Some(behind.trim_start().strip_prefix(':')?.trim_start())
}

/// Reads `'<f4'` and the like.
fn scalar_of(value: &str) -> Option<Scalar> {
    let (kind, _) = quoted(value)?;
    let endian = if kind.starts_with('>') { Endian::Big } else { Endian::Little };
    let kind = match kind.trim_start_matches(['<', '>', '|', '=']) {
        "f2" => Kind::F16,
        "f4" => Kind::F32,
        "f8" => Kind::F64,
        "i1" => Kind::I8,
        "i2" => Kind::I16,
        "i4" => Kind::I32,
        "i8" => Kind::I64,
        "u1" | "b1" => Kind::U8,
        "u2" => Kind::U16,
        "u4" => Kind::U32,
        "u8" => Kind::U64,
        _ => return None,
    };
    Some(Scalar { kind, endian })
}

/// A quoted text at the start, and the text after it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text.get(1..)?.split_once(quote)
}

/// Parses `('x', '<f8'), ('tag', '|S4'), ('rgb', '<u1', (3,))]` after its opening bracket.
fn record_of(text: &str) -> Result<Element, DecodeError> {
    let bad = DecodeError::HeaderLine { format: FORMAT, line: 1, field: "descr (fields of names and types)" };
    read_fields(text).map(|(fields, size)| Element::Record(fields, size)).ok_or(bad)
}

fn read_fields(text: &str) -> Option<(Vec<Field>, usize)> {
    let (mut fields, mut end, mut rest) = (Vec::new(), 0_usize, text.trim_start());
    while let Some(field) = rest.strip_prefix('(') {
        let (name, behind) = quoted(field.trim_start())?;
        let kind = behind.trim_start().strip_prefix(',')?.trim_start();
        let (spelled, behind) = quoted(kind)?;
        let behind = behind.trim_start();
        // A third entry is the shape of an array within the record.
        let (count, behind) = match behind.strip_prefix(',').map(str::trim_start) {
            Some(shape) if shape.starts_with('(') => {
                let count =
                    shape_of(shape)?.iter().try_fold(1_usize, |n, axis| n.checked_mul(usize::try_from(*axis).ok()?))?;
                (Some(count), shape.split_once(')')?.1.trim_start())
            }
            Some(behind) => (None, behind),
            None => (None, behind),
        };
        let size = size_of(spelled)?.checked_mul(count.unwrap_or(1)).filter(|size| *size <= FIELD_BYTES_MAX)?;
        let scalar = scalar_of(kind).filter(|_| count.is_none());
        fields.push(Field { name: name.to_owned(), scalar, start: end });
        end = end.checked_add(size)?;
        rest = behind.strip_prefix(')')?.trim_start();
        rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
    }
    (rest.starts_with(']') && !fields.is_empty() && end > 0).then_some((fields, end))
}

/// Size in bytes of a type in numpy's spelling: a letter and a size, in characters of four bytes if the letter is U.
fn size_of(spelled: &str) -> Option<usize> {
    let kind = spelled.trim_start_matches(['<', '>', '|', '=']);
    let (letter, size) = kind.split_at_checked(1)?;
    let size: usize = size.split('[').next()?.parse().ok()?;
    size.checked_mul(if letter == "U" { 4 } else { 1 })
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
    use super::MAGIC;
    use super::*;
    use crate::scan::Columns;
    use crate::scan::decode::{Grid, Limits};

    fn array(header: &str, numbers: &[u8]) -> Vec<u8> {
        let mut bytes = [&MAGIC[..], &[1, 0]].concat();
        bytes.extend(u16::try_from(header.len()).expect("short").to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(numbers);
        bytes
    }

    fn read(header: &str, numbers: &[u8]) -> Result<Cloud, DecodeError> {
        let limits = Limits::default();
        decode(&mut array(header, numbers).as_slice(), &Request::new(&limits))
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
    fn the_order_of_the_axes_does_not_matter() {
        let (c, f) = ([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12], [1, 7, 4, 10, 2, 8, 5, 11, 3, 9, 6, 12]);
        let [c, f] = [("False", c), ("True", f)].map(|(order, numbers)| {
            read(&format!("{{'descr': '|i1', 'fortran_order': {order}, 'shape': (2, 2, 3), }}"), &numbers)
                .expect("reads")
        });
        assert_eq!((c.labels.clone(), c.stripes.len()), (Labels::Row, 4));
        assert_eq!(c, f);
        let flat =
            read("{'descr': '|i1', 'fortran_order': True, 'shape': (2, 3), }", &[1, 4, 2, 5, 3, 6]).expect("reads");
        assert_eq!(flat.points().collect::<Vec<_>>(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    }

    #[test]
    fn records_are_read_by_the_names_of_their_fields() {
        let header = "{'descr': [('z', '<i2'), ('profile', '|u1'), ('y', '|i1'), ('x', '|i1')], 'shape': (2,), }";
        let cloud = read(header, &[3, 0, 7, 2, 1, 6, 0, 8, 5, 4]).expect("reads");
        assert_eq!(cloud.points().collect::<Vec<_>>(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(cloud.labels, Labels::Column("profile".to_owned()));
    }

    #[test]
    fn a_matrix_is_read_with_its_pitches_and_points_with_pitches_are_refused() {
        let limits = Limits::default();
        let grid = Grid { x_pitch_mm: Some(5.0), y_pitch_mm: Some(0.5), columns_are_profiles: false };
        let request = Request { grid, ..Request::new(&limits) };
        let bytes = array("{'descr': '|i1', 'fortran_order': True, 'shape': (2, 4), }", &[1, 5, 2, 6, 3, 7, 4, 8]);
        let cloud = decode(&mut bytes.as_slice(), &request).expect("reads");
        assert_eq!((cloud.labels.clone(), cloud.stripes.len()), (Labels::Row, 2));
        assert_eq!(cloud.points().last(), Some([5.0, 1.5, 8.0]));
        let points = array("{'descr': '|i1', 'fortran_order': False, 'shape': (1, 1, 3), }", &[1, 2, 3]);
        assert_eq!(decode(&mut points.as_slice(), &request).expect_err("points").code(), "pitch_unused");
    }

    #[test]
    fn each_wrong_array_has_its_own_reason() {
        for (header, code) in [
            ("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }", "file_truncated"),
            ("{'descr': [('x', '<f4'), ('y', '<f4')], 'shape': (1,), }", "column_unknown"),
            ("{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '|S4')], 'shape': (1,), }", "header_invalid"),
            ("{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '<f4')], 'shape': (2,), }", "file_truncated"),
            ("{'descr': '<i1', 'fortran_order': False, 'shape': (2, 6), }", "pitch_needed"),
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
        let error = decode(&mut other, &Request::new(&limits));
        assert_eq!(error.expect_err("not numpy").code(), "format_mismatch");
    }
}

#[cfg(test)]
mod npy_header_tests {
    use super::*;

    #[test]
    fn fields_are_found_among_others_of_any_size() {
        let text = "('t', '<i8'), ('x', '<f4'), ('name', '<U3'), ('rgb', '|u1', (3,)), ('y', '>f8'), ('', '|V2'), ('z', '<f2')]";
        let Ok(Element::Record(fields, size)) = record_of(text) else { panic!("fields") };
        let starts: Vec<(&str, usize, bool)> =
            fields.iter().map(|field| (field.name.as_str(), field.start, field.scalar.is_some())).collect();
        let expected = [
            ("t", 0, true),
            ("x", 8, true),
            ("name", 12, false),
            ("rgb", 24, false),
            ("y", 27, true),
            ("", 35, false),
            ("z", 37, true),
        ];
        assert_eq!((starts.as_slice(), size), (&expected[..], 39));
        for text in ["]", "('x', '<f8')", "('x', [('a', '<f8')])]", "('x', '<f8', (99999999999, 99999999999))]", "('x'"]
        {
            assert!(record_of(text).is_err(), "{text}");
        }
    }
}
