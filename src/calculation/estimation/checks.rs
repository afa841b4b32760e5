//! Checks that do not depend on the method: scans that no method can measure, poses whose uncertainty is too large, and parts that
//! are scanned from inside.

use super::estimate::{Pose, Uncertainty};
use super::refusal::Refusal;
use super::settings::Settings;
use crate::scan::Scan;
use nalgebra::Vector3;
use std::f64::consts::FRAC_2_PI;

/// A section with an arc below this is treated as a straight line.
const STRAIGHT_DEG: f64 = 0.5;

/// The refusal, the most specific first.
pub(super) fn unusable(scan: &Scan, settings: &Settings) -> Option<Refusal> {
    let profiles_count = scan.stations().len();
    if identical(scan) {
        return Some(Refusal::PointsIdentical { points_count: scan.points().len() });
    }
    if profiles_count < settings.profiles_min as usize {
        return Some(Refusal::TooFewProfiles { profiles_count, profiles_min: settings.profiles_min });
    }
    if scan.is_planar() && scan.stations().first().map(|s| s.x) == scan.stations().last().map(|s| s.x) {
        return Some(Refusal::TravelMissing { profiles_count });
    }
    collinear(scan).then_some(Refusal::PointsCollinear { profiles_count })
}

fn identical(scan: &Scan) -> bool {
    let first = scan.columns().get(scan.points().start);
    scan.is_planar() && scan.points().all(|index| scan.columns().get(index) == first)
}

/// Whether every profile of the scan is straight to within the rounding of its coordinates.
fn collinear(scan: &Scan) -> bool {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.stations().iter().all(|station| {
        scan.load(*station, &mut y, &mut z);
        // Two points always lie on a line.
        y.len() > 2 && straight(&y, &z)
    })
}

fn straight(y: &[f64], z: &[f64]) -> bool {
    let count = y.len() as f64;
    let (mean_y, mean_z) = (y.iter().sum::<f64>() / count, z.iter().sum::<f64>() / count);
    let (mut yy, mut yz, mut zz) = (0.0, 0.0, 0.0);
    for (y, z) in y.iter().zip(z) {
        let (y, z) = (y - mean_y, z - mean_z);
        (yy, yz, zz) = (yy + y * y, yz + y * z, zz + z * z);
    }
    let (mean, spread) = (0.5 * (yy + zz), 0.5 * (yy - zz).hypot(2.0 * yz));
    // An arc of angle φ has the variance R²φ²/12 along the chord and R²φ⁴/720 across it: their ratio is φ²/60.
    mean - spread <= (mean + spread) * STRAIGHT_DEG.to_radians().powi(2) / 60.0
}

/// Default of the largest standard uncertainty of a position, relative to the radius. A useful scan of a part of any size is far
/// below a hundredth.
const POSITION_SHARE: f64 = 0.01;

/// The refusal of a pose whose angles, or position at the reference point, are more uncertain than allowed.
pub(super) fn undetermined(uncertainty: &Uncertainty, radius: f64, settings: &Settings) -> Option<Refusal> {
    let [[deflection, ..], [_, pitch, ..], [_, _, y, ..], [_, _, _, z, _], _] = uncertainty.covariance;
    let (angle_deg, position_mm) = (deflection.max(pitch).sqrt().to_degrees(), y.max(z).sqrt());
    let angle_max_deg = settings.angle_uncertainty_max_deg;
    let position_max_mm = settings.position_uncertainty_max_mm.unwrap_or(POSITION_SHARE * radius);
    // The comparison is written so that NaN counts as undetermined.
    let is_known = angle_deg <= angle_max_deg && position_mm <= position_max_mm;
    (!is_known).then_some(Refusal::PoseUndetermined { angle_deg, angle_max_deg, position_mm, position_max_mm })
}

/// Number of points that are examined.
const POINTS_MAX: usize = 4096;

/// Whether the part is scanned from inside: the arc of the points near its surface opens towards +Z, where the sensor is. Then the
/// scan shows the inside of a pipe, or an axis of the coordinates is mirrored. An arc of 180° or more has no opening: the mean of
/// its unit directions from the axis, sin(φ/2)/(φ/2) long, is shorter than 2/π.
pub(super) fn is_concave(scan: &Scan, pose: &Pose, reach: f64) -> bool {
    let axis = pose.axis_in_scan();
    let (origin, direction) = (Vector3::from(axis.point_mm), Vector3::from(axis.direction));
    let stride = scan.points().len().div_ceil(POINTS_MAX).max(1);
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    for point in scan.every_nth_point(stride) {
        let from = Vector3::from(point) - origin;
        let across = from - direction * from.dot(&direction);
        let distance = across.norm();
        if (distance - pose.radius).abs() <= reach && distance > 0.0 {
            (sum, count) = (sum + across / distance, count + 1.0);
        }
    }
    sum.norm() > FRAC_2_PI * count && sum.z < 0.0
}
