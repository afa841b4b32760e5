//! The axis of a part as a line in any direction.

use super::angle::Angle;
use super::axis_line::AxisLine;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A point of the line and its unit direction, in the frame that the context names, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// A point of the line, mm.
    pub point_mm: [f64; 3],
    /// Unit direction.
    pub direction: [f64; 3],
}

impl Axis {
    /// Beyond this angle from X, degrees, the slopes of a line and where it meets x = 0 say little: at 60° a shift of the line
    /// by 1 mm already moves that place by 2 mm.
    pub const LINE_MAX_DEG: f64 = 60.0;

    /// The angle between the line and X, from 0 to 90°.
    #[must_use]
    pub fn tilt(&self) -> Angle {
        let [x, y, z] = self.direction;
        Angle::from_radians(y.hypot(z).atan2(x.abs()))
    }

    /// The line by its slopes, where it lies within [`Self::LINE_MAX_DEG`] of X.
    #[must_use]
    pub fn line(&self) -> Option<AxisLine> {
        let [x, y, z] = self.direction;
        let is_near = self.tilt().degrees() < Self::LINE_MAX_DEG;
        is_near.then(|| AxisLine::through(self.point_mm, y / x, z / x))
    }

    /// Distance of a point from the line, mm.
    #[must_use]
    pub fn distance(&self, point: [f64; 3]) -> f64 {
        (Vector3::from(point) - Vector3::from(self.point_mm)).cross(&Vector3::from(self.direction)).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_near_x_has_slopes_and_an_upright_one_has_none() {
        let axis = Axis { point_mm: [10.0, 2.0, 3.0], direction: [0.8, 0.6, 0.0] };
        let line = axis.line().expect("37 degrees from X");
        assert!((line.p - 0.75).abs() < 1e-12 && (line.y0 - (2.0 - 7.5)).abs() < 1e-12 && line.z0 == 3.0);
        assert!((axis.tilt().degrees() - 36.869_897_645_844_02).abs() < 1e-9);
        assert!((axis.distance([10.0, 2.0, 8.0]) - 5.0).abs() < 1e-12);
        assert_eq!(Axis { direction: [0.0, 0.0, 1.0], ..axis }.line(), None);
    }
}
