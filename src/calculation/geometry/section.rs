//! The ellipse that a plane x = const cuts out of a cylinder.

use super::angle::Angle;
use serde::{Deserialize, Serialize};

/// An ellipse in a plane x = const of the rail frame, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SectionEllipse {
    /// Centre, mm.
    pub centre_y: f64,
    /// Centre, mm.
    pub centre_z: f64,
    /// Semi-major axis, mm.
    pub semi_major: f64,
    /// Semi-minor axis, mm; the cylinder's radius.
    pub semi_minor: f64,
    /// Direction of the major axis from +Y towards +Z, in (−90°, 90°].
    pub rotation: Angle,
}

impl SectionEllipse {
    /// The point at the parameter angle `t` (radians, from the major axis).
    #[must_use]
    pub fn point(&self, t: f64) -> [f64; 2] {
        let (sin, cos) = self.rotation.radians().sin_cos();
        let (major, minor) = (self.semi_major * t.cos(), self.semi_minor * t.sin());
        [self.centre_y + major * cos - minor * sin, self.centre_z + major * sin + minor * cos]
    }
}
