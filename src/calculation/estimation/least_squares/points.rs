//! Points in centred coordinates of about unit size, and sums over them in a fixed order.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Least number of points that one task adds up; the rounding of the sum grows with the square root of the number of points.
const CHUNK_MIN: usize = 4096;
/// Largest number of tasks, which depends only on the points, so that the result does not depend on the number of threads.
const CHUNKS_MAX: usize = 256;

/// Points that are processed at once.
const LANES: usize = 8;

/// Points with the centre and the scale that are applied to them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Points<'a> {
    raw: &'a [[f64; 3]],
    centre: Vector3<f64>,
    /// A power of two, so that multiplication is exact.
    magnification: f64,
}

impl<'a> Points<'a> {
    pub(super) fn new(raw: &'a [[f64; 3]], centre: Vector3<f64>, magnification: f64) -> Self {
        Self { raw, centre, magnification }
    }

    pub(super) fn count(&self) -> usize {
        self.raw.len()
    }

    /// The point at an index, after centring and scaling.
    pub(super) fn get(&self, index: usize) -> Option<Vector3<f64>> {
        self.raw.get(index).map(|point| self.see(point))
    }

    /// All points in their order.
    pub(super) fn iter(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.raw.iter().map(|point| self.see(point))
    }

    /// Adds up the terms of all points in a fixed order, in chunks that depend only on the number of points.
    pub(super) fn sum<const N: usize>(&self, terms: &impl Terms<N>) -> [f64; N] {
        let of_chunk = |chunk| Arch::new().dispatch(Sum { points: self, chunk, terms });
        let chunk = self.raw.len().div_ceil(CHUNKS_MAX).max(CHUNK_MIN);
        if self.raw.len() <= chunk {
            return of_chunk(self.raw);
        }
        let parts: Vec<[f64; N]> = self.raw.par_chunks(chunk).map(of_chunk).collect();
        parts.iter().fold([0.0; N], |mut total, part| {
            add(&mut total, part);
            total
        })
    }

    /// The point with the largest `measure` and its value; the first of equal ones.
    pub(super) fn farthest(&self, measure: impl Fn(&Vector3<f64>) -> f64) -> (Vector3<f64>, f64) {
        self.iter().fold((Vector3::zeros(), 0.0), |best, point| {
            let value = measure(&point);
            if value > best.1 { (point, value) } else { best }
        })
    }

    #[inline(always)]
    fn see(&self, point: &[f64; 3]) -> Vector3<f64> {
        (Vector3::from(*point) - self.centre) * self.magnification
    }
}

#[inline(always)]
fn add<const N: usize>(total: &mut [f64; N], terms: &[f64; N]) {
    for (sum, term) in total.iter_mut().zip(terms) {
        *sum += term;
    }
}

/// Terms of a sum over points whose coordinates are stored by component.
pub(super) trait Terms<const N: usize>: Sync {
    /// The terms of [`LANES`] points.
    fn of(&self, x: Lanes, y: Lanes, z: Lanes) -> [Lanes; N];
}

struct Sum<'a, T, const N: usize> {
    points: &'a Points<'a>,
    chunk: &'a [[f64; 3]],
    terms: &'a T,
}

impl<T: Terms<N>, const N: usize> WithSimd for Sum<'_, T, N> {
    type Output = [f64; N];

    // Uses the instructions of the processor; the order of the additions is always the same.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; N] {
        let mut total = [[0.0; LANES]; N];
        for block in self.chunk.chunks(LANES) {
            let (mut x, mut y, mut z, mut there) = ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
            let places = x.iter_mut().zip(&mut y).zip(&mut z).zip(&mut there);
            for ((((x, y), z), there), point) in places.zip(block) {
                let seen = self.points.see(point);
                (*x, *y, *z, *there) = (seen.x, seen.y, seen.z, 1.0);
            }
            let terms = self.terms.of(Lanes(x), Lanes(y), Lanes(z));
            for (total, term) in total.iter_mut().zip(terms) {
                let term = term * Lanes(there);
                let (totals, terms) = (S::as_mut_simd_f64s(total).0, S::as_simd_f64s(&term.0).0);
                for (total, term) in totals.iter_mut().zip(terms) {
                    *total = simd.add_f64s(*total, *term);
                }
            }
        }
        total.map(|lanes| lanes.iter().sum())
    }
}

/// Numbers of several points, processed together.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes([f64; LANES]);

impl Lanes {
    /// The same number for every point.
    #[inline(always)]
    pub(super) fn all(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    pub(super) fn map(self, change: impl Fn(f64) -> f64) -> Self {
        Self(self.0.map(change))
    }

    #[inline(always)]
    fn with(mut self, other: Self, combine: impl Fn(f64, f64) -> f64) -> Self {
        for (one, other) in self.0.iter_mut().zip(other.0) {
            *one = combine(*one, other);
        }
        self
    }
}

impl std::ops::Add for Lanes {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(other, |one, other| one + other)
    }
}

impl std::ops::Sub for Lanes {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(other, |one, other| one - other)
    }
}

impl std::ops::Mul for Lanes {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(other, |one, other| one * other)
    }
}
