//! What the machine is told and what it answers: the requests and events that go in, the verdict and the acts that come out.
//! Words only.

use super::events::EventKind;
use super::failure::{Failure, Fault};
use super::job::JobEnd;
use super::lease::LeaseRequest;
use super::refusal::Refusal;
use super::state::State;
use crate::motion::Carrier;

/// What a manipulator can be told by hand.
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

/// What became of a request that changes something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// It is being done.
    Accepted,
    /// It was so before; nothing was sent.
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

/// What moves, or is to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Activity {
    /// A path; by the job's id.
    Move(String),
    /// A scan; by the job's id.
    Scan(String),
    /// One manipulator finds its references.
    Home(Carrier),
}

impl Activity {
    /// The id of the job, where it is one.
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

/// What the machine is told.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Input {
    /// Somebody wants the lease.
    TakeLease(LeaseRequest),
    /// The holder lives.
    RenewLease(String),
    /// The holder gives it back.
    ReleaseLease(String),
    /// Enable or disable; `fit` says whether the manipulator can, or is so already.
    Command { lease: String, carrier: Carrier, manual: Manual, fit: Result<Taken, Refusal> },
    /// A job or a homing; `fit` says whether path and devices allow it.
    Start { lease: String, activity: Activity, fit: Result<(), Refusal> },
    /// Stop. Needs nothing.
    Stop,
    /// Acknowledge the faults; `fit` says whether every device answers and stands.
    Reset { lease: String, fit: Result<(), Refusal> },
    /// The service ends.
    Close,
    /// A device answers, for the first time or again; whether it, or another one, was read to move.
    Up { member: Member, moves: bool },
    /// A device does not answer any more.
    Lost(Member, Fault),
    /// A device, or what was asked of it, is not as it should be.
    Fault(Fault),
    /// The activity has come to its end, and everything is at rest.
    Finished,
    /// The activity could not go on; no device is in doubt.
    GivenUp(Failure),
    /// After a halt, every device was seen at rest.
    AtRest,
    /// After a reset, every device was read at rest and without a fault.
    Reread,
    /// Time has passed.
    Time,
}

/// What is to be done after an input.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Act {
    /// Tell every device to halt.
    Halt,
    /// Begin the activity that was checked.
    Begin,
    /// Tell a manipulator.
    Tell(Carrier, Manual),
    /// Acknowledge the devices' own faults, and read every device.
    Reread,
    /// A job has ended so.
    End(JobEnd),
    /// Something that everybody may read.
    Note(EventKind),
}

/// What the machine makes of an input.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// It is taken; these are to be done, in order.
    Accepted(Vec<Act>),
    /// It was so before; nothing is to be done.
    AlreadySo,
    /// It is not taken, and nothing has changed.
    Refused(Refusal),
}
