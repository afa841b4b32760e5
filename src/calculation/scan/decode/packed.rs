//! Records of three little-endian floats and nothing else: the fast way into a cloud.
//!
//! A scan of millions of points has to pass in a few sweeps over memory. So blocks are taken apart without a branch, and
//! checked as a whole: one x, all finite, all within the limit. Only a block that is not goes point by point.
//!
//! What is left is mostly the kernel's handing out of fresh pages, so the columns are filled in place, and no others are
//! needed. (Filling them from two threads at once was tried; the kernel made both wait.)

use super::error::DecodeError;
use super::gather::Gather;
use super::records::row_of;
use crate::scan::columns::Columns;

/// Records of a block: what is read and what is written stay in the first-level cache.
const BLOCK: usize = 512;
/// Records for which room is made at once; it is cleared before it is filled, and is still in the second-level cache then.
const ROOM: usize = 16 * 1024;
/// Points of one x from which they are worth a pass of their own.
const RUN_MIN: usize = 16;

/// The columns of y and z.
type Both<'a, R> = (&'a mut Vec<R>, &'a mut Vec<R>);

/// A record of three floats and nothing else.
pub(super) trait Packed: Copy {
    /// The float.
    type Real: Copy + Default + PartialEq + Into<f64>;
    /// x, y, z.
    fn point(&self) -> [Self::Real; 3];
    /// Whether no value is NaN or of a magnitude above `limit`.
    fn all_within(values: &[Self::Real], limit: f64) -> bool;
    /// The columns, where they are of this float.
    fn columns(columns: &mut Columns) -> Option<Both<'_, Self::Real>>;
}

impl Packed for [u8; 12] {
    type Real = f32;

    #[inline]
    fn point(&self) -> [f32; 3] {
        let (words, _) = self.as_chunks::<4>();
        let [x, y, z] = words else { return [f32::NAN; 3] };
        [f32::from_le_bytes(*x), f32::from_le_bytes(*y), f32::from_le_bytes(*z)]
    }

    fn all_within(values: &[f32], limit: f64) -> bool {
        let limit = limit as f32;
        values.iter().fold(true, |all, value| all & (value.abs() <= limit))
    }

    fn columns(columns: &mut Columns) -> Option<Both<'_, f32>> {
        if let Columns::F32 { y, z } = columns { Some((y, z)) } else { None }
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

    fn all_within(values: &[f64], limit: f64) -> bool {
        values.iter().fold(true, |all, value| all & (value.abs() <= limit))
    }

    fn columns(columns: &mut Columns) -> Option<Both<'_, f64>> {
        if let Columns::F64 { y, z } = columns { Some((y, z)) } else { None }
    }
}

/// Points that share a label and an x, as they follow each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Run {
    pub(super) label: f64,
    pub(super) x: f64,
    pub(super) count: usize,
}

/// Takes records whose coordinates are millimetres. Those before them have been taken.
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
        // One at a time they find the point that is to be refused, or the one too many.
        for record in records {
            let label = row_of(gather.seen(), row_length);
            gather.push(label, record.point().map(Into::into))?;
        }
    }
    Ok(())
}

/// Columns being filled.
struct Target<'a, R> {
    row_length: Option<usize>,
    limit: f64,
    kept: usize,
    runs: Vec<Run>,
    /// The x that the records are at, for how many, and how many stayed at the one before.
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

    /// Takes records apart, those that are not finite left out and the rest moved up: the points kept, and their runs.
    /// `None` where a point lies beyond the limit. `at` is the position of the first record in the file.
    fn fill<P: Packed<Real = R>>(mut self, mut records: &[P], mut at: usize) -> Option<(usize, Vec<Run>)> {
        while !records.is_empty() {
            let left = match self.row_length {
                Some(length) => length.max(1) - at % length.max(1),
                // Profiles of a file are mostly of one length; where that holds no block is tried in vain.
                None => self.last_stay.checked_sub(self.stay).filter(|left| *left > 0).unwrap_or(BLOCK),
            };
            let (block, _) = records.split_at(left.min(BLOCK).min(records.len()));
            let taken = self.take_some(block, row_of(at, self.row_length))?;
            at += taken;
            records = records.get(taken..).unwrap_or_default();
        }
        Some((self.kept, self.runs))
    }

    /// Takes the start of a block, all of it where it shares one x; how much.
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
        // Where x changes all the time, whole blocks would be tried in vain for each point.
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

    /// Takes a block of one x without a missing point; false, and nothing taken, where it is not.
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

    /// Takes a run of one x with missing points in it: how many are none. `None`, and nothing taken, where another x
    /// or a coordinate beyond the limit is among them.
    fn take_with_gaps<P: Packed<Real = R>>(&mut self, run: &[P], x: R) -> Option<usize> {
        let mut kept = 0;
        let mut odd = false;
        for record in run {
            let point = record.point();
            let [_, y, z] = point;
            // Overwritten by the next point where this one is missing.
            *self.y.get_mut(self.kept + kept)? = y;
            *self.z.get_mut(self.kept + kept)? = z;
            let fine = (point[0] == x) & P::all_within(&[y, z], self.limit);
            odd |= !fine & is_finite(point);
            kept += usize::from(fine);
        }
        (!odd).then_some(kept)
    }

    /// Takes what is finite, one after the other; `None` where a finite coordinate lies beyond the limit.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Limits, Precision, Unit};
    use crate::scan::{Cloud, Labels};

    fn record([x, y, z]: [f32; 3]) -> [u8; 12] {
        let bytes: Vec<u8> = [x, y, z].into_iter().flat_map(f32::to_le_bytes).collect();
        bytes.try_into().expect("twelve bytes")
    }

    /// Many blocks, rows that end within blocks, x that changes within rows, missing points.
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
    fn the_fast_way_gives_what_one_point_after_the_other_gives() {
        let (records, limits) = (records(), Limits::default());
        for row_length in [None, Some(640), Some(1280), Some(1_000_000)] {
            let mut gather = Gather::new(Unit::Millimetre, Precision::Single, &limits);
            // Twice, as from a reader whose buffer ends somewhere.
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
