//! The messages between the task of the cell and the drivers: commands to a driver, and its reports.

use crate::cell::failure::Failure;
use crate::cell::input::Member;
use crate::device::{Action, DeviceError, Profile, Reading, SensorReading, StageReading};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// A command to a driver.
#[derive(Debug)]
pub(in crate::cell) struct DriverOrder<C> {
    /// Identifies it in its outcome.
    pub(in crate::cell) number: u64,
    /// The number of the newest halt when the command was given. It is not sent after a later halt.
    pub(in crate::cell) halts: u64,
    /// The fencing token of the lease.
    pub(in crate::cell) fence: u64,
    /// The command itself.
    pub(in crate::cell) command: C,
}

/// A command to a manipulator.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cell) enum ManipulatorCommand {
    /// Read the device now.
    Read,
    /// Send an action.
    Send(Action),
}

/// A command to the stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::cell) enum StageCommand {
    /// Read the device now.
    Read,
    /// Move to a position.
    MoveTo { target_mm: f64, speed_mm_s: f64 },
}

/// A command to the sensor: take profiles, and forward them to the client of the scan as they arrive.
#[derive(Debug)]
pub(in crate::cell) struct Acquisition {
    pub(in crate::cell) profiles_count: u64,
    pub(in crate::cell) sink: mpsc::Sender<Vec<Profile>>,
    /// The longest wait for the receiver of the profiles.
    pub(in crate::cell) patience: Duration,
}

/// The outcome of a command.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cell) enum Outcome {
    /// The device has accepted it. `sequence` is the sequence number of a command to a manipulator, otherwise 0.
    Taken { sequence: u16 },
    /// It was not sent, or the device refused it; the device did nothing.
    Refused(DeviceError),
    /// A halt came first, and nothing of the command was sent.
    Overtaken,
    /// A halt came before its acknowledgement; it may have been executed.
    Cut,
    /// It may have been executed.
    Unknown(Failure),
}

/// A reading of a device.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cell) enum DeviceReading {
    Manipulator(Reading),
    Stage(StageReading),
    Sensor(SensorReading),
}

/// A report of a driver to the task of the cell.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cell) enum DriverEvent {
    /// The link is up; the first reading.
    Up { asked_at: Instant, seen: DeviceReading },
    /// A reading.
    Read { asked_at: Instant, seen: DeviceReading },
    /// The link is down. `was_up` is false if it never was up.
    Lost { error: DeviceError, was_up: bool },
    /// The outcome of a command.
    Outcome { order: u64, outcome: Outcome },
    /// The device was read at rest after this halt.
    AtRest { halt: u64 },
    /// The device refuses to halt.
    HaltRefused { error: DeviceError },
    /// After a reconnect: whether the device had accepted the command whose answer was lost.
    Resolved { sequence: u16, taken: bool },
    /// The number of profiles that were received so far.
    Profiles { received_count: u64 },
    /// All profiles were received, or the scan is incomplete.
    ScanEnded { result: Result<(), Failure> },
}

/// An event of a driver, and its device.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cell) struct Report {
    pub(in crate::cell) member: Member,
    pub(in crate::cell) event: DriverEvent,
}

/// Why a session with a device ended.
#[derive(Debug)]
pub(in crate::cell) enum SessionEnd {
    /// The link failed.
    Lost(DeviceError),
    /// A call was dropped so that a halt could be sent; the connection can no longer be used.
    Cut,
    /// The cell has ended.
    Closed,
}
