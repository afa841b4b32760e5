//! The axis of a part as a line that crosses every plane x = const.

use super::angle::Angle;
use super::section::SectionEllipse;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The line y = `y0` + p·x, z = `z0` + q·x in the rail frame, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisLine {
    /// dy/dx, the tangent of the deflection.
    pub p: f64,
    /// dz/dx, the tangent of the pitch.
    pub q: f64,
    /// Where the line meets the plane x = 0, mm.
    pub y0: f64,
    /// Where the line meets the plane x = 0, mm.
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

#[cfg(test)]
mod tests {
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
