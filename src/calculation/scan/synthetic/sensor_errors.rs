//! Systematic errors of a laser line scanner, which repeat from profile to profile. A scan does not show most of them, and the
//! Cramér-Rao bound of the truth knows none of them.

use super::Part;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Errors of the sensor; none by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorErrors {
    /// Smooth non-linearity of z.
    pub bend: Bend,
    /// Periodic non-linearity of z.
    pub ripple: Ripple,
    /// Points on steep flanks.
    pub curl: Curl,
    /// Points seen by a second reflection.
    pub reflections: Reflections,
}

/// The scale of z is bent: dz = size·((z − middle)/range)².
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bend {
    /// The error at `range_mm` from the middle; 0 for none.
    pub size_mm: f64,
    /// Where the error vanishes, z in the rail frame.
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

/// Points beyond an angle of incidence move away from the axis, the farther the steeper the surface stands.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Curl {
    /// How much for each radian beyond the angle, along the line of sight from the axis; below 0 towards the axis.
    pub mm_per_rad: f64,
    /// The angle between the line of sight and the direction of the sensor.
    pub from_deg: f64,
}

/// Points that the sensor sees by a second reflection, on a wrong place along the line of sight from the axis.
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
    /// `direction` is that of the line of sight, radians from +Z towards −Y.
    pub(super) fn offset_mm(self, part: &Part, direction: f64) -> f64 {
        if self.mm_per_rad == 0.0 {
            return 0.0;
        }
        let incidence = (direction - part.facing()).abs();
        self.mm_per_rad * (incidence - self.from_deg.to_radians()).max(0.0)
    }
}

impl Reflections {
    /// How far the next point on the part is displaced; mostly not at all.
    pub(super) fn offset_mm(self, chance: &mut ChaCha8Rng) -> f64 {
        // Drawn only where it is asked for: a sensor of a simulated cell has one source of random numbers for everything.
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
mod tests {
    use super::*;
    use crate::scan::Scan;
    use crate::scan::synthetic::make;

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
    fn flanks_curl_beyond_the_angle_alone() {
        let curl = Curl { mm_per_rad: 0.5, from_deg: 50.0 };
        let part = exact(SensorErrors { curl, ..SensorErrors::default() });
        for [x, y, z] in scanned(&part) {
            let [axis_y, axis_z] = part.axis.at(x);
            let (u, w) = (y - axis_y, z - axis_z);
            let beyond = (u.atan2(w).abs() - 50f64.to_radians()).max(0.0);
            // Along the line of sight: the distance from the axis grows by that times the cosine of the tilt along it, and the
            // tilt of the axis is 1.17°, whose cosine is above 0.9997.
            let off = part.axis.distance([x, y, z]) - part.radius_mm;
            assert!((off - 0.5 * beyond).abs() < 3e-4 * 0.5 * beyond + 1e-9, "{off} {beyond}");
        }
    }

    #[test]
    fn the_asked_share_is_reflected_and_does_not_count_as_on_the_part() {
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
