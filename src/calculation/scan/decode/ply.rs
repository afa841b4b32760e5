//! PLY, text and binary of either byte order: the vertices; other elements before them are skipped.
//!
//! The reader is our own: the crate that is safe on hostile input parses element by element and property by property, which takes
//! far longer than the few passes over memory that are acceptable for a scan of millions of points.

use super::error::{DecodeError, ends_early};
use super::format::Format;
use super::gather::Gather;
use super::hints::shorten;
use super::limits::Limits;
use super::lines::{Lines, text, words};
use super::names::{self, ColumnMap};
use super::number::Numbers;
use super::records::{Endian, Kind, Layout, Place, Scalar, read_records};
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels, Unit};
use std::io::BufRead;

const FORMAT: Format = Format::Ply;

/// Reads the vertices of a PLY file.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::of_header(reader, request.limits)?;
    let header = read_header(&mut lines, request.limits)?;
    let at = header.elements.iter().position(|element| element.name == "vertex");
    let at = at.ok_or(DecodeError::HeaderMissing { format: FORMAT, field: "element vertex" })?;
    let (before, rest) = header.elements.split_at(at);
    let vertex = rest.first().ok_or(DecodeError::HeaderMissing { format: FORMAT, field: "element vertex" })?;

    let limit = request.limits.points_max;
    let count = usize::try_from(vertex.count).ok().filter(|count| *count <= limit);
    let count = count.ok_or(DecodeError::TooManyPoints { limit })?;
    let names: Vec<String> = vertex.properties.iter().map(|(name, _)| name.clone()).collect();
    let map = names::map_columns(&names, request)?;
    let stated = names::settle_stated(map.unit, header.unit)?;
    let unit = settle_unit(request.unit, stated)?;
    let layout = lay_out(vertex, &map, Endian::Little)?;
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    let has_lists = vertex.stride().is_none();
    match header.body {
        Body::Ascii => {
            skip_lines(&mut lines, before)?;
            let mut numbers = Numbers::new(request.decimal);
            read_lines(&mut lines, vertex, &map, &mut numbers, &mut gather)?;
            numbers.finish()?;
        }
        Body::Binary(endian) => {
            let reader = lines.into_reader();
            before.iter().try_for_each(|element| skip_records(reader, element, endian))?;
            if has_lists {
                read_records_with_lists(reader, vertex, &map, endian, &mut gather)?;
            } else {
                let stride = vertex.stride().unwrap_or_default();
                read_records(reader, &lay_out(vertex, &map, endian)?, stride, count, &mut gather)?;
            }
        }
    }
    gather.finish(match map.label {
        Some((_, name)) => Labels::Column(name),
        None => Labels::None,
    })
}

/// Positions of the coordinates in a vertex.
fn lay_out(vertex: &Element, map: &ColumnMap, endian: Endian) -> Result<Layout, DecodeError> {
    // With lists, the positions within a record determine only the types of the numbers.
    let step = vertex.stride().unwrap_or_default();
    let place = |position: usize| {
        let start = vertex.properties.iter().take(position).fold(0, |sum, (_, kind)| sum + size_of(*kind));
        let kind = vertex.properties.get(position).map(|(_, kind)| *kind);
        let Some(PropertyType::Scalar(kind)) = kind else {
            return Err(DecodeError::HeaderMissing { format: FORMAT, field: "property x, y or z" });
        };
        Ok(Place { scalar: Scalar { kind, endian }, start, step })
    };
    let [x, y, z] = map.point;
    let label = map.label.as_ref().map(|(position, _)| place(*position)).transpose()?;
    Ok(Layout { point: [place(x)?, place(y)?, place(z)?], label, row_length: None })
}

fn size_of(kind: PropertyType) -> usize {
    match kind {
        PropertyType::Scalar(kind) => kind.size(),
        PropertyType::List { .. } => 0,
    }
}

/// Skips the lines of elements before the vertices.
fn skip_lines(lines: &mut Lines<'_>, elements: &[Element]) -> Result<(), DecodeError> {
    for element in elements {
        for _ in 0..element.count {
            if lines.next_line()?.is_none() {
                return Err(DecodeError::EndsEarly { format: FORMAT });
            }
        }
    }
    Ok(())
}

fn read_lines(
    lines: &mut Lines<'_>,
    vertex: &Element,
    map: &ColumnMap,
    numbers: &mut Numbers,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    let mut done = 0;
    let mut places = Vec::new();
    while done < vertex.count {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else {
            return Err(DecodeError::Truncated { expected: vertex.count, found: done });
        };
        if line.trim_ascii().is_empty() {
            continue;
        }
        let ragged = |expected: usize| {
            let found = words(line).count();
            DecodeError::RaggedRow { line: number, expected, found, text: shorten(line) }
        };
        place_properties(line, vertex, &mut places).ok_or_else(|| ragged(vertex.properties.len()))?;
        let mut cell = |property: usize| {
            let column = places.get(property).copied().unwrap_or(property);
            numbers.read(words(line).nth(column).ok_or_else(|| ragged(map.end()))?, number, column)
        };
        let [x, y, z] = map.point;
        let label = map.label.as_ref().map_or(Ok(0.0), |(property, _)| cell(*property))?;
        gather.push(label, [cell(x)?, cell(y)?, cell(z)?])?;
        done += 1;
    }
    Ok(())
}

/// The word at which each property of a line begins; empty without lists. `None` if a list has no length.
fn place_properties(line: &[u8], vertex: &Element, places: &mut Vec<usize>) -> Option<()> {
    places.clear();
    if vertex.stride().is_some() {
        return Some(());
    }
    let mut at = 0_usize;
    for (_, kind) in &vertex.properties {
        places.push(at);
        at += 1;
        if let PropertyType::List { .. } = kind {
            let items: usize = text(words(line).nth(at - 1)?).parse().ok()?;
            at = at.checked_add(items)?;
        }
    }
    Some(())
}

/// Reads vertices of varying length, property by property.
fn read_records_with_lists(
    reader: &mut dyn BufRead,
    vertex: &Element,
    map: &ColumnMap,
    endian: Endian,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    let label_at = map.label.as_ref().map(|(property, _)| *property);
    for done in 0..vertex.count {
        let (mut point, mut label) = ([f64::NAN; 3], 0.0);
        for (property, (_, kind)) in vertex.properties.iter().enumerate() {
            let value = read_property(reader, *kind, endian).map_err(|error| match error {
                DecodeError::EndsEarly { .. } => DecodeError::Truncated { expected: vertex.count, found: done },
                error => error,
            })?;
            for (coordinate, at) in point.iter_mut().zip(map.point) {
                if at == property {
                    *coordinate = value;
                }
            }
            if label_at == Some(property) {
                label = value;
            }
        }
        gather.push(label, point)?;
    }
    Ok(())
}

/// Reads a number, or skips a list, which has no value.
fn read_property(reader: &mut dyn BufRead, kind: PropertyType, endian: Endian) -> Result<f64, DecodeError> {
    match kind {
        PropertyType::Scalar(kind) => read_scalar(reader, Scalar { kind, endian }),
        PropertyType::List { count, item } => {
            let items = read_scalar(reader, Scalar { kind: count, endian })?;
            if items.is_nan() || items < 0.0 {
                return Err(DecodeError::EndsEarly { format: FORMAT });
            }
            skip(reader, (items as u64).saturating_mul(item.size() as u64))?;
            Ok(f64::NAN)
        }
    }
}

fn read_scalar(reader: &mut dyn BufRead, scalar: Scalar) -> Result<f64, DecodeError> {
    let mut bytes = [0; 8];
    let stored = bytes.get_mut(..scalar.kind.size()).unwrap_or_default();
    reader.read_exact(stored).map_err(|error| ends_early(error, FORMAT))?;
    scalar.read(&bytes, 0).ok_or(DecodeError::EndsEarly { format: FORMAT })
}

/// Skips the records of an element before the vertices.
fn skip_records(reader: &mut dyn BufRead, element: &Element, endian: Endian) -> Result<(), DecodeError> {
    if let Some(stride) = element.stride() {
        return skip(reader, element.count.saturating_mul(stride as u64));
    }
    for _ in 0..element.count {
        for (_, kind) in &element.properties {
            read_property(reader, *kind, endian)?;
        }
    }
    Ok(())
}

fn skip(reader: &mut dyn BufRead, bytes: u64) -> Result<(), DecodeError> {
    let mut left = bytes;
    while left > 0 {
        let there = reader.fill_buf()?.len();
        if there == 0 {
            return Err(DecodeError::EndsEarly { format: FORMAT });
        }
        let used = usize::try_from(left).unwrap_or(usize::MAX).min(there);
        reader.consume(used);
        left -= used as u64;
    }
    Ok(())
}

/// Largest number of elements of a file; usual files have two or three.
const ELEMENTS_MAX: usize = 32;

/// The encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Body {
    /// One record a line.
    Ascii,
    /// Consecutive binary records.
    Binary(Endian),
}

/// The type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PropertyType {
    /// One number.
    Scalar(Kind),
    /// A count, followed by that many numbers.
    List {
        /// The kind of the count.
        count: Kind,
        /// The kind of the numbers.
        item: Kind,
    },
}

/// A kind of record and the number of its records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<(String, PropertyType)>,
}

impl Element {
    /// Size of a record in bytes; `None` if it varies because of a list.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum: usize, (_, kind)| match kind {
            PropertyType::Scalar(kind) => Some(sum + kind.size()),
            PropertyType::List { .. } => None,
        })
    }
}

/// A complete header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) body: Body,
    pub(super) elements: Vec<Element>,
    /// The unit from a comment such as `Unit: mm`.
    pub(super) unit: Option<Unit>,
}

/// Reads up to and including the line `end_header`.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Limits, Unit};
    use crate::scan::{Columns, Stripe};

    fn read(bytes: &[u8]) -> Result<Cloud, DecodeError> {
        let limits = Limits { points_max: 1000, ..Limits::default() };
        decode(&mut &*bytes, &Request::new(&limits))
    }

    /// Two vertices with y, a colour, x (double), z and a label, after an element with a list.
    fn file(encoding: &str, body: &[u8]) -> Vec<u8> {
        let header = format!(
            "ply\r\nformat {encoding} 1.0\ncomment made by hand\nelement face 2\nproperty list uchar ushort corners\n\
             property char kind\nelement vertex 2\nproperty float y\nproperty uchar red\nproperty double x\n\
             property int z\nproperty short frame\nelement edge 1\nproperty int a\nend_header\n"
        );
        [header.as_bytes(), body].concat()
    }

    fn binary(order: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
        let mut body = [&[2][..], &order(&7u16.to_le_bytes()), &order(&8u16.to_le_bytes()), &[1, 0, 1]].concat();
        for (y, x, z, frame) in [(1.5f32, 0.1f64, -3i32, 4i16), (2.5, 0.1, 9, 5)] {
            body.extend(order(&y.to_le_bytes()));
            body.push(200);
            body.extend(order(&x.to_le_bytes()));
            body.extend(order(&z.to_le_bytes()));
            body.extend(order(&frame.to_le_bytes()));
        }
        body
    }

    #[test]
    fn every_encoding_gives_the_same_points_with_other_elements_present() {
        let little = file("binary_little_endian", &binary(<[u8]>::to_vec));
        let big = file("binary_big_endian", &binary(|bytes| bytes.iter().rev().copied().collect()));
        let ascii = file("ascii", b"2 7 8 1\n0 1\n1.5 200 0.1 -3 4\n2.5 200 0.1 9 5\n1\n");
        for bytes in [little, big, ascii] {
            let cloud = read(&bytes).expect("reads");
            let stripes = [Stripe { label: 4.0, x: 0.1, end: 1 }, Stripe { label: 5.0, x: 0.1, end: 2 }];
            assert_eq!((&*cloud.stripes, cloud.labels), (&stripes[..], Labels::Column("frame".to_owned())));
            assert_eq!(cloud.columns, Columns::F64 { y: vec![1.5, 2.5], z: vec![-3.0, 9.0] });
        }
    }

    #[test]
    fn a_reader_that_gives_a_few_bytes_at_a_time_gives_the_same_cloud() {
        let bytes = file("binary_little_endian", &binary(<[u8]>::to_vec));
        let limits = Limits::default();
        let request = Request { unit: Some(Unit::Inch), ..Request::new(&limits) };
        let whole = decode(&mut bytes.as_slice(), &request).expect("reads");
        let mut slow = std::io::BufReader::with_capacity(5, bytes.as_slice());
        assert_eq!(decode(&mut slow, &request).expect("reads"), whole);
    }

    #[test]
    fn each_wrong_file_has_its_own_reason() {
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        let with = |count: &str, properties: &str, body: &str| {
            format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{body}")
        };
        for (text, code) in [
            ("plx\n".to_owned(), "format_mismatch"),
            ("ply\nformat ascii 1.0\n".to_owned(), "file_truncated"),
            ("ply\nformat morse 1.0\nend_header\n".to_owned(), "header_invalid"),
            ("ply\nformat ascii 1.0\nend_header\n".to_owned(), "header_invalid"),
            (with("two", xyz, ""), "header_invalid"),
            (with("1", "property float x\nproperty float y\n", "1 2\n"), "column_unknown"),
            (with("1", &format!("property list uchar int n\n{xyz}"), "many 1 2 3\n"), "row_ragged"),
            (with("1", &format!("property list uchar int n\n{xyz}"), "2 1 2 3\n"), "row_ragged"),
            (with("1", "property float x\nproperty float y\nproperty list uchar int z\n", "1 2 0\n"), "header_invalid"),
            (with("2", xyz, "1 2 3\n"), "file_truncated"),
            (with("1", xyz, "1 2\n"), "row_ragged"),
            (with("1", xyz, "1 2 c\n"), "number_invalid"),
            (with("1", xyz, "1 2 1e308\n"), "coordinate_out_of_range"),
            (with("2", xyz, "nan nan nan\n1 inf 2\n"), "no_points"),
            (with("0", xyz, ""), "no_points"),
            (with("18446744073709551615", xyz, "1 2 3\n"), "too_many_points"),
        ] {
            assert_eq!(read(text.as_bytes()).expect_err("wrong").code(), code, "{text}");
        }
        let short = file("binary_little_endian", &binary(<[u8]>::to_vec)[..30]);
        assert!(matches!(read(&short), Err(DecodeError::Truncated { expected: 2, found: 1 })));
    }

    #[test]
    fn lists_within_vertices_are_skipped_in_every_encoding() {
        let header = |encoding: &str| {
            format!(
                "ply\nformat {encoding} 1.0\nelement vertex 2\nproperty list uchar short faces\nproperty float x\n\
                 property list uchar uchar tags\nproperty float y\nproperty float z\nend_header\n"
            )
        };
        let binary = |order: fn(&[u8]) -> Vec<u8>| {
            let mut body = vec![2, 9, 9, 9, 9];
            let floats =
                |values: &[f32]| values.iter().flat_map(|value| order(&value.to_le_bytes())).collect::<Vec<u8>>();
            body.extend([floats(&[1.0]), vec![1, 7], floats(&[2.0, 3.0]), vec![0]].concat());
            body.extend([floats(&[4.0]), vec![0], floats(&[5.0, 6.0])].concat());
            body
        };
        let ascii = [header("ascii").as_bytes(), b"2 9 9 1 1 7 2 3\n0 4 0 5 6\n"].concat();
        let little = [header("binary_little_endian").as_bytes(), &binary(<[u8]>::to_vec)].concat();
        let big =
            [header("binary_big_endian").as_bytes(), &binary(|bytes| bytes.iter().rev().copied().collect())].concat();
        for bytes in [ascii, little.clone(), big] {
            let cloud = read(&bytes).expect("reads");
            assert_eq!(cloud.points().collect::<Vec<_>>(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        }
        let short = read(&little[..little.len() - 3]);
        assert!(matches!(short, Err(DecodeError::Truncated { expected: 2, found: 1 })), "{short:?}");
    }

    #[test]
    fn header_lines_may_end_with_cr_and_obj_info_may_state_the_unit() {
        let ascii = "ply\rformat ascii 1.0\robj_info unit: um\relement vertex 1\rproperty float x\rproperty float y\r\
                     property float z\rend_header\r1000 2000 3000\r";
        let binary = ascii.replace("ascii", "binary_little_endian").replace("1000 2000 3000\r", "");
        let numbers: Vec<u8> = [1000f32, 2000.0, 3000.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        for bytes in [ascii.as_bytes().to_vec(), [binary.as_bytes(), &numbers].concat()] {
            let cloud = read(&bytes).expect("reads");
            assert_eq!((cloud.unit, cloud.points().collect::<Vec<_>>()), (Unit::Micrometre, vec![[1.0, 2.0, 3.0]]));
        }
    }
}
