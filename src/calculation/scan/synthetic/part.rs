//! The description of a synthetic part and of its simulated scan.

use super::export::Export;
use super::features::{Edges, Feature, Interference, Prepared};
use super::noise::Noise;
use super::sensor::{LaserPlane, SensorErrors};
use super::travel::Travel;
use crate::geometry::AxisLine;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// A part and its simulated scan. Lengths in mm, angles in degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Radius of the cylinder.
    pub radius_mm: f64,
    /// The true axis.
    pub axis: AxisLine,
    /// Plane of the first profile.
    pub x_start_mm: f64,
    /// Distance from the first profile to the last.
    pub length_mm: f64,
    /// Number of profiles.
    pub profiles_count: usize,
    /// Points a profile, before drop-outs.
    pub points_count: usize,
    /// Observed arc of each section.
    pub arc_deg: f64,
    /// Direction of the sensor, from +Z towards +Y; 0 is above. The middle of the arc faces the sensor.
    pub view_deg: f64,
    /// The side of the cylinder that the sensor observes.
    pub side: Side,
    /// Tilt of the laser plane relative to the rail.
    pub laser_plane: LaserPlane,
    /// Distribution of the points of a profile over its arc.
    pub sampling: Sampling,
    /// Largest displacement of a profile from its regular position, as a share of half the spacing; with 1 neighbours can coincide.
    pub spacing_spread: f64,
    /// Standard deviation of the noise, in y and in z.
    pub noise_sigma_mm: f64,
    /// Correlation of a point's noise with its predecessor's, 0 to 1; the standard deviation is unchanged.
    pub noise_correlation: f64,
    /// Degrees of freedom, above 2, of the Student t distribution of the noise; `None` for normal noise. The standard deviation is
    /// unchanged.
    pub noise_freedom: Option<f64>,
    /// Standard deviation of the displacement of complete profiles, in y and in z.
    pub jitter_sigma_mm: f64,
    /// Systematic errors of the sensor.
    pub sensor: SensorErrors,
    /// Motion of the stage, and which profiles are delivered.
    pub travel: Travel,
    /// Features on the part, as shares of the profiles that have them.
    pub interference: Interference,
    /// Objects next to the part.
    pub surroundings: Surroundings,
    /// Share of the points that are missing.
    pub drop_out_ratio: f64,
    /// Share of the points that are displaced by up to [`SPIKE_MM`].
    pub spike_ratio: f64,
    /// The ends of the part; profiles beyond them show the adjacent object, or nothing.
    pub edges: Edges,
    /// The format of the points.
    pub export: Export,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Distribution of the points of a profile over its arc.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sampling {
    /// By equal angles about the axis.
    #[default]
    EvenAngle,
    /// By equal steps of y, as for a sensor above the part; surfaces more than 90° from +Z are not visible.
    EvenAcross,
}

/// The observed side of a cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Side {
    /// The outer surface of a shaft or pipe.
    #[default]
    Outside,
    /// The inner surface of a pipe: the sensor observes the opposite wall. Features on the part rise towards the axis by the same
    /// height as outside, so a flat clamp does not look flat.
    Inside,
}

impl Side {
    /// 1 if away from the surface is away from the axis, −1 if it is towards the axis.
    pub(super) fn sign(self) -> f64 {
        match self {
            Self::Outside => 1.0,
            Self::Inside => -1.0,
        }
    }
}

/// Largest displacement of a point by a spike.
pub const SPIKE_MM: f64 = 10.0;

/// Number of repetitions of the blocks of features along the part.
pub(super) const BLOCKS_COUNT: usize = 3;

impl Part {
    /// The published situation of a complete part: screw holes, straight holes and clamps on 60 % of its profiles.
    #[must_use]
    pub fn with_interference(seed: u64) -> Self {
        Self {
            interference: Interference {
                screw_holes: 0.20,
                straight_holes: 0.16,
                clamps: 0.24,
                clamp_arc: 0.5,
                clamp_height_mm: 25.0,
                ..Interference::default()
            },
            ..Self::smooth(seed)
        }
    }

    /// A smooth part of 200 mm radius and 800 mm length; 400 profiles of 640 points observe 140° of it, and it is tilted by about
    /// 1°.
    #[must_use]
    pub fn smooth(seed: u64) -> Self {
        Self {
            radius_mm: 200.0,
            axis: AxisLine {
                p: 0.3575_f64.to_radians().tan(),
                q: 1.1127_f64.to_radians().tan(),
                y0: -8.272,
                z0: 6.514,
            },
            x_start_mm: 0.0,
            length_mm: 800.0,
            profiles_count: 400,
            points_count: 640,
            arc_deg: 140.0,
            view_deg: 0.0,
            side: Side::default(),
            laser_plane: LaserPlane::default(),
            sampling: Sampling::EvenAngle,
            spacing_spread: 0.0,
            noise_sigma_mm: 0.05,
            noise_correlation: 0.0,
            noise_freedom: None,
            jitter_sigma_mm: 0.0,
            sensor: SensorErrors::default(),
            travel: Travel::default(),
            interference: Interference::default(),
            surroundings: Surroundings::default(),
            drop_out_ratio: 0.0,
            spike_ratio: 0.0,
            edges: Edges::default(),
            export: Export::default(),
            seed,
        }
    }

    pub(super) fn feature(&self, index: usize) -> Feature {
        self.interference.feature((index * BLOCKS_COUNT) as f64 / self.profiles_count as f64 % 1.0)
    }

    pub(super) fn station_x(&self, index: usize, chance: &mut ChaCha8Rng) -> f64 {
        let steps = self.profiles_count.saturating_sub(1).max(1);
        let moved = if self.spacing_spread > 0.0 {
            0.5 * self.spacing_spread.min(1.0) * chance.random_range(-1.0..1.0)
        } else {
            0.0
        };
        self.x_start_mm + self.length_mm * (index as f64 + moved) / steps as f64
    }

    /// The direction of the point at `place` (0 to 1 along the profile): radians from +Z towards −Y.
    pub(super) fn direction(&self, place: f64) -> f64 {
        let half = 0.5 * self.arc_deg.to_radians();
        let facing = match self.sampling {
            Sampling::EvenAngle => (1.0 - 2.0 * place) * half - self.view_deg.to_radians(),
            Sampling::EvenAcross => {
                let seen = |angle: f64| angle.clamp(-HORIZON_RAD, HORIZON_RAD).sin();
                let view = self.view_deg.to_radians();
                let (low, high) = (seen(view - half), seen(view + half));
                -(low + (high - low) * place).asin()
            }
        };
        self.opposite(facing)
    }

    /// The edges of one scan with their random numbers drawn.
    pub(super) fn prepared_edges(&self) -> Prepared {
        self.edges.prepare(self.axis, self.radius_mm, self.side.sign(), self.points_count, self.seed)
    }

    /// The noise of a new profile.
    pub(super) fn noise(&self, chance: &mut ChaCha8Rng) -> Noise {
        Noise::begin(self.noise_sigma_mm, self.noise_correlation, self.noise_freedom, self.jitter_sigma_mm, chance)
    }

    /// The direction in which the surface faces the sensor, radians from +Z towards −Y.
    pub(super) fn facing(&self) -> f64 {
        self.opposite(-self.view_deg.to_radians())
    }

    /// Inside a pipe the surface faces a sensor from the other side of the axis.
    fn opposite(&self, direction: f64) -> f64 {
        match self.side {
            Side::Outside => direction,
            Side::Inside => direction + PI,
        }
    }
}

/// Directions beyond this, radians, are hidden from a sensor above the part.
pub(super) const HORIZON_RAD: f64 = 1.55;

/// Points next to the part, as shares of the points on it. None by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surroundings {
    /// Points on a horizontal ground plane, half of them on either side.
    pub floor: f64,
    /// Depth of the ground plane below the middle of the axis.
    pub floor_depth_mm: f64,
    /// Points of a support on the +Y side.
    pub support: f64,
    /// Share of the profiles with points on the support.
    pub supports: f64,
    /// Radius of a round support with its axis parallel to the part's and at its height; 0 for a flat one.
    pub support_radius_mm: f64,
}
