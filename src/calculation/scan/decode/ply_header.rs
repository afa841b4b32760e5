//! The header of a PLY file: its encoding and its elements.

use super::error::DecodeError;
use super::format::Format;
use super::limits::Limits;
use super::lines::{Lines, text, words};
use super::names;
use super::scalar::{Endian, Kind};
use super::unit::Unit;

const FORMAT: Format = Format::Ply;
/// Elements of a file; those in use have two or three.
const ELEMENTS_MAX: usize = 32;

/// How the body is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Body {
    /// One record a line.
    Ascii,
    /// Records without anything between.
    Binary(Endian),
}

/// The type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PropertyType {
    /// One number.
    Scalar(Kind),
    /// A count, and as many numbers.
    List {
        /// The kind of the count.
        count: Kind,
        /// The kind of the numbers.
        item: Kind,
    },
}

/// A kind of record and how many there are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<(String, PropertyType)>,
}

impl Element {
    /// Bytes of a record; `None` where a list makes them vary.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum: usize, (_, kind)| match kind {
            PropertyType::Scalar(kind) => Some(sum + kind.size()),
            PropertyType::List { .. } => None,
        })
    }
}

/// A whole header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) body: Body,
    pub(super) elements: Vec<Element>,
    /// What a comment such as `Unit: mm` states.
    pub(super) unit: Option<Unit>,
}

/// Reads up to and with the line `end_header`.
pub(super) fn read_header(lines: &mut Lines<'_>, limits: &Limits) -> Result<Header, DecodeError> {
    if lines.next_line()?.is_none_or(|line| line.trim_ascii() != b"ply") {
        return Err(DecodeError::NotThisFormat { format: FORMAT });
    }
    let mut body = None;
    let mut header = Header { body: Body::Ascii, elements: Vec::new(), unit: None };
    for _ in 0..limits.header_lines_max {
        let number = lines.number() + 1;
        let bad = |field| DecodeError::HeaderLine { format: FORMAT, line: number, field };
        let Some(line) = lines.next_line()? else { return Err(DecodeError::EndsEarly { format: FORMAT }) };
        let mut parts = words(line);
        match parts.next().unwrap_or_default() {
            b"format" => body = Some(parts.next().and_then(body_of).ok_or(bad("format"))?),
            b"element" => {
                if header.elements.len() == ELEMENTS_MAX {
                    return Err(bad("element"));
                }
                header.elements.push(element_of(parts).ok_or(bad("element"))?);
            }
            b"property" => {
                let element = header.elements.last_mut().ok_or(bad("element"))?;
                if element.properties.len() == limits.columns_max {
                    return Err(DecodeError::TooManyColumns { limit: limits.columns_max });
                }
                element.properties.push(property_of(parts).ok_or(bad("property"))?);
            }
            keyword @ (b"comment" | b"obj_info") => {
                let comment = line.trim_ascii().get(keyword.len()..).unwrap_or_default();
                header.unit = header.unit.or(names::unit_of_comment(comment));
            }
            b"end_header" => {
                header.body = body.ok_or(DecodeError::HeaderMissing { format: FORMAT, field: "format" })?;
                return Ok(header);
            }
            b"" => {}
            _ => return Err(bad("format, element, property, comment or end_header")),
        }
    }
    Err(DecodeError::HeaderTooLong { format: FORMAT, limit: limits.header_lines_max })
}

fn body_of(word: &[u8]) -> Option<Body> {
    match word {
        b"ascii" => Some(Body::Ascii),
        b"binary_little_endian" => Some(Body::Binary(Endian::Little)),
        b"binary_big_endian" => Some(Body::Binary(Endian::Big)),
        _ => None,
    }
}

fn element_of<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Option<Element> {
    let name = text(words.next()?).to_owned();
    let count = text(words.next()?).parse().ok()?;
    Some(Element { name, count, properties: Vec::new() })
}

fn property_of<'a>(mut words: impl Iterator<Item = &'a [u8]>) -> Option<(String, PropertyType)> {
    let kind = match words.next()? {
        b"list" => PropertyType::List { count: kind_of(words.next()?)?, item: kind_of(words.next()?)? },
        word => PropertyType::Scalar(kind_of(word)?),
    };
    Some((text(words.next()?).to_owned(), kind))
}

fn kind_of(word: &[u8]) -> Option<Kind> {
    Some(match word {
        b"char" | b"int8" => Kind::I8,
        b"uchar" | b"uint8" => Kind::U8,
        b"short" | b"int16" => Kind::I16,
        b"ushort" | b"uint16" => Kind::U16,
        b"int" | b"int32" => Kind::I32,
        b"uint" | b"uint32" => Kind::U32,
        b"float" | b"float32" => Kind::F32,
        b"double" | b"float64" => Kind::F64,
        _ => return None,
    })
}
