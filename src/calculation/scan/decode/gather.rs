//! The central function by which all readers add points to a cloud: it scales them, leaves out missing points, refuses coordinates
//! that are out of range, and run-length encodes label and x.

use super::error::DecodeError;
use super::limits::Limits;
use crate::scan::cloud::{Cloud, Labels, Stripe, Unit};
use crate::scan::columns::{self, Columns};
use std::collections::HashSet;

/// The precision of a file's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Precision {
    /// Every coordinate is an `f32`.
    Single,
    /// Some are `f64`.
    Double,
}

/// A cloud under construction.
pub(super) struct Gather<'a> {
    limits: &'a Limits,
    unit: Unit,
    scale: f64,
    seen: usize,
    missing: u64,
    /// Labels and planes of missing points with a known plane, mm.
    blanks: Vec<(f64, f64)>,
    stripes: Vec<Stripe>,
    columns: Columns,
}

impl<'a> Gather<'a> {
    /// An empty cloud. Single precision is retained if no scaling is needed.
    pub(super) fn new(unit: Unit, precision: Precision, limits: &'a Limits) -> Self {
        let columns = match (unit, precision) {
            (Unit::Millimetre, Precision::Single) => Columns::F32 { y: Vec::new(), z: Vec::new() },
            _ => Columns::F64 { y: Vec::new(), z: Vec::new() },
        };
        Self {
            limits,
            unit,
            scale: unit.in_mm(),
            seen: 0,
            missing: 0,
            blanks: Vec::new(),
            stripes: Vec::new(),
            columns,
        }
    }

    /// Reserves space for `points` more, which the caller has found in the input; not exactly that number, since there may be many
    /// such calls.
    pub(super) fn reserve(&mut self, points: usize) {
        let points = points.min(self.limits.points_max);
        match &mut self.columns {
            Columns::F32 { y, z } => {
                columns::reserve(y, points);
                columns::reserve(z, points);
            }
            Columns::F64 { y, z } => {
                columns::reserve(y, points);
                columns::reserve(z, points);
            }
        }
    }

    /// Number of points so far, missing ones included.
    pub(super) fn seen(&self) -> usize {
        self.seen
    }

    /// Largest coordinate that is stored without conversion; `None` if the file's unit is not the millimetre.
    pub(super) fn plain_limit(&self) -> Option<f64> {
        (self.scale == 1.0).then_some(self.limits.coordinate_max_mm)
    }

    /// Adds one point in the file's unit; a point that is not finite counts as missing.
    pub(super) fn push(&mut self, label: f64, point: [f64; 3]) -> Result<(), DecodeError> {
        let index = self.seen;
        self.count(1)?;
        let [x, y, z] = point.map(|value| value * self.scale);
        let limit = self.limits.coordinate_max_mm;
        // The comparison is written so that NaN fails it.
        if !(x.abs() <= limit && y.abs() <= limit && z.abs() <= limit && label.is_finite()) {
            return self.turn_away(index, label, point);
        }
        let end = match &mut self.columns {
            Columns::F32 { y: ys, z: zs } => {
                ys.push(y as f32);
                zs.push(z as f32);
                ys.len()
            }
            Columns::F64 { y: ys, z: zs } => {
                ys.push(y);
                zs.push(z);
                ys.len()
            }
        };
        self.extend_stripe(label, x, end);
        Ok(())
    }

    /// Adds `count` points at once: `fill` writes the finite points within [`Self::plain_limit`], in millimetres, to the start of
    /// the space reserved for all, and returns their number. Returns false, and adds nothing, if a point has to be refused or there
    /// are too many.
    pub(super) fn fill<P: Packed>(
        &mut self,
        count: usize,
        fill: impl FnOnce(&mut [P::Real], &mut [P::Real]) -> Option<(usize, Vec<Run>)>,
    ) -> bool {
        if count > self.limits.points_max.saturating_sub(self.seen) {
            return false;
        }
        let Some((y, z)) = P::columns(&mut self.columns) else { return false };
        let mut end = y.len();
        y.resize(end + count, P::Real::default());
        z.resize(end + count, P::Real::default());
        let filled = y.get_mut(end..).zip(z.get_mut(end..)).and_then(|(y, z)| fill(y, z));
        let kept = filled.as_ref().map_or(0, |(kept, _)| *kept);
        y.truncate(end + kept);
        z.truncate(end + kept);
        let Some((_, runs)) = filled else { return false };
        self.seen += count;
        self.missing += count.saturating_sub(kept) as u64;
        for run in &runs {
            end += run.count;
            self.extend_stripe(run.label, run.x, end);
        }
        true
    }

    /// The finished cloud.
    ///
    /// # Errors
    /// [`DecodeError::NoPoints`] if all points are missing.
    pub(super) fn finish(self, labels: Labels) -> Result<Cloud, DecodeError> {
        if self.columns.is_empty() {
            return Err(DecodeError::NoPoints { missing_count: self.missing });
        }
        let blanks = self.blanks_without_points();
        let Self { stripes, columns, unit, missing: missing_count, .. } = self;
        Ok(Cloud { stripes, columns, labels, unit, blanks, missing_count })
    }

    /// Adds a profile without a point, at x in the file's unit.
    pub(super) fn push_blank(&mut self, label: f64, x: f64) {
        let blank = (label, x * self.scale);
        let known = label.is_finite() && blank.1.abs() <= self.limits.coordinate_max_mm;
        if known && self.blanks.len() < self.limits.profiles_max && self.blanks.last() != Some(&blank) {
            self.blanks.push(blank);
        }
    }

    /// The planes of labels without points.
    fn blanks_without_points(&self) -> Vec<f64> {
        if self.blanks.is_empty() {
            return Vec::new();
        }
        let full: HashSet<u64> = self.stripes.iter().map(|stripe| stripe.label.to_bits()).collect();
        self.blanks.iter().filter(|(label, _)| !full.contains(&label.to_bits())).map(|(_, x)| *x).collect()
    }

    fn count(&mut self, points: usize) -> Result<(), DecodeError> {
        if points > self.limits.points_max.saturating_sub(self.seen) {
            return Err(DecodeError::TooManyPoints { limit: self.limits.points_max });
        }
        self.seen += points;
        Ok(())
    }

    #[cold]
    fn turn_away(&mut self, index: usize, label: f64, point: [f64; 3]) -> Result<(), DecodeError> {
        if !(label.is_finite() && point.iter().all(|value| value.is_finite())) {
            self.missing += 1;
            let [x, ..] = point;
            self.push_blank(label, x);
            return Ok(());
        }
        let limit = self.limits.coordinate_max_mm;
        let value = point
            .into_iter()
            .map(|value| value * self.scale)
            .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        Err(DecodeError::CoordinateOutOfRange { index, value, limit })
    }

    fn extend_stripe(&mut self, label: f64, x: f64, end: usize) {
        match self.stripes.last_mut() {
            Some(last) if last.x == x && last.label == label => last.end = end,
            _ => self.stripes.push(Stripe { label, x, end }),
        }
    }
}

/// The columns of y and z.
pub(super) type Both<'a, R> = (&'a mut Vec<R>, &'a mut Vec<R>);

/// A record of exactly three floats.
pub(super) trait Packed: Copy {
    /// The float.
    type Real: Copy + Default + PartialEq + Into<f64>;
    /// x, y, z.
    fn point(&self) -> [Self::Real; 3];
    /// Whether no value is NaN or exceeds `limit` in magnitude.
    fn all_within(values: &[Self::Real], limit: f64) -> bool;
    /// The columns, if they have this type.
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

/// Consecutive points that share a label and an x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Run {
    pub(super) label: f64,
    pub(super) x: f64,
    pub(super) count: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_one_label_and_x_share_a_stripe() {
        let limits = Limits::default();
        let mut gather = Gather::new(Unit::Metre, Precision::Single, &limits);
        for (label, x, y) in [(0.0, 1.0, 1.0), (0.0, 1.0, f64::NAN), (0.0, 1.0, 2.0), (1.0, 1.0, 3.0), (1.0, 2.0, 4.0)]
        {
            gather.push(label, [x, y, 0.5]).expect("in range");
        }
        let cloud = gather.finish(Labels::Row).expect("points");
        assert_eq!(cloud.missing_count, 1);
        let stripe = |label, x, end| Stripe { label, x, end };
        assert_eq!(cloud.stripes, [stripe(0.0, 1000.0, 2), stripe(1.0, 1000.0, 3), stripe(1.0, 2000.0, 4)]);
        assert_eq!(cloud.columns, Columns::F64 { y: vec![1e3, 2e3, 3e3, 4e3], z: vec![500.0; 4] });
    }

    #[test]
    fn a_row_of_missing_points_is_blank_where_its_plane_is_known() {
        let limits = Limits::default();
        let mut gather = Gather::new(Unit::Metre, Precision::Double, &limits);
        for (label, x, y) in [(0.0, 1.0, f64::NAN), (0.0, 1.0, 2.0), (1.0, 2.0, f64::NAN), (2.0, f64::NAN, f64::NAN)] {
            gather.push(label, [x, y, 0.5]).expect("in range");
        }
        gather.push_blank(3.0, 4.0);
        let cloud = gather.finish(Labels::Row).expect("points");
        assert_eq!((cloud.blanks, cloud.missing_count), (vec![2000.0, 4000.0], 3));
    }

    #[test]
    fn a_coordinate_that_scaling_makes_infinite_is_refused_and_named() {
        let limits = Limits::default();
        let mut gather = Gather::new(Unit::Metre, Precision::Double, &limits);
        gather.push(0.0, [0.0; 3]).expect("in range");
        let error = gather.push(0.0, [0.0, -1e308, 0.0]).expect_err("huge");
        assert!(matches!(error, DecodeError::CoordinateOutOfRange { index: 1, .. }), "{error}");
    }

    #[test]
    fn missing_points_count_against_the_limit() {
        let limits = Limits { points_max: 3, ..Limits::default() };
        let mut gather = Gather::new(Unit::Millimetre, Precision::Double, &limits);
        gather.push(0.0, [f64::NAN; 3]).expect("within");
        gather.push(f64::NAN, [0.0; 3]).expect("within");
        gather.push(0.0, [0.0; 3]).expect("within");
        assert_eq!(gather.push(0.0, [0.0; 3]).expect_err("beyond").code(), "too_many_points");
    }
}
