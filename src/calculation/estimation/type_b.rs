//! What makes a pose uncertain without showing in the scan: the stage, the sensor's place on it, the temperature. Known from
//! calibration, not from statistics (GUM, JCGM 100, 4.3: type B). In: standard uncertainties and how the method answers to a
//! profile that is shifted. Out: lines of the budget.

use super::budget::Line;
use super::linearity::{self, PatchInfluence};
use super::settings::SettingError;
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Matrix5x2, Vector3, Vector5};
use serde::{Deserialize, Serialize};

/// Standard uncertainties from calibration; zero where nothing is known or nothing matters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TypeB {
    /// How far the stage carries the sensor off a straight line, in y and in z, at any place of the rail, mm.
    pub stage_straightness_mm: f64,
    /// Places of the rail this far apart are off with the correlation exp(−1/2), as exp(−distance²/(2·this²)), since a guide
    /// bends smoothly, mm.
    pub stage_straightness_length_mm: f64,
    /// Deviation of the sensor's distance from the true one at any place of the laser line, alike in every profile, mm.
    pub sensor_linearity_mm: f64,
    /// Places of the laser line this far apart have deviations with the correlation exp(−1/2), as exp(−distance²/2·this²), mm.
    /// `None` takes a fifth of the width that is seen of the part, for which the effect on its position is about the largest.
    pub sensor_linearity_length_mm: Option<f64>,
    /// Rotation of the coordinates of the scan against the rail frame, about each axis, degrees.
    pub extrinsics_rotation_deg: f64,
    /// Place of the coordinates of the scan in the rail frame, along each axis, mm.
    pub extrinsics_position_mm: f64,
    /// Temperature of the part against the one that lengths are stated for, K.
    pub temperature_sigma_k: f64,
    /// How much of its length the part grows by in one kelvin; 11.5e-6 is steel.
    pub expansion_per_k: f64,
}

impl Default for TypeB {
    fn default() -> Self {
        Self {
            stage_straightness_mm: 0.0,
            stage_straightness_length_mm: 100.0,
            sensor_linearity_mm: 0.0,
            sensor_linearity_length_mm: None,
            extrinsics_rotation_deg: 0.0,
            extrinsics_position_mm: 0.0,
            temperature_sigma_k: 0.0,
            expansion_per_k: 11.5e-6,
        }
    }
}

/// How (p, q, y_ref, z_ref, radius) answer to a shift of one profile by 1 mm in y and in z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Influence {
    pub(super) x: f64,
    pub(super) effect: Matrix5x2<f64>,
}

/// What the lines of the budget are about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    pub(super) axis: AxisLine,
    pub(super) x_ref: f64,
    pub(super) radius: f64,
    /// Where the origin of the rail frame lies, mm: calibration is stated about it.
    pub(super) origin: [f64; 3],
}

impl Found {
    /// The point of the axis at x_ref from the origin of the rail frame, mm.
    fn offset_from_origin(&self) -> Vector3<f64> {
        let [y, z] = self.axis.at(self.x_ref);
        Vector3::new(self.x_ref, y, z) - Vector3::from(self.origin)
    }
}

/// Stretches of the rail whose profiles are taken together: what is to be added up grows as their square.
const STRETCHES: usize = 128;

impl TypeB {
    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingError`] names the first value that is out of range.
    pub(super) fn check(&self) -> Result<(), SettingError> {
        let length = ("between 0 and 1000 mm", 0.0..=1000.0);
        let correlation = ("between 1 and 100000 mm", 1.0..=1e5);
        let checks = [
            ("type_b.stage_straightness_mm", length.clone(), self.stage_straightness_mm),
            ("type_b.stage_straightness_length_mm", correlation.clone(), self.stage_straightness_length_mm),
            ("type_b.sensor_linearity_mm", length.clone(), self.sensor_linearity_mm),
            ("type_b.sensor_linearity_length_mm", correlation, self.sensor_linearity_length_mm.unwrap_or(1.0)),
            ("type_b.extrinsics_rotation_deg", ("between 0 and 10", 0.0..=10.0), self.extrinsics_rotation_deg),
            ("type_b.extrinsics_position_mm", length, self.extrinsics_position_mm),
            ("type_b.temperature_sigma_k", ("between 0 and 100", 0.0..=100.0), self.temperature_sigma_k),
            ("type_b.expansion_per_k", ("between 0 and 0.001", 0.0..=1e-3), self.expansion_per_k),
        ];
        match checks.into_iter().find(|(_, (_, range), value)| !range.contains(value)) {
            Some((name, (allowed, _), value)) => Err(SettingError { name, allowed, value }),
            None => Ok(()),
        }
    }

    /// Variance of the x of a point, mm²: the part of it that no scan shows.
    pub(super) fn along_x(&self, [x, y, z]: [f64; 3]) -> f64 {
        let rotation = self.extrinsics_rotation_deg.to_radians();
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        self.extrinsics_position_mm.powi(2) + rotation * rotation * (y * y + z * z) + (growth * x).powi(2)
    }

    /// Whether any standard uncertainty is stated.
    #[must_use]
    pub fn is_stated(&self) -> bool {
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        let stated = [
            self.stage_straightness_mm,
            self.sensor_linearity_mm,
            self.extrinsics_rotation_deg,
            self.extrinsics_position_mm,
            growth,
        ];
        stated.iter().any(|standard| *standard > 0.0)
    }

    /// The lines that are not zero, from the answers to a shift of each profile and of each patch of the laser line.
    pub(super) fn lines(&self, found: &Found, influences: &[Influence], patches: &[PatchInfluence]) -> Vec<Line> {
        let straightness = (self.stage_straightness_mm > 0.0)
            .then(|| Line::of_slopes(Line::STAGE_STRAIGHTNESS, &self.straightness(influences), &found.axis));
        let linearity = (self.sensor_linearity_mm > 0.0).then(|| {
            let covariance = linearity::covariance(patches, self.sensor_linearity_mm, self.sensor_linearity_length_mm);
            Line::of_slopes(Line::SENSOR_LINEARITY, &covariance, &found.axis)
        });
        [straightness, linearity].into_iter().flatten().chain(self.of_whole_scan(found)).collect()
    }

    /// Those of them that move everything in the scan together with the axis.
    pub(super) fn of_whole_scan(&self, found: &Found) -> Vec<Line> {
        let extrinsics = (self.extrinsics_rotation_deg > 0.0 || self.extrinsics_position_mm > 0.0)
            .then(|| Line::of_slopes(Line::SENSOR_EXTRINSICS, &self.extrinsics(found), &found.axis));
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        let temperature = (growth > 0.0).then(|| {
            // Every point moves away from the origin; the axis is read off where it meets x = x_ref.
            let from = found.offset_from_origin();
            let (p, q) = (found.axis.p, found.axis.q);
            let shift = Vector5::new(0.0, 0.0, from.y - p * from.x, from.z - q * from.x, found.radius);
            Line::of_shift(Line::TEMPERATURE, &(shift * growth), &found.axis)
        });
        [extrinsics, temperature].into_iter().flatten().collect()
    }

    /// Σ ρ(x, x′) u² E Eᵀ′ over pairs of profiles, y and z apart: the profiles are off by as much as the rail is there. A
    /// correlation of exp(−distance/length) would be that of a rail with a kink at every place, and would state a slope that is
    /// too small: most of a smooth bend over the length of a scan is a slope.
    fn straightness(&self, influences: &[Influence]) -> Matrix5<f64> {
        let stretches = stretches(influences);
        let mut sum = Matrix5::zeros();
        for a in &stretches {
            for b in &stretches {
                let distance = (a.x - b.x) / self.stage_straightness_length_mm;
                let alike = (-0.5 * distance * distance).exp();
                sum += a.effect * b.effect.transpose() * alike;
            }
        }
        sum * self.stage_straightness_mm.powi(2)
    }

    /// A rotation ω about the origin of the rail frame moves a point P by ω × P and turns the direction T by ω × T; a
    /// translation moves every point alike. The axis is read off where it meets x = x_ref.
    fn extrinsics(&self, found: &Found) -> Matrix5<f64> {
        let AxisLine { p, q, .. } = found.axis;
        let tangent = Vector3::new(1.0, p, q);
        // A point that is moved by `by` and a direction that is turned by `turn`, seen in the plane x = x_ref.
        let shift = |by: Vector3<f64>, turn: Vector3<f64>| {
            Vector5::new(turn.y - p * turn.x, turn.z - q * turn.x, by.y - p * by.x, by.z - q * by.x, 0.0)
        };
        let mut sum = Matrix5::zeros();
        for unit in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let rotation = unit * self.extrinsics_rotation_deg.to_radians();
            let turned = shift(rotation.cross(&found.offset_from_origin()), rotation.cross(&tangent));
            let moved = shift(unit * self.extrinsics_position_mm, Vector3::zeros());
            sum += turned * turned.transpose() + moved * moved.transpose();
        }
        sum
    }
}

/// Influences of neighbours taken together, at the mean of their places.
fn stretches(influences: &[Influence]) -> Vec<Influence> {
    let size = influences.len().div_ceil(STRETCHES).max(1);
    let together = |piece: &[Influence]| Influence {
        x: piece.iter().map(|influence| influence.x).sum::<f64>() / piece.len() as f64,
        effect: piece.iter().map(|influence| influence.effect).sum(),
    };
    influences.chunks(size).map(together).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Uncertainty;

    const ALONG_X: Found = Found {
        axis: AxisLine { p: 0.0, q: 0.0, y0: 30.0, z0: -400.0 },
        x_ref: 500.0,
        radius: 200.0,
        origin: [0.0; 3],
    };

    fn standard(type_b: TypeB, influences: &[Influence]) -> [f64; 5] {
        let lines = type_b.lines(&ALONG_X, influences, &[]);
        assert_eq!(lines.len(), 1);
        Uncertainty::of(&lines, &ALONG_X.axis, ALONG_X.x_ref).budget[0].standard
    }

    fn near(found: [f64; 5], expected: [f64; 5]) -> bool {
        found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-9)
    }

    /// A line through n profiles: y_ref is their mean, the slope Σ dx·y / Σ dx².
    fn line_through(stations: &[f64]) -> Vec<Influence> {
        let middle = stations.iter().sum::<f64>() / stations.len() as f64;
        let spread: f64 = stations.iter().map(|x| (x - middle).powi(2)).sum();
        let influence = |&x: &f64| {
            let (slope, position) = ((x - middle) / spread, 1.0 / stations.len() as f64);
            let mut effect = Matrix5x2::zeros();
            (effect[(0, 0)], effect[(1, 1)]) = (slope, slope);
            (effect[(2, 0)], effect[(3, 1)]) = (position, position);
            Influence { x, effect }
        };
        stations.iter().map(influence).collect()
    }

    #[test]
    fn what_is_zero_has_no_line() {
        assert_eq!(TypeB::default().lines(&ALONG_X, &line_through(&[0.0, 100.0]), &[]), []);
    }

    #[test]
    fn a_rail_that_is_off_everywhere_alike_moves_the_axis_and_does_not_turn_it() {
        let stations: Vec<f64> = (0..300).map(f64::from).collect();
        let alike = TypeB { stage_straightness_mm: 0.01, stage_straightness_length_mm: 1e5, ..TypeB::default() };
        let [p, q, y, z, radius] = standard(alike, &line_through(&stations));
        assert!((y - 0.01).abs() < 1e-4 && (z - 0.01).abs() < 1e-4, "{y} {z}");
        // A smooth rail has a slope of 0.01 mm/L at any place.
        assert!((p - 1e-7).abs() < 1e-9 && (q - 1e-7).abs() < 1e-9 && radius == 0.0, "{p} {q}");
    }

    #[test]
    fn a_rail_that_is_off_independently_at_two_ends_tilts_as_error_propagation_says() {
        let independent = TypeB { stage_straightness_mm: 0.01, stage_straightness_length_mm: 1.0, ..TypeB::default() };
        let found = standard(independent, &line_through(&[0.0, 1000.0]));
        let (position, slope) = (0.01 / 2f64.sqrt(), 0.01 * 2f64.sqrt() / 1000.0);
        assert!(near(found, [slope, slope, position, position, 0.0]), "{found:?}");
    }

    #[test]
    fn a_rotated_sensor_turns_the_axis_and_moves_it_by_its_lever() {
        let rotated = TypeB { extrinsics_rotation_deg: 0.001_f64.to_degrees(), ..TypeB::default() };
        // About X by (−z, y), about Y z by −x, about Z y by x, each times 0.001.
        let y = 0.001 * 400f64.hypot(500.0);
        let z = 0.001 * 30f64.hypot(500.0);
        assert!(near(standard(rotated, &[]), [0.001, 0.001, y, z, 0.0]));
        let moved = TypeB { extrinsics_position_mm: 0.02, ..TypeB::default() };
        assert!(near(standard(moved, &[]), [0.0, 0.0, 0.02, 0.02, 0.0]));
    }

    #[test]
    fn a_warm_part_grows_about_the_origin() {
        let warm = TypeB { temperature_sigma_k: 2.0, expansion_per_k: 1e-5, ..TypeB::default() };
        assert!(near(standard(warm, &[]), [0.0, 0.0, 6e-4, 8e-3, 4e-3]));
    }
}
