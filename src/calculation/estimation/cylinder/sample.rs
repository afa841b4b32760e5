//! The points of one profile for the sums of the fit, and a thinned copy of a scan that represents all of it: every n-th profile,
//! every n-th point of each. A regular stride preserves the share of every feature, while a grid of equal areas would increase the
//! share of outliers. Also the size and the roughness of a scan, which bound the search for a start.

use super::block::Place;
use super::kernel::{Curvature, Inner, Sweep};
use super::model::View;
use super::normal_equations::Sums;
use crate::estimation::statistics::{self, median};
use crate::scan::{Scan, Station, Stretch};

/// At most `profiles_max` profiles of at most `points_max` points, evenly spread.
#[derive(Debug, Clone, Default)]
pub(super) struct Sample {
    pub(super) stations: Vec<Station>,
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    /// Whether its points have individual x.
    has_own_x: bool,
    /// Standard deviation from the resolution of the coordinates, mm.
    resolution: f64,
}

impl Sample {
    pub(super) fn take(scan: &Scan, used: &[bool], profiles_max: usize, points_max: usize) -> Self {
        let usable: Vec<&Station> =
            scan.stations().iter().zip(used).filter(|(_, used)| **used).map(|(station, _)| station).collect();
        let mut sample = Self { resolution: rounding_standard(scan.lattice()), ..Self::default() };
        for station in spread(usable.len(), profiles_max).filter_map(|index| usable.get(index)) {
            let places = spread(station.end - station.start, points_max);
            sample.push(station.x, places.filter_map(|place| scan.point(station, station.start + place)));
        }
        sample
    }

    /// Adds a profile at `x`, unless it has no point.
    pub(super) fn push(&mut self, x: f64, points: impl Iterator<Item = [f64; 3]>) {
        let start = self.y.len();
        for [own_x, y, z] in points {
            self.has_own_x |= own_x != x;
            self.x.push(own_x);
            self.y.push(y);
            self.z.push(z);
        }
        let end = self.y.len();
        if end > start {
            self.stations.push(Station { x, start, end });
        }
    }

    /// Standard deviation from the resolution of the coordinates, mm: the lower bound of every scatter.
    pub(super) fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.y.len()
    }

    /// The points of one of the sample's profiles.
    pub(super) fn points(&self, station: &Station) -> impl Iterator<Item = [f64; 3]> + Clone + '_ {
        let range = station.start..station.end;
        let [x, y, z] = [&self.x, &self.y, &self.z].map(|values| values.get(range.clone()).unwrap_or_default());
        x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z])
    }

    /// One of these points.
    pub(super) fn point(&self, index: usize) -> Option<[f64; 3]> {
        Some([*self.x.get(index)?, *self.y.get(index)?, *self.z.get(index)?])
    }

    /// The same points for the sums.
    pub(super) fn profile(&self, station: &Station) -> ProfilePoints<'_> {
        let range = station.start..station.end;
        let [x, y, z] = [&self.x, &self.y, &self.z].map(|values| values.get(range.clone()).unwrap_or_default());
        ProfilePoints { x: station.x, own_x: self.has_own_x.then_some(x), points: Stretch::F64 { y, z } }
    }

    /// The sample without the points for which `taken` is true; profiles that become empty are removed.
    pub(super) fn without(&self, taken: impl Fn([f64; 3]) -> bool) -> Self {
        let mut rest = Self { resolution: self.resolution, ..Self::default() };
        for station in &self.stations {
            rest.push(station.x, self.points(station).filter(|point| !taken(*point)));
        }
        rest
    }
}

/// `most` indices spread evenly over `count`, or all of them.
pub(super) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |i| (2 * i + 1) * count / (2 * taken))
}

/// Standard deviation of a value that is rounded to a step of 1 (JCGM 100, 4.3.7).
pub(super) const OF_STEP: f64 = 0.288_675_134_594_812_9;

/// Standard deviation from the resolution of y and z, mm; 0 if one of them lies on no lattice, since a raster across the profile
/// alone rounds no distance.
pub(super) fn rounding_standard([_, y, z]: [f64; 3]) -> f64 {
    OF_STEP * y.min(z)
}

/// Profiles that are examined for the roughness.
const PROFILES_MAX: usize = 64;
/// Runs of four neighbouring points of a profile that are examined.
const RUNS_MAX: usize = 64;
/// Variance of the difference of two neighbouring sagittas, b − ½(a + c), for points with unit noise across the chord:
/// ¼ + 9/4 + 9/4 + ¼.
const SAGITTA_VARIANCE: f64 = 5.0;

/// Median over the profiles of the diagonal of their bounding boxes, mm.
pub(super) fn size(sample: &Sample) -> f64 {
    let span = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (high - low).max(0.0)
    };
    let diagonal = |station| {
        let points = || sample.points(station);
        span(&mut points().map(|[_, y, _]| y)).hypot(span(&mut points().map(|[_, _, z]| z)))
    };
    median(sample.stations.iter().map(diagonal)).unwrap_or(0.0)
}

/// Robust spread of points about the curve through their neighbours in the order of the file, mm.
///
/// The distance of a point from the chord of its neighbours is curvature plus noise; its change to the next point is noise alone.
/// The result is too large for shuffled profiles and too small for correlated noise, but sufficient as a measure of nearness.
pub(in crate::estimation) fn roughness(scan: &Scan) -> f64 {
    let columns = scan.columns();
    let mut squared = Vec::with_capacity(PROFILES_MAX * RUNS_MAX);
    for station in spread(scan.stations().len(), PROFILES_MAX).filter_map(|index| scan.stations().get(index)) {
        let runs_count = (station.end - station.start).saturating_sub(3);
        for first in spread(runs_count, RUNS_MAX).map(|place| station.start + place) {
            if let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(|next| columns.get(first + next)) {
                let change = sagitta(b, c, d) - sagitta(a, b, c);
                squared.push(if change.is_finite() { change * change / SAGITTA_VARIANCE } else { 0.0 });
            }
        }
    }
    statistics::sigma(&squared, &mut Vec::new())
}

/// Distance of the middle of three points to the left of the chord of the outer ones, mm.
fn sagitta([ay, az]: [f64; 2], [by, bz]: [f64; 2], [cy, cz]: [f64; 2]) -> f64 {
    let (dy, dz) = (cy - ay, cz - az);
    ((by - ay) * dz - (bz - az) * dy) / (dy * dy + dz * dz).sqrt()
}

/// The points of one profile: in the plane at `x`, or with individual x.
#[derive(Debug, Clone, Copy)]
pub(super) struct ProfilePoints<'a> {
    pub(super) x: f64,
    pub(super) own_x: Option<&'a [f64]>,
    pub(super) points: Stretch<'a>,
}

impl<'a> ProfilePoints<'a> {
    /// The points of a profile of a scan.
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
    use super::*;
    use crate::estimation::cylinder::model::{Cylinder, Response};
    use nalgebra::{Matrix5, Vector5};

    #[test]
    fn the_sums_equal_those_of_single_points() {
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
            // The normal matrix takes s at the surface: a relative error of
            // d
            // /R, at most 0.02/50, of terms with s ≤ R·0.112 ≪ dx.
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
