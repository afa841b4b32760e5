//! Binary points, record after record, into a cloud. What PLY, PCD and NPY share once their headers are read.
//!
//! Records of exactly three little-endian floats take the fast way of [`packed`](super::packed); others go point by point.

use super::error::DecodeError;
use super::gather::Gather;
use super::gather::Precision;
use super::packed::take_packed;
use super::scalar::{Endian, Kind, Scalar};
use std::io::BufRead;

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

/// The number of the row that the point at `index` lies in.
pub(super) fn row_of(index: usize, row_length: Option<usize>) -> f64 {
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
    let (row_length, count) = (layout.row_length, bytes.len() / stride.max(1));
    match (layout.packed_kind(stride), gather.plain_limit()) {
        (Some(Kind::F32), Some(limit)) => take_packed::<[u8; 12]>(bytes.as_chunks().0, row_length, limit, gather),
        (Some(Kind::F64), Some(limit)) => take_packed::<[u8; 24]>(bytes.as_chunks().0, row_length, limit, gather),
        _ => {
            gather.reserve(count);
            take_points(bytes, layout, count, gather)
        }
    }
}
