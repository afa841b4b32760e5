//! A block of projected points in the first-level cache, and sums over it, eight lanes wide whatever the processor.
//!
//! Eight partial sums in a fixed order and no fused multiply-add: the bits are the same with vectors of eight, four, two or
//! one. What runs on every point is a method that is always inlined, never a closure: the compiler may leave a closure out of
//! line, and then it does not use the instructions that were chosen.

use super::projection::{Oblique, Projection};
use pulp::Simd;

pub(super) const LANES: usize = 8;
pub(super) const BLOCK: usize = 128;
/// Where a lane without a point lies, mm: beyond every cut-off.
const FAR: f64 = 1e12;

/// A few projected points; lanes beyond the last lie far away.
pub(super) struct Block {
    cos: [f64; BLOCK],
    sin: [f64; BLOCK],
    distance: [f64; BLOCK],
    axial: [f64; BLOCK],
    rows_count: usize,
}

/// Where the points of a block are along x.
#[derive(Debug, Clone, Copy)]
pub(super) enum Place<'a> {
    /// All in one plane x = const.
    Plane(&'a Projection),
    /// Each at an x of its own.
    Own(&'a Oblique, &'a [f64]),
}

/// Some points of a block: direction from the axis, distance from the surface and offset along the axis. The offset counts from
/// where the axis meets the plane of the profile, or from the reference point where each point has an x of its own.
#[derive(Clone, Copy)]
pub(super) struct Points<V> {
    pub(super) cos: V,
    pub(super) sin: V,
    pub(super) distance: V,
    pub(super) axial: V,
}

/// How points change N running values.
pub(super) trait Fold<const N: usize> {
    /// The values with these points in them.
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; N], points: Points<S::f64s>) -> [S::f64s; N];
}

impl Block {
    #[inline(always)]
    pub(super) fn empty() -> Self {
        let (cos, sin, distance, axial) = ([0.0; BLOCK], [0.0; BLOCK], [FAR; BLOCK], [0.0; BLOCK]);
        Self { cos, sin, distance, axial, rows_count: 0 }
    }

    /// Takes in the points (y, z), at most as many as a block holds.
    #[inline(always)]
    pub(super) fn fill<T: Copy + Into<f64>>(&mut self, place: Place<'_>, y: &[T], z: &[T]) {
        match place {
            Place::Plane(projection) => self.fill_plane(projection, y, z),
            Place::Own(oblique, x) => self.fill_own(oblique, x, y, z),
        }
    }

    #[inline(always)]
    fn fill_own<T: Copy + Into<f64>>(&mut self, oblique: &Oblique, x: &[f64], y: &[T], z: &[T]) {
        let count = x.len().min(y.len()).min(z.len());
        let directions = self.cos.iter_mut().zip(&mut self.sin);
        let offsets = self.distance.iter_mut().zip(&mut self.axial);
        for (((cos, sin), (d, axial)), (&x, (&y, &z))) in directions.zip(offsets).zip(x.iter().zip(y.iter().zip(z))) {
            let [across, up, along] = oblique.place([x, y.into(), z.into()]);
            let rho2 = across * across + up * up;
            let rho = if rho2 > f64::MIN_POSITIVE { rho2 } else { f64::MIN_POSITIVE }.sqrt();
            let per_rho = 1.0 / rho;
            (*cos, *sin, *d) = (across * per_rho, up * per_rho, rho - oblique.radius);
            *axial = along;
        }
        self.distance.iter_mut().skip(count).for_each(|d| *d = FAR);
        self.rows_count = count.div_ceil(LANES);
    }

    #[inline(always)]
    fn fill_plane<T: Copy + Into<f64>>(&mut self, projection: &Projection, y: &[T], z: &[T]) {
        let count = y.len().min(z.len());
        let directions = self.cos.iter_mut().zip(&mut self.sin);
        let offsets = self.distance.iter_mut().zip(&mut self.axial);
        for (((cos, sin), (d, axial)), (&y, &z)) in directions.zip(offsets).zip(y.iter().zip(z)) {
            let [across, up] = projection.place(y.into(), z.into());
            let rho2 = across * across + up * up;
            let rho = if rho2 > f64::MIN_POSITIVE { rho2 } else { f64::MIN_POSITIVE }.sqrt();
            let per_rho = 1.0 / rho;
            (*cos, *sin, *d) = (across * per_rho, up * per_rho, rho - projection.radius);
            *axial = projection.axial(across, up);
        }
        self.distance.iter_mut().skip(count).for_each(|d| *d = FAR);
        self.rows_count = count.div_ceil(LANES);
    }

    /// Folds all points into `values`, each into its lane.
    #[inline(always)]
    pub(super) fn fold<S: Simd, const N: usize>(&self, simd: S, values: &mut [[f64; LANES]; N], fold: &impl Fold<N>) {
        let strips_count = LANES / S::F64_LANES;
        let zero = simd.splat_f64s(0.0);
        let [cos, sin, distance, axial] =
            [&self.cos, &self.sin, &self.distance, &self.axial].map(|column| S::as_simd_f64s(column).0);
        // As many lanes as fit a register go down the whole block, so that their values never leave the registers.
        for strip in 0..strips_count {
            let mut running = [zero; N];
            for (running, lanes) in running.iter_mut().zip(values.iter()) {
                *running = S::as_simd_f64s(lanes).0.get(strip).copied().unwrap_or(zero);
            }
            let directions = cos.chunks_exact(strips_count).zip(sin.chunks_exact(strips_count));
            let offsets = distance.chunks_exact(strips_count).zip(axial.chunks_exact(strips_count));
            for ((cos, sin), (distance, axial)) in directions.zip(offsets).take(self.rows_count) {
                let [cos, sin, distance, axial] =
                    [cos, sin, distance, axial].map(|row| row.get(strip).copied().unwrap_or(zero));
                running = fold.fold(simd, running, Points { cos, sin, distance, axial });
            }
            for (running, lanes) in running.iter().zip(values.iter_mut()) {
                if let Some(lanes) = S::as_mut_simd_f64s(lanes).0.get_mut(strip) {
                    *lanes = *running;
                }
            }
        }
    }
}
