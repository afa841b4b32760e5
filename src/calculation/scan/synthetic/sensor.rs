//! The laser line scanner of a synthetic scan: its measuring plane, the intersections of its rays with the cylinder, and its
//! systematic errors, which are equal in all profiles. A scan does not show most of them, and the Cramér-Rao bound does not include
//! them.

use crate::geometry::AxisLine;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Tilt of the laser plane relative to the plane perpendicular to the rail. The plane of the profile at x_i is rotated about the
/// point (x_i, 0, 0): x = x_i + z·tan(`about_y_deg`) − y·tan(`about_z_deg`).
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
    /// x of the intersection of the axis with the laser plane.
    pub(super) x: f64,
    /// Unit direction within the laser plane.
    pub(super) direction: [f64; 3],
}

impl LaserPlane {
    /// Whether it is perpendicular to the rail.
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

    /// The line of sight from the axis in `direction`, radians from +Z towards −Y, viewed along X.
    pub(super) fn sight(&self, axis: &AxisLine, x: f64, direction: f64) -> Sight {
        let [by_y, by_z] = self.slopes();
        let (y, z) = (-direction.sin(), direction.cos());
        let along = by_y * y + by_z * z;
        let length = (1.0 + along * along).sqrt();
        // The axis crosses the plane at x = x_i + by_y·(y0 + p·x) + by_z·(z0 + q·x).
        let x = (x + (by_y * axis.y0 + by_z * axis.z0)) / (1.0 - (by_y * axis.p + by_z * axis.q));
        Sight { x, direction: [along / length, y / length, z / length] }
    }
}

impl Sight {
    /// (y, z) of the point on this line that lies `offset` mm beyond the surface.
    ///
    /// A point at the distance ρ along the unit direction D has the distance ρ·√(1 − (D·T)²/n²) from the axis of direction T = (1,
    /// p, q), n² = 1 + p² + q².
    pub(super) fn point(&self, axis: &AxisLine, radius_mm: f64, offset: f64) -> [f64; 2] {
        let AxisLine { p, q, .. } = *axis;
        let [unit_x, unit_y, unit_z] = self.direction;
        let along = (p * unit_y + q * unit_z + unit_x).powi(2) / (1.0 + p * p + q * q);
        let reach = radius_mm / (1.0 - along).sqrt() + offset;
        let [centre_y, centre_z] = axis.at(self.x);
        [centre_y + reach * unit_y, centre_z + reach * unit_z]
    }
}

/// Errors of the sensor; none by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorErrors {
    /// Smooth non-linearity of z.
    pub bend: Bend,
    /// Periodic non-linearity of z.
    pub ripple: Ripple,
    /// Displacement of points on steep flanks.
    pub curl: Curl,
    /// Points from a second reflection.
    pub reflections: Reflections,
}

/// Curvature of the scale of z: dz = size·((z − middle)/range)².
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bend {
    /// The error at `range_mm` from the middle; 0 for none.
    pub size_mm: f64,
    /// z in the rail frame at which the error is zero.
    pub middle_mm: f64,
    /// Half of the measuring range in z.
    pub range_mm: f64,
}

/// A wave along the laser line, as the pixels of the camera cause it: dz = amplitude·sin(2π·y/period).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ripple {
    /// The largest error; 0 for none.
    pub amplitude_mm: f64,
    /// Length of one wave along y.
    pub period_mm: f64,
}

/// Points beyond an angle of incidence are displaced away from the axis, more for steeper surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Curl {
    /// Displacement for each radian beyond the angle, along the line of sight from the axis; below 0 towards the axis.
    pub mm_per_rad: f64,
    /// The angle between the line of sight and the direction of the sensor.
    pub from_deg: f64,
}

/// Points that the sensor sees by a second reflection, at a wrong position along the line of sight from the axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reflections {
    /// Share of the points on the part.
    pub ratio: f64,
    /// Distance from the true point; above 0 away from the axis.
    pub offset_mm: f64,
}

impl Bend {
    fn error_mm(self, z: f64) -> f64 {
        if self.size_mm == 0.0 { 0.0 } else { self.size_mm * ((z - self.middle_mm) / self.range_mm).powi(2) }
    }
}

impl Ripple {
    fn error_mm(self, y: f64) -> f64 {
        if self.amplitude_mm == 0.0 { 0.0 } else { self.amplitude_mm * (TAU * y / self.period_mm).sin() }
    }
}

impl Curl {
    /// `facing` is the direction in which the surface faces the sensor, `direction` that of the line of sight, radians from +Z
    /// towards −Y.
    pub(super) fn offset_mm(self, facing: f64, direction: f64) -> f64 {
        if self.mm_per_rad == 0.0 {
            return 0.0;
        }
        let incidence = (direction - facing).abs();
        self.mm_per_rad * (incidence - self.from_deg.to_radians()).max(0.0)
    }
}

impl Reflections {
    /// Displacement of the next point on the part; usually none.
    pub(super) fn offset_mm(self, chance: &mut ChaCha8Rng) -> f64 {
        // Drawn only if requested, because a simulated cell's sensor has one source of random numbers for all effects.
        let is_displaced = self.ratio > 0.0 && chance.random_bool(self.ratio.min(1.0));
        if is_displaced { self.offset_mm } else { 0.0 }
    }
}

impl SensorErrors {
    /// The point as a non-linear sensor reports it.
    pub(super) fn reported(&self, [y, z]: [f64; 2]) -> [f64; 2] {
        [y, z + (self.bend.error_mm(z) + self.ripple.error_mm(y))]
    }
}

#[cfg(test)]
mod laser_plane_tests {
    use super::*;

    #[test]
    fn rays_of_a_tilted_plane_meet_the_cylinder_in_the_plane() {
        for (about_y_deg, about_z_deg) in [(0.0, 0.0), (5.0, 0.0), (0.0, -12.0), (25.0, 30.0)] {
            let plane = LaserPlane { about_y_deg, about_z_deg };
            let axis = AxisLine { p: 0.1, q: -0.15, y0: 40.0, z0: -300.0 };
            for step in 0..12 {
                let sight = plane.sight(&axis, 500.0, 0.5 * f64::from(step));
                let [y, z] = sight.point(&axis, 80.0, 0.0);
                let x = plane.x_at(500.0, [y, z]);
                // The rotated normal of the plane: Rz·Ry·(1, 0, 0) is proportional to (1, −dx/dy, −dx/dz).
                let normal = [1.0, about_z_deg.to_radians().tan(), -about_y_deg.to_radians().tan()];
                let off_plane = normal[0] * (x - 500.0) + normal[1] * y + normal[2] * z;
                assert!(off_plane.abs() < 1e-9, "{off_plane}");
                assert!((axis.distance([x, y, z]) - 80.0).abs() < 1e-9);
                // It lies on the ray that starts at the intersection of the axis with the plane.
                let [axis_y, axis_z] = axis.at(sight.x);
                let [by_x, by_y, by_z] = sight.direction;
                let reach = (y - axis_y) * by_y + (z - axis_z) * by_z + (x - sight.x) * by_x;
                assert!((x - sight.x - reach * by_x).abs() < 1e-9 && (y - axis_y - reach * by_y).abs() < 1e-9);
            }
        }
    }
}

#[cfg(test)]
mod sensor_errors_tests {
    use super::*;
    use crate::scan::Scan;
    use crate::scan::synthetic::{Part, make};

    fn exact(sensor: SensorErrors) -> Part {
        Part { noise_sigma_mm: 0.0, profiles_count: 20, points_count: 200, sensor, ..Part::smooth(1) }
    }

    fn points(scan: &Scan) -> Vec<[f64; 3]> {
        scan.stations().iter().flat_map(|station| scan.points_of(station)).collect()
    }

    fn scanned(part: &Part) -> Vec<[f64; 3]> {
        points(&make(part).expect("a scan").0)
    }

    #[test]
    fn a_bend_and_a_ripple_move_z_by_their_formulas() {
        let bend = Bend { size_mm: 0.2, middle_mm: 150.0, range_mm: 100.0 };
        let ripple = Ripple { amplitude_mm: 0.03, period_mm: 8.0 };
        let plain = scanned(&exact(SensorErrors::default()));
        let bent = scanned(&exact(SensorErrors { bend, ripple, ..SensorErrors::default() }));
        for ([x, y, z], bent) in plain.into_iter().zip(bent) {
            let error = 0.2 * (z - 150.0).powi(2) / 1e4 + 0.03 * (TAU * y / 8.0).sin();
            assert!(bent[..2] == [x, y] && (bent[2] - z - error).abs() < 1e-12);
        }
    }

    #[test]
    fn points_on_flanks_are_displaced_only_beyond_the_angle() {
        let curl = Curl { mm_per_rad: 0.5, from_deg: 50.0 };
        let part = exact(SensorErrors { curl, ..SensorErrors::default() });
        for [x, y, z] in scanned(&part) {
            let [axis_y, axis_z] = part.axis.at(x);
            let (u, w) = (y - axis_y, z - axis_z);
            let beyond = (u.atan2(w).abs() - 50f64.to_radians()).max(0.0);
            // Along the line of sight the distance from the axis grows by the offset times the cosine of the tilt along it. The
            // tilt of the axis is 1.17°, whose cosine is above 0.9997.
            let off = part.axis.distance([x, y, z]) - part.radius_mm;
            assert!((off - 0.5 * beyond).abs() < 3e-4 * 0.5 * beyond + 1e-9, "{off} {beyond}");
        }
    }

    #[test]
    fn the_requested_share_is_reflected_and_does_not_count_as_on_the_part() {
        let reflections = Reflections { ratio: 0.2, offset_mm: -3.0 };
        let part = exact(SensorErrors { reflections, ..SensorErrors::default() });
        let (scan, truth) = make(&part).expect("a scan");
        let off = points(&scan).into_iter().filter(|point| part.axis.distance(*point) < part.radius_mm - 2.9);
        let share = off.count() as f64 / 4000.0;
        // 4000 points: the share scatters by √(0.2·0.8/4000) = 0.0063.
        assert!((share - 0.2).abs() < 4.0 * 0.0063, "{share}");
        let on_part = truth.inner_ratio_per_profile.iter().sum::<f64>() / 20.0;
        assert!((on_part - (1.0 - share)).abs() < 1e-12);
    }
}
