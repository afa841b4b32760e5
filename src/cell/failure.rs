//! Why a job ended early, why a device is not trusted any more, and what is latched until a reset. An operator reads these.

use super::number::said;
use super::refusal::Refusal;
use crate::device::DeviceError;
use crate::motion::{Axis, Carrier};
use std::time::Duration;
use tokio::time::Instant;

/// What stopped a job that nothing is wrong with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopCause {
    /// Somebody asked for it.
    Requested,
    /// The lease that had started it ran out.
    LeaseOver,
    /// The lease that had started it was given back.
    LeaseReleased,
    /// The service is being shut down.
    Closing,
}

impl StopCause {
    /// As an operator would say it.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Requested => "a stop was requested",
            Self::LeaseOver => "the lease ran out",
            Self::LeaseReleased => "the lease was given back",
            Self::Closing => "the service is stopping",
        }
    }
}

/// Why a job could not go on, or a command was not seen to be done.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The link, or the device's answer.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A command was handed over, and the device has not said that it took it.
    #[error("{}: command {sequence} was not acknowledged within {} ms; whether it was done is not known", carrier.name(), within.as_millis())]
    NotAcknowledged {
        /// Which.
        carrier: Carrier,
        /// Sequence number of the command.
        sequence: u16,
        /// How long was waited.
        within: Duration,
    },
    /// The device took a command and gave it up.
    #[error("{}: has given up command {sequence} by itself", carrier.name())]
    Aborted {
        /// Which.
        carrier: Carrier,
        /// Sequence number of the command.
        sequence: u16,
    },
    /// The device has seen a command that is not ours.
    #[error("{}: has seen command {found} where {sequence} was the last of ours; somebody else commands it", carrier.name())]
    Overridden {
        /// Which.
        carrier: Carrier,
        /// Sequence number of our last command.
        sequence: u16,
        /// Sequence number that the device has seen.
        found: u16,
    },
    /// An axis has not come to its target in time.
    #[error("axis {} of {} is at {} {unit} and not at {} {unit} after {} ms", axis.name(), carrier.name(), said(*actual), said(*target), within.as_millis(), unit = axis.unit())]
    NotArrived {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it is; mm or degrees.
        actual: f64,
        /// Where it should be; mm or degrees.
        target: f64,
        /// How long was waited.
        within: Duration,
    },
    /// An axis has stopped, or lags, while others go on.
    #[error("axis {} of {} is at {} {unit} and should be at {} {unit} by the progress of the other axes; all were stopped. Find out what holds it, then reset", axis.name(), carrier.name(), said(*actual), said(*expected), unit = axis.unit())]
    NotFollowing {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it is; mm or degrees.
        actual: f64,
        /// Where it should be; mm or degrees.
        expected: f64,
    },
    /// A manipulator has not found its references in time.
    #[error("{}: has not found its references within {} ms", carrier.name(), within.as_millis())]
    NotHomed {
        /// Which.
        carrier: Carrier,
        /// How long was waited.
        within: Duration,
    },
    /// Something was read before a set-point that does not let the devices move; the set-point was not sent.
    #[error("before the next set-point: {0}")]
    NotReady(Box<Refusal>),
    /// While set-points were out, something was read that does not let the devices go on.
    #[error("during the motion: {0}")]
    Interrupted(Box<Refusal>),
    /// The state could not be read in time before a set-point.
    #[error("{}: could not be read back within {} ms", carrier.name(), within.as_millis())]
    NotReadBack {
        /// Which.
        carrier: Carrier,
        /// How long was waited.
        within: Duration,
    },
    /// After a halt, a device was not seen at rest.
    #[error("{device}: not seen at rest within {} ms after the halt", within.as_millis())]
    NotAtRest {
        /// Its name in the configuration.
        device: String,
        /// How long was waited.
        within: Duration,
    },
    /// The device does not take the halt.
    #[error("it refuses to halt: {0}; look whether it moves, and stop it at its panel")]
    HaltRefused(DeviceError),
    /// The device reports a fault of its own.
    #[error("{device}: reports {}; see to it, then reset", fault_code(*code))]
    DeviceFault {
        /// Its name in the configuration.
        device: String,
        /// As the device gives it; 0 where it gives none.
        code: u32,
    },
    /// The stage has not come to where it was sent.
    #[error("{device}: is at {} mm and not at {} mm after {} ms", said(*actual_mm), said(*target_mm), within.as_millis())]
    StageNotArrived {
        /// Its name in the configuration.
        device: String,
        /// Where it is, mm.
        actual_mm: f64,
        /// Where it should be, mm.
        target_mm: f64,
        /// How long was waited.
        within: Duration,
    },
    /// No profile came for too long.
    #[error("{device}: no profile for {} ms, {received_count} of {expected_count} came", within.as_millis())]
    ScanStalled {
        /// Name of the sensor in the configuration.
        device: String,
        /// Profiles that came.
        received_count: u64,
        /// Profiles that were asked for.
        expected_count: u64,
        /// How long was waited.
        within: Duration,
    },
    /// Nobody takes the profiles, or not fast enough.
    #[error("the profiles are not taken; the scan was given up")]
    ProfilesNotTaken,
    /// The task of the cell has ended without saying how the job stands.
    #[error("the cell has ended; nothing is known about the devices")]
    CellGone,
}

impl Failure {
    /// A stable short word.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Device(DeviceError::LinkLost { .. }) => "link_lost",
            Self::Device(DeviceError::Silent { .. }) => "silent",
            Self::Device(DeviceError::Implausible { .. }) => "implausible",
            Self::Device(DeviceError::Rejected { .. }) => "rejected",
            Self::Device(DeviceError::Fenced { .. }) => "fenced",
            Self::Device(DeviceError::Unsupported { .. }) => "unsupported",
            Self::Device(DeviceError::ScanFault { .. }) => "scan_fault",
            Self::NotAcknowledged { .. } => "not_acknowledged",
            Self::Aborted { .. } => "aborted",
            Self::Overridden { .. } => "overridden",
            Self::NotArrived { .. } | Self::StageNotArrived { .. } => "not_arrived",
            Self::NotFollowing { .. } => "not_following",
            Self::NotHomed { .. } => "not_homed",
            Self::NotReady(_) => "not_ready",
            Self::Interrupted(_) => "interrupted",
            Self::NotReadBack { .. } => "not_read_back",
            Self::NotAtRest { .. } => "not_at_rest",
            Self::HaltRefused(_) => "halt_refused",
            Self::DeviceFault { .. } => "device_fault",
            Self::ScanStalled { .. } => "scan_stalled",
            Self::ProfilesNotTaken => "profiles_not_taken",
            Self::CellGone => "cell_gone",
        }
    }

    /// Whether it is latched: nothing moves until somebody has looked and reset. What was found before anything was sent, and
    /// a scan that is not whole, are not; the devices are where they are read to be.
    #[must_use]
    pub const fn latches(&self) -> bool {
        !matches!(
            self,
            Self::NotReady(_)
                | Self::ScanStalled { .. }
                | Self::ProfilesNotTaken
                | Self::Device(DeviceError::ScanFault { .. })
        )
    }

    /// Whether it leaves open what a device did, or where it is.
    #[must_use]
    pub const fn leaves_unknown(&self) -> bool {
        match self {
            Self::Device(error) => error.leaves_unknown(),
            Self::NotAcknowledged { .. }
            | Self::Overridden { .. }
            | Self::NotReadBack { .. }
            | Self::NotAtRest { .. }
            | Self::HaltRefused(_)
            | Self::CellGone => true,
            Self::Aborted { .. }
            | Self::NotArrived { .. }
            | Self::NotFollowing { .. }
            | Self::NotHomed { .. }
            | Self::NotReady(_)
            | Self::Interrupted(_)
            | Self::DeviceFault { .. }
            | Self::StageNotArrived { .. }
            | Self::ScanStalled { .. }
            | Self::ProfilesNotTaken => false,
        }
    }
}

/// A device's own fault code, as a sentence carries it.
pub(super) fn fault_code(code: u32) -> String {
    match code {
        0 => "a fault without a code".to_owned(),
        code => format!("fault code {code} of the device (see its manual)"),
    }
}

/// A fault that is latched until a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// The device's name in the configuration.
    pub device: String,
    /// What happened; its `code()` is the short word, its text says it aloud.
    pub failure: Failure,
    /// When.
    pub at: Instant,
}
