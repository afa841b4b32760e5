//! Compares a pose with a true axis that may lie in any direction of the coordinates of the scan.

#![expect(clippy::expect_used, reason = "a test may fail")]

use coaxis::estimation::Pose;
use coaxis::geometry::{Axis, AxisLine, Frame};
use nalgebra::{Matrix5, Vector3};
use std::f64::consts::FRAC_PI_2;

/// Errors of (deflection, pitch, y_ref, z_ref, radius) and their standard uncertainties, radians and mm.
pub(crate) type Compared = ([f64; 5], [f64; 5]);

/// In the coordinates of the scan if the axis is nearly parallel to X there, otherwise in the frame of the pose.
pub(crate) fn compared(pose: &Pose, truth: &Axis, radius_mm: f64) -> Compared {
    // The matrix is symmetric, so the order of rows and columns does not matter.
    let own = Matrix5::from(pose.uncertainty.covariance);
    let (line, x_ref, covariance, true_line) = match pose.on_rail() {
        Some(rail) => (rail.axis, rail.x_ref, Matrix5::from(rail.uncertainty.covariance), slopes(truth)),
        None => {
            let in_own_frame = pose.cut.as_ref().map_or(*truth, |cut| in_frame(&cut.frame, truth));
            (pose.axis, pose.x_ref, own, slopes(&in_own_frame))
        }
    };
    let standard = covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into();
    let [y, z] = line.at(x_ref);
    let Some(true_line) = true_line else { return ([FRAC_PI_2; 5], standard) };
    let [true_y, true_z] = true_line.at(x_ref);
    let angles = [line.deflection().radians(), line.pitch().radians()];
    let true_angles = [true_line.deflection().radians(), true_line.pitch().radians()];
    let errors =
        [angles[0] - true_angles[0], angles[1] - true_angles[1], y - true_y, z - true_z, pose.radius - radius_mm];
    (errors, standard)
}

/// The line by its slopes, at any angle to X: a file whose profiles are planes of X may contain an axis at a large angle to it.
fn slopes(axis: &Axis) -> Option<AxisLine> {
    let [x, y, z] = axis.direction;
    (x != 0.0).then(|| AxisLine::through(axis.point_mm, y / x, z / x))
}

pub(crate) fn in_frame(frame: &Frame, axis: &Axis) -> Axis {
    let rotation = frame.rotation().expect("a frame");
    let point = rotation * (Vector3::from(axis.point_mm) - Vector3::from(frame.origin_mm));
    Axis { point_mm: point.into(), direction: (rotation * Vector3::from(axis.direction)).into() }
}
