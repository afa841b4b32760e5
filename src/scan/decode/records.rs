//! Binary points, record after record, into a cloud. What PLY, PCD and NPY share once their headers are read.
//! Must not know which of them it serves.
//!
//! A scan of millions of points has to pass in a few memory sweeps, so records of exactly three little-endian floats
//! go block by block: one branch-free pass asks whether a block shares one x and is clean, a second takes it apart.
//! Any other record, and any block that is not clean, goes point by point.

use super::gather::{Gather, Stretch};
use super::scalar::{Endian, Kind, Scalar};
use super::{DecodeError, Precision};
use crate::scan::Columns;
use std::io::BufRead;

/// Records of a block: 12 KiB in single precision, so that the second pass finds it in the first-level cache.
const BLOCK: usize = 1024;

/// Where one number of every record lies: that of record i at `start` + i·`step`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) scalar: Scalar,
    pub(super) start: usize,
    pub(super) step: usize,
}

/// The layout of points in bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    /// x, y and z.
    pub(super) point: [Place; 3],
    /// The profile's label, where the file has one.
    pub(super) label: Option<Place>,
    /// Points of a row, where the file is organised in rows; their number is the label then.
    pub(super) row_length: Option<usize>,
}

impl Layout {
    /// Single where every coordinate is.
    pub(super) fn precision(&self) -> Precision {
        if self.point.iter().all(|place| place.scalar.kind == Kind::F32) {
            Precision::Single
        } else {
            Precision::Double
        }
    }

    /// The label of the point at `index` where no column gives one.
    pub(super) fn row_of(&self, index: usize) -> f64 {
        row_of(index, self.row_length)
    }

    /// The kind of the three numbers where a record of `stride` bytes is nothing but them, little-endian, in order.
    fn packed_kind(&self, stride: usize) -> Option<Kind> {
        let [x, y, z] = self.point;
        let (scalar, size) = (x.scalar, x.scalar.kind.size());
        let alike = y.scalar == scalar && z.scalar == scalar && scalar.endian == Endian::Little;
        let in_order = x.start == 0 && y.start == size && z.start == 2 * size && stride == 3 * size;
        (alike && in_order && self.label.is_none() && matches!(scalar.kind, Kind::F32 | Kind::F64))
            .then_some(scalar.kind)
    }
}

/// Reads `count` records of `stride` bytes.
///
/// # Errors
/// [`DecodeError::Truncated`] where the input ends before, and whatever a point may be refused for.
pub(super) fn read_records(
    reader: &mut dyn BufRead,
    layout: &Layout,
    stride: usize,
    count: usize,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    let mut split = Vec::new();
    let mut done = 0;
    while done < count {
        let bytes = reader.fill_buf()?;
        let whole = (bytes.len() / stride.max(1)).min(count - done);
        if whole > 0 {
            if done == 0 {
                gather.reserve(whole);
            }
            let used = whole * stride;
            take_block(bytes.get(..used).unwrap_or_default(), layout, stride, gather)?;
            reader.consume(used);
            done += whole;
        } else {
            // The buffer ends inside a record.
            read_split(reader, &mut split, stride)?;
            if split.len() < stride {
                return Err(DecodeError::Truncated { expected: count as u64, found: done as u64 });
            }
            take_block(&split, layout, stride, gather)?;
            done += 1;
        }
    }
    Ok(())
}

/// Takes `count` points from `bytes` that hold all of them, in any arrangement.
pub(super) fn take_points(
    bytes: &[u8],
    layout: &Layout,
    count: usize,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    let [x, y, z] = layout.point;
    let at = |place: Place, index: usize| {
        place.scalar.read(bytes, place.start.saturating_add(index.saturating_mul(place.step)))
    };
    for index in 0..count {
        let label = match (layout.label, layout.row_length) {
            (Some(place), _) => at(place, index),
            (None, row_length) => Some(row_of(gather.seen(), row_length)),
        };
        let (Some(x), Some(y), Some(z), Some(label)) = (at(x, index), at(y, index), at(z, index), label) else {
            return Err(DecodeError::Truncated { expected: count as u64, found: index as u64 });
        };
        gather.push(label, [x, y, z])?;
    }
    Ok(())
}

#[expect(clippy::cast_precision_loss, reason = "rows are far fewer than 2^53")]
fn row_of(index: usize, row_length: Option<usize>) -> f64 {
    row_length.map_or(0.0, |length| (index / length.max(1)) as f64)
}

/// Fills `split` with one record that lies across buffers; shorter only at the end of the input.
fn read_split(reader: &mut dyn BufRead, split: &mut Vec<u8>, stride: usize) -> Result<(), DecodeError> {
    split.clear();
    while split.len() < stride {
        let bytes = reader.fill_buf()?;
        let part = bytes.get(..(stride - split.len()).min(bytes.len())).unwrap_or_default();
        if part.is_empty() {
            break;
        }
        split.extend_from_slice(part);
        let used = part.len();
        reader.consume(used);
    }
    Ok(())
}

/// Takes whole records, the fast way where there is one.
fn take_block(bytes: &[u8], layout: &Layout, stride: usize, gather: &mut Gather<'_>) -> Result<(), DecodeError> {
    match (layout.packed_kind(stride), gather.plain_limit()) {
        (Some(Kind::F32), Some(limit)) => {
            take_packed::<[u8; 12]>(bytes.as_chunks().0, layout.row_length, limit, gather)
        }
        (Some(Kind::F64), Some(limit)) => {
            take_packed::<[u8; 24]>(bytes.as_chunks().0, layout.row_length, limit, gather)
        }
        _ => take_points(bytes, layout, bytes.len() / stride.max(1), gather),
    }
}

/// A record of three floats and nothing else.
trait Packed: Sized + Copy {
    /// The float.
    type Real: Copy + PartialEq + Into<f64>;
    /// x, y, z.
    fn point(&self) -> [Self::Real; 3];
    /// Whether no coordinate is NaN or larger than `limit`.
    fn is_within(&self, limit: f64) -> bool;
    /// The columns that hold this float.
    fn columns(columns: &mut Columns) -> Option<(&mut Vec<Self::Real>, &mut Vec<Self::Real>)>;
}

impl Packed for [u8; 12] {
    type Real = f32;

    #[inline]
    fn point(&self) -> [f32; 3] {
        let [a, b, c, d, e, f, g, h, i, j, k, l] = *self;
        [f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]), f32::from_le_bytes([i, j, k, l])]
    }

    #[inline]
    fn is_within(&self, limit: f64) -> bool {
        let [x, y, z] = self.point();
        #[expect(clippy::cast_possible_truncation, reason = "a limit half a step off refuses nothing that matters")]
        let limit = limit as f32;
        (x.abs() <= limit) & (y.abs() <= limit) & (z.abs() <= limit)
    }

    fn columns(columns: &mut Columns) -> Option<(&mut Vec<f32>, &mut Vec<f32>)> {
        match columns {
            Columns::F32 { y, z } => Some((y, z)),
            Columns::F64 { .. } => None,
        }
    }
}

impl Packed for [u8; 24] {
    type Real = f64;

    #[inline]
    fn point(&self) -> [f64; 3] {
        let (words, _) = self.as_chunks::<8>();
        let [x, y, z] = words else { return [f64::NAN; 3] };
        [f64::from_le_bytes(*x), f64::from_le_bytes(*y), f64::from_le_bytes(*z)]
    }

    #[inline]
    fn is_within(&self, limit: f64) -> bool {
        let [x, y, z] = self.point();
        (x.abs() <= limit) & (y.abs() <= limit) & (z.abs() <= limit)
    }

    fn columns(columns: &mut Columns) -> Option<(&mut Vec<f64>, &mut Vec<f64>)> {
        match columns {
            Columns::F64 { y, z } => Some((y, z)),
            Columns::F32 { .. } => None,
        }
    }
}

/// Packed records that share their x.
struct PackedStretch<'a, P>(&'a [P]);

impl<P: Packed> Stretch for PackedStretch<'_, P> {
    fn x(&self) -> f64 {
        self.0.first().map_or(f64::NAN, |record| record.point()[0].into())
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn append_to(&self, columns: &mut Columns) -> bool {
        let Some((y, z)) = P::columns(columns) else { return false };
        y.extend(self.0.iter().map(|record| record.point()[1]));
        z.extend(self.0.iter().map(|record| record.point()[2]));
        true
    }
}

/// Splits records at the ends of rows, then into blocks.
fn take_packed<P: Packed>(
    mut records: &[P],
    row_length: Option<usize>,
    limit: f64,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    while !records.is_empty() {
        let left = row_length.map_or(BLOCK, |length| length.max(1) - gather.seen() % length.max(1));
        let (block, rest) = records.split_at(left.min(BLOCK).min(records.len()));
        take_packed_block(block, row_of(gather.seen(), row_length), limit, gather)?;
        records = rest;
    }
    Ok(())
}

/// Takes a block of one row at once where it is clean and of one x, run by run where it is not.
fn take_packed_block<P: Packed>(
    mut block: &[P],
    label: f64,
    limit: f64,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    while let Some(first) = block.first() {
        let [x, _, _] = first.point();
        let uniform = block.iter().fold(true, |all, record| all & (record.point()[0] == x));
        let run = if uniform {
            block.len()
        } else {
            // At least the first: NaN is not even equal to itself.
            block.iter().position(|record| record.point()[0] != x).unwrap_or(block.len()).max(1)
        };
        let (stretch, rest) = block.split_at(run);
        let clean = stretch.iter().fold(true, |all, record| all & record.is_within(limit));
        if !clean || !gather.push_stretch(label, &PackedStretch(stretch))? {
            for record in stretch {
                gather.push(label, record.point().map(Into::into))?;
            }
        }
        block = rest;
    }
    Ok(())
}
