//! The parameters with which the cell is started: its devices, the arrangement of the manipulators, and its deadlines with their
//! defaults. Also the order for a scan.

use crate::device::{Manipulator, ProfileSensor, Stage};
use crate::motion::{Arrangement, Pair};
use std::time::Duration;

/// The devices; the cell's task owns them from its start to its end.
pub struct Devices {
    /// Both manipulators; every cell has them.
    pub manipulators: Pair<Box<dyn Manipulator>>,
    /// The sensor, if there is one.
    pub sensor: Option<Box<dyn ProfileSensor>>,
    /// The stage, if there is one.
    pub stage: Option<Box<dyn Stage>>,
}

/// The settings of the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Positions and limits of the manipulators.
    pub arrangement: Arrangement,
    /// Polling period of a device at rest.
    pub poll: Duration,
    /// Polling period of a device that moves, or that has not yet acknowledged a command.
    pub poll_moving: Duration,
    /// Longest wait for one answer; at most 300 ms.
    pub reply: Duration,
    /// Longest wait for a connection and its first reading; nothing moves before it, and the device keeps its own watchdog.
    pub connect: Duration,
    /// Longest wait until a device has acknowledged a command; at most 300 ms.
    pub acknowledge: Duration,
    /// Grace time of a call when a halt is due; then the call is dropped, and the connection closed.
    pub halt_grace: Duration,
    /// How long a device continues to move without a heartbeat from coaxis; at most 400 ms, so that it stops within 500 ms.
    pub watchdog: Duration,
    /// Longest time after a halt until every device has been read at rest.
    pub rest: Duration,
    /// Added to the planned time to each waypoint before an axis counts as not arrived.
    pub arrival: Duration,
    /// First wait before reconnecting; it doubles with every attempt.
    pub backoff_first: Duration,
    /// Longest wait before reconnecting.
    pub backoff_last: Duration,
    /// Shortest time to live of a lease.
    pub lease_least: Duration,
    /// Longest time to live of a lease.
    pub lease_most: Duration,
    /// Polling period of the sensor outside scans.
    pub sensor_poll: Duration,
    /// Longest wait for an answer of the sensor. It may be longer, because the sensor moves nothing.
    pub sensor_reply: Duration,
    /// Longest time without a profile while the stage moves the sensor.
    pub scan_stall: Duration,
    /// Longest time for a manipulator to find its references.
    pub homing: Duration,
    /// Distance from its target at which the stage has arrived, mm.
    pub stage_tolerance_mm: f64,
}

impl Settings {
    /// The default settings for an arrangement.
    #[must_use]
    pub const fn new(arrangement: Arrangement) -> Self {
        Self {
            arrangement,
            poll: Duration::from_millis(50),
            poll_moving: Duration::from_millis(20),
            reply: Duration::from_millis(200),
            connect: Duration::from_secs(2),
            acknowledge: Duration::from_millis(300),
            halt_grace: Duration::from_millis(25),
            watchdog: Duration::from_millis(300),
            rest: Duration::from_secs(2),
            arrival: Duration::from_secs(2),
            backoff_first: Duration::from_millis(250),
            backoff_last: Duration::from_secs(5),
            lease_least: Duration::from_secs(1),
            lease_most: Duration::from_secs(60),
            sensor_poll: Duration::from_secs(1),
            sensor_reply: Duration::from_secs(2),
            scan_stall: Duration::from_secs(1),
            homing: Duration::from_secs(120),
            stage_tolerance_mm: 0.05,
        }
    }

    /// Checks the settings against their ranges; the guaranteed times to stop depend on these.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), SettingsError> {
        let bounds = [
            ("poll", self.poll, 5, 100),
            ("poll_moving", self.poll_moving, 5, 50),
            ("reply", self.reply, 20, 300),
            ("connect", self.connect, 20, 30_000),
            ("acknowledge", self.acknowledge, 20, 300),
            ("halt_grace", self.halt_grace, 0, 45),
            ("watchdog", self.watchdog, 100, 400),
            ("rest", self.rest, 100, 60_000),
            ("arrival", self.arrival, 100, 600_000),
            ("backoff_first", self.backoff_first, 10, 60_000),
            ("backoff_last", self.backoff_last, 10, 60_000),
            ("lease_least", self.lease_least, 100, 600_000),
            ("lease_most", self.lease_most, 100, 600_000),
            ("sensor_poll", self.sensor_poll, 50, 60_000),
            ("homing", self.homing, 100, 3_600_000),
            ("sensor_reply", self.sensor_reply, 20, 60_000),
            ("scan_stall", self.scan_stall, 50, 60_000),
        ];
        for (what, given, least, most) in bounds {
            let (least, most) = (Duration::from_millis(least), Duration::from_millis(most));
            if given < least || given > most {
                return Err(SettingsError::OutOfBounds { what, given, least, most });
            }
        }
        if self.lease_least > self.lease_most {
            return Err(SettingsError::LeaseBounds { least: self.lease_least, most: self.lease_most });
        }
        if !(self.stage_tolerance_mm.is_finite() && self.stage_tolerance_mm > 0.0) {
            return Err(SettingsError::StageTolerance { given_mm: self.stage_tolerance_mm });
        }
        Ok(())
    }
}

/// A setting that cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A time is out of its range.
    #[error("{what} is {} ms; it must be from {} to {} ms", given.as_millis(), least.as_millis(), most.as_millis())]
    OutOfBounds {
        /// The name of the setting.
        what: &'static str,
        /// Its value.
        given: Duration,
        /// Least allowed value.
        least: Duration,
        /// Greatest allowed value.
        most: Duration,
    },
    /// The shortest lease is longer than the longest.
    #[error("lease_least is {} ms and lease_most {} ms", least.as_millis(), most.as_millis())]
    LeaseBounds {
        /// Value of `lease_least`.
        least: Duration,
        /// Value of `lease_most`.
        most: Duration,
    },
    /// The tolerance of the stage is not a positive length.
    #[error("stage_tolerance_mm is {given_mm}; it must be above zero")]
    StageTolerance {
        /// Its value.
        given_mm: f64,
    },
}

/// An order for a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanOrder {
    /// Start position of the stage, mm along the rail.
    pub x_from_mm: f64,
    /// End position of the stage, mm along the rail.
    pub x_to_mm: f64,
    /// Number of profiles; the trigger of the sensor decides where they are taken.
    pub profiles_count: u64,
    /// Speed of the stage while profiles are taken, mm/s.
    pub speed_mm_s: f64,
}
