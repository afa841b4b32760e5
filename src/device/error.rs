//! The result of a call to a device: a future, and the errors with the messages that an operator reads.

use std::pin::Pin;
use std::time::Duration;

/// A call to a device that is under way.
pub type Pending<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Why a call to a device failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// There is no connection, or it was lost. The request may or may not have reached the device.
    #[error("{device}: the link is down: {cause}")]
    LinkLost {
        /// Its name in the configuration.
        device: String,
        /// The error of the link.
        cause: String,
    },
    /// No answer in time. The request may or may not have been executed.
    #[error("{device}: no answer within {} ms", within.as_millis())]
    Silent {
        /// Its name in the configuration.
        device: String,
        /// How long the adaptor waited.
        within: Duration,
    },
    /// The protocol does not allow the answer, or it is not plausible.
    #[error("{device}: the answer is not plausible: {what}")]
    Implausible {
        /// Its name in the configuration.
        device: String,
        /// The error, with the value that was read.
        what: String,
    },
    /// The device has refused the command, and did nothing.
    #[error("{device}: refused, device code {code}")]
    Rejected {
        /// Its name in the configuration.
        device: String,
        /// The code of the device; 0 if it gives none.
        code: u32,
    },
    /// The command has an older fencing token than an earlier command; nothing was sent.
    #[error("{device}: the command has the fencing token {fence}, which is older than {newest}; it was not sent")]
    Fenced {
        /// Its name in the configuration.
        device: String,
        /// Fencing token of the command.
        fence: u64,
        /// The newest fencing token.
        newest: u64,
    },
    /// The device cannot do this.
    #[error("{device}: cannot {what}")]
    Unsupported {
        /// Its name in the configuration.
        device: String,
        /// The request.
        what: String,
    },
    /// The data of the sensor have a gap or a fault; the scan is incomplete.
    #[error("{device}: the scan is incomplete: {fault}")]
    ScanFault {
        /// Its name in the configuration.
        device: String,
        /// The fault.
        fault: ScanFault,
    },
}

/// Why a scan is not usable.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScanFault {
    /// Frames are missing between two received ones.
    #[error("frame {found} was received instead of {expected}; {} are missing", found.saturating_sub(*expected))]
    FrameGap {
        /// Expected index.
        expected: u64,
        /// Received index.
        found: u64,
    },
    /// The sensor could not take every profile that was triggered.
    #[error("the sensor reports {count} dropped triggers")]
    TriggerDrops {
        /// Number of dropped triggers during the scan.
        count: u64,
    },
    /// The sensor could not send every profile.
    #[error("the sensor reports {count} profiles dropped on the network")]
    NetworkDrops {
        /// Number of dropped profiles during the scan.
        count: u64,
    },
    /// The sensor could not compute every profile.
    #[error("the sensor reports {count} profiles dropped in processing")]
    ProcessingDrops {
        /// Number of dropped profiles during the scan.
        count: u64,
    },
    /// The encoder position decreases or does not change.
    #[error("the encoder went from {from} to {to} ticks, opposite to the direction of travel")]
    EncoderReversed {
        /// Ticks of the previous frame.
        from: i64,
        /// Ticks of this frame.
        to: i64,
    },
    /// Fewer profiles than requested were received within the time limit.
    #[error("{received_count} of {expected_count} profiles were received")]
    Incomplete {
        /// Number of received profiles.
        received_count: u64,
        /// Number of requested profiles.
        expected_count: u64,
    },
    /// The sensor sends other messages than profiles, or profiles in a form that is not supported.
    #[error(
        "the sensor sends no profiles in a supported form; switch on uniform profile, profile point cloud or uniform surface"
    )]
    NoProfiles,
}

impl DeviceError {
    /// Whether the request may have been executed in spite of the error.
    #[must_use]
    pub const fn leaves_unknown(&self) -> bool {
        matches!(self, Self::LinkLost { .. } | Self::Silent { .. } | Self::Implausible { .. })
    }
}
