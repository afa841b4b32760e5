//! What a call to a device returns: a future, and the errors with the messages that an operator reads.

use std::pin::Pin;
use std::time::Duration;

/// A call to a device that is under way.
pub type Pending<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Why a call to a device failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// No connection, or none any more. The request may or may not have reached the device.
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
    /// An answer that the protocol does not allow, or that is not plausible.
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
    /// The command carries an older fencing token than a command before; nothing was sent.
    #[error("{device}: the command has the fencing token {fence}, which is older than {newest}; it was not sent")]
    Fenced {
        /// Its name in the configuration.
        device: String,
        /// Of the command.
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
        /// Which.
        fault: ScanFault,
    },
}

/// Why a scan cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScanFault {
    /// Frames are missing between two that came.
    #[error("frame {found} came where {expected} was due, {} are missing", found.saturating_sub(*expected))]
    FrameGap {
        /// Index that was due.
        expected: u64,
        /// Index that came.
        found: u64,
    },
    /// The sensor could not take every profile that was triggered.
    #[error("the sensor reports {count} dropped triggers")]
    TriggerDrops {
        /// During the scan.
        count: u64,
    },
    /// The sensor could not send every profile.
    #[error("the sensor reports {count} profiles dropped on the network")]
    NetworkDrops {
        /// During the scan.
        count: u64,
    },
    /// The sensor could not compute every profile.
    #[error("the sensor reports {count} profiles dropped in processing")]
    ProcessingDrops {
        /// During the scan.
        count: u64,
    },
    /// The position on the rail runs backwards or stands still.
    #[error("the encoder went from {from} to {to} ticks against the travel")]
    EncoderReversed {
        /// Ticks of the frame before.
        from: i64,
        /// Ticks of the frame.
        to: i64,
    },
    /// Fewer profiles than were asked for came before the time was over.
    #[error("{received_count} of {expected_count} profiles came")]
    Incomplete {
        /// Profiles that came.
        received_count: u64,
        /// Profiles that were asked for.
        expected_count: u64,
    },
    /// Other messages than profiles came, or none that can be used.
    #[error(
        "the sensor sends no profiles that are understood; switch on uniform profile, profile point cloud or uniform surface"
    )]
    NoProfiles,
}

impl DeviceError {
    /// Whether the request may have been executed nevertheless.
    #[must_use]
    pub const fn leaves_unknown(&self) -> bool {
        matches!(self, Self::LinkLost { .. } | Self::Silent { .. } | Self::Implausible { .. })
    }
}
