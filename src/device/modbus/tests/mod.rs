//! The adaptors over a pipe to the PLC's side of the map, on paused time: what they promise, and what they make of a wire
//! that cuts, stalls, corrupts, doubles and delays.

mod campaign;
mod contract;
mod promises;
mod stage;
mod wire;

use super::{Layout, ModbusManipulator, Plc, Settings};
use crate::device::simulated::{Controller, ControllerSettings};
use crate::device::{Action, Command};
use crate::motion::{Axes, AxisLimits, Position};
use std::sync::Arc;
use std::time::Duration;
use wire::{Wire, WireFault};

/// Limits of 200 mm and 200 degrees to both sides, 50 mm/s, 500 mm/s².
fn controller() -> Controller {
    let limits = AxisLimits { lower: -200.0, upper: 200.0, speed: 50.0, acceleration: 500.0, jerk: 5e3, step: 400.0 };
    let turn = AxisLimits { lower: -3.5, upper: 3.5, speed: 1.0, acceleration: 10.0, jerk: 100.0, step: 7.0 };
    Controller::new(ControllerSettings::exact(Axes { x: limits, y: limits, z: limits, c: turn }))
}

/// A PLC with two manipulators and a stage.
fn plc() -> Arc<Plc> {
    Arc::new(Plc::new(Layout::default(), vec![controller(), controller(), controller()]))
}

/// A manipulator over a wire that fails as `wire` says.
fn manipulator(wire: &Wire) -> ModbusManipulator {
    Settings::default().manipulator("m1", wire.dial()).expect("settings that can be")
}

fn command(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(500), action }
}

/// x to `target_mm` at the greatest speed.
fn x_to(target_mm: f64) -> Action {
    let only_x = |x| Position { x, ..Position::default() };
    Action::MoveTo { axes: Axes { x: true, ..Axes::default() }, targets: only_x(target_mm), speeds: only_x(50.0) }
}
