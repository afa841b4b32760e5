//! The guarantees of a manipulator's adaptor.
//!
//! The device enforces its own limits, watchdog and safety functions; coaxis reads, checks, and sends supervised set-points. The
//! contract test checks the following for every adaptor:
//!
//! - connecting reads and moves nothing; nothing is sent again after a reconnect;
//! - a command has absolute targets, a sequence number and a fencing token; one with an older token is refused before it is sent;
//! - a command whose answer was lost is resolved by reading [`Reading::acknowledged`], never by sending it again;
//! - a device executes a command only if its sequence number is newer than the last one that it has received;
//! - a device that receives no heartbeat for its watchdog time stops by itself.

use super::error::DeviceError;
use super::error::Pending;
use crate::motion::{Axes, Position};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A manipulator behind its adaptor. It takes one request at a time; a request that is dropped before its answer closes the
/// connection.
pub trait Manipulator: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects or reconnects, checks that the device is the configured one, and reads its state. It moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Reads the complete state once, which is also a heartbeat for the device.
    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Sends a command once. `Ok` means that it was sent, not that the device has accepted it; [`Reading::acknowledged`] shows
    /// that. After an error with [`DeviceError::leaves_unknown`] the command may have arrived.
    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>>;
}

/// A command to a device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// 1 to 65535, then 1 again; two commands never have the same number.
    pub sequence: u16,
    /// The fencing token of the lease, which increases with every lease. Halts carry the newest one.
    pub fence: u64,
    /// How long the device continues to move without a heartbeat.
    pub watchdog: Duration,
    /// The action.
    pub action: Action,
}

/// The actions of a manipulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Switch the drives on under position control.
    Enable,
    /// Switch the drives off.
    Disable,
    /// Acknowledge the device's faults.
    Reset,
    /// Find the reference of these axes.
    Home {
        /// The axes.
        axes: Axes<bool>,
    },
    /// Move to absolute targets.
    MoveTo {
        /// The axes that move; the others stay.
        axes: Axes<bool>,
        /// Absolute positions; mm, rad.
        targets: Position,
        /// Greatest speeds; mm/s, rad/s.
        speeds: Position,
    },
    /// Stop at the greatest deceleration, with the drives on: stop category 2, not a safety function.
    Halt,
}

/// The state of a device or of an axis, as defined by PLCopen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisState {
    /// No power, or not under position control.
    Disabled,
    /// Under position control and at rest.
    Standstill,
    /// It is being homed.
    Homing,
    /// Moves to a target.
    DiscreteMotion,
    /// Moves without a target.
    ContinuousMotion,
    /// Follows another axis.
    SynchronizedMotion,
    /// Stopping after a halt.
    Stopping,
    /// Stopped by a fault; needs a reset.
    ErrorStop,
}

impl AxisState {
    /// Whether it moves or may move.
    #[must_use]
    pub const fn moves(self) -> bool {
        match self {
            Self::Disabled | Self::Standstill | Self::ErrorStop => false,
            Self::Homing
            | Self::DiscreteMotion
            | Self::ContinuousMotion
            | Self::SynchronizedMotion
            | Self::Stopping => true,
        }
    }
}

/// The mode of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// No commands are accepted.
    Off,
    /// An operator commands it at its panel.
    Manual,
    /// It accepts commands of coaxis.
    Automatic,
}

/// The states of the safety functions of the device; coaxis only reads them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Safety {
    /// The emergency stop is not pressed.
    pub emergency_stop_ok: bool,
    /// The guard is closed.
    pub guard_closed: bool,
    /// The drives are ready.
    pub drives_ready: bool,
    /// The device accepts commands of coaxis.
    pub remote_enabled: bool,
}

impl Safety {
    /// Whether all safety functions allow motion.
    #[must_use]
    pub const fn allows_motion(self) -> bool {
        self.emergency_stop_ok && self.guard_closed && self.drives_ready && self.remote_enabled
    }
}

/// The acknowledgement of the newest command that the device has received.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledged {
    /// Its sequence number; 0 before the first command.
    pub sequence: u16,
    /// Its result.
    pub result: CommandResult,
}

/// The result of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommandResult {
    /// There was no command.
    None,
    /// Accepted, not started yet.
    Accepted,
    /// Being executed.
    Running,
    /// Finished.
    Done,
    /// Refused; nothing was executed.
    Rejected,
    /// Ended early by a halt, a newer command, the watchdog or a fault.
    Aborted,
}

/// The state of an axis, as the device reports it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisReading {
    /// Actual position; mm, or rad.
    pub actual: f64,
    /// The commanded position at this moment; mm, or rad.
    pub commanded: f64,
    /// The device's own lower limit; mm, or rad.
    pub lower: f64,
    /// The device's own upper limit; mm, or rad.
    pub upper: f64,
    /// The device's own greatest speed; mm/s, or rad/s.
    pub speed: f64,
    /// Its state.
    pub state: AxisState,
    /// Whether its reference is known.
    pub homed: bool,
    /// Whether it is at its target.
    pub in_position: bool,
    /// Whether it has a fault.
    pub fault: bool,
    /// Whether it is at a limit.
    pub limit_hit: bool,
}

/// The state of a device, read at one moment and checked: every number is finite, every lower limit is below its upper one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// State of the device.
    pub state: AxisState,
    /// Its mode.
    pub mode: Mode,
    /// Its safety functions.
    pub safety: Safety,
    /// The acknowledgement of the newest command.
    pub acknowledged: Acknowledged,
    /// Fault code of the device; 0 means none.
    pub fault_code: u32,
    /// A counter that increases while the program of the device runs.
    pub heartbeat: u16,
    /// Each axis.
    pub axes: Axes<AxisReading>,
}

impl Reading {
    /// Actual positions of the axes.
    #[must_use]
    pub fn position(&self) -> Position {
        self.axes.map(|_, axis| axis.actual)
    }

    /// Whether the device or any axis moves or may move.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.state.moves() || self.axes.iter().any(|(_, axis)| axis.state.moves())
    }
}
