//! PLY, text and binary of either byte order: the vertices; other elements before them are passed over.
//! From bytes to a cloud.
//!
//! The reader is our own: the crate that is safe on hostile input parses element by element and property by property,
//! which takes far longer than the few sweeps over memory that a scan of millions of points may cost.

use super::gather::Gather;
use super::lines::{Lines, words};
use super::names::{self, ColumnMap};
use super::number::parse_number;
use super::ply_header::{Body, Element, PropertyType, read_header};
use super::records::{Layout, Place, read_records};
use super::scalar::{Endian, Scalar};
use super::{DecodeError, Format, Request, ends_early, settle_unit};
use crate::scan::{Cloud, Labels};
use std::io::BufRead;

const FORMAT: Format = Format::Ply;

/// Reads the vertices of a PLY file.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::new(reader, request.limits);
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
    match header.body {
        Body::Ascii => {
            skip_lines(&mut lines, before)?;
            read_lines(&mut lines, &map, count, &mut gather)?;
        }
        Body::Binary(endian) => {
            let reader = lines.into_reader();
            before.iter().try_for_each(|element| skip_records(reader, element, endian))?;
            let stride = vertex.stride().unwrap_or_default();
            read_records(reader, &lay_out(vertex, &map, endian)?, stride, count, &mut gather)?;
        }
    }
    gather.finish(match map.label {
        Some((_, name)) => Labels::Column(name),
        None => Labels::None,
    })
}

/// Where the coordinates lie in a vertex.
fn lay_out(vertex: &Element, map: &ColumnMap, endian: Endian) -> Result<Layout, DecodeError> {
    let step = vertex.stride().ok_or(DecodeError::Unsupported {
        format: FORMAT,
        what: "lists within vertices are not read; write the vertices without them",
    })?;
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

/// Passes over the lines of elements that stand before the vertices.
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
    map: &ColumnMap,
    count: usize,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    let [x, y, z] = map.point;
    let label_at = map.label.as_ref().map(|(position, _)| *position);
    let mut done = 0;
    while done < count {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else {
            return Err(DecodeError::Truncated { expected: count as u64, found: done as u64 });
        };
        if line.trim_ascii().is_empty() {
            continue;
        }
        let cell = |column: usize| {
            let word = words(line).nth(column);
            let word =
                word.ok_or(DecodeError::RaggedRow { line: number, expected: map.end(), found: words(line).count() })?;
            parse_number(word).ok_or(DecodeError::BadNumber { line: number, column: column + 1 })
        };
        let label = label_at.map_or(Ok(0.0), cell)?;
        gather.push(label, [cell(x)?, cell(y)?, cell(z)?])?;
        done += 1;
    }
    Ok(())
}

/// Passes over the records of an element that stands before the vertices.
fn skip_records(reader: &mut dyn BufRead, element: &Element, endian: Endian) -> Result<(), DecodeError> {
    if let Some(stride) = element.stride() {
        return skip(reader, element.count.saturating_mul(stride as u64));
    }
    for _ in 0..element.count {
        for (_, kind) in &element.properties {
            match *kind {
                PropertyType::Scalar(kind) => skip(reader, kind.size() as u64)?,
                PropertyType::List { count, item } => {
                    let mut bytes = [0; 8];
                    let counted = bytes.get_mut(..count.size()).unwrap_or_default();
                    reader.read_exact(counted).map_err(|error| ends_early(error, FORMAT))?;
                    let items = Scalar { kind: count, endian }.read(&bytes, 0).filter(|items| *items >= 0.0);
                    let items = items.ok_or(DecodeError::EndsEarly { format: FORMAT })?;
                    skip(reader, (items as u64).saturating_mul(item.size() as u64))?;
                }
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Limits, Unit};
    use crate::scan::{Columns, Stripe};

    fn read(bytes: &[u8]) -> Result<Cloud, DecodeError> {
        let limits = Limits { points_max: 1000, ..Limits::default() };
        decode(&mut &*bytes, &Request { unit: None, profile_column: None, limits: &limits })
    }

    /// Two vertices with y, a colour, x (double), z and a label, behind an element with a list.
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
    fn every_encoding_gives_the_same_points_from_among_other_elements() {
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
        let request = Request { unit: Some(Unit::Inch), profile_column: None, limits: &limits };
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
            (with("1", &format!("{xyz}property list uchar int n\n"), "1 2 3 0\n"), "format_unsupported"),
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
}
