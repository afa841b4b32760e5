//! A pose that was found in the frame of its sections, in the coordinates of the scan.

use super::Pose;
use crate::geometry::{Axis, AxisLine};
use nalgebra::{Matrix3, Matrix5, Vector3, Vector5};

/// The pose in the coordinates of the scan, by slopes and by where the axis meets planes x = const.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnRail {
    /// The axis.
    pub axis: AxisLine,
    /// The x of the point of the axis that is known best, mm.
    pub x_ref: f64,
    /// What a change of the pose's own (deflection, pitch, y_ref, z_ref, radius) does to these.
    pub jacobian: Matrix5<f64>,
}

impl OnRail {
    /// A covariance of the pose's own numbers as one of these.
    #[must_use]
    pub fn covariance(&self, own: &Matrix5<f64>) -> Matrix5<f64> {
        self.jacobian * own * self.jacobian.transpose()
    }
}

impl Pose {
    /// The axis in the coordinates of the scan, with the point that is known best.
    #[must_use]
    pub fn axis_in_scan(&self) -> Axis {
        let [y, z] = self.axis.at(self.x_ref);
        let (rotation, origin) = self.placement();
        let point = origin + rotation * Vector3::new(self.x_ref, y, z);
        let direction = rotation * Vector3::from(self.axis.direction());
        Axis { point_mm: point.into(), direction: direction.normalize().into() }
    }

    /// The pose by slopes and by where the axis meets planes x = const of the scan; `None` where it lies too far from X.
    #[must_use]
    pub fn on_rail(&self) -> Option<OnRail> {
        if self.cut.is_none() {
            return Some(OnRail { axis: self.axis, x_ref: self.x_ref, jacobian: Matrix5::identity() });
        }
        let placed = self.axis_in_scan();
        let axis = placed.line()?;
        let [x_ref, ..] = placed.point_mm;
        Some(OnRail { axis, x_ref, jacobian: self.jacobian(&axis) })
    }

    /// How (deflection, pitch, y_ref, z_ref, radius) of `axis`, the same in the coordinates of the scan, follow from those of
    /// the pose.
    ///
    /// A change moves the point of the axis by δP and turns the direction T = (1, p, q) by δT. Seen along the new X, whose
    /// component of T is T_x, the slopes change by (δT_y − p′ δT_x)/T_x, and the point of the axis in the plane x = x_ref by
    /// δP_y − p′ δP_x; likewise z with q′.
    fn jacobian(&self, axis: &AxisLine) -> Matrix5<f64> {
        let (rotation, _) = self.placement();
        let [by_p, by_q] = [self.axis.p, self.axis.q].map(|slope| 1.0 + slope * slope);
        let tangent = rotation * Vector3::new(1.0, self.axis.p, self.axis.q);
        let [to_deflection, to_pitch] = [axis.p, axis.q].map(|slope| 1.0 / (1.0 + slope * slope));
        let column = |point: Vector3<f64>, turn: Vector3<f64>, radius: f64| {
            Vector5::new(
                to_deflection * (turn.y - axis.p * turn.x) / tangent.x,
                to_pitch * (turn.z - axis.q * turn.x) / tangent.x,
                point.y - axis.p * point.x,
                point.z - axis.q * point.x,
                radius,
            )
        };
        let (zero, y, z) = (Vector3::zeros(), rotation * Vector3::y(), rotation * Vector3::z());
        Matrix5::from_columns(&[
            column(zero, y * by_p, 0.0),
            column(zero, z * by_q, 0.0),
            column(y, zero, 0.0),
            column(z, zero, 0.0),
            column(zero, zero, 1.0),
        ])
    }

    /// The rotation from the frame of the pose into the coordinates of the scan, and the origin of that frame there.
    fn placement(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let frame = self.cut.as_ref().map(|cut| cut.frame);
        let rotation = frame.and_then(|frame| frame.rotation().ok()).map_or_else(Matrix3::identity, |r| r.transpose());
        (rotation, frame.map_or_else(Vector3::zeros, |frame| Vector3::from(frame.origin_mm)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::section_cut::SectionCut;
    use crate::estimation::{EndFaces, RadiusSource, Uncertainty};

    fn pose(axis: AxisLine, cut: Option<SectionCut>) -> Pose {
        let uncertainty = Uncertainty::of(&[]);
        let (radius_source, end_faces) = (RadiusSource::Fitted, EndFaces::default());
        Pose { axis, x_ref: 30.0, cut, radius: 20.0, radius_source, uncertainty, end_faces }
    }

    #[test]
    fn the_jacobian_is_what_changes_of_the_pose_do_in_the_coordinates_of_the_scan() {
        let tilted = Axis { point_mm: [100.0, -20.0, 7.0], direction: [0.8, 0.36, -0.48] };
        let cut = SectionCut::about(&tilted, 20.0, [0.0, 60.0]);
        let line = AxisLine::through([30.0, 1.0, -2.0], 0.05, -0.03);
        let here = pose(line, cut);
        let found = here.on_rail().expect("36 degrees from X");
        let values = |pose: &Pose| {
            let axis = pose.axis_in_scan().line().expect("near X");
            let [y, z] = axis.at(found.x_ref);
            Vector5::new(axis.deflection().radians(), axis.pitch().radians(), y, z, pose.radius)
        };
        for index in 0..5 {
            let moved = |by: f64| {
                let step = Vector5::ith(index, by);
                let angles = [line.p.atan() + step[0], line.q.atan() + step[1]];
                let [y, z] = line.at(30.0);
                let axis = AxisLine::through([30.0, y + step[2], z + step[3]], angles[0].tan(), angles[1].tan());
                values(&Pose { radius: 20.0 + step[4], ..pose(axis, cut) })
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - found.jacobian.column(index)).norm() < 1e-6, "{index}");
        }
    }

    #[test]
    fn a_pose_of_the_rail_is_what_it_is() {
        let line = AxisLine { p: 0.1, q: 0.2, y0: 1.0, z0: 2.0 };
        let found = pose(line, None).on_rail().expect("on the rail");
        assert_eq!((found.axis, found.x_ref, found.jacobian), (line, 30.0, Matrix5::identity()));
    }
}
