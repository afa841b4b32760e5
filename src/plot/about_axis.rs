//! Points in coordinates around the fitted axis. Must not know pictures.

use crate::estimation::{Estimate, Outcome, Pose};
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};

/// The cylinder of a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cylinder {
    pub(super) axis: AxisLine,
    pub(super) radius: f64,
}

/// The pose, where there is one.
pub(super) fn pose(estimate: &Estimate) -> Option<&Pose> {
    match &estimate.outcome {
        Outcome::Accepted(pose) => Some(pose),
        Outcome::Refused(_) => None,
    }
}

impl Cylinder {
    /// The part of (x, y, z) − axis that is square to the axis, turned into the plane: length is the distance ρ from
    /// the axis, direction counts from +Y towards +Z.
    ///
    /// With u = y − y_axis(x), w = z − z_axis(x), s = (p·u + q·w)/n²: direction of (u − p·s, w − q·s),
    /// ρ² = u² + w² − (p·u + q·w)²/n². Every point of the cylinder lies at ρ = R, however the axis is tilted.
    pub(super) fn polar(&self, x: f64, [y, z]: [f64; 2]) -> Polar {
        let AxisLine { p, q, .. } = self.axis;
        let [axis_y, axis_z] = self.axis.at(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let along = p * u + q * w;
        let s = along / (1.0 + p * p + q * q);
        Polar { distance: (u * u + w * w - along * s).max(0.0).sqrt(), angle: (w - q * s).atan2(u - p * s) }
    }
}

/// A point as seen along the axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Polar {
    /// From the axis, mm.
    pub(super) distance: f64,
    /// From +Y towards +Z, radians.
    pub(super) angle: f64,
}

/// Whether the profile at `index` takes part in the pose.
pub(super) fn is_valid(estimate: &Estimate, index: usize) -> bool {
    estimate.profiles.get(index).is_some_and(|profile| profile.rejected.is_none())
}

/// At most about `most` points of the scan, spread evenly over it: the profile's index, x, and (y, z).
///
/// One point out of every `step`, at a place within it that moves by the golden ratio: a fixed place would, on rows of
/// equal length, show the same few directions of every profile.
pub(super) fn thinned(scan: &Scan, most: usize) -> impl Iterator<Item = (usize, f64, [f64; 2])> {
    let (first, total) = (scan.points().start, scan.points().len());
    let step = total.div_ceil(most.max(1)).max(1);
    let places = (0..total.div_ceil(step)).map(move |block| {
        let part = (block as f64 * 0.618_033_988_749_895).fract();
        first + (block * step + (part * step as f64) as usize).min(total.saturating_sub(1))
    });
    let mut stations = scan.stations().iter().copied().enumerate().peekable();
    places.filter_map(move |place| {
        while stations.peek().is_some_and(|(_, Station { end, .. })| *end <= place) {
            stations.next();
        }
        let &(index, station) = stations.peek()?;
        Some((index, station.x, scan.columns().get(place)?))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_of_a_tilted_cylinder_lies_at_its_radius() {
        let cylinder = Cylinder { axis: AxisLine { p: 0.3, q: -0.2, y0: 5.0, z0: -7.0 }, radius: 200.0 };
        for i in 0..20 {
            let x = f64::from(i) * 30.0;
            let point = cylinder.axis.section(200.0, x).point(f64::from(i) * 0.7);
            assert!((cylinder.polar(x, point).distance - 200.0).abs() < 1e-9);
        }
    }
}
