//! Points in coordinates around the fitted axis, and the verdicts on their profiles.

use crate::estimation::{Estimate, Method, Outcome, Pose};
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};

/// The cylinder of a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cylinder {
    pub(super) axis: AxisLine,
    pub(super) radius: f64,
}

/// The names of the coordinates of a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Names {
    /// Label of the axis along the rail or along the part.
    pub(super) x_label: &'static str,
    pub(super) x: &'static str,
    pub(super) y: &'static str,
    pub(super) z: &'static str,
    /// A remark about the frame, if it is not that of the scan.
    pub(super) remark: Option<&'static str>,
}

const OF_SCAN: Names = Names { x_label: "x (mm)", x: "x", y: "y", z: "z", remark: None };
const OF_SECTIONS: Names = Names {
    x_label: "x′, along the part (mm)",
    x: "x′",
    y: "y′",
    z: "z′",
    remark: Some("x′, y′, z′: frame with X′ along the axis as it was detected"),
};

/// The names of the frame of a picture: that of the scan, or of the sections that were cut along the axis.
pub(super) fn names(estimate: &Estimate) -> Names {
    if pose(estimate).is_some_and(|pose| pose.cut.is_some()) { OF_SECTIONS } else { OF_SCAN }
}

/// The pose, if there is one.
pub(super) fn pose(estimate: &Estimate) -> Option<&Pose> {
    match &estimate.outcome {
        Outcome::Accepted(pose) => Some(pose),
        Outcome::Refused(_) => None,
    }
}

impl Cylinder {
    /// The cylinder of a pose.
    pub(super) fn of(pose: &Pose) -> Self {
        Self { axis: pose.axis, radius: pose.radius }
    }

    /// The x at which the plane perpendicular to the axis at x = `centre_x` meets the surface in the direction `angle`.
    ///
    /// With the radial vector r = (r_x, ρ cos θ, ρ sin θ), r ⟂ (1, p, q): r_x = −ρ(p cos θ + q sin θ), |r| = R.
    pub(super) fn x_of_plane(&self, centre_x: f64, angle: f64) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let slope = self.axis.p * cos + self.axis.q * sin;
        centre_x - self.radius * slope / (1.0 + slope * slope).sqrt()
    }

    /// The component of (x, y, z) − axis perpendicular to the axis, rotated into the plane: its length is the distance ρ from the
    /// axis, its direction counts from +Y towards +Z.
    ///
    /// With u = y − y_axis(x), w = z − z_axis(x), s = (p·u + q·w)/n²: direction of (u − p·s, w − q·s), ρ² = u² + w² − (p·u +
    /// q·w)²/n². Every point of the cylinder lies at ρ = R for any tilt of the axis.
    pub(super) fn polar(&self, [x, y, z]: [f64; 3]) -> Polar {
        let AxisLine { p, q, .. } = self.axis;
        let [axis_y, axis_z] = self.axis.at(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let along = p * u + q * w;
        let s = along / (1.0 + p * p + q * q);
        Polar { distance: (u * u + w * w - along * s).max(0.0).sqrt(), angle: (w - q * s).atan2(u - p * s) }
    }
}

/// A point viewed along the axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Polar {
    /// Distance from the axis, mm.
    pub(super) distance: f64,
    /// Direction from +Y towards +Z, radians.
    pub(super) angle: f64,
}

/// The verdict on a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    Valid,
    Rejected,
    /// No verdict: the method uses all points, or the scan was refused before its profiles were evaluated.
    Unjudged,
}

/// The verdict on the profile at `index`.
pub(super) fn status(estimate: &Estimate, index: usize) -> Status {
    match estimate.profiles.get(index).map(|profile| profile.rejected) {
        Some(None) if estimate.method == Method::LeastSquares => Status::Unjudged,
        Some(None) => Status::Valid,
        Some(Some(_)) => Status::Rejected,
        None => Status::Unjudged,
    }
}

/// At most about `most` points of the scan, spread evenly over it: the profile's index, and (x, y, z).
///
/// One point out of every `step`, at a position within it that moves by the golden ratio: on rows of equal length a fixed position
/// would show the same few directions of every profile.
pub(super) fn thinned(scan: &Scan, most: usize) -> impl Iterator<Item = (usize, [f64; 3])> {
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
        Some((index, scan.point(&station, place)?))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plane_of_an_end_face_is_perpendicular_to_the_axis() {
        let cylinder = Cylinder { axis: AxisLine { p: 0.3, q: -0.2, y0: 5.0, z0: -7.0 }, radius: 200.0 };
        let [y0, z0] = cylinder.axis.at(50.0);
        for i in 0..20 {
            let angle = f64::from(i) * 0.3;
            let x = cylinder.x_of_plane(50.0, angle);
            // The radial vector has this direction in (y, z), and with its x the length R.
            let across = (200.0_f64.powi(2) - (x - 50.0).powi(2)).sqrt();
            let [dy, dz] = [across * angle.cos(), across * angle.sin()];
            assert!((x - 50.0 + 0.3 * dy - 0.2 * dz).abs() < 1e-9, "perpendicular to the direction (1, p, q)");
            let polar = cylinder.polar([x, y0 + dy, z0 + dz]);
            assert!((polar.distance - 200.0).abs() < 1e-9);
            assert!((polar.angle - angle).sin().abs() < 1e-9 && (polar.angle - angle).cos() > 0.0);
        }
    }

    #[test]
    fn every_point_of_a_tilted_cylinder_lies_at_its_radius() {
        let cylinder = Cylinder { axis: AxisLine { p: 0.3, q: -0.2, y0: 5.0, z0: -7.0 }, radius: 200.0 };
        for i in 0..20 {
            let x = f64::from(i) * 30.0;
            let [y, z] = cylinder.axis.section(200.0, x).point(f64::from(i) * 0.7);
            assert!((cylinder.polar([x, y, z]).distance - 200.0).abs() < 1e-9);
        }
    }
}
