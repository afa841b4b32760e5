//! The surface of a scan as a grid: unrolled around a cylinder, or seen from above where there is none.

use super::about_axis::{Cylinder, thinned};
use super::grid::Grid;
use super::seen::{Seen, turned_into};
use super::spread::{median, quantile};
use super::ticks::Range;
use crate::estimation::Estimate;
use crate::scan::Scan;

/// Points that are looked at for the range across.
const POINTS_MAX: usize = 50_000;
/// Share of the points of a cell below its height: of a closed part the upper side is seen, and one stray point above it is not.
const UPPER: f64 = 0.9;

/// Direction around the axis in degrees against x, each cell the median signed distance of its points from the cylinder, mm.
///
/// The median, because a single spike would colour the mean of a cell of ten points.
pub(super) fn unrolled(scan: &Scan, estimate: &Estimate, cylinder: Cylinder) -> Grid {
    let seen = Seen::new(thinned(scan, POINTS_MAX).map(|(_, at)| cylinder.polar(at).angle.to_degrees()));
    let degrees = seen.window();
    // No finer than the points of a profile lie apart.
    Grid::empty(scan, degrees, seen.bins_count()).filled(
        scan,
        estimate,
        |point| {
            let polar = cylinder.polar(point);
            (turned_into(polar.angle.to_degrees(), degrees.lo), polar.distance - cylinder.radius)
        },
        median,
    )
}

/// y against x in the coordinates of the scan, each cell the height z of its upper points, mm.
pub(super) fn from_above(scan: &Scan, estimate: &Estimate) -> Grid {
    let mut y: Vec<f64> = thinned(scan, POINTS_MAX).map(|(_, [_, y, _])| y).collect();
    let [lo, hi] = [0.002, 0.998].map(|part| quantile(&mut y, part).unwrap_or(0.0));
    Grid::empty(scan, Range::new(lo, hi).padded(0.01), usize::MAX).filled(
        scan,
        estimate,
        |[_, y, z]| (y, z),
        |heights| quantile(heights, UPPER),
    )
}
