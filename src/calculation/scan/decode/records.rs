//! Binary points, record by record, into a cloud: the part that PLY, PCD and NPY share after their headers.
//!
//! Records of exactly three little-endian floats take a fast path; others are processed point by point. A scan of millions of
//! points has to be read in a few passes over memory, so the fast path processes blocks without a branch and checks each as a unit:
//! one x, all finite, all within the limit. Only a block that fails the check is processed point by point.
//!
//! The remaining time is mostly that of the kernel, which allocates fresh pages, so the columns are filled in place without further
//! buffers. (Filling them from two threads at once was tried; the kernel made both wait.)
//!
//! [`Scalar`] is a number as binary formats store it; reading one fails only at the end of the bytes.

use super::error::DecodeError;
use super::gather::{Gather, Packed, Precision, Run};
use std::io::BufRead;

/// Position of one number of every record: that of record i is at `start` + i·`step`.
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
    /// The profile's label, if the file has one.
    pub(super) label: Option<Place>,
    /// Points of a row, if the file is organised in rows; the number of the row is then the label.
    pub(super) row_length: Option<usize>,
}

impl Layout {
    /// Single if every coordinate is single.
    pub(super) fn precision(&self) -> Precision {
        if self.point.iter().all(|place| place.scalar.kind == Kind::F32) {
            Precision::Single
        } else {
            Precision::Double
        }
    }

    /// The label of the point at `index` if no column contains one.
    pub(super) fn row_of(&self, index: usize) -> f64 {
        row_of(index, self.row_length)
    }

    /// The kind of the three numbers if a record of `stride` bytes contains exactly these, little-endian, in order.
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
/// [`DecodeError::Truncated`] if the input ends before, and the errors of single points.
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

/// Adds `count` points from `bytes`, which contain all of them, in any layout.
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

/// Fills `split` with one record that extends across buffers; it is shorter only at the end of the input.
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

/// Adds complete records, by the fast path if possible.
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

/// Records of a block: its input and output stay in the first-level cache.
const BLOCK: usize = 512;
/// Records for which space is reserved at once; the space is cleared before it is filled, and is then still in the second-level
/// cache.
const ROOM: usize = 16 * 1024;
/// Least number of points of one x that are worth a separate pass.
const RUN_MIN: usize = 16;

/// Adds records whose coordinates are millimetres. The records before them have been added.
pub(super) fn take_packed<P: Packed>(
    records: &[P],
    row_length: Option<usize>,
    limit: f64,
    gather: &mut Gather<'_>,
) -> Result<(), DecodeError> {
    gather.reserve(records.len());
    for records in records.chunks(ROOM) {
        let at = gather.seen();
        let fill = |y: &mut [P::Real], z: &mut [P::Real]| Target::new(row_length, limit, y, z).fill(records, at);
        if gather.fill::<P>(records.len(), fill) {
            continue;
        }
        // Processing one record at a time finds the point to refuse, or the first one beyond the limit.
        for record in records {
            let label = row_of(gather.seen(), row_length);
            gather.push(label, record.point().map(Into::into))?;
        }
    }
    Ok(())
}

/// Columns that are being filled.
struct Target<'a, R> {
    row_length: Option<usize>,
    limit: f64,
    kept: usize,
    runs: Vec<Run>,
    /// The current x, the number of its records so far, and the number of records at the previous x.
    x: Option<R>,
    stay: usize,
    last_stay: usize,
    y: &'a mut [R],
    z: &'a mut [R],
}

impl<'a, R: Copy + PartialEq + Into<f64>> Target<'a, R> {
    fn new(row_length: Option<usize>, limit: f64, y: &'a mut [R], z: &'a mut [R]) -> Self {
        Self { row_length, limit, kept: 0, runs: Vec::new(), x: None, stay: 0, last_stay: 0, y, z }
    }

    /// Adds records without those that are not finite: returns the points kept, and their runs. `None` if a point lies beyond the
    /// limit. `at` is the index of the first record in the file.
    fn fill<P: Packed<Real = R>>(mut self, mut records: &[P], mut at: usize) -> Option<(usize, Vec<Run>)> {
        while !records.is_empty() {
            let left = match self.row_length {
                Some(length) => length.max(1) - at % length.max(1),
                // Profiles of a file usually have the same length; then no block fails the check.
                None => self.last_stay.checked_sub(self.stay).filter(|left| *left > 0).unwrap_or(BLOCK),
            };
            let (block, _) = records.split_at(left.min(BLOCK).min(records.len()));
            let taken = self.take_some(block, row_of(at, self.row_length))?;
            at += taken;
            records = records.get(taken..).unwrap_or_default();
        }
        Some((self.kept, self.runs))
    }

    /// Processes the start of a block, or all of it if it shares one x; returns the number of records.
    fn take_some<P: Packed<Real = R>>(&mut self, block: &[P], label: f64) -> Option<usize> {
        let x_of = |record: &P| record.point()[0];
        let is_number = |x: &R| !(*x).into().is_nan();
        let x = block.iter().map(x_of).find(is_number);
        let Some(x) = x.filter(|x| P::all_within(&[*x], self.limit)) else {
            self.take_points(block, label)?;
            return Some(block.len());
        };
        if self.x != Some(x) {
            (self.x, self.last_stay, self.stay) = (Some(x), self.stay, 0);
        }
        if self.take_clean(block, x) {
            self.stay += block.len();
            self.extend_run(label, x.into(), block.len());
            return Some(block.len());
        }
        let end = block.iter().map(x_of).position(|other| other != x && is_number(&other)).unwrap_or(block.len());
        // If x changes all the time, a complete block would fail the check for each point.
        let end = if end < RUN_MIN { block.len() } else { end };
        let run = block.get(..end).unwrap_or_default();
        self.stay += end;
        match self.take_with_gaps(run, x) {
            Some(0) => {}
            Some(kept) => self.extend_run(label, x.into(), kept),
            None => self.take_points(run, label)?,
        }
        Some(end)
    }

    /// Adds a block of one x without a missing point; otherwise returns false and adds nothing.
    fn take_clean<P: Packed<Real = R>>(&mut self, block: &[P], x: R) -> bool {
        let range = self.kept..self.kept + block.len();
        let (Some(ys), Some(zs)) = (self.y.get_mut(range.clone()), self.z.get_mut(range)) else { return false };
        let mut uniform = true;
        for ((record, y), z) in block.iter().zip(ys.iter_mut()).zip(zs.iter_mut()) {
            let point = record.point();
            uniform &= point[0] == x;
            (*y, *z) = (point[1], point[2]);
        }
        uniform && P::all_within(ys, self.limit) && P::all_within(zs, self.limit)
    }

    /// Adds a run of one x with missing points and returns their number. `None`, adding nothing, if another x or a coordinate
    /// beyond the limit occurs.
    fn take_with_gaps<P: Packed<Real = R>>(&mut self, run: &[P], x: R) -> Option<usize> {
        let mut kept = 0;
        let mut odd = false;
        for record in run {
            let point = record.point();
            let [_, y, z] = point;
            // Overwritten by the next point if this one is missing.
            *self.y.get_mut(self.kept + kept)? = y;
            *self.z.get_mut(self.kept + kept)? = z;
            let fine = (point[0] == x) & P::all_within(&[y, z], self.limit);
            odd |= !fine & is_finite(point);
            kept += usize::from(fine);
        }
        (!odd).then_some(kept)
    }

    /// Adds the finite points one by one; `None` if a finite coordinate lies beyond the limit.
    fn take_points<P: Packed<Real = R>>(&mut self, block: &[P], label: f64) -> Option<()> {
        for record in block {
            let point = record.point();
            let [x, y, z] = point;
            if P::all_within(&point, self.limit) {
                *self.y.get_mut(self.kept)? = y;
                *self.z.get_mut(self.kept)? = z;
                self.extend_run(label, x.into(), 1);
            } else if is_finite(point) {
                return None;
            }
        }
        Some(())
    }

    fn extend_run(&mut self, label: f64, x: f64, count: usize) {
        self.kept += count;
        match self.runs.last_mut() {
            Some(run) if run.x == x && run.label == label => run.count += count,
            _ => self.runs.push(Run { label, x, count }),
        }
    }
}

fn is_finite<R: Into<f64>>(point: [R; 3]) -> bool {
    point.into_iter().fold(true, |all, value| all & value.into().is_finite())
}

/// The number of the row that contains the point at `index`.
pub(super) fn row_of(index: usize, row_length: Option<usize>) -> f64 {
    row_length.map_or(0.0, |length| (index / length.max(1)) as f64)
}

/// The kind of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Signed, one byte.
    I8,
    /// Unsigned, one byte.
    U8,
    /// Signed, two bytes.
    I16,
    /// Unsigned, two bytes.
    U16,
    /// Signed, four bytes.
    I32,
    /// Unsigned, four bytes.
    U32,
    /// Signed, eight bytes.
    I64,
    /// Unsigned, eight bytes.
    U64,
    /// Half precision.
    F16,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Kind {
    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

/// The order of a number's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Endian {
    /// Least significant first.
    Little,
    /// Most significant first.
    Big,
}

/// A number's kind and byte order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Scalar {
    pub(super) kind: Kind,
    pub(super) endian: Endian,
}

impl Scalar {
    /// The number at `offset`; `None` if the bytes end first.
    pub(super) fn read(self, bytes: &[u8], offset: usize) -> Option<f64> {
        let rest = bytes.get(offset..)?;
        Some(match self.kind {
            Kind::I8 => f64::from(i8::from_le_bytes(*rest.first_chunk()?)),
            Kind::U8 => f64::from(*rest.first()?),
            Kind::I16 => f64::from(i16::from_le_bytes(self.ordered(rest)?)),
            Kind::U16 => f64::from(u16::from_le_bytes(self.ordered(rest)?)),
            Kind::I32 => f64::from(i32::from_le_bytes(self.ordered(rest)?)),
            Kind::U32 => f64::from(u32::from_le_bytes(self.ordered(rest)?)),
            Kind::I64 => i64::from_le_bytes(self.ordered(rest)?) as f64,
            Kind::U64 => u64::from_le_bytes(self.ordered(rest)?) as f64,
            Kind::F16 => half(u16::from_le_bytes(self.ordered(rest)?)),
            Kind::F32 => f64::from(f32::from_le_bytes(self.ordered(rest)?)),
            Kind::F64 => f64::from_le_bytes(self.ordered(rest)?),
        })
    }

    /// The first `N` bytes, least significant first.
    fn ordered<const N: usize>(self, bytes: &[u8]) -> Option<[u8; N]> {
        let mut bytes = *bytes.first_chunk::<N>()?;
        if self.endian == Endian::Big {
            bytes.reverse();
        }
        Some(bytes)
    }
}

/// The value of a number of half precision (IEEE 754 binary16): one bit of sign, five of exponent, ten of fraction.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff);
    let magnitude = match (bits >> 10) & 0x1f {
        0 => fraction * 2f64.powi(-24),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        exponent => (1024.0 + fraction) * 2f64.powi(i32::from(exponent) - 25),
    };
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Limits, Unit};
    use crate::scan::{Cloud, Labels};

    fn record([x, y, z]: [f32; 3]) -> [u8; 12] {
        let bytes: Vec<u8> = [x, y, z].into_iter().flat_map(f32::to_le_bytes).collect();
        bytes.try_into().expect("twelve bytes")
    }

    /// Many blocks, with rows that end within blocks, x that changes within rows, and missing points.
    fn records() -> Vec<[u8; 12]> {
        let missing = |i: usize, value| if i % 101 == 5 || i / 700 == 9 { f32::NAN } else { value };
        let x = |i: usize| missing(i / 3 * 2, (i / 1500) as f32 + if i % 5000 == 7 { 0.25 } else { 0.0 });
        (0..100 * BLOCK + 77).map(|i| record([x(i), (i % 900) as f32, missing(i, 1.5)])).collect()
    }

    fn one_by_one(records: &[[u8; 12]], row_length: Option<usize>, limits: &Limits) -> Cloud {
        let mut gather = Gather::new(Unit::Millimetre, Precision::Single, limits);
        for (at, record) in records.iter().enumerate() {
            gather.push(row_of(at, row_length), record.point().map(f64::from)).expect("in range");
        }
        gather.finish(Labels::Row).expect("points")
    }

    #[test]
    fn the_fast_path_equals_reading_point_by_point() {
        let (records, limits) = (records(), Limits::default());
        for row_length in [None, Some(640), Some(1280), Some(1_000_000)] {
            let mut gather = Gather::new(Unit::Millimetre, Precision::Single, &limits);
            // In two parts, as from a reader whose buffer ends in between.
            let (start, rest) = records.split_at(30 * BLOCK + 12);
            take_packed(start, row_length, 1e6, &mut gather).expect("in range");
            take_packed(rest, row_length, 1e6, &mut gather).expect("in range");
            assert_eq!(gather.finish(Labels::Row).expect("points"), one_by_one(&records, row_length, &limits));
        }
    }

    #[test]
    fn the_first_point_beyond_the_limit_is_named() {
        let (mut records, limits) = (records(), Limits::default());
        records[50 * BLOCK + 3] = record([0.0, 0.0, 2e6]);
        records[50 * BLOCK + 9] = record([0.0, 3e6, 0.0]);
        let mut gather = Gather::new(Unit::Millimetre, Precision::Single, &limits);
        let error = take_packed(&records, None, 1e6, &mut gather).expect_err("beyond");
        assert!(matches!(error, DecodeError::CoordinateOutOfRange { index, .. } if index == 50 * BLOCK + 3), "{error}");
    }
}

#[cfg(test)]
mod scalar_tests {
    use super::*;

    #[test]
    fn both_byte_orders_give_the_same_number() {
        let (little, big) = (Endian::Little, Endian::Big);
        let read = |kind, endian, bytes: &[u8]| Scalar { kind, endian }.read(bytes, 1);
        assert_eq!(read(Kind::F32, little, &[9, 0, 0, 0xc0, 0x3f]), Some(1.5));
        assert_eq!(read(Kind::F32, big, &[9, 0x3f, 0xc0, 0, 0]), Some(1.5));
        assert_eq!(read(Kind::I16, big, &[9, 0xff, 0xfe]), Some(-2.0));
        assert_eq!(read(Kind::U64, little, &[9, 1, 1, 0, 0, 0, 0, 0, 0]), Some(257.0));
        assert_eq!(read(Kind::F64, little, &[9, 0, 0]), None);
    }

    #[test]
    fn half_precision_is_read_with_subnormal_and_special_values() {
        let read = |bits: u16| Scalar { kind: Kind::F16, endian: Endian::Little }.read(&bits.to_le_bytes(), 0);
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_953_125),
            (0x7bff, 65504.0),
            (0x0001, 2f64.powi(-24)),
            (0x0400, 2f64.powi(-14)),
            (0xfc00, f64::NEG_INFINITY),
        ] {
            assert_eq!(read(bits), Some(value), "{bits:x}");
        }
        assert!(read(0x7e00).is_some_and(f64::is_nan));
    }
}
