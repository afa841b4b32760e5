//! Errors that the scan cannot show: those of the stage, of the mounting and the linearity of the sensor, and of the temperature.
//! They come from calibration, not from statistics (GUM, JCGM 100, 4.3: type B), and become lines of the budget through the
//! response of the method to a shifted profile.
//!
//! Linearity of the sensor: its distance scale deviates by a smooth function δ(y) of the position along the laser line, equal in
//! every profile, so that more profiles do not average it out. δ is modelled as a random function with the standard deviation u and
//! the correlation ρ = exp(−(y − y′)²/2L²), and the pose responds with E(y) to a shift of the points about y in z. The covariance
//! of the pose is then Σ ρ(y_a − y_b) u² E_a E_bᵀ over patches of the line. Along a tilted part the points of one patch lie at
//! different z, where δ differs as it does between positions of the line: its slope along z has the standard deviation u/L, to
//! which the pose responds with F(y), and Σ ρ (u/L)² F_a F_bᵀ is added.

use super::budget::Line;
use super::settings::TypeB;
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Matrix5x2, Vector3, Vector5};

/// Response of (p, q, y_ref, z_ref, radius) to a shift of one profile by 1 mm in y and in z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Influence {
    pub(super) x: f64,
    pub(super) effect: Matrix5x2<f64>,
}

/// The pose that the lines of the budget refer to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Found {
    pub(super) axis: AxisLine,
    pub(super) x_ref: f64,
    pub(super) radius: f64,
    /// Origin of the rail frame, mm: calibration is stated about it.
    pub(super) origin: [f64; 3],
}

impl Found {
    /// The point of the axis at x_ref relative to the origin of the rail frame, mm.
    fn offset_from_origin(&self) -> Vector3<f64> {
        let [y, z] = self.axis.at(self.x_ref);
        Vector3::new(self.x_ref, y, z) - Vector3::from(self.origin)
    }
}

/// Number of stretches of the rail whose profiles are combined: the number of terms of the sum grows as its square.
const STRETCHES: usize = 128;

impl TypeB {
    /// Variance of the x of a point, mm²: the contribution that no scan shows.
    pub(super) fn along_x(&self, [x, y, z]: [f64; 3]) -> f64 {
        let rotation = self.extrinsics_rotation_deg.to_radians();
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        self.extrinsics_position_mm.powi(2) + rotation * rotation * (y * y + z * z) + (growth * x).powi(2)
    }

    /// The lines that are not zero, from the responses to a shift of each profile and of each patch of the laser line.
    pub(super) fn lines(&self, found: &Found, influences: &[Influence], patches: &[PatchInfluence]) -> Vec<Line> {
        let straightness = (self.stage_straightness_mm > 0.0)
            .then(|| Line::of_slopes(Line::STAGE_STRAIGHTNESS, &self.straightness(influences), &found.axis));
        let linearity = (self.sensor_linearity_mm > 0.0).then(|| {
            let covariance = linearity_covariance(patches, self.sensor_linearity_mm, self.sensor_linearity_length_mm);
            Line::of_slopes(Line::SENSOR_LINEARITY, &covariance, &found.axis)
        });
        [straightness, linearity].into_iter().flatten().chain(self.of_whole_scan(found)).collect()
    }

    /// The lines of errors that move everything in the scan together with the axis.
    pub(super) fn of_whole_scan(&self, found: &Found) -> Vec<Line> {
        let extrinsics = (self.extrinsics_rotation_deg > 0.0 || self.extrinsics_position_mm > 0.0)
            .then(|| Line::of_slopes(Line::SENSOR_EXTRINSICS, &self.extrinsics(found), &found.axis));
        let growth = self.temperature_sigma_k * self.expansion_per_k;
        let temperature = (growth > 0.0).then(|| {
            // Every point moves away from the origin; the axis is evaluated at its intersection with x = x_ref.
            let from = found.offset_from_origin();
            let (p, q) = (found.axis.p, found.axis.q);
            let shift = Vector5::new(0.0, 0.0, from.y - p * from.x, from.z - q * from.x, found.radius);
            Line::of_shift(Line::TEMPERATURE, &(shift * growth), &found.axis)
        });
        [extrinsics, temperature].into_iter().flatten().collect()
    }

    /// Σ ρ(x, x′) u² E Eᵀ′ over pairs of profiles, y and z separately: a profile has the deviation of the rail at its x. A
    /// correlation of exp(−distance/length) would describe a rail with a kink at every position and state too small a slope: most
    /// of a smooth bend over the length of a scan is a slope.
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

    /// A rotation ω about the origin of the rail frame moves a point P by ω × P and turns the direction T by ω × T; a translation
    /// moves every point equally. The axis is evaluated at its intersection with x = x_ref.
    fn extrinsics(&self, found: &Found) -> Matrix5<f64> {
        let AxisLine { p, q, .. } = found.axis;
        let tangent = Vector3::new(1.0, p, q);
        // A point that is moved by `by` and a direction that is turned by `turn`, evaluated in the plane x = x_ref.
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

/// Influences of neighbours combined, at the mean of their positions.
fn stretches(influences: &[Influence]) -> Vec<Influence> {
    let size = influences.len().div_ceil(STRETCHES).max(1);
    let together = |piece: &[Influence]| Influence {
        x: piece.iter().map(|influence| influence.x).sum::<f64>() / piece.len() as f64,
        effect: piece.iter().map(|influence| influence.effect).sum(),
    };
    influences.chunks(size).map(together).collect()
}

/// Number of patches along the line; a correlation length shorter than a patch is treated as one patch, which overstates its
/// effect.
const PATCHES: usize = 64;
/// Default correlation length, as a share of the observed width: shorter errors average out along the line, longer ones shift the
/// part as a whole. Between 0.15 and 0.25 the effect on the position is within 10 % of its maximum, for arcs of 60° to 150°.
const LENGTH_SHARE: f64 = 0.2;

/// Response of (p, q, y_ref, z_ref, radius) to a shift of the points of one patch by 1 mm in z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PatchInfluence {
    /// Middle of the patch, mm.
    pub(super) y: f64,
    pub(super) effect: Vector5<f64>,
    /// Response to a shift by 1 mm for each mm by which a point lies higher than the others of the patch.
    pub(super) slope: Vector5<f64>,
}

/// The laser line cut into patches of equal width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Patches {
    low: f64,
    width: f64,
}

impl Patches {
    /// Patches over all of these positions; `None` if there are none.
    pub(super) fn over(places: impl Iterator<Item = f64>) -> Option<Self> {
        let wider = |[low, high]: [f64; 2], y: f64| [low.min(y), high.max(y)];
        let [low, high] = places.fold([f64::INFINITY, f64::NEG_INFINITY], wider);
        (low <= high).then(|| Self { low, width: (high - low) / PATCHES as f64 })
    }

    pub(super) const fn count() -> usize {
        PATCHES
    }

    /// The patch that contains this position.
    pub(super) fn index(&self, y: f64) -> usize {
        let place = (y - self.low) / self.width.max(f64::MIN_POSITIVE);
        // The cast saturates, and NaN becomes 0.
        (place as usize).min(PATCHES - 1)
    }

    /// The influences of these patches, given in order.
    pub(super) fn influences(&self, effects: Vec<[Vector5<f64>; 2]>) -> Vec<PatchInfluence> {
        let influence = |(index, [effect, slope]): (usize, [Vector5<f64>; 2])| PatchInfluence {
            y: self.low + (index as f64 + 0.5) * self.width,
            effect,
            slope,
        };
        effects.into_iter().enumerate().map(influence).collect()
    }
}

/// Covariance of (p, q, y_ref, z_ref, radius) under a linearity error of `standard` mm with this correlation length, mm.
fn linearity_covariance(influences: &[PatchInfluence], standard: f64, length: Option<f64>) -> Matrix5<f64> {
    let seen = || influences.iter().filter(|influence| influence.effect.amax() > 0.0);
    let ends = seen().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at.y), high.max(at.y)]);
    let [low, high] = ends;
    let length = length.unwrap_or(LENGTH_SHARE * (high - low)).max(f64::MIN_POSITIVE);
    let mut sum = Matrix5::zeros();
    for a in seen() {
        for b in seen() {
            let correlation = (-0.5 * ((a.y - b.y) / length).powi(2)).exp();
            sum += a.effect * b.effect.transpose() * correlation;
            // Divided one by one, because the square of the least length underflows.
            sum += (a.slope / length) * (b.slope / length).transpose() * correlation;
        }
    }
    sum * standard.powi(2)
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
    fn an_uncertainty_of_zero_has_no_line() {
        assert_eq!(TypeB::default().lines(&ALONG_X, &line_through(&[0.0, 100.0]), &[]), []);
    }

    #[test]
    fn a_rail_with_a_constant_deviation_moves_the_axis_and_does_not_turn_it() {
        let stations: Vec<f64> = (0..300).map(f64::from).collect();
        let alike = TypeB { stage_straightness_mm: 0.01, stage_straightness_length_mm: 1e5, ..TypeB::default() };
        let [p, q, y, z, radius] = standard(alike, &line_through(&stations));
        assert!((y - 0.01).abs() < 1e-4 && (z - 0.01).abs() < 1e-4, "{y} {z}");
        // A smooth rail has a slope of 0.01 mm/L at any position.
        assert!((p - 1e-7).abs() < 1e-9 && (q - 1e-7).abs() < 1e-9 && radius == 0.0, "{p} {q}");
    }

    #[test]
    fn independent_deviations_at_two_ends_tilt_the_axis_as_error_propagation_predicts() {
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

#[cfg(test)]
mod linearity_tests {
    use super::*;

    /// The position z is the mean over the line.
    fn mean_of(places: &[f64]) -> Vec<PatchInfluence> {
        let effect = Vector5::new(0.0, 0.0, 0.0, 1.0 / places.len() as f64, 0.0);
        places.iter().map(|&y| PatchInfluence { y, effect, slope: Vector5::zeros() }).collect()
    }

    #[test]
    fn a_constant_error_shifts_the_axis_and_independent_ones_average_out() {
        let line = mean_of(&[-30.0, -10.0, 10.0, 30.0]);
        let z = |length: f64| linearity_covariance(&line, 0.02, Some(length))[(3, 3)].sqrt();
        assert!((z(1e5) - 0.02).abs() < 1e-8);
        assert!((z(1.0) - 0.01).abs() < 1e-8);
        // Two positions 20 mm apart with L = 20 mm: u²·(1 + exp(−1/2))/2.
        let two = linearity_covariance(&mean_of(&[0.0, 20.0]), 0.02, Some(20.0))[(3, 3)];
        assert!((two - 4e-4 * 0.5 * (1.0 + (-0.5f64).exp())).abs() < 1e-15);
    }

    #[test]
    fn along_a_tilted_part_the_slope_of_the_error_counts() {
        let slope = Vector5::new(0.0, 0.5, 0.0, 0.0, 0.0);
        let place = PatchInfluence { y: 0.0, effect: Vector5::new(0.0, 0.0, 0.0, 1.0, 0.0), slope };
        let found = linearity_covariance(&[place], 0.02, Some(10.0));
        assert!(
            (found[(3, 3)] - 4e-4).abs() < 1e-18 && (found[(1, 1)] - (0.5 * 0.02 / 10.0_f64).powi(2)).abs() < 1e-18
        );
    }

    #[test]
    fn the_default_length_is_a_share_of_the_width_and_one_position_needs_none() {
        let line = mean_of(&[-50.0, 0.0, 50.0]);
        assert_eq!(linearity_covariance(&line, 0.01, None), linearity_covariance(&line, 0.01, Some(20.0)));
        assert!((linearity_covariance(&mean_of(&[3.0]), 0.01, None)[(3, 3)] - 1e-4).abs() < 1e-18);
        assert_eq!(linearity_covariance(&[], 0.01, None), Matrix5::zeros());
    }

    #[test]
    fn patches_cover_the_line_and_clamp_positions_outside() {
        let patches = Patches::over([-10.0, 54.0].into_iter()).expect("places");
        assert_eq!([-10.0, -9.5, 53.5, 54.0].map(|y| patches.index(y)), [0, 0, 63, 63]);
        assert_eq!([-1e9, 1e9, f64::NAN].map(|y| patches.index(y)), [0, 63, 0]);
        assert_eq!(Patches::over([2.0].into_iter()).expect("a place").index(2.0), 0);
        assert_eq!(Patches::over(std::iter::empty()), None);
    }
}
