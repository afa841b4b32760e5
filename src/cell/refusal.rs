//! Why the cell does not do what it is asked, as an operator would say it. Nothing was sent to any device then.

use super::State;
use crate::device::{AxisState, Mode};
use crate::motion::{Axis, Carrier};
use std::time::Duration;

/// Why a request was refused. Must not carry texts of its own; the numbers are the message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The cell is doing something else, or cannot do anything.
    #[error("the cell is {state}, so it cannot {verb}", state = state.name())]
    WrongState {
        /// What it does.
        state: State,
        /// What it was asked for.
        verb: &'static str,
        /// The move or scan under way, where there is one.
        job: Option<String>,
    },
    /// Nobody holds the lease.
    #[error("nobody holds the lease; take it first")]
    LeaseRequired,
    /// Another client holds the lease.
    #[error("{holder} holds the lease for another {} ms", remaining.as_millis())]
    LeaseHeld {
        /// Who.
        holder: String,
        /// How long it lasts unless renewed.
        remaining: Duration,
    },
    /// The lease that is named is over, or never was.
    #[error("the lease is over; take it again")]
    LeaseOver,
    /// Faults are latched.
    #[error("{count} faults are latched; see to them, then reset")]
    Faulted {
        /// How many.
        count: usize,
    },
    /// A device cannot be reached, or its state is old.
    #[error("{device} has not answered for {} ms", age.as_millis())]
    DeviceStale {
        /// Its name in the configuration.
        device: String,
        /// Since its last good answer.
        age: Duration,
    },
    /// Somebody commands the manipulator at its panel, or nobody does.
    #[error("{} is in mode {mode:?}; switch it to automatic", carrier.name())]
    NotRemote {
        /// Which.
        carrier: Carrier,
        /// Its mode.
        mode: Mode,
    },
    /// A safety function keeps the manipulator from moving.
    #[error("the safety functions of {} do not let it move", carrier.name())]
    SafetyOpen {
        /// Which.
        carrier: Carrier,
    },
    /// The manipulator is not enabled.
    #[error("{} is {state:?}; enable it first", carrier.name())]
    NotEnabled {
        /// Which.
        carrier: Carrier,
        /// Its state.
        state: AxisState,
    },
    /// An axis has no reference.
    #[error("axis {} of {} has no reference; home it first", axis.name(), carrier.name())]
    NotHomed {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
    },
    /// The path is not allowed, or does not start where the devices are.
    #[error(transparent)]
    Motion(#[from] crate::motion::MotionRefusal),
    /// There is no stage, or no sensor, in this cell.
    #[error("this cell has no {what}")]
    NotThere {
        /// What.
        what: &'static str,
    },
    /// A job with this id was started before.
    #[error("the job {job} was started before; it is not started again")]
    Repeated {
        /// Its id.
        job: String,
    },
    /// The stage cannot go there, or not as fast.
    #[error("{what} of {given} is outside of {least} to {most}")]
    ScanOutOfRange {
        /// Which number of the order, with its unit.
        what: &'static str,
        /// As ordered.
        given: f64,
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
    /// A device moves that nobody here has told to.
    #[error("{device} moves")]
    Moves {
        /// Its name in the configuration.
        device: String,
    },
    /// A device reports a fault.
    #[error("{device} reports fault {code}; see to it, then reset")]
    DeviceFault {
        /// Its name in the configuration.
        device: String,
        /// As the device gives it.
        code: u32,
    },
    /// The cell is being shut down.
    #[error("the service is stopping")]
    Closing,
}
