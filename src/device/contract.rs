//! The contract of all adaptors, as tests that are run against an adaptor. Input: an adaptor. Output: a [`Report`] of named checks.
//! The read-only part moves nothing and may be run against a machine (`coaxis devices check`); [`motion`] moves devices, and is
//! only for tests.

pub mod motion;

use super::error::DeviceError;
use super::manipulator::{AxisReading, AxisState, Manipulator, Reading};
use super::sensor::{ProfileSensor, SensorReading};
use super::sensor::{Stage, StageReading};
use crate::motion::{Axes, Axis};
use serde::Serialize;
use std::fmt::Display;
use std::time::Duration;
use tokio::time::sleep;

/// Interval between two readings that are compared.
const APART: Duration = Duration::from_millis(100);
/// Encoder noise that an axis at rest may show, mm or rad.
const STANDS: f64 = 1e-3;
/// Distance by which an axis may be beyond its limit, mm or rad, because limits apply to targets and not to encoder readings.
const BEYOND: f64 = 0.5;

/// The result of the checks of one device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Its name in the configuration.
    pub device: String,
    /// The checks in the order in which they were made, without those that depend on a failed one.
    pub checks: Vec<Check>,
}

/// One check with its result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// The required property.
    pub name: &'static str,
    /// Whether the device has the property.
    pub passed: bool,
    /// The observation.
    pub words: String,
}

impl Report {
    fn new(device: &str) -> Self {
        Self { device: device.to_owned(), checks: Vec::new() }
    }

    /// Whether every check has passed.
    #[must_use]
    pub fn passed(&self) -> bool {
        !self.checks.is_empty() && self.checks.iter().all(|check| check.passed)
    }

    fn note(&mut self, name: &'static str, passed: bool, words: impl Display) {
        self.checks.push(Check { name, passed, words: words.to_string() });
    }

    /// Records whether a device is at rest, and returns it.
    fn stands(&mut self, moves: bool) -> bool {
        let words = if moves {
            "it moves, and is not read any further so that its watchdog can stop it"
        } else {
            "it is at rest"
        };
        self.note("it is at rest before it is read", !moves, words);
        !moves
    }

    /// Records whether the device answered; `None` if it did not.
    fn answered<T>(
        &mut self,
        name: &'static str,
        answer: Result<T, DeviceError>,
        say: impl FnOnce(&T) -> String,
    ) -> Option<T> {
        match answer {
            Ok(answer) => {
                self.note(name, true, say(&answer));
                Some(answer)
            }
            Err(error) => {
                self.note(name, false, error);
                None
            }
        }
    }
}

/// Checks a manipulator by reading alone, and reconnects to it twice. A manipulator that moves is not read any further, because
/// each reading would be a heartbeat for its motion.
pub async fn check_manipulator(device: &mut dyn Manipulator) -> Report {
    let mut report = Report::new(device.name());
    let name = "it can be connected to";
    let Some(first) = report.answered(name, device.connect().await, say_state) else { return report };
    if !report.stands(first.state.moves() || first_axis(&first.axes, |axis| axis.state.moves()).is_some()) {
        return report;
    }
    sleep(APART).await;
    let Some(second) = report.answered("it can be read", device.read().await, say_state) else { return report };
    plausible(&mut report, &second);
    let beat = first.heartbeat != second.heartbeat;
    let words = format!("{} and, {} ms later, {}", first.heartbeat, APART.as_millis(), second.heartbeat);
    report.note("its heartbeat changes", beat, words);
    let moved = moved(&first, &second);
    let stands = moved.is_none();
    report.note("connecting moves nothing", stands, moved.unwrap_or_else(|| "all axes are at rest".to_owned()));
    if !stands {
        return report;
    }
    let Some(third) = report.answered("it can be connected to again", device.connect().await, say_state) else {
        return report;
    };
    let same = second.acknowledged.sequence == third.acknowledged.sequence;
    let words = format!("newest command {} and then {}", second.acknowledged.sequence, third.acknowledged.sequence);
    report.note("connecting again sends no command", same, words);
    report.answered("it can be read after that", device.read().await, say_state);
    report
}

/// Checks a sensor by reading alone. Reconnects to it, and ends a scan while none runs.
pub async fn check_sensor(device: &mut dyn ProfileSensor) -> Report {
    let mut report = Report::new(device.name());
    let name = "it can be connected to";
    let Some(first) = report.answered(name, device.connect().await, say_sensor) else { return report };
    let words = format!("model {:?}, serial number {:?}", first.model, first.serial);
    report.note("it says what it is", !first.model.is_empty() && !first.serial.is_empty(), words);
    let words = if first.running { "it takes profiles" } else { "it takes none" };
    report.note("connecting starts no scan", !first.running, words);
    if let Some(temperature) = first.temperature_c {
        let plausible = (-40.0..=125.0).contains(&temperature);
        report.note("its temperature is plausible", plausible, format!("{temperature} °C"));
    }
    // A running sensor is used by another client, or has to be stopped by the service.
    if !first.running {
        let stopped = device.stop().await;
        report.answered("ending a scan where none runs is harmless", stopped, |()| "accepted".to_owned());
    }
    let second = device.read().await;
    let Some(second) = report.answered("it can be read", second, say_sensor) else { return report };
    let same = (&first.model, &first.serial) == (&second.model, &second.serial);
    report.note("its identity stays the same", same, format!("serial number {:?}", second.serial));
    report
}

/// Checks a stage by reading alone, and reconnects to it.
pub async fn check_stage(device: &mut dyn Stage) -> Report {
    let mut report = Report::new(device.name());
    let name = "it can be connected to";
    let Some(first) = report.answered(name, device.connect().await, say_stage) else { return report };
    if !report.stands(first.moves) {
        return report;
    }
    sleep(APART).await;
    let Some(second) = report.answered("it can be read", device.read().await, say_stage) else { return report };
    let StageReading { actual_mm, lower_mm, upper_mm, speed_mm_s, .. } = second;
    let finite = [actual_mm, lower_mm, upper_mm, speed_mm_s].iter().all(|value| value.is_finite());
    report.note("its numbers are finite", finite, format!("at {actual_mm} mm"));
    let words = format!("{lower_mm} mm to {upper_mm} mm, at most {speed_mm_s} mm/s");
    report.note("its limits are plausible", lower_mm < upper_mm && speed_mm_s > 0.0, words);
    let inside = (lower_mm - BEYOND..=upper_mm + BEYOND).contains(&actual_mm);
    report.note("its position is within its limits", inside, format!("at {actual_mm} mm"));
    let stands = !second.moves && (second.actual_mm - first.actual_mm).abs() <= STANDS;
    let words = format!("{} mm and, {} ms later, {actual_mm} mm", first.actual_mm, APART.as_millis());
    report.note("connecting moves nothing", stands, words);
    report.note("it has no fault", second.fault_code == 0, format!("fault code {}", second.fault_code));
    report
}

/// The guarantees of a reading: finite numbers, limits in order, axes within them, consistent states.
fn plausible(report: &mut Report, reading: &Reading) {
    let bad = first_axis(&reading.axes, |axis| {
        let AxisReading { actual, commanded, lower, upper, speed, .. } = *axis;
        [actual, commanded, lower, upper, speed].iter().any(|value| !value.is_finite())
    });
    report.note("its numbers are finite", bad.is_none(), say_axis(bad, "is not"));
    let bad = first_axis(&reading.axes, |axis| axis.lower >= axis.upper || axis.speed <= 0.0);
    report.note("its limits are plausible", bad.is_none(), say_axis(bad, "has implausible limits"));
    let bad = first_axis(&reading.axes, |axis| !(axis.lower - BEYOND..=axis.upper + BEYOND).contains(&axis.actual));
    report.note("its axes are within their limits", bad.is_none(), say_axis(bad, "is not"));
    let bad = first_axis(&reading.axes, |axis| axis.state.moves());
    let fits = bad.is_none() || reading.state.moves();
    report.note(
        "its state is consistent with the states of its axes",
        fits,
        format!("{:?}, {}", reading.state, say_axis(bad, "moves")),
    );
    let clear = reading.fault_code == 0 && reading.state != AxisState::ErrorStop;
    report.note("it has no fault", clear, format!("{:?}, fault code {}", reading.state, reading.fault_code));
}

fn first_axis(axes: &Axes<AxisReading>, bad: impl Fn(&AxisReading) -> bool) -> Option<Axis> {
    axes.iter().find(|(_, axis)| bad(axis)).map(|(axis, _)| axis)
}

fn say_axis(axis: Option<Axis>, what: &str) -> String {
    axis.map_or_else(|| "all axes".to_owned(), |axis| format!("axis {} {what}", axis.name()))
}

/// Describes the first axis that has moved, if there is one.
fn moved(before: &Reading, after: &Reading) -> Option<String> {
    let (before, after) = (before.position(), after.position());
    let axis = Axis::ALL.into_iter().find(|axis| (after.get(*axis) - before.get(*axis)).abs() > STANDS)?;
    let (from, to) = (axis.outside(*before.get(axis)), axis.outside(*after.get(axis)));
    Some(format!("axis {} went from {from} to {to} {}", axis.name(), axis.unit()))
}

fn say_state(reading: &Reading) -> String {
    let Axes { x, y, z, c } = reading.position().map(|axis, value| axis.outside(*value));
    format!("{:?}, {:?}, at {x:.3} {y:.3} {z:.3} mm, {c:.4} deg", reading.state, reading.mode)
}

fn say_sensor(reading: &SensorReading) -> String {
    format!("{} {}, firmware {}", reading.model, reading.serial, reading.firmware)
}

fn say_stage(reading: &StageReading) -> String {
    format!("at {:.3} mm, {}", reading.actual_mm, if reading.moves { "moving" } else { "at rest" })
}
