//! Points in centred coordinates of about unit size, and sums over them in a fixed order.

use nalgebra::Vector3;
use rayon::prelude::*;

/// Points that one task adds up at least; the rounding of the sum grows with the square root of their number.
const CHUNK_MIN: usize = 4096;
/// Most tasks: their number depends on the points alone, so the result does not depend on the threads.
const CHUNKS_MAX: usize = 256;

/// Points with the centre and the scale that they are seen through.
#[derive(Debug, Clone, Copy)]
pub(super) struct Points<'a> {
    raw: &'a [[f64; 3]],
    centre: Vector3<f64>,
    /// A power of two, by which multiplication is exact.
    magnification: f64,
}

impl<'a> Points<'a> {
    pub(super) fn new(raw: &'a [[f64; 3]], centre: Vector3<f64>, magnification: f64) -> Self {
        Self { raw, centre, magnification }
    }

    pub(super) fn count(&self) -> usize {
        self.raw.len()
    }

    /// The point at a position, seen through centre and scale.
    pub(super) fn get(&self, index: usize) -> Option<Vector3<f64>> {
        self.raw.get(index).map(|point| self.see(point))
    }

    /// Every point in its order.
    pub(super) fn iter(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.raw.iter().map(|point| self.see(point))
    }

    /// Adds up what `terms` makes of every point: in chunks that depend on the number of points alone, and in their order.
    pub(super) fn sum<const N: usize>(&self, terms: impl Fn(Vector3<f64>) -> [f64; N] + Sync) -> [f64; N] {
        let of_chunk = |chunk: &[[f64; 3]]| {
            let mut total = [0.0; N];
            for point in chunk {
                add(&mut total, &terms(self.see(point)));
            }
            total
        };
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

    /// The point for which `measure` is greatest, with that value; the first of equals.
    pub(super) fn farthest(&self, measure: impl Fn(&Vector3<f64>) -> f64) -> (Vector3<f64>, f64) {
        self.iter().fold((Vector3::zeros(), 0.0), |best, point| {
            let value = measure(&point);
            if value > best.1 { (point, value) } else { best }
        })
    }

    #[inline]
    fn see(&self, point: &[f64; 3]) -> Vector3<f64> {
        (Vector3::from(*point) - self.centre) * self.magnification
    }
}

#[inline]
fn add<const N: usize>(total: &mut [f64; N], terms: &[f64; N]) {
    for (sum, term) in total.iter_mut().zip(terms) {
        *sum += term;
    }
}
