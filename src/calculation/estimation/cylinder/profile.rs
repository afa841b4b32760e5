//! The points of one profile as they are stored, and the sums over them.

use super::block::Place;
use super::kernel::{Curvature, Inner, Sweep};
use super::projection::View;
use super::sums::Sums;
use crate::scan::{Scan, Station, Stretch};

/// The points of one profile: in the plane at `x`, or each at an x of its own.
#[derive(Debug, Clone, Copy)]
pub(super) struct ProfilePoints<'a> {
    pub(super) x: f64,
    pub(super) own_x: Option<&'a [f64]>,
    pub(super) points: Stretch<'a>,
}

impl<'a> ProfilePoints<'a> {
    /// Those of a profile of a scan.
    pub(super) fn of(scan: &'a Scan, station: &Station) -> Self {
        let points = scan.columns().stretch(station.start..station.end);
        Self { x: station.x, own_x: scan.own_x(station), points }
    }

    /// The sums in the parameters of the view.
    pub(super) fn sums(&self, view: &View, cut_off_squared: f64, curvature: Curvature) -> Sums {
        let per_cut2 = 1.0 / cut_off_squared;
        self.look(view, |place| match self.points {
            Stretch::F32 { y, z } => Sweep { place, y, z }.sums(per_cut2, curvature),
            Stretch::F64 { y, z } => Sweep { place, y, z }.sums(per_cut2, curvature),
        })
    }

    /// The same for Newton's step, with the points that lie within `epsilon`, mm.
    pub(super) fn sums_and_inner(&self, view: &View, cut_off_squared: f64, epsilon: f64) -> (Sums, Inner) {
        let (per_cut2, epsilon2) = (1.0 / cut_off_squared, epsilon * epsilon);
        self.look(view, |place| match self.points {
            Stretch::F32 { y, z } => Sweep { place, y, z }.sums_and_inner(per_cut2, epsilon2),
            Stretch::F64 { y, z } => Sweep { place, y, z }.sums_and_inner(per_cut2, epsilon2),
        })
    }

    /// Σ min(d²·`per_tolerance2`, 1).
    pub(super) fn truncated_squares(&self, view: &View, per_tolerance2: f64) -> f64 {
        self.look(view, |place| match self.points {
            Stretch::F32 { y, z } => Sweep { place, y, z }.truncated_squares(per_tolerance2),
            Stretch::F64 { y, z } => Sweep { place, y, z }.truncated_squares(per_tolerance2),
        })
    }

    /// Calls `found` with the squared distances from the surface, mm², a block of points at a time.
    pub(super) fn squared_distances(&self, view: &View, found: impl FnMut(&[f64])) {
        self.look(view, |place| match self.points {
            Stretch::F32 { y, z } => Sweep { place, y, z }.squared_distances(found),
            Stretch::F64 { y, z } => Sweep { place, y, z }.squared_distances(found),
        });
    }

    fn look<R>(&self, view: &View, with: impl FnOnce(Place<'_>) -> R) -> R {
        match self.own_x {
            None => with(Place::Plane(&view.at(self.x))),
            Some(own_x) => with(Place::Own(&view.oblique(), own_x)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::{Cylinder, Response};
    use super::*;
    use nalgebra::{Matrix5, Vector5};

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
        let own_x = vec![70.0; y.len()];
        for (curvature, own_x) in [Curvature::Weight, Curvature::Slope]
            .into_iter()
            .flat_map(|curvature| [(curvature, None), (curvature, Some(own_x.as_slice()))])
        {
            let points = ProfilePoints { x: 70.0, own_x, points: Stretch::F64 { y: &y, z: &z } };
            let found = view.unturned(&points.sums(&view, 0.0004, curvature));
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
        let points = ProfilePoints { x: 11.0, own_x: None, points: Stretch::F64 { y: &y, z: &z } };
        let found = view.unturned(&points.sums(&view, 0.01, Curvature::Slope));
        let mut expected = Matrix5::zeros();
        for (y, z) in y.iter().zip(&z) {
            let Response { a, b, t, .. } = cylinder.slice(11.0).response(*y, *z);
            let row = Vector5::new(a * t, b * t, a, b, -1.0);
            expected += row * row.transpose();
        }
        assert!((found.normal - expected).norm() < 1e-12 * expected.norm());
    }
}
