//! The sums that one Gauss-Newton or Newton step needs, over the points of one profile: the hot loop of the method.
//! Must not know where the weights' scale comes from or what becomes of the step.

use super::model::{Cylinder, Response, Slice};
use nalgebra::{Matrix5, Vector5};

/// What re-weights the points of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weighting {
    /// Square of Tukey's cut-off distance, mm².
    pub(super) cut_off_squared: f64,
    /// What stands in the normal matrix.
    pub(super) curvature: Curvature,
}

/// How a point bends the cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Curvature {
    /// By its weight w: never negative, so the step leads downhill from far away (iteratively re-weighted least squares).
    Weight,
    /// By the slope ψ′ of w·d: Newton's step, quadratic near the solution; also the bread of the sandwich covariance.
    Slope,
}

/// Sums over points: gradient Σ w·d·J and normal matrix Σ k·J Jᵀ of (p, q, y_ref, z_ref, R).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sums {
    pub(super) gradient: Vector5<f64>,
    pub(super) normal: Matrix5<f64>,
    /// Σ w.
    pub(super) weight: f64,
}

const LANES: usize = 8;
/// Where a lane without a point looks, mm: beyond every cut-off.
const FAR: f64 = 1e12;
const TERMS: usize = 20;

impl Sums {
    pub(super) fn zero() -> Self {
        Self { gradient: Vector5::zeros(), normal: Matrix5::zeros(), weight: 0.0 }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.gradient += other.gradient;
        self.normal += other.normal;
        self.weight += other.weight;
    }
}

/// Sums over the points (y, z) of the profile at `x`.
pub(super) fn sum(cylinder: &Cylinder, x: f64, y: &[f64], z: &[f64], weighting: Weighting) -> Sums {
    let slice = cylinder.slice(x);
    let totals = match weighting.curvature {
        Curvature::Weight => lanes::<false>(&slice, y, z, 1.0 / weighting.cut_off_squared),
        Curvature::Slope => lanes::<true>(&slice, y, z, 1.0 / weighting.cut_off_squared),
    };
    expand(&totals)
}

fn lanes<const SLOPE: bool>(slice: &Slice, y: &[f64], z: &[f64], per_cut2: f64) -> [f64; TERMS] {
    let mut totals = [[0.0; LANES]; TERMS];
    let (y_whole, y_rest) = y.as_chunks::<LANES>();
    let (z_whole, z_rest) = z.as_chunks::<LANES>();
    for (y, z) in y_whole.iter().zip(z_whole) {
        add::<SLOPE>(&mut totals, slice, y, z, per_cut2);
    }
    for (&y, &z) in y_rest.iter().zip(z_rest) {
        // One point beside places so far away that they have no weight.
        let (mut ys, mut zs) = ([FAR; LANES], [0.0; LANES]);
        if let (Some(first_y), Some(first_z)) = (ys.first_mut(), zs.first_mut()) {
            (*first_y, *first_z) = (y, z);
        }
        add::<SLOPE>(&mut totals, slice, &ys, &zs, per_cut2);
    }
    totals.map(|lane| lane.iter().sum())
}

#[inline(always)]
fn add<const SLOPE: bool>(
    totals: &mut [[f64; LANES]; TERMS],
    slice: &Slice,
    y: &[f64; LANES],
    z: &[f64; LANES],
    per_cut2: f64,
) {
    for i in 0..LANES {
        #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
        let (y, z) = (y[i], z[i]);
        let Response { d, a, b, t } = slice.response(y, z);
        let share = (d * d * per_cut2).min(1.0);
        let rest = 1.0 - share;
        let w = rest * rest;
        let k = if SLOPE { rest * (1.0 - 5.0 * share) } else { w };
        let wd = w * d;
        let (ka, kb) = (k * a, k * b);
        let (kaa, kab, kbb) = (ka * a, ka * b, kb * b);
        let (wda, wdb) = (wd * a, wd * b);
        let terms = [
            w,
            wd,
            wda,
            wdb,
            wda * t,
            wdb * t,
            k,
            ka,
            kb,
            kaa,
            kab,
            kbb,
            ka * t,
            kb * t,
            kaa * t,
            kab * t,
            kbb * t,
            kaa * t * t,
            kab * t * t,
            kbb * t * t,
        ];
        for (total, term) in totals.iter_mut().zip(terms) {
            #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
            {
                total[i] += term;
            }
        }
    }
}

#[rustfmt::skip]
fn expand(totals: &[f64; TERMS]) -> Sums {
    let [w, wd, wda, wdb, wdat, wdbt, k, ka, kb, kaa, kab, kbb, kat, kbt, kaat, kabt, kbbt, kaatt, kabtt, kbbtt] = *totals;
    Sums {
        weight: w,
        gradient: Vector5::new(wdat, wdbt, wda, wdb, -wd),
        normal: Matrix5::new(
            kaatt, kabtt, kaat, kabt, -kat,
            kabtt, kbbtt, kabt, kbbt, -kbt,
            kaat, kabt, kaa, kab, -ka,
            kabt, kbbt, kab, kbb, -kb,
            -kat, -kbt, -ka, -kb, k,
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sums_are_those_of_the_points_one_by_one() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let section = cylinder.axis().section(50.0, 70.0);
        let points: Vec<[f64; 2]> = (0..21)
            .map(|i| section.point(f64::from(i) * 0.1))
            .enumerate()
            .map(|(i, [y, z])| [y + 0.01 * (i as f64 * 1.7).sin(), z + if i == 5 { 9.0 } else { 0.0 }])
            .collect();
        let (y, z): (Vec<f64>, Vec<f64>) = points.iter().map(|[y, z]| (*y, *z)).unzip();
        for curvature in [Curvature::Weight, Curvature::Slope] {
            let weighting = Weighting { cut_off_squared: 0.0004, curvature };
            let mut expected = Sums::zero();
            for [y, z] in &points {
                let Response { d, a, b, t } = cylinder.slice(70.0).response(*y, *z);
                let rest = (1.0 - d * d / 0.0004).max(0.0);
                let bend =
                    if curvature == Curvature::Weight { rest * rest } else { rest * (1.0 - 5.0 * d * d / 0.0004) };
                let row = Vector5::new(a * t, b * t, a, b, -1.0);
                expected.gradient += row * (rest * rest * d);
                expected.normal += row * row.transpose() * bend;
                expected.weight += rest * rest;
            }
            let found = sum(&cylinder, 70.0, &y, &z, weighting);
            assert!((found.gradient - expected.gradient).norm() < 1e-9 * expected.gradient.norm());
            assert!((found.normal - expected.normal).norm() < 1e-9 * expected.normal.norm());
            assert!((found.weight - expected.weight).abs() < 1e-9);
        }
    }
}
