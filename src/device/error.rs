//! What can go wrong between us and a device, as an operator would say it.

use std::time::Duration;

/// Why a device did not do, or did not say, what it was asked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DeviceError {
    /// No connection, or none any more. What was under way may or may not have reached the device.
    #[error("{device}: the link is down: {cause}")]
    LinkLost {
        /// Its name in the configuration.
        device: String,
        /// What the link said.
        cause: String,
    },
    /// No answer in time. What was asked may or may not have been done.
    #[error("{device}: no answer within {} ms", within.as_millis())]
    Silent {
        /// Its name in the configuration.
        device: String,
        /// How long was waited.
        within: Duration,
    },
    /// An answer that the protocol does not allow, or that cannot be true.
    #[error("{device}: the answer makes no sense: {what}")]
    Implausible {
        /// Its name in the configuration.
        device: String,
        /// What, with the value that was read.
        what: String,
    },
    /// The device has refused, and says so; it did nothing.
    #[error("{device}: refused, device code {code}")]
    Rejected {
        /// Its name in the configuration.
        device: String,
        /// As the device gives it; 0 where it gives none.
        code: u32,
    },
    /// The command carries an older fence than one that was seen; nothing was sent.
    #[error("{device}: the command has fence {fence}, and {newest} has commanded since; it was not sent")]
    Fenced {
        /// Its name in the configuration.
        device: String,
        /// Of the command.
        fence: u64,
        /// Newest seen.
        newest: u64,
    },
    /// The device cannot do this.
    #[error("{device}: cannot {what}")]
    Unsupported {
        /// Its name in the configuration.
        device: String,
        /// What it was asked.
        what: String,
    },
    /// The data of the sensor have a gap or a fault; the scan cannot be whole.
    #[error("{device}: the scan is not whole: {fault}")]
    ScanFault {
        /// Its name in the configuration.
        device: String,
        /// Which.
        fault: ScanFault,
    },
}

/// What makes a scan unusable, by name.
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
    /// Whether what was asked may have been done all the same.
    #[must_use]
    pub const fn leaves_unknown(&self) -> bool {
        matches!(self, Self::LinkLost { .. } | Self::Silent { .. } | Self::Implausible { .. })
    }
}
