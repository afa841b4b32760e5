//! The plane in which a laser line scanner measures, and where its rays meet the cylinder.

use super::Part;
use crate::geometry::AxisLine;

/// Tilt of the laser plane against the plane square to the rail. The plane of the profile at x_i turns about the point
/// (x_i, 0, 0): x = x_i + z·tan(`about_y_deg`) − y·tan(`about_z_deg`).
///
/// A tilted sensor reports y and z of its points, and x follows from the plane: noise moves a point within the plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LaserPlane {
    /// Rotation about Y, towards +X on the side of +Z.
    pub about_y_deg: f64,
    /// Rotation about Z, towards −X on the side of +Y.
    pub about_z_deg: f64,
}

/// A line of sight from the axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// x of the point where the axis crosses the laser plane.
    pub(super) x: f64,
    /// Unit direction within the laser plane.
    pub(super) direction: [f64; 3],
}

impl LaserPlane {
    /// Whether it is square to the rail.
    #[must_use]
    pub fn is_square(&self) -> bool {
        self.about_y_deg == 0.0 && self.about_z_deg == 0.0
    }

    /// dx/dy and dx/dz within the plane.
    fn slopes(&self) -> [f64; 2] {
        [-self.about_z_deg.to_radians().tan(), self.about_y_deg.to_radians().tan()]
    }

    /// x of the point at (y, z) in the plane of the profile at `x`.
    #[must_use]
    pub fn x_at(&self, x: f64, [y, z]: [f64; 2]) -> f64 {
        let [by_y, by_z] = self.slopes();
        x + (by_y * y + by_z * z)
    }

    /// The line of sight from the axis in `direction`, radians from +Z towards −Y seen along X.
    pub(super) fn sight(&self, axis: &AxisLine, x: f64, direction: f64) -> Sight {
        let [by_y, by_z] = self.slopes();
        let (y, z) = (-direction.sin(), direction.cos());
        let along = by_y * y + by_z * z;
        let length = (1.0 + along * along).sqrt();
        // The axis crosses the plane where x = x_i + by_y·(y0 + p·x) + by_z·(z0 + q·x).
        let x = (x + (by_y * axis.y0 + by_z * axis.z0)) / (1.0 - (by_y * axis.p + by_z * axis.q));
        Sight { x, direction: [along / length, y / length, z / length] }
    }
}

impl Sight {
    /// (y, z) of the point on this line that lies `offset` mm beyond the surface.
    ///
    /// A point at the distance ρ along the unit direction D has the distance ρ·√(1 − (D·T)²/n²) from the axis of direction
    /// T = (1, p, q), n² = 1 + p² + q².
    pub(super) fn point(&self, part: &Part, offset: f64) -> [f64; 2] {
        let AxisLine { p, q, .. } = part.axis;
        let [unit_x, unit_y, unit_z] = self.direction;
        let along = (p * unit_y + q * unit_z + unit_x).powi(2) / (1.0 + p * p + q * q);
        let reach = part.radius_mm / (1.0 - along).sqrt() + offset;
        let [centre_y, centre_z] = part.axis.at(self.x);
        [centre_y + reach * unit_y, centre_z + reach * unit_z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_of_a_tilted_plane_meet_the_cylinder_in_the_plane() {
        for (about_y_deg, about_z_deg) in [(0.0, 0.0), (5.0, 0.0), (0.0, -12.0), (25.0, 30.0)] {
            let plane = LaserPlane { about_y_deg, about_z_deg };
            let axis = AxisLine { p: 0.1, q: -0.15, y0: 40.0, z0: -300.0 };
            let part = Part { axis, radius_mm: 80.0, laser_plane: plane, ..Part::smooth(1) };
            for step in 0..12 {
                let sight = plane.sight(&axis, 500.0, 0.5 * f64::from(step));
                let [y, z] = sight.point(&part, 0.0);
                let x = plane.x_at(500.0, [y, z]);
                // The rotated normal of the plane: Rz·Ry·(1, 0, 0) is proportional to (1, −dx/dy, −dx/dz).
                let normal = [1.0, about_z_deg.to_radians().tan(), -about_y_deg.to_radians().tan()];
                let off_plane = normal[0] * (x - 500.0) + normal[1] * y + normal[2] * z;
                assert!(off_plane.abs() < 1e-9, "{off_plane}");
                assert!((axis.distance([x, y, z]) - 80.0).abs() < 1e-9);
                // It lies on the ray: from where the axis crosses the plane, along the direction.
                let [axis_y, axis_z] = axis.at(sight.x);
                let [by_x, by_y, by_z] = sight.direction;
                let reach = (y - axis_y) * by_y + (z - axis_z) * by_z + (x - sight.x) * by_x;
                assert!((x - sight.x - reach * by_x).abs() < 1e-9 && (y - axis_y - reach * by_y).abs() < 1e-9);
            }
        }
    }
}
