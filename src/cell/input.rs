//! The input of the machine (requests and events) and its output (the verdict, with the effects that the task executes).

use super::events::EventKind;
use super::failure::{Failure, Fault, JobEnd};
use super::lease::LeaseRequest;
use super::refusal::Refusal;
use super::state::State;
use crate::motion::Carrier;

/// A manual command to a manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Manual {
    /// Put the drives under control.
    Enable,
    /// Take the drives out of control.
    Disable,
    /// Find the reference of all axes. Moves.
    Home,
}

impl Manual {
    /// The verb used in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Enable => "enable",
            Self::Disable => "disable",
            Self::Home => "home",
        }
    }
}

/// The answer to a request that was not refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// It is being executed.
    Accepted,
    /// The requested state was already reached; nothing was sent.
    AlreadySo,
}

/// One of the devices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) enum Member {
    /// One of the manipulators.
    Manipulator(Carrier),
    /// The stage.
    Stage,
    /// The sensor.
    Sensor,
}

/// The activity of the cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Activity {
    /// Executes a path, under the id of its job.
    Move(String),
    /// Takes a scan, under the id of its job.
    Scan(String),
    /// Homes a manipulator.
    Home(Carrier),
}

impl Activity {
    /// The id of the job, if the activity is one.
    pub(super) fn job(&self) -> Option<&str> {
        match self {
            Self::Move(job) | Self::Scan(job) => Some(job),
            Self::Home(_) => None,
        }
    }

    pub(super) const fn state(&self) -> State {
        match self {
            Self::Scan(_) => State::Scanning,
            Self::Move(_) | Self::Home(_) => State::Moving,
        }
    }

    pub(super) const fn verb(&self) -> &'static str {
        match self {
            Self::Move(_) => "move",
            Self::Scan(_) => "scan",
            Self::Home(_) => "home",
        }
    }
}

/// An input of the machine.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Input {
    /// A client requests the lease.
    TakeLease(LeaseRequest),
    /// The holder renews the lease.
    RenewLease(String),
    /// The holder releases the lease.
    ReleaseLease(String),
    /// Enable or disable; `fit` is the result of the check of the manipulator.
    Command { lease: String, carrier: Carrier, manual: Manual, fit: Result<Taken, Refusal> },
    /// A job or a homing; `fit` is the result of the check of the path and the devices.
    Start { lease: String, activity: Activity, fit: Result<(), Refusal> },
    /// Stop; needs no lease.
    Stop,
    /// Acknowledge the faults; `fit` is the result of the check that every device answers and is at rest.
    Reset { lease: String, fit: Result<(), Refusal> },
    /// The service is being shut down.
    Close,
    /// A device answers, for the first time or again. `moves` is true if any device moves by its last reading.
    Up { member: Member, moves: bool },
    /// A device no longer answers.
    Lost(Member, Fault),
    /// A device has a fault, or a command to it failed.
    Fault(Fault),
    /// The activity is finished, and every device is at rest.
    Finished,
    /// The activity failed; the states of all devices are known.
    GivenUp(Failure),
    /// After a halt, every device was read at rest.
    AtRest,
    /// After a reset, every device was read at rest and without a fault.
    Reread,
    /// Check whether the lease has expired.
    Time,
}

/// An effect, which the task executes after an input.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Effect {
    /// Halt every device.
    Halt,
    /// Begin the activity that was checked.
    Begin,
    /// Send a manual command.
    Command(Carrier, Manual),
    /// Acknowledge the devices' own faults, and read every device.
    Reread,
    /// Report the end of the job.
    End(JobEnd),
    /// Record an event.
    Note(EventKind),
}

/// The decision of the machine about an input.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// It is accepted; the effects are executed in this order.
    Accepted(Vec<Effect>),
    /// The requested state was already reached; there is nothing to do.
    AlreadySo,
    /// It is refused, and nothing has changed.
    Refused(Refusal),
}
