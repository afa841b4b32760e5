//! The drivers: a task for each device, which owns its adaptor, reads it at a pace, does one errand at a time with a deadline,
//! and looks at the halt flag before anything else. A lost link is reported, dropped and tried again; nothing is sent again.
//! In: orders, and the halt flag. Out: reports. `attend` is the loop that they share; read it first.

mod attend;
mod backoff;
mod call;
mod halts;
mod manipulator;
mod post;
mod sensor;
mod stage;
mod timing;

pub(super) use halts::{HaltAtEnd, HaltFlag, Halted, Halts};
pub(super) use manipulator::{ManipulatorDriver, moves};
pub(super) use post::Post;
pub(super) use sensor::SensorDriver;
pub(super) use stage::StageDriver;
pub use timing::SILENCE;
pub(super) use timing::Timing;

use super::failure::Failure;
use super::input::Member;
use crate::device::{Action, DeviceError, Profile, Reading, SensorReading, StageReading};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Something that a device is to do.
#[derive(Debug)]
pub(super) struct Order<E> {
    /// Names it in its outcome.
    pub(super) number: u64,
    /// How many halts had been raised when it was given: a later halt overtakes it.
    pub(super) halts: u64,
    /// Of the lease that commands.
    pub(super) fence: u64,
    /// What.
    pub(super) errand: E,
}

/// What a manipulator is to do.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Handling {
    /// Be read now.
    Look,
    /// Take a command.
    Send(Action),
}

/// What the stage is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Travel {
    /// Be read now.
    Look,
    /// Go there.
    To { target_mm: f64, speed_mm_s: f64 },
}

/// What the sensor is to do: take profiles, and hand them over as they come.
#[derive(Debug)]
pub(super) struct Taking {
    pub(super) profiles_count: u64,
    pub(super) sink: mpsc::Sender<Vec<Profile>>,
    /// How long the one that takes the profiles may let us wait.
    pub(super) patience: Duration,
}

/// What became of an order.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// The device has it. The sequence number of a manipulator's command; 0 for others.
    Taken { sequence: u16 },
    /// It was not sent, or the device refused it: nothing was done.
    Refused(DeviceError),
    /// A halt came before it; not a byte of it was sent.
    Overtaken,
    /// A halt came before the word on it; it may have been done.
    Cut,
    /// It may have been done.
    Unknown(Failure),
}

/// What a device said.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Seen {
    Manipulator(Reading),
    Stage(StageReading),
    Sensor(SensorReading),
}

/// What a driver tells the cell's task.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum News {
    /// The link is up; this was read first.
    Up { asked_at: Instant, seen: Seen },
    /// It was read.
    Read { asked_at: Instant, seen: Seen },
    /// The link is down. `was_up` is false where it never was up.
    Lost { error: DeviceError, was_up: bool },
    /// What became of an order.
    Told { order: u64, outcome: Outcome },
    /// After this halt, it was seen at rest.
    Rested { halt: u64 },
    /// It refuses to halt.
    WillNotHalt { error: DeviceError },
    /// After a reconnect: what became of the command whose answer was lost.
    Resolved { sequence: u16, taken: bool },
    /// Profiles have come, so many so far.
    Profiles { received_count: u64 },
    /// All profiles came, or the scan cannot be whole.
    ScanEnded { result: Result<(), Failure> },
}

/// News, and of whom.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Report {
    pub(super) member: Member,
    pub(super) news: News,
}

/// Why a driver does not attend its device any more.
#[derive(Debug)]
pub(super) enum Gone {
    /// The link.
    Lost(DeviceError),
    /// A call was dropped so that a halt could go out; the connection was the price.
    Cut,
    /// The cell has ended.
    Closed,
}
