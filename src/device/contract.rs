//! The contract that every adaptor keeps, as a test that is run against it: one and the same for all. In: an adaptor. Out: a
//! [`Report`] of named checks. The read-only part moves nothing and may be run against a machine (`coaxis devices check`);
//! [`motion`] moves, and is for tests.

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

/// Between two readings that are compared.
const APART: Duration = Duration::from_millis(100);
/// An axis that stands may show this much of its encoder's noise, mm or rad.
const STANDS: f64 = 1e-3;
/// An axis may stand beyond its limit by this much, mm or rad: limits are where targets end, not what an encoder shows.
const BEYOND: f64 = 0.5;

/// What was found out about one device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Its name in the configuration.
    pub device: String,
    /// In the order in which they were made; what depends on one that failed is left out.
    pub checks: Vec<Check>,
}

/// One thing that was checked.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// What must be so.
    pub name: &'static str,
    /// Whether it is.
    pub passed: bool,
    /// What was seen.
    pub words: String,
}

impl Report {
    fn new(device: &str) -> Self {
        Self { device: device.to_owned(), checks: Vec::new() }
    }

    /// Whether everything that was checked is as it must be.
    #[must_use]
    pub fn passed(&self) -> bool {
        !self.checks.is_empty() && self.checks.iter().all(|check| check.passed)
    }

    fn note(&mut self, name: &'static str, passed: bool, words: impl Display) {
        self.checks.push(Check { name, passed, words: words.to_string() });
    }

    /// Notes whether a device stands still, and returns it.
    fn stands(&mut self, moves: bool) -> bool {
        let words = if moves { "it moves, and is left alone so that its watchdog can stop it" } else { "it stands" };
        self.note("it stands before it is read", !moves, words);
        !moves
    }

    /// Notes whether something was answered at all; `None` where it was not.
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

/// Checks a manipulator by reading alone. Connects to it again twice. One that moves is left alone at once: a reading would tell it
/// that its commander is alive.
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
    report.note("its heartbeat counts", beat, words);
    let moved = moved(&first, &second);
    let stands = moved.is_none();
    report.note("connecting moves nothing", stands, moved.unwrap_or_else(|| "all axes stand".to_owned()));
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

/// Checks a sensor by reading alone. Connects to it again, and ends a scan while none runs.
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
        report.note("its temperature can be", plausible, format!("{temperature} °C"));
    }
    // A sensor that runs is used by another client, or has to be stopped by the service.
    if !first.running {
        let stopped = device.stop().await;
        report.answered("ending a scan where none runs is harmless", stopped, |()| "accepted".to_owned());
    }
    let second = device.read().await;
    let Some(second) = report.answered("it can be read", second, say_sensor) else { return report };
    let same = (&first.model, &first.serial) == (&second.model, &second.serial);
    report.note("it stays the same", same, format!("serial number {:?}", second.serial));
    report
}

/// Checks a stage by reading alone. Connects to it again.
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
    report.note("its limits make sense", lower_mm < upper_mm && speed_mm_s > 0.0, words);
    let inside = (lower_mm - BEYOND..=upper_mm + BEYOND).contains(&actual_mm);
    report.note("it stands within its limits", inside, format!("at {actual_mm} mm"));
    let stands = !second.moves && (second.actual_mm - first.actual_mm).abs() <= STANDS;
    let words = format!("{} mm and, {} ms later, {actual_mm} mm", first.actual_mm, APART.as_millis());
    report.note("connecting moves nothing", stands, words);
    report.note("it has no fault", second.fault_code == 0, format!("fault code {}", second.fault_code));
    report
}

/// What a reading promises: finite numbers, limits in order, axes within them, states that fit together.
fn plausible(report: &mut Report, reading: &Reading) {
    let bad = first_axis(&reading.axes, |axis| {
        let AxisReading { actual, commanded, lower, upper, speed, .. } = *axis;
        [actual, commanded, lower, upper, speed].iter().any(|value| !value.is_finite())
    });
    report.note("its numbers are finite", bad.is_none(), say_axis(bad, "is not"));
    let bad = first_axis(&reading.axes, |axis| axis.lower >= axis.upper || axis.speed <= 0.0);
    report.note("its limits make sense", bad.is_none(), say_axis(bad, "has none that do"));
    let bad = first_axis(&reading.axes, |axis| !(axis.lower - BEYOND..=axis.upper + BEYOND).contains(&axis.actual));
    report.note("its axes stand within their limits", bad.is_none(), say_axis(bad, "does not"));
    let bad = first_axis(&reading.axes, |axis| axis.state.moves());
    let fits = bad.is_none() || reading.state.moves();
    report.note("its state fits its axes' states", fits, format!("{:?}, {}", reading.state, say_axis(bad, "moves")));
    let clear = reading.fault_code == 0 && reading.state != AxisState::ErrorStop;
    report.note("it has no fault", clear, format!("{:?}, fault code {}", reading.state, reading.fault_code));
}

fn first_axis(axes: &Axes<AxisReading>, bad: impl Fn(&AxisReading) -> bool) -> Option<Axis> {
    axes.iter().find(|(_, axis)| bad(axis)).map(|(axis, _)| axis)
}

fn say_axis(axis: Option<Axis>, what: &str) -> String {
    axis.map_or_else(|| "all axes".to_owned(), |axis| format!("axis {} {what}", axis.name()))
}

/// The first axis that is elsewhere, in words.
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
