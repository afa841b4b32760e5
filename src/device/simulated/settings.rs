//! The settings of the simulated cell in the configuration: lengths in mm, angles in degrees. The defaults are the published
//! situation: a part of 200 mm radius with holes and clamps, tilted by about one degree.

use super::rail::{Rail, Straightness};
use crate::motion::{Axes, Axis, AxisLimits, Pair};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// The simulated cell. The same settings and the same sequence of events give the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Simulated seconds of motion per second. Links and watchdogs are not accelerated.
    pub time_factor: f64,
    /// Time from a request to its answer.
    pub latency_ms: f64,
    /// Longest time that an adaptor waits for an answer.
    pub reply_within_ms: f64,
    /// The part on the manipulators.
    pub part: PartSettings,
    /// The sensor.
    pub sensor: SensorSettings,
    /// The stage that moves the sensor.
    pub stage: StageSettings,
    /// The manipulators, except for their limits.
    pub manipulators: ManipulatorSettings,
}

/// The part at its initial place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PartSettings {
    /// Radius of the cylinder.
    pub radius_mm: f64,
    /// Distance between the end planes.
    pub length_mm: f64,
    /// Where its axis intersects the near end plane, along the rail.
    pub near_end_mm: f64,
    /// Whether it has holes and clamps on its surface.
    pub interference: bool,
    /// Tilt of its axis towards +Y.
    pub deflection_deg: f64,
    /// Tilt of its axis towards +Z.
    pub pitch_deg: f64,
    /// Where its axis intersects x = 0.
    pub y_c0_mm: f64,
    /// Where its axis intersects x = 0.
    pub z_c0_mm: f64,
}

/// The profile sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorSettings {
    /// Number of points per profile.
    pub points_count: u32,
    /// Arc of a section that its light reaches from above.
    pub arc_deg: f64,
    /// Half width of its field of view on each side of the middle of the rail.
    pub field_half_width_mm: f64,
    /// Lower end of its field of view.
    pub field_z_lower_mm: f64,
    /// Upper end of its field of view.
    pub field_z_upper_mm: f64,
    /// Standard deviation of the noise, in y and in z.
    pub noise_sigma_mm: f64,
    /// Correlation of a point's noise with its neighbour's, 0 to 1.
    pub noise_correlation: f64,
    /// Fraction of the points that are missing.
    pub drop_out_ratio: f64,
    /// Fraction of the points that are displaced by up to 10 mm.
    pub spike_ratio: f64,
    /// Travel of the stage between two profiles.
    pub profile_pitch_mm: f64,
    /// Resolution of the encoder on the rail.
    pub encoder_mm: f64,
}

/// The linear stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StageSettings {
    /// Least position.
    pub lower_mm: f64,
    /// Greatest position.
    pub upper_mm: f64,
    /// Initial position.
    pub start_mm: f64,
    /// Greatest speed.
    pub speed_mm_s: f64,
    /// Acceleration.
    pub acceleration_mm_s2: f64,
    /// Greatest deviation of the sensor from a straight line, in y and in z.
    pub straightness_mm: f64,
    /// It stops if no heartbeat arrives for this time.
    pub watchdog_ms: f64,
}

/// Both manipulators, except for their limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ManipulatorSettings {
    /// Backlash of the linear axes.
    pub backlash_mm: f64,
    /// Backlash of the rotary axis.
    pub backlash_deg: f64,
    /// Fraction of each linear axis' motion that shows along each of the other two.
    pub coupling_ratio: f64,
    /// Greatest watchdog time that they accept.
    pub watchdog_ms: f64,
    /// Duration of a homing.
    pub homing_s: f64,
    /// Whether the references are initially known.
    pub homed: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            seed: 1,
            time_factor: 1.0,
            latency_ms: 4.0,
            reply_within_ms: 150.0,
            part: PartSettings::default(),
            sensor: SensorSettings::default(),
            stage: StageSettings::default(),
            manipulators: ManipulatorSettings::default(),
        }
    }
}

impl Default for PartSettings {
    fn default() -> Self {
        Self {
            radius_mm: 200.0,
            length_mm: 800.0,
            near_end_mm: 0.0,
            interference: true,
            deflection_deg: 0.3575,
            pitch_deg: 1.1127,
            y_c0_mm: -8.272,
            z_c0_mm: 6.514,
        }
    }
}

impl Default for SensorSettings {
    fn default() -> Self {
        Self {
            points_count: 640,
            arc_deg: 140.0,
            field_half_width_mm: 220.0,
            field_z_lower_mm: 0.0,
            field_z_upper_mm: 270.0,
            noise_sigma_mm: 0.05,
            noise_correlation: 0.3,
            drop_out_ratio: 0.01,
            spike_ratio: 0.002,
            profile_pitch_mm: 2.0,
            encoder_mm: 0.001,
        }
    }
}

impl Default for StageSettings {
    fn default() -> Self {
        Self {
            lower_mm: -50.0,
            upper_mm: 1000.0,
            start_mm: 0.0,
            speed_mm_s: 200.0,
            acceleration_mm_s2: 500.0,
            straightness_mm: 0.005,
            watchdog_ms: 300.0,
        }
    }
}

impl Default for ManipulatorSettings {
    fn default() -> Self {
        Self {
            backlash_mm: 0.05,
            backlash_deg: 0.005,
            coupling_ratio: 0.02,
            watchdog_ms: 500.0,
            homing_s: 0.5,
            homed: true,
        }
    }
}

/// The position of a manipulator and its limits, which the configuration gives for all adaptors alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// Position of the clamp in the rail frame when its axes are at zero.
    pub mount_mm: [f64; 3],
    /// Limits in mm and rad.
    pub limits: Axes<AxisLimits>,
}

/// A setting that is out of its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingError {
    /// A number is out of its range.
    #[error("{name} must be {allowed}, got {value}")]
    OutOfRange {
        /// Name of the setting.
        name: &'static str,
        /// The allowed values, as text.
        allowed: &'static str,
        /// Its value.
        value: f64,
    },
    /// A lower bound is not below its upper bound.
    #[error("the lower bound of {name} must be below its upper bound, got {lower} and {upper}")]
    Inverted {
        /// Name of the setting.
        name: &'static str,
        /// The lower bound.
        lower: f64,
        /// The upper bound.
        upper: f64,
    },
    /// The limits of an axis of a manipulator cannot be used.
    #[error("axis {} needs finite limits, the lower one below the upper one, and a speed and an acceleration above 0", axis.name())]
    Limits {
        /// The axis.
        axis: Axis,
    },
    /// The manipulators are not in order along the rail.
    #[error("m2 must be at least 1 mm beyond m1 along the rail, got {apart_mm} mm")]
    Mounts {
        /// Distance from m1 to m2.
        apart_mm: f64,
    },
}

type Rule = (&'static str, f64, RangeInclusive<f64>, &'static str);

const LENGTH: (RangeInclusive<f64>, &str) = (-1e5..=1e5, "between -100000 and 100000");
const SIZE: (RangeInclusive<f64>, &str) = (0.1..=1e5, "between 0.1 and 100000");
const SHARE: (RangeInclusive<f64>, &str) = (0.0..=1.0, "between 0 and 1");
const ERROR: (RangeInclusive<f64>, &str) = (0.0..=100.0, "between 0 and 100");
const WAIT: (RangeInclusive<f64>, &str) = (0.0..=10_000.0, "between 0 and 10000");
const TILT: (RangeInclusive<f64>, &str) = (-30.0..=30.0, "between -30 and 30");

fn rule(name: &'static str, value: f64, (range, allowed): (RangeInclusive<f64>, &'static str)) -> Rule {
    (name, value, range, allowed)
}

impl Settings {
    /// The straightness that a calibration of the simulated stage would state. The cell has no other error that a scan cannot show:
    /// the sensor is at its exact place in the rail frame, and its distances have no systematic error.
    #[must_use]
    pub fn straightness(&self) -> Straightness {
        let StageSettings { lower_mm, upper_mm, straightness_mm, .. } = self.stage;
        Rail::calibration(straightness_mm, upper_mm - lower_mm)
    }

    /// Checks every value against its range.
    ///
    /// # Errors
    /// [`SettingError`] names the first value that is out of range.
    pub fn check(&self) -> Result<(), SettingError> {
        for (name, value, range, allowed) in self.rules() {
            if !range.contains(&value) {
                return Err(SettingError::OutOfRange { name, allowed, value });
            }
        }
        let (sensor, stage) = (&self.sensor, &self.stage);
        below("the sensor's field along z", sensor.field_z_lower_mm, sensor.field_z_upper_mm)?;
        below("the stage's travel", stage.lower_mm, stage.upper_mm)?;
        if !(stage.lower_mm..=stage.upper_mm).contains(&stage.start_mm) {
            let (name, allowed, value) = ("stage.start_mm", "within the stage's travel", stage.start_mm);
            return Err(SettingError::OutOfRange { name, allowed, value });
        }
        Ok(())
    }

    fn rules(&self) -> Vec<Rule> {
        let Self { part, sensor, stage, manipulators, .. } = self;
        vec![
            rule("time_factor", self.time_factor, (0.01..=1000.0, "between 0.01 and 1000")),
            rule("latency_ms", self.latency_ms, WAIT),
            rule("reply_within_ms", self.reply_within_ms, (1.0..=10_000.0, "between 1 and 10000")),
            rule("part.radius_mm", part.radius_mm, SIZE),
            rule("part.length_mm", part.length_mm, SIZE),
            rule("part.near_end_mm", part.near_end_mm, LENGTH),
            rule("part.deflection_deg", part.deflection_deg, TILT),
            rule("part.pitch_deg", part.pitch_deg, TILT),
            rule("part.y_c0_mm", part.y_c0_mm, LENGTH),
            rule("part.z_c0_mm", part.z_c0_mm, LENGTH),
            rule("sensor.points_count", f64::from(sensor.points_count), (8.0..=10_000.0, "between 8 and 10000")),
            rule("sensor.arc_deg", sensor.arc_deg, (1.0..=180.0, "between 1 and 180")),
            rule("sensor.field_half_width_mm", sensor.field_half_width_mm, SIZE),
            rule("sensor.field_z_lower_mm", sensor.field_z_lower_mm, LENGTH),
            rule("sensor.field_z_upper_mm", sensor.field_z_upper_mm, LENGTH),
            rule("sensor.noise_sigma_mm", sensor.noise_sigma_mm, ERROR),
            rule("sensor.noise_correlation", sensor.noise_correlation, SHARE),
            rule("sensor.drop_out_ratio", sensor.drop_out_ratio, SHARE),
            rule("sensor.spike_ratio", sensor.spike_ratio, SHARE),
            rule("sensor.profile_pitch_mm", sensor.profile_pitch_mm, (0.01..=1000.0, "between 0.01 and 1000")),
            rule("sensor.encoder_mm", sensor.encoder_mm, (1e-6..=1.0, "between 0.000001 and 1")),
            rule("stage.lower_mm", stage.lower_mm, LENGTH),
            rule("stage.upper_mm", stage.upper_mm, LENGTH),
            rule("stage.speed_mm_s", stage.speed_mm_s, SIZE),
            rule("stage.acceleration_mm_s2", stage.acceleration_mm_s2, SIZE),
            rule("stage.straightness_mm", stage.straightness_mm, ERROR),
            rule("stage.watchdog_ms", stage.watchdog_ms, WAIT),
            rule("manipulators.backlash_mm", manipulators.backlash_mm, ERROR),
            rule("manipulators.backlash_deg", manipulators.backlash_deg, (0.0..=10.0, "between 0 and 10")),
            rule("manipulators.coupling_ratio", manipulators.coupling_ratio, (0.0..=0.5, "between 0 and 0.5")),
            rule("manipulators.watchdog_ms", manipulators.watchdog_ms, WAIT),
            rule("manipulators.homing_s", manipulators.homing_s, (0.0..=600.0, "between 0 and 600")),
        ]
    }
}

fn below(name: &'static str, lower: f64, upper: f64) -> Result<(), SettingError> {
    if lower < upper { Ok(()) } else { Err(SettingError::Inverted { name, lower, upper }) }
}

/// Checks the positions and limits of the manipulators.
pub(super) fn check_mountings(mountings: &Pair<Mounting>) -> Result<(), SettingError> {
    for (_, mounting) in mountings.iter() {
        for (axis, own) in mounting.limits.iter() {
            let finite = [own.lower, own.upper, own.speed, own.acceleration].iter().all(|value| value.is_finite());
            if !(finite && own.lower < own.upper && own.speed > 0.0 && own.acceleration > 0.0) {
                return Err(SettingError::Limits { axis });
            }
        }
    }
    let ([from, _, _], [to, _, _]) = (mountings.m1.mount_mm, mountings.m2.mount_mm);
    let apart_mm = to - from;
    if apart_mm >= 1.0 { Ok(()) } else { Err(SettingError::Mounts { apart_mm }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_an_invalid_value_is_reported_by_name() {
        assert_eq!(Settings::default().check(), Ok(()));
        let mut wrong = Settings::default();
        wrong.sensor.profile_pitch_mm = 0.0;
        let told = wrong.check().expect_err("no pitch").to_string();
        assert_eq!(told, "sensor.profile_pitch_mm must be between 0.01 and 1000, got 0");
        let wrong = Settings { time_factor: f64::NAN, ..Settings::default() };
        assert!(matches!(wrong.check(), Err(SettingError::OutOfRange { name: "time_factor", .. })));
        let mut wrong = Settings::default();
        wrong.stage.lower_mm = 2000.0;
        assert!(matches!(wrong.check(), Err(SettingError::Inverted { .. })));
        assert!(serde_json::from_str::<Settings>(r#"{"part": {"radius": 3}}"#).is_err());
        assert_eq!(serde_json::from_str::<Settings>("{}").expect("all defaults"), Settings::default());
    }
}
