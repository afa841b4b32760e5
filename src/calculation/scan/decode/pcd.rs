//! PCD of the point cloud library, text, binary and compressed. Rows of an organised cloud become labels.
//! From bytes to a cloud.
//!
//! The reader is our own: the crate for this format reserves whatever two numbers of the compressed body ask for, which
//! no caller can catch.

use super::error::DecodeError;
use super::format::Format;
use super::gather::Gather;
use super::hints::shorten;
use super::inflate::check_ratio;
use super::lines::{Lines, words};
use super::lzf;
use super::names::{self, ColumnMap};
use super::number::Numbers;
use super::pcd_header::{Body, Field, Header, read_header};
use super::records::{Layout, Place, read_records, take_points};
use super::scalar::{Endian, Scalar};
use super::{Request, ends_early, settle_unit};
use crate::scan::cloud::{Cloud, Labels};
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
            let unpacked = unpack(lines.into_reader(), &header, request)?;
            take_points(&unpacked, &layout, header.points(), &mut gather)?;
        }
    }
    gather.finish(match (map.label, header.height) {
        (Some((_, name)), _) => Labels::Column(name),
        (None, 0 | 1) => Labels::None,
        (None, _) => Labels::Row,
    })
}

/// Where the coordinates lie: in every point, or in the block of each field where the points are compressed.
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
    // A field of several numbers takes as many words.
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

/// The unpacked body of a compressed file; reserves what the packed bytes that are really there can become.
fn unpack(reader: &mut dyn BufRead, header: &Header, request: &Request<'_>) -> Result<Vec<u8>, DecodeError> {
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
    lzf::unpack(&packed, size).ok_or(DecodeError::DamagedPoints { format: FORMAT })
}

fn read_size(reader: &mut dyn BufRead) -> Result<u64, DecodeError> {
    let mut bytes = [0; 4];
    reader.read_exact(&mut bytes).map_err(|error| ends_early(error, FORMAT))?;
    Ok(u64::from(u32::from_le_bytes(bytes)))
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
