//! Whether the part is seen from inside: the sensor looks down from +Z, so that the points of a part that it sees from outside
//! lie above the axis. Below it lies the inside of a pipe, or an axis of the coordinates is mirrored.

use super::estimate::Pose;
use crate::scan::Scan;
use nalgebra::Vector3;
use std::f64::consts::FRAC_2_PI;

/// Points that are looked at.
const POINTS_MAX: usize = 4096;

/// Whether the arc of the points near the surface opens towards +Z. An arc of half a turn or more opens nowhere: the mean of
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
