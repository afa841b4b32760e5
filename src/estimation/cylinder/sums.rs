//! The sums that one Gauss-Newton or Newton step needs, over the points of one profile. Must not know where the weights'
//! scale comes from, what becomes of the step, or how a point is looked at.

use super::kernel::{Curvature, Inner, Sweep};
use super::projection::Projection;
use crate::scan::Stretch;
use nalgebra::{Matrix5, Vector5};

/// Sums over points: gradient Σ w·d·J and normal matrix Σ k·J Jᵀ of (p, q, y_ref, z_ref, R).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sums {
    pub(super) gradient: Vector5<f64>,
    pub(super) normal: Matrix5<f64>,
    /// Σ w.
    pub(super) weight: f64,
}

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

/// Sums over the points of a profile, in the parameters of its projection.
pub(super) fn sum(projection: &Projection, points: Stretch<'_>, cut_off_squared: f64, curvature: Curvature) -> Sums {
    let per_cut2 = 1.0 / cut_off_squared;
    let moments = match points {
        Stretch::F32 { y, z } => Sweep { projection, y, z }.moments(per_cut2, curvature),
        Stretch::F64 { y, z } => Sweep { projection, y, z }.moments(per_cut2, curvature),
    };
    projection.sums(&moments)
}

/// The same for Newton's step, with what lies within `epsilon`, mm.
pub(super) fn sum_and_count(
    projection: &Projection,
    points: Stretch<'_>,
    cut_off_squared: f64,
    epsilon: f64,
) -> (Sums, Inner) {
    let (per_cut2, epsilon2) = (1.0 / cut_off_squared, epsilon * epsilon);
    let (moments, inner) = match points {
        Stretch::F32 { y, z } => Sweep { projection, y, z }.moments_and_inner(per_cut2, epsilon2),
        Stretch::F64 { y, z } => Sweep { projection, y, z }.moments_and_inner(per_cut2, epsilon2),
    };
    (projection.sums(&moments), inner)
}

#[cfg(test)]
mod tests {
    use super::super::model::{Cylinder, Response};
    use super::*;

    #[test]
    fn the_sums_are_those_of_the_points_one_by_one() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let section = cylinder.axis().section(50.0, 70.0);
        let (y, z): (Vec<f64>, Vec<f64>) = (0..21)
            .map(|i| section.point(f64::from(i) * 0.1))
            .enumerate()
            .map(|(i, [y, z])| (y + 0.01 * (i as f64 * 1.7).sin(), z + if i == 5 { 9.0 } else { 0.0 }))
            .unzip();
        let view = cylinder.facing([0.3, 0.8]);
        let points = Stretch::F64 { y: &y, z: &z };
        for curvature in [Curvature::Weight, Curvature::Slope] {
            let found = view.unturned(&sum(&view.at(70.0), points, 0.0004, curvature));
            let mut expected = Sums::zero();
            for (y, z) in y.iter().zip(&z) {
                let Response { d, a, b, t } = cylinder.slice(70.0).response(*y, *z);
                let rest = (1.0 - d * d / 0.0004).max(0.0);
                let bend =
                    if curvature == Curvature::Weight { rest * rest } else { rest * (1.0 - 5.0 * d * d / 0.0004) };
                let row = Vector5::new(a * t, b * t, a, b, -1.0);
                expected.gradient += row * (rest * rest * d);
                expected.normal += row * row.transpose() * bend;
                expected.weight += rest * rest;
            }
            assert!((found.gradient - expected.gradient).norm() < 1e-9 * expected.gradient.norm());
            // The normal matrix takes s at the surface: off by |d|/R, at most 0.02/50, of terms with s ≤ R·0.112 ≪ dx.
            assert!((found.normal - expected.normal).norm() < 1e-4 * expected.normal.norm());
            assert!((found.weight - expected.weight).abs() < 1e-9);
        }
    }

    #[test]
    fn on_the_surface_the_normal_matrix_is_exact() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: -0.17, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let section = cylinder.axis().section(50.0, 11.0);
        let (y, z): (Vec<f64>, Vec<f64>) =
            (0..40).map(|i| section.point(f64::from(i) * 0.15)).map(|[y, z]| (y, z)).unzip();
        let view = cylinder.facing([-0.3, 0.8]);
        let found = view.unturned(&sum(&view.at(11.0), Stretch::F64 { y: &y, z: &z }, 0.01, Curvature::Slope));
        let mut expected = Matrix5::zeros();
        for (y, z) in y.iter().zip(&z) {
            let Response { a, b, t, .. } = cylinder.slice(11.0).response(*y, *z);
            let row = Vector5::new(a * t, b * t, a, b, -1.0);
            expected += row * row.transpose();
        }
        assert!((found.normal - expected).norm() < 1e-12 * expected.norm());
    }
}
