//! How a job ended, why it ended early, why a device is no longer trusted, and which faults are latched until a reset. Operators
//! read these messages.

use super::refusal::{Refusal, fault_code, number_text};
use crate::device::DeviceError;
use crate::motion::{Axis, Carrier};
use std::fmt;
use std::time::Duration;

use tokio::time::Instant;

/// Why a job without a fault was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopCause {
    /// A stop was requested.
    Requested,
    /// The lease that had started it expired.
    LeaseOver,
    /// The lease that had started it was released.
    LeaseReleased,
    /// The service is being shut down.
    Closing,
}

impl StopCause {
    /// The text for an operator.
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

/// Why a job failed, or why the result of a command is not known.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The link failed, or the answer of the device could not be used.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A command was sent, and the device did not acknowledge it in time.
    #[error("{}: command {sequence} was not acknowledged within {} ms; whether it was executed is not known", carrier.name(), within.as_millis())]
    NotAcknowledged {
        /// The manipulator.
        carrier: Carrier,
        /// Sequence number of the command.
        sequence: u16,
        /// How long the cell waited.
        within: Duration,
    },
    /// The device accepted a command and then aborted it.
    #[error("{}: the device has aborted command {sequence}", carrier.name())]
    Aborted {
        /// The manipulator.
        carrier: Carrier,
        /// Sequence number of the command.
        sequence: u16,
    },
    /// The device has received a command from another client.
    #[error("{}: has received command {found}, but {sequence} was the last one of coaxis; another client commands it", carrier.name())]
    Overridden {
        /// The manipulator.
        carrier: Carrier,
        /// Sequence number of the last command of coaxis.
        sequence: u16,
        /// Sequence number of the last command that the device received.
        found: u16,
    },
    /// An axis did not reach its target in time.
    #[error("axis {} of {} is at {} {unit} and not at {} {unit} after {} ms", axis.name(), carrier.name(), number_text(*actual), number_text(*target), within.as_millis(), unit = axis.unit())]
    NotArrived {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Actual position; mm or degrees.
        actual: f64,
        /// Target position; mm or degrees.
        target: f64,
        /// How long the cell waited.
        within: Duration,
    },
    /// An axis has stopped, or lags, while other axes go on.
    #[error("axis {} of {} is at {} {unit} and should be at {} {unit} by the progress of the other axes; all were stopped. Find out what blocks it, then reset", axis.name(), carrier.name(), number_text(*actual), number_text(*expected), unit = axis.unit())]
    NotFollowing {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Actual position; mm or degrees.
        actual: f64,
        /// Expected position; mm or degrees.
        expected: f64,
    },
    /// A manipulator did not find its references in time.
    #[error("{}: has not found its references within {} ms", carrier.name(), within.as_millis())]
    NotHomed {
        /// The manipulator.
        carrier: Carrier,
        /// How long the cell waited.
        within: Duration,
    },
    /// A reading before a set-point does not allow the devices to move; the set-point was not sent.
    #[error("before the next set-point: {0}")]
    NotReady(Box<Refusal>),
    /// A reading during the motion does not allow the devices to go on.
    #[error("during the motion: {0}")]
    Interrupted(Box<Refusal>),
    /// The state could not be read in time before a set-point.
    #[error("{}: could not be read back within {} ms", carrier.name(), within.as_millis())]
    NotReadBack {
        /// The manipulator.
        carrier: Carrier,
        /// How long the cell waited.
        within: Duration,
    },
    /// After a halt, no reading showed the device at rest.
    #[error("{device}: not seen at rest within {} ms after the halt", within.as_millis())]
    NotAtRest {
        /// Its name in the configuration.
        device: String,
        /// How long the cell waited.
        within: Duration,
    },
    /// The device refuses the halt.
    #[error("the device refuses to halt: {0}; check whether it moves, and stop it at its panel")]
    HaltRefused(DeviceError),
    /// The device reports a fault of its own.
    #[error("{device}: reports {}; see to it, then reset", fault_code(*code))]
    DeviceFault {
        /// Its name in the configuration.
        device: String,
        /// Fault code as reported by the device; 0 if it reports none.
        code: u32,
    },
    /// The stage did not reach its target.
    #[error("{device}: is at {} mm and not at {} mm after {} ms", number_text(*actual_mm), number_text(*target_mm), within.as_millis())]
    StageNotArrived {
        /// Its name in the configuration.
        device: String,
        /// Actual position, mm.
        actual_mm: f64,
        /// Target position, mm.
        target_mm: f64,
        /// How long the cell waited.
        within: Duration,
    },
    /// No profile was received for too long.
    #[error("{device}: no profile for {} ms, {received_count} of {expected_count} were received", within.as_millis())]
    ScanStalled {
        /// Name of the sensor in the configuration.
        device: String,
        /// Profiles that were received.
        received_count: u64,
        /// Profiles that were requested.
        expected_count: u64,
        /// How long the cell waited.
        within: Duration,
    },
    /// The receiver did not read the profiles, or did not read them fast enough.
    #[error("the receiver did not read the profiles in time; the scan was stopped")]
    ProfilesNotTaken,
    /// The task of the cell has ended without reporting how the job ended.
    #[error("the cell has ended; the state of the devices is not known")]
    CellGone,
}

impl Failure {
    /// The code of the failure in documents; it is stable.
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

    /// Whether the failure is latched, so that nothing moves until a reset. A failure found before anything was sent and an
    /// incomplete scan are not latched, because the positions of the devices are known.
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

    /// Whether the failure leaves the position or the last command of a device unknown.
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

/// A fault that is latched until a reset.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// The device's name in the configuration.
    pub device: String,
    /// What happened.
    pub failure: Failure,
    /// When it happened.
    pub at: Instant,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// Every target was reached, as the readings confirm.
    Done,
    /// It was stopped, and every device was read at rest.
    Stopped(StopCause),
    /// It failed, and the devices were stopped.
    Failed(Failure),
    /// It failed, and it is not known where the devices are or whether they executed the last command.
    Unknown(Failure),
}

impl fmt::Display for JobEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done => f.write_str("done"),
            Self::Stopped(cause) => write!(f, "stopped: {}", cause.text()),
            Self::Failed(failure) => write!(f, "failed: {failure}"),
            Self::Unknown(failure) => write!(f, "unknown where the devices are: {failure}"),
        }
    }
}
