//! The header of a numpy array: the type of its elements, the order of its axes and its shape.
//!
//! The header is a Python literal with three keys in a fixed spelling, and is read here: the crate for this format
//! recurses into nested brackets and multiplies sizes unchecked, either of which a hostile header turns into an abort.

use super::ends_early;
use super::error::DecodeError;
use super::format::Format;
use super::scalar::{Endian, Kind, Scalar};
use std::io::Read;

const FORMAT: Format = Format::Npy;
pub(super) const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Bytes of a header; numpy itself asks for confirmation beyond this.
const HEADER_MAX: usize = 10_000;
/// Axes of an array; points have two or three.
const AXES_MAX: usize = 32;
/// Bytes of one field; more than any that stands beside coordinates has.
const FIELD_BYTES_MAX: usize = 1 << 16;

/// A field of a structured array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: String,
    /// `None` where it is no single number.
    pub(super) scalar: Option<Scalar>,
    pub(super) start: usize,
}

/// What an array consists of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Element {
    /// Numbers.
    Plain(Scalar),
    /// Records of fields, of so many bytes each.
    Record(Vec<Field>, usize),
}

/// What the header of an array says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ArrayHeader {
    pub(super) element: Element,
    /// Whether the first axis varies fastest, and not the last.
    pub(super) is_fortran: bool,
    pub(super) shape: Vec<u64>,
}

impl ArrayHeader {
    /// The kind of its numbers.
    ///
    /// # Errors
    /// [`DecodeError::Unsupported`] where it has fields.
    pub(super) fn scalar(&self) -> Result<Scalar, DecodeError> {
        match self.element {
            Element::Plain(scalar) => Ok(scalar),
            Element::Record(..) => {
                let what = "an array with fields is read alone, not as one of x, y, z; save one array";
                Err(DecodeError::Unsupported { format: FORMAT, what })
            }
        }
    }

    /// Elements of the array, where they are not more than `limit`.
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

/// A quoted text at the start, and what follows it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text.get(1..)?.split_once(quote)
}

/// Reads `('x', '<f8'), ('tag', '|S4'), ('rgb', '<u1', (3,))]` behind its opening bracket.
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

/// Bytes of a type as numpy spells it: a letter and a size, in characters of four bytes where the letter is U.
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
