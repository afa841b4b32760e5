//! PCD of the point cloud library, text, binary and compressed. Rows of an organised cloud become labels.
//!
//! The reader is our own: the crate for this format reserves as much memory as two numbers of the compressed body request, and a
//! caller cannot catch the failure. The bodies are compressed with LZF. A control byte below 32 announces that many literals plus
//! one. Any other announces a copy from the bytes already written: three bits of length (7: the next byte adds to it) and thirteen
//! bits of distance.

use super::error::{DecodeError, ends_early};
use super::format::Format;
use super::gather::Gather;
use super::hints::shorten;
use super::inflate::check_ratio;
use super::limits::Limits;
use super::lines::{Lines, text, words};
use super::names::{self, ColumnMap};
use super::number::Numbers;
use super::records::{Endian, Kind, Layout, Place, Scalar, read_records, take_points};
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels, Unit};
use std::io::{BufRead, Read};

const FORMAT: Format = Format::Pcd;

/// Reads a PCD file.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::of_header(reader, request.limits)?;
    let header = read_header(&mut lines, request.limits)?;
    let names: Vec<String> = header.fields.iter().map(|field| field.name.clone()).collect();
    let map = names::map_columns(&names, request)?;
    let unit = settle_unit(request.unit, names::settle_stated(map.unit, header.unit)?)?;
    let layout = lay_out(&header, &map)?;
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    match header.body {
        Body::Ascii => {
            let mut numbers = Numbers::new(request.decimal);
            read_lines(&mut lines, &header, &map, &layout, &mut numbers, &mut gather)?;
            numbers.finish()?;
        }
        Body::Binary => {
            read_records(lines.into_reader(), &layout, header.stride(), header.points(), &mut gather)?;
        }
        Body::Compressed => {
            let unpacked = decompress_body(lines.into_reader(), &header, request)?;
            take_points(&unpacked, &layout, header.points(), &mut gather)?;
        }
    }
    gather.finish(match (map.label, header.height) {
        (Some((_, name)), _) => Labels::Column(name),
        (None, 0 | 1) => Labels::None,
        (None, _) => Labels::Row,
    })
}

/// Positions of the coordinates: in every point, or in the block of each field if the points are compressed.
fn lay_out(header: &Header, map: &ColumnMap) -> Result<Layout, DecodeError> {
    let place = |position: usize| {
        let field = header.fields.get(position).filter(|field| field.count > 0);
        let field = field.ok_or(DecodeError::HeaderMissing { format: FORMAT, field: "COUNT of every field" })?;
        let before = header.fields.iter().take(position).map(Field::size).sum::<usize>();
        let (start, step) = match header.body {
            Body::Compressed => (before.saturating_mul(header.points()), field.size()),
            Body::Ascii | Body::Binary => (before, header.stride()),
        };
        Ok::<_, DecodeError>(Place { scalar: Scalar { kind: field.kind, endian: Endian::Little }, start, step })
    };
    let [x, y, z] = map.point;
    let label = map.label.as_ref().map(|(position, _)| place(*position)).transpose()?;
    let row_length = (header.height > 1).then_some(header.width);
    Ok(Layout { point: [place(x)?, place(y)?, place(z)?], label, row_length })
}

fn read_lines(
    lines: &mut Lines<'_>,
    header: &Header,
    map: &ColumnMap,
    layout: &Layout,
    numbers: &mut Numbers,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    // A field of several numbers has as many words.
    let word_of = |position: usize| header.fields.iter().take(position).map(|field| field.count).sum::<usize>();
    let [x, y, z] = map.point.map(word_of);
    let label_at = map.label.as_ref().map(|(position, _)| word_of(*position));
    let expected = word_of(header.fields.len());
    while gather.seen() < header.points() {
        let number = lines.number() + 1;
        let Some(line) = lines.next_line()? else {
            return Err(DecodeError::Truncated { expected: header.points() as u64, found: gather.seen() as u64 });
        };
        if line.trim_ascii().is_empty() {
            continue;
        }
        let mut cell = |column: usize| {
            let found = || words(line).count();
            let ragged = || DecodeError::RaggedRow { line: number, expected, found: found(), text: shorten(line) };
            numbers.read(words(line).nth(column).ok_or_else(ragged)?, number, column)
        };
        let label = label_at.map_or(Ok(layout.row_of(gather.seen())), &mut cell)?;
        gather.push(label, [cell(x)?, cell(y)?, cell(z)?])?;
    }
    Ok(())
}

/// The decompressed body of a compressed file; reserves no more than the received bytes can produce.
fn decompress_body(reader: &mut dyn BufRead, header: &Header, request: &Request<'_>) -> Result<Vec<u8>, DecodeError> {
    let packed_size = read_size(reader)?;
    let stated = read_size(reader)?;
    let expected = (header.points() as u64).saturating_mul(header.stride() as u64);
    if stated != expected {
        return Err(DecodeError::SizeMismatch { format: FORMAT, field: "the unpacked size", stated, expected });
    }
    let limit = request.limits.inflated_bytes_max;
    let size = usize::try_from(stated).ok().filter(|_| stated <= limit);
    let size = size.ok_or(DecodeError::InflatedTooLarge { limit })?;
    let mut packed = Vec::new();
    reader.take(packed_size).read_to_end(&mut packed)?;
    if (packed.len() as u64) < packed_size {
        return Err(DecodeError::Truncated { expected: header.points() as u64, found: 0 });
    }
    check_ratio(stated, request.sent_bytes(packed_size), request.limits.inflate_ratio_max)?;
    decompress_lzf(&packed, size).ok_or(DecodeError::DamagedPoints { format: FORMAT })
}

fn read_size(reader: &mut dyn BufRead) -> Result<u64, DecodeError> {
    let mut bytes = [0; 4];
    reader.read_exact(&mut bytes).map_err(|error| ends_early(error, FORMAT))?;
    Ok(u64::from(u32::from_le_bytes(bytes)))
}

/// Largest count of numbers in one field; more than any usual descriptor has.
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
    /// Count of its numbers.
    pub(super) count: usize,
}

impl Field {
    /// Bytes of the field in one point.
    pub(super) fn size(&self) -> usize {
        self.kind.size() * self.count
    }
}

/// A complete header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    /// Points of a row.
    pub(super) width: usize,
    /// Number of rows; 1 if the points are not organised.
    pub(super) height: usize,
    pub(super) body: Body,
    /// The unit from a comment such as `unit: mm`.
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

/// The contents of the header lines, before they are compared.
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

/// Reads up to and including the line `DATA`.
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
    /// Compares the lines with each other.
    fn check(self, body: Body, limits: &Limits) -> Result<Header, DecodeError> {
        let missing = |field| DecodeError::HeaderMissing { format: FORMAT, field };
        // Before version 0.7 a header states neither.
        let unorganised = self.points.filter(|_| self.width.is_none() && self.height.is_none());
        let width = self.width.or(unorganised).ok_or(missing("WIDTH"))?;
        let height = self.height.or(unorganised.map(|_| 1)).ok_or(missing("HEIGHT"))?;
        // The product may exceed u64 if the header is wrong.
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
            // COUNT is optional and defaults to 1.
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

/// Largest number of bytes per byte of input: three can produce a copy of 264.
const RATIO_MAX: usize = 88;

/// Decompresses `packed` into exactly `size` bytes; `None` if it contains more, fewer, or invalid data.
fn decompress_lzf(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    if size > packed.len().saturating_mul(RATIO_MAX) {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut input = packed.iter();
    while let Some(&control) = input.next() {
        let control = usize::from(control);
        if control < 32 {
            let rest = input.as_slice();
            out.extend_from_slice(rest.get(..=control)?);
            input = rest.get(control + 1..)?.iter();
        } else {
            let length = match control >> 5 {
                7 => 7 + usize::from(*input.next()?),
                length => length,
            } + 2;
            let distance = ((control & 0x1f) << 8) + usize::from(*input.next()?) + 1;
            copy_within(&mut out, distance, length)?;
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

/// Repeats `length` bytes from `distance` before the end; the two may overlap, which repeats a pattern.
fn copy_within(out: &mut Vec<u8>, distance: usize, length: usize) -> Option<()> {
    let start = out.len().checked_sub(distance)?;
    if distance >= length {
        out.extend_from_within(start..start + length);
    } else {
        for at in start..start + length {
            let byte = *out.get(at)?;
            out.push(byte);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Limits;
    use crate::scan::{Columns, Stripe};

    fn read(bytes: &[u8]) -> Result<Cloud, DecodeError> {
        let limits = Limits { points_max: 1000, ..Limits::default() };
        decode(&mut &*bytes, &Request::new(&limits))
    }

    /// Three by two points of x, a normal of two numbers, z and y.
    fn file(data: &str, body: &[u8]) -> Vec<u8> {
        let header = format!(
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x normal z y\nSIZE 4 1 8 2\nTYPE F U F I\nCOUNT 1 2 1 1\nWIDTH 3\n\
             HEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6\nDATA {data}\n"
        );
        [header.as_bytes(), body].concat()
    }

    const POINTS: [(f32, f64, i16); 6] =
        [(1.0, 0.1, 1), (1.0, f64::NAN, 2), (1.0, 0.3, 3), (2.0, 0.4, 4), (2.0, 0.5, 5), (2.0, 0.6, 6)];

    /// Field after field, as literals of up to 32 bytes.
    fn packed() -> Vec<u8> {
        let mut plain: Vec<u8> = POINTS.iter().flat_map(|(x, ..)| x.to_le_bytes()).collect();
        plain.extend([9; 12]);
        plain.extend(POINTS.iter().flat_map(|(_, z, _)| z.to_le_bytes()));
        plain.extend(POINTS.iter().flat_map(|(_, _, y)| y.to_le_bytes()));
        let packed: Vec<u8> = plain.chunks(32).flat_map(|part| [&[part.len() as u8 - 1], part].concat()).collect();
        let size = |bytes: &[u8]| (bytes.len() as u32).to_le_bytes();
        [&size(&packed)[..], &size(&plain), &packed].concat()
    }

    #[test]
    fn every_storage_gives_the_same_rows() {
        let ascii: String = POINTS.iter().map(|(x, z, y)| format!("{x} 9 9 {z} {y}\n")).collect();
        let binary: Vec<u8> = POINTS
            .iter()
            .flat_map(|(x, z, y)| [&x.to_le_bytes()[..], &[9, 9], &z.to_le_bytes(), &y.to_le_bytes()].concat())
            .collect();
        for bytes in [file("ascii", ascii.as_bytes()), file("binary", &binary), file("binary_compressed", &packed())] {
            let cloud = read(&bytes).expect("reads");
            let stripes = [Stripe { label: 0.0, x: 1.0, end: 2 }, Stripe { label: 1.0, x: 2.0, end: 5 }];
            assert_eq!((&*cloud.stripes, cloud.labels, cloud.missing_count), (&stripes[..], Labels::Row, 1));
            let (y, z) = (vec![1.0, 3.0, 4.0, 5.0, 6.0], vec![0.1, 0.3, 0.4, 0.5, 0.6]);
            assert_eq!(cloud.columns, Columns::F64 { y, z });
        }
    }

    #[test]
    fn each_wrong_file_has_its_own_reason() {
        let whole = String::from_utf8(file("ascii", b"")).expect("text");
        for (from, to, code) in [
            ("# .PCD", "%PDF", "format_mismatch"),
            ("POINTS 6", "POINTS 7", "size_mismatch"),
            ("WIDTH 3", "WIDTH 18446744073709551615", "size_mismatch"),
            ("WIDTH 3\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6", "WIDTH 5000\nHEIGHT 5000", "too_many_points"),
            ("WIDTH 3\n", "", "header_invalid"),
            ("SIZE 4 1", "SIZE 3 1", "header_invalid"),
            ("COUNT 1 2", "COUNT 1 99999999999", "header_invalid"),
            ("COUNT 1 2", "COUNT 0 2", "header_invalid"),
            ("FIELDS x", "FIELDS w", "column_unknown"),
            ("DATA ascii", "DATA morse", "header_invalid"),
            ("DATA ascii\n", "", "file_truncated"),
            ("", "", "file_truncated"),
        ] {
            let text = whole.replacen(from, to, 1);
            assert_eq!(read(text.as_bytes()).expect_err("wrong").code(), code, "{from} -> {to}");
        }
        let mut body = packed();
        assert_eq!(read(&file("binary_compressed", &body[..20])).expect_err("cut").code(), "file_truncated");
        body[4] ^= 1;
        assert_eq!(read(&file("binary_compressed", &body)).expect_err("lies").code(), "size_mismatch");
        body[4] ^= 1;
        body[8] = 255;
        assert_eq!(read(&file("binary_compressed", &body)).expect_err("damaged").code(), "file_damaged");
        let short = read(&file("binary", &[0; 40]));
        assert!(matches!(short, Err(DecodeError::Truncated { expected: 6, found: 2 })));
    }

    #[test]
    fn a_file_before_version_0_7_states_its_points_alone() {
        let text = "# .PCD v.5 - Point Cloud Data file format\rVERSION .5\rFIELDS x y z\rSIZE 4 4 4\rTYPE F F F\rPOINTS 2\r\
                    DATA ascii\r1 2 3\r4 5 6\r";
        for text in [text.to_owned(), text.replace('\r', "\n"), text.replace('\r', "\r\n")] {
            let cloud = read(text.as_bytes()).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(cloud.points().collect::<Vec<_>>(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        }
    }
}

#[cfg(test)]
mod lzf_tests {
    use super::*;

    #[test]
    fn literals_and_overlapping_copies_unpack() {
        // "abc", then 9 bytes from 3 back: the pattern three times more.
        let packed = [2, b'a', b'b', b'c', 7 << 5, 0, 2];
        assert_eq!(decompress_lzf(&packed, 12).as_deref(), Some(&b"abcabcabcabc"[..]));
        assert_eq!(decompress_lzf(&[0, b'x', 1 << 5, 0], 4).as_deref(), Some(&b"xxxx"[..]));
    }

    #[test]
    fn invalid_compressed_data_are_refused() {
        assert_eq!(decompress_lzf(&[5, 1, 2], 6), None, "literals beyond the end");
        assert_eq!(decompress_lzf(&[0, 1, 32, 9], 4), None, "copy from before the start");
        assert_eq!(decompress_lzf(&[0, 1], 2), None, "too few");
        assert_eq!(decompress_lzf(&[1, 1, 1], 1), None, "too many");
        assert_eq!(decompress_lzf(&[0, 1], usize::MAX), None, "a size that no such input can have");
    }
}
