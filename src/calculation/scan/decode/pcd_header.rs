//! The header of a PCD file: its fields, its size and how the points are stored.

use super::error::DecodeError;
use super::format::Format;
use super::limits::Limits;
use super::lines::{Lines, text, words};
use super::names;
use super::scalar::Kind;
use super::unit::Unit;

const FORMAT: Format = Format::Pcd;
/// Numbers of one field; more than any descriptor in use has.
const COUNT_MAX: usize = 4096;

/// How the points are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Body {
    /// One point a line.
    Ascii,
    /// Point after point.
    Binary,
    /// Field after field, LZF.
    Compressed,
}

/// One field of every point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    pub(super) name: String,
    /// The kind of its numbers.
    pub(super) kind: Kind,
    /// How many numbers it has.
    pub(super) count: usize,
}

impl Field {
    /// Bytes of the field in one point.
    pub(super) fn size(&self) -> usize {
        self.kind.size() * self.count
    }
}

/// A whole header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    /// Points of a row.
    pub(super) width: usize,
    /// Rows; 1 where the points are not organised.
    pub(super) height: usize,
    pub(super) body: Body,
    /// What a comment such as `unit: mm` states.
    pub(super) unit: Option<Unit>,
}

impl Header {
    /// All points, missing ones included.
    pub(super) fn points(&self) -> usize {
        self.width.saturating_mul(self.height)
    }

    /// Bytes of a point.
    pub(super) fn stride(&self) -> usize {
        self.fields.iter().map(Field::size).sum()
    }
}

/// What the lines say, before they are held against each other.
#[derive(Default)]
struct Statements {
    names: Vec<String>,
    sizes: Vec<usize>,
    types: Vec<u8>,
    counts: Vec<usize>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    unit: Option<Unit>,
}

/// Reads up to and with the line `DATA`.
pub(super) fn read_header(lines: &mut Lines<'_>, limits: &Limits) -> Result<Header, DecodeError> {
    let mut said = Statements::default();
    for _ in 0..limits.header_lines_max {
        let number = lines.number() + 1;
        let bad = |field| DecodeError::HeaderLine { format: FORMAT, line: number, field };
        let Some(line) = lines.next_line()? else { return Err(DecodeError::EndsEarly { format: FORMAT }) };
        if let Some(comment) = line.trim_ascii_start().strip_prefix(b"#") {
            said.unit = said.unit.or(names::unit_of_comment(comment));
            continue;
        }
        let mut parts = words(line);
        let keyword = parts.next().unwrap_or_default();
        let values: Vec<&[u8]> = parts.take(limits.columns_max + 1).collect();
        if values.len() > limits.columns_max {
            return Err(DecodeError::TooManyColumns { limit: limits.columns_max });
        }
        let first = values.first().copied().unwrap_or_default();
        match keyword {
            b"FIELDS" | b"COLUMNS" => said.names = values.iter().map(|word| text(word).to_owned()).collect(),
            b"SIZE" => said.sizes = numbers(&values).ok_or(bad("SIZE"))?,
            b"TYPE" => said.types = values.iter().filter_map(|word| word.first().copied()).collect(),
            b"COUNT" => said.counts = numbers(&values).ok_or(bad("COUNT"))?,
            b"WIDTH" => said.width = Some(text(first).parse().map_err(|_| bad("WIDTH"))?),
            b"HEIGHT" => said.height = Some(text(first).parse().map_err(|_| bad("HEIGHT"))?),
            b"POINTS" => said.points = Some(text(first).parse().map_err(|_| bad("POINTS"))?),
            b"DATA" => return said.check(body_of(first).ok_or(bad("DATA"))?, limits),
            b"VERSION" | b"VIEWPOINT" | b"" => {}
            _ if number == 1 => return Err(DecodeError::NotThisFormat { format: FORMAT }),
            _ => return Err(bad("FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, VIEWPOINT, POINTS or DATA")),
        }
    }
    Err(DecodeError::HeaderTooLong { format: FORMAT, limit: limits.header_lines_max })
}

fn body_of(word: &[u8]) -> Option<Body> {
    match word {
        b"ascii" => Some(Body::Ascii),
        b"binary" => Some(Body::Binary),
        b"binary_compressed" => Some(Body::Compressed),
        _ => None,
    }
}

fn numbers(words: &[&[u8]]) -> Option<Vec<usize>> {
    words.iter().map(|word| text(word).parse().ok()).collect()
}

impl Statements {
    /// Holds the lines against each other.
    fn check(self, body: Body, limits: &Limits) -> Result<Header, DecodeError> {
        let missing = |field| DecodeError::HeaderMissing { format: FORMAT, field };
        // Before version 0.7 a header states neither.
        let unorganised = self.points.filter(|_| self.width.is_none() && self.height.is_none());
        let width = self.width.or(unorganised).ok_or(missing("WIDTH"))?;
        let height = self.height.or(unorganised.map(|_| 1)).ok_or(missing("HEIGHT"))?;
        // The product may be beyond u64 where the header lies.
        let expected = width.saturating_mul(height);
        if let Some(stated) = self.points.filter(|stated| *stated != expected) {
            return Err(DecodeError::SizeMismatch { format: FORMAT, field: "POINTS", stated, expected });
        }
        let limit = limits.points_max;
        if usize::try_from(expected).is_ok_and(|points| points > limit) {
            return Err(DecodeError::TooManyPoints { limit });
        }
        let fields = self.fields()?;
        let size = |value| usize::try_from(value).map_err(|_| DecodeError::TooManyPoints { limit });
        Ok(Header { fields, width: size(width)?, height: size(height)?, body, unit: self.unit })
    }

    fn fields(&self) -> Result<Vec<Field>, DecodeError> {
        let missing = |field| DecodeError::HeaderMissing { format: FORMAT, field };
        if self.names.is_empty() {
            return Err(missing("FIELDS"));
        }
        let mut fields = Vec::with_capacity(self.names.len());
        for (position, name) in self.names.iter().enumerate() {
            let size = self.sizes.get(position).ok_or(missing("SIZE of every field"))?;
            let letter = self.types.get(position).ok_or(missing("TYPE of every field"))?;
            // COUNT may be left out, and is 1 then.
            let count = if self.counts.is_empty() { Some(1) } else { self.counts.get(position).copied() };
            let count = count.filter(|count| *count <= COUNT_MAX).ok_or(missing("COUNT of every field"))?;
            let kind = kind_of(*letter, *size).ok_or(missing("a known TYPE and SIZE of every field"))?;
            fields.push(Field { name: name.clone(), kind, count });
        }
        Ok(fields)
    }
}

fn kind_of(letter: u8, size: usize) -> Option<Kind> {
    Some(match (letter, size) {
        (b'F', 4) => Kind::F32,
        (b'F', 8) => Kind::F64,
        (b'I', 1) => Kind::I8,
        (b'I', 2) => Kind::I16,
        (b'I', 4) => Kind::I32,
        (b'I', 8) => Kind::I64,
        (b'U', 1) => Kind::U8,
        (b'U', 2) => Kind::U16,
        (b'U', 4) => Kind::U32,
        (b'U', 8) => Kind::U64,
        _ => return None,
    })
}
