//! The axis of a part: as a line in any direction, and as a line that crosses every plane x = const, with the elliptical section of
//! the cylinder about it in such a plane; and the plane angle in which directions are stated.

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
    /// Beyond this angle from X, degrees, the slopes of a line and its intersection with x = 0 are of little use: at 60° a shift of
    /// the line by 1 mm already moves the intersection by 2 mm.
    pub const LINE_MAX_DEG: f64 = 60.0;

    /// The angle between the line and X, from 0 to 90°.
    #[must_use]
    pub fn tilt(&self) -> Angle {
        let [x, y, z] = self.direction;
        Angle::from_radians(y.hypot(z).atan2(x.abs()))
    }

    /// The line by its slopes, if it lies within [`Self::LINE_MAX_DEG`] of X.
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

/// The line y = `y0` + p·x, z = `z0` + q·x in the rail frame, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisLine {
    /// dy/dx, the tangent of the deflection.
    pub p: f64,
    /// dz/dx, the tangent of the pitch.
    pub q: f64,
    /// y of the intersection with the plane x = 0, mm.
    pub y0: f64,
    /// z of the intersection with the plane x = 0, mm.
    pub z0: f64,
}

impl AxisLine {
    /// The line through (`x`, `y`, `z`) with slopes `p` and `q`.
    #[must_use]
    pub fn through([x, y, z]: [f64; 3], p: f64, q: f64) -> Self {
        Self { p, q, y0: y - p * x, z0: z - q * x }
    }

    /// (y, z) of the line in the plane at `x`, mm.
    #[must_use]
    pub fn at(&self, x: f64) -> [f64; 2] {
        [self.y0 + self.p * x, self.z0 + self.q * x]
    }

    /// Rotation towards +Y: atan p.
    #[must_use]
    pub fn deflection(&self) -> Angle {
        Angle::from_radians(self.p.atan())
    }

    /// Rotation towards +Z: atan q.
    #[must_use]
    pub fn pitch(&self) -> Angle {
        Angle::from_radians(self.q.atan())
    }

    /// Unit direction, pointing along +X.
    #[must_use]
    pub fn direction(&self) -> [f64; 3] {
        Vector3::new(1.0, self.p, self.q).normalize().into()
    }

    /// Distance of a point from the line, |P₀P × T| / |T|, mm.
    #[must_use]
    pub fn distance(&self, [x, y, z]: [f64; 3]) -> f64 {
        let tangent = Vector3::new(1.0, self.p, self.q);
        let [line_y, line_z] = self.at(x);
        Vector3::new(0.0, y - line_y, z - line_z).cross(&tangent).norm() / tangent.norm()
    }

    /// The section of the cylinder of this axis and `radius` by the plane at `x`.
    ///
    /// u² + w² − (p·u + q·w)²/n² = R² with n² = 1 + p² + q²: semi-minor axis R, semi-major axis R·n along (p, q).
    #[must_use]
    pub fn section(&self, radius: f64, x: f64) -> SectionEllipse {
        let [centre_y, centre_z] = self.at(x);
        let n = (1.0 + self.p * self.p + self.q * self.q).sqrt();
        SectionEllipse {
            centre_y,
            centre_z,
            semi_major: radius * n,
            semi_minor: radius,
            rotation: Angle::from_radians(self.q.atan2(self.p)),
        }
    }
}

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

/// A plane angle, kept in radians.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Angle(f64);

impl Angle {
    /// From radians.
    #[must_use]
    pub const fn from_radians(radians: f64) -> Self {
        Self(radians)
    }

    /// From degrees.
    #[must_use]
    pub const fn from_degrees(degrees: f64) -> Self {
        Self(degrees.to_radians())
    }

    /// In radians.
    #[must_use]
    pub const fn radians(self) -> f64 {
        self.0
    }

    /// In degrees.
    #[must_use]
    pub const fn degrees(self) -> f64 {
        self.0.to_degrees()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_near_x_has_slopes_and_a_vertical_one_has_none() {
        let axis = Axis { point_mm: [10.0, 2.0, 3.0], direction: [0.8, 0.6, 0.0] };
        let line = axis.line().expect("37 degrees from X");
        assert!((line.p - 0.75).abs() < 1e-12 && (line.y0 - (2.0 - 7.5)).abs() < 1e-12 && line.z0 == 3.0);
        assert!((axis.tilt().degrees() - 36.869_897_645_844_02).abs() < 1e-9);
        assert!((axis.distance([10.0, 2.0, 8.0]) - 5.0).abs() < 1e-12);
        assert_eq!(Axis { direction: [0.0, 0.0, 1.0], ..axis }.line(), None);
    }
}

#[cfg(test)]
mod axis_line_tests {
    use super::*;

    #[test]
    fn the_section_satisfies_the_cylinder_equation() {
        let axis = AxisLine { p: 5f64.to_radians().tan(), q: 5f64.to_radians().tan(), y0: 1.0, z0: -2.0 };
        let ellipse = axis.section(200.0, 30.0);
        // Hand-derived: 200·√(1 + 2·tan² 5°) = 201.525… (the source paper prints 201.4).
        assert!((ellipse.semi_major - 201.525).abs() < 5e-4);
        for i in 0..12 {
            let [y, z] = ellipse.point(f64::from(i) * 0.5);
            assert!((axis.distance([30.0, y, z]) - 200.0).abs() < 1e-9);
        }
    }
}
