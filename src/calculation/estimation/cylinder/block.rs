//! A block of projected points that fits the first-level cache, sums over it in eight lanes, and the moments that follow from the
//! sums.
//!
//! Eight partial sums in a fixed order without fused multiply-add give the same bits with vectors of eight, four, two or one lanes.
//! The code that runs on every point is an always inlined method and not a closure: the compiler may leave a closure out of line,
//! where it does not use the selected instructions.
//!
//! The gradient and the normal matrix follow from weighted moments. Where all points lie in one plane x = const, fifteen moments
//! suffice, because the lever of the slopes follows from the direction; points with individual x need nineteen.

use super::model::{Oblique, Projection};
use super::normal_equations::Sums;
use nalgebra::{Matrix2, Matrix5, Vector2, Vector5};
use pulp::Simd;

pub(super) const LANES: usize = 8;
pub(super) const BLOCK: usize = 128;
/// Coordinate of an unused lane, mm: beyond every cut-off.
const FAR: f64 = 1e12;

/// A few projected points; unused lanes are filled with a far point.
pub(super) struct Block {
    cos: [f64; BLOCK],
    sin: [f64; BLOCK],
    distance: [f64; BLOCK],
    axial: [f64; BLOCK],
    rows_count: usize,
}

/// Positions of the points of a block along x.
#[derive(Debug, Clone, Copy)]
pub(super) enum Place<'a> {
    /// All in one plane x = const.
    Plane(&'a Projection),
    /// Each at its own x.
    Own(&'a Oblique, &'a [f64]),
}

/// Some points of a block: direction from the axis, distance from the surface and offset along the axis. The offset counts from the
/// intersection of the axis with the plane of the profile or, for points with individual x, from the reference point.
#[derive(Clone, Copy)]
pub(super) struct Points<V> {
    pub(super) cos: V,
    pub(super) sin: V,
    pub(super) distance: V,
    pub(super) axial: V,
}

/// Folds points into N running values.
pub(super) trait Fold<const N: usize> {
    /// The values after these points.
    fn fold<S: Simd>(&self, simd: S, values: [S::f64s; N], points: Points<S::f64s>) -> [S::f64s; N];
}

impl Block {
    #[inline(always)]
    pub(super) fn empty() -> Self {
        let (cos, sin, distance, axial) = ([0.0; BLOCK], [0.0; BLOCK], [FAR; BLOCK], [0.0; BLOCK]);
        Self { cos, sin, distance, axial, rows_count: 0 }
    }

    /// Projects the points (y, z), at most as many as a block contains.
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
        // Each group of lanes that fits a register runs down the whole block, so that its values stay in the registers.
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

/// Sums over points with the direction (C, S) from the axis, the distance d from the surface, the axial offset s, Tukey's
/// weight w and the curvature k.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moments {
    /// Σ w,
    pub(super) weight: f64,
    /// Σ w·d, w·d·C, w·d·S, w·d·C·s and w·d·S·s,
    pub(super) pull: [f64; 5],
    /// Σ k, k·C, k·S, k·C², k·CS, k·C³, k·C²S, k·C⁴ and k·C³S: with C² + S² = 1 they are all moments to the fourth order.
    pub(super) bend: [f64; 9],
}

/// The same sums as [`Moments`] for points with individual x, with the lever t in place of s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OwnMoments {
    /// Σ w,
    pub(super) weight: f64,
    /// Σ w·d, w·d·C, w·d·S, w·d·C·t and w·d·S·t,
    pub(super) pull: [f64; 5],
    /// Σ k, k·C, k·S, k·C² and k·CS,
    pub(super) bend: [f64; 5],
    /// Σ k·t, k·t·C, k·t·S, k·t·C², k·t·CS, k·t², k·t²·C² and k·t²·CS.
    pub(super) lever: [f64; 8],
}

impl Moments {
    /// The sums in the parameters along e₁ and e₂.
    ///
    /// The gradient is exact. The normal matrix uses s at the surface, R(−e₁ₓC − e₂ₓS): a relative error of d/R in a term that is
    /// small itself, like the second derivative of ρ, which the Gauss-Newton step omits.
    pub(super) fn sums(&self, projection: &Projection) -> Sums {
        let dx = projection.dx;
        let [wd, wdc, wds, wdcs, wdss] = self.pull;
        let [k, c, s, cc, cs, ccc, ccs, cccc, cccs] = self.bend;
        let (ss, css, sss) = (k - cc, c - ccc, s - ccs);
        let (ccss, csss) = (cc - cccc, cs - cccs);
        let ssss = ss - ccss;
        let [a, b] = projection.axial.map(|part| part * projection.radius);
        // Σ k·(C, S)ᵀ(C, S) times 1, s and s², and Σ k·(C, S) times 1 and s.
        let plain = Matrix2::new(cc, cs, cs, ss);
        let once = Matrix2::new(ccc, ccs, ccs, css) * a + Matrix2::new(ccs, css, css, sss) * b;
        let twice = Matrix2::new(cccc, cccs, cccs, ccss) * (a * a)
            + Matrix2::new(cccs, ccss, ccss, csss) * (2.0 * a * b)
            + Matrix2::new(ccss, csss, csss, ssss) * (b * b);
        let (lever, edge) = (plain * dx + once, Vector2::new(c, s));
        let slopes = plain * (dx * dx) + once * (2.0 * dx) + twice;
        let slope_edge = edge * dx + plain * Vector2::new(a, b);
        let mut normal = Matrix5::zeros();
        normal.fixed_view_mut::<2, 2>(0, 0).copy_from(&slopes);
        normal.fixed_view_mut::<2, 2>(0, 2).copy_from(&lever);
        normal.fixed_view_mut::<2, 2>(2, 0).copy_from(&lever);
        normal.fixed_view_mut::<2, 2>(2, 2).copy_from(&plain);
        normal.fixed_view_mut::<2, 1>(0, 4).copy_from(&slope_edge);
        normal.fixed_view_mut::<1, 2>(4, 0).copy_from(&slope_edge.transpose());
        normal.fixed_view_mut::<2, 1>(2, 4).copy_from(&edge);
        normal.fixed_view_mut::<1, 2>(4, 2).copy_from(&edge.transpose());
        normal.fixed_view_mut::<1, 1>(4, 4).fill(k);
        let gradient = -Vector5::new(wdc * dx + wdcs, wds * dx + wdss, wdc, wds, wd);
        Sums { gradient, normal, weight: self.weight }
    }
}

impl OwnMoments {
    /// The sums in the parameters along e₁ and e₂; both are exact except for the second derivative of ρ, which the Gauss-Newton
    /// step omits.
    pub(super) fn sums(&self) -> Sums {
        let [wd, wdc, wds, wdct, wdst] = self.pull;
        let [k, c, s, cc, cs] = self.bend;
        let [t, tc, ts, tcc, tcs, tt, ttcc, ttcs] = self.lever;
        #[rustfmt::skip]
        let normal = Matrix5::new(
            ttcc, ttcs, tcc, tcs, tc,
            ttcs, tt - ttcc, tcs, t - tcc, ts,
            tcc, tcs, cc, cs, c,
            tcs, t - tcc, cs, k - cc, s,
            tc, ts, c, s, k,
        );
        Sums { gradient: -Vector5::new(wdct, wdst, wdc, wds, wd), normal, weight: self.weight }
    }
}
