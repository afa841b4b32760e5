//! What a made controller is like: its limits, its watchdog, its play.

use crate::motion::{Axes, AxisLimits, Position};
use std::time::Duration;

/// What a controller is like. Lengths in mm, angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerSettings {
    /// Its own limits.
    pub limits: Axes<AxisLimits>,
    /// Where the axes stand at first.
    pub start: Position,
    /// Whether the references are known at first.
    pub homed: bool,
    /// Simulated seconds of motion in a second of the caller's clock. Watchdog and heartbeat are not made faster.
    pub time_factor: f64,
    /// Greatest watchdog that it grants; a command may ask for less.
    pub watchdog_max: Duration,
    /// How long the finding of a reference takes, simulated s. The axes stay: distance-coded marks.
    pub homing_s: f64,
    /// Backlash between an axis' encoder and its clamp.
    pub backlash: Axes<f64>,
    /// Share of each linear axis' motion that the clamp shows along each of the other two.
    pub coupling_ratio: f64,
}

impl ControllerSettings {
    /// A stiff manipulator with these limits that stands at zero, or where its limits are nearest to it.
    #[must_use]
    pub fn exact(limits: Axes<AxisLimits>) -> Self {
        Self {
            limits,
            start: limits.map(|_, own| 0.0_f64.max(own.lower).min(own.upper)),
            homed: true,
            time_factor: 1.0,
            watchdog_max: Duration::from_millis(500),
            homing_s: 0.5,
            backlash: Axes::default(),
            coupling_ratio: 0.0,
        }
    }
}
