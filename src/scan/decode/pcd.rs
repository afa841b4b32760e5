//! PCD of the point cloud library, text, binary and compressed. Rows of an organised cloud become labels.
//! From bytes to a cloud.
//!
//! The reader is our own: the crate for this format reserves whatever two numbers of the compressed body ask for, which
//! no caller can catch.

use super::gather::Gather;
use super::lines::{Lines, words};
use super::lzf;
use super::names::{self, ColumnMap};
use super::number::parse_number;
use super::pcd_header::{Body, Field, Header, read_header};
use super::records::{Layout, Place, read_records, take_points};
use super::scalar::{Endian, Scalar};
use super::{DecodeError, Format, Limits, Request, ends_early, settle_unit};
use crate::scan::{Cloud, Labels};
use std::io::{BufRead, Read};

const FORMAT: Format = Format::Pcd;

/// Reads a PCD file.
pub(super) fn decode(reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    let mut lines = Lines::new(reader, request.limits);
    let header = read_header(&mut lines, request.limits)?;
    let names: Vec<String> = header.fields.iter().map(|field| field.name.clone()).collect();
    let map = names::map_columns(&names, request)?;
    let unit = settle_unit(request.unit, names::settle_stated(map.unit, header.unit)?)?;
    let layout = lay_out(&header, &map)?;
    let mut gather = Gather::new(unit, layout.precision(), request.limits);
    match header.body {
        Body::Ascii => read_lines(&mut lines, &header, &map, &layout, &mut gather)?,
        Body::Binary => {
            read_records(lines.into_reader(), &layout, header.stride(), header.points(), &mut gather)?;
        }
        Body::Compressed => {
            let unpacked = unpack(lines.into_reader(), &header, request.limits)?;
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
        let cell = |column: usize| {
            let word = words(line).nth(column);
            let word =
                word.ok_or_else(|| DecodeError::RaggedRow { line: number, expected, found: words(line).count() })?;
            parse_number(word).ok_or(DecodeError::BadNumber { line: number, column: column + 1 })
        };
        let label = label_at.map_or(Ok(layout.row_of(gather.seen())), cell)?;
        gather.push(label, [cell(x)?, cell(y)?, cell(z)?])?;
    }
    Ok(())
}

/// The unpacked body of a compressed file; reserves what the packed bytes that are really there can become.
fn unpack(reader: &mut dyn BufRead, header: &Header, limits: &Limits) -> Result<Vec<u8>, DecodeError> {
    let packed_size = read_size(reader)?;
    let stated = read_size(reader)?;
    let expected = (header.points() as u64).saturating_mul(header.stride() as u64);
    if stated != expected {
        return Err(DecodeError::SizeMismatch { format: FORMAT, field: "the unpacked size", stated, expected });
    }
    let limit = limits.inflated_bytes_max;
    let size = usize::try_from(stated).ok().filter(|_| stated <= limit);
    let size = size.ok_or(DecodeError::InflatedTooLarge { limit })?;
    let mut packed = Vec::new();
    reader.take(packed_size).read_to_end(&mut packed)?;
    if (packed.len() as u64) < packed_size {
        return Err(DecodeError::Truncated { expected: header.points() as u64, found: 0 });
    }
    lzf::unpack(&packed, size).ok_or(DecodeError::DamagedPoints { format: FORMAT })
}

fn read_size(reader: &mut dyn BufRead) -> Result<u64, DecodeError> {
    let mut bytes = [0; 4];
    reader.read_exact(&mut bytes).map_err(|error| ends_early(error, FORMAT))?;
    Ok(u64::from(u32::from_le_bytes(bytes)))
}
