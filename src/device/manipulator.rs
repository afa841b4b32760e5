//! What the adaptor of a manipulator guarantees.
//!
//! The device keeps its own limits, watchdog and safety functions; coaxis reads, checks, and sends supervised set-points. The contract
//! test checks of every adaptor:
//!
//! - connecting reads and moves nothing; nothing is sent again after a reconnect;
//! - a command has absolute targets, a sequence number and a fencing token; one with an older token is refused before it is sent;
//! - a command whose answer was lost is resolved by reading [`Reading::acknowledged`], never by sending it again;
//! - a device executes a command only where its sequence number is newer than the last one that it has seen;
//! - a device that gets no heartbeat for the time of its watchdog stops by itself.

use super::error::DeviceError;
use super::error::Pending;
use crate::motion::{Axes, Position};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A manipulator behind its adaptor. One request at a time; a request that is dropped before its answer closes the connection.
pub trait Manipulator: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects again, checks that the device is the configured one, and reads its state. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Reads the whole state once. Also a heartbeat for the device.
    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Sends a command once. `Ok` means that it was sent, not that the device has taken it: that is read in
    /// [`Reading::acknowledged`]. After an error with [`DeviceError::leaves_unknown`] it may have arrived.
    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>>;
}

/// A command to a device.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// 1 to 65535, then 1 again; never repeated for another command.
    pub sequence: u16,
    /// The fencing token of the lease, which grows with every lease. Halts carry the newest.
    pub fence: u64,
    /// How long the device goes on moving without a heartbeat.
    pub watchdog: Duration,
    /// The action.
    pub action: Action,
}

/// The actions of a manipulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Switch the drives on, under control.
    Enable,
    /// Switch the drives off.
    Disable,
    /// Acknowledge the device's faults.
    Reset,
    /// Find the reference of these axes.
    Home {
        /// Which.
        axes: Axes<bool>,
    },
    /// Go there.
    MoveTo {
        /// Which axes; the others stay.
        axes: Axes<bool>,
        /// Absolute; mm, rad.
        targets: Position,
        /// Greatest speeds; mm/s, rad/s.
        speeds: Position,
    },
    /// Stop at the greatest deceleration, with the drives on: stop category 2, not a safety function.
    Halt,
}

/// The state of a device or of an axis, as PLCopen has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisState {
    /// No power, or not under control.
    Disabled,
    /// Under control, at rest.
    Standstill,
    /// It is being homed.
    Homing,
    /// Moves to a target.
    DiscreteMotion,
    /// Moves without a target.
    ContinuousMotion,
    /// Follows another axis.
    SynchronizedMotion,
    /// Comes to rest after a halt.
    Stopping,
    /// Stopped by a fault; needs a reset.
    ErrorStop,
}

impl AxisState {
    /// Whether it moves, or may.
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
    /// Taken.
    Accepted,
    /// Under way.
    Running,
    /// Finished.
    Done,
    /// Refused; nothing was done.
    Rejected,
    /// Ended before its end, by a halt, a newer command, the watchdog or a fault.
    Aborted,
}

/// The state of an axis, as the device reports it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisReading {
    /// Where it is; mm, or rad.
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
    /// Its reference is known.
    pub homed: bool,
    /// It is at its target.
    pub in_position: bool,
    /// It has a fault.
    pub fault: bool,
    /// It stands at a limit.
    pub limit_hit: bool,
}

/// A device's state, read at one moment, checked: every number finite, every lower limit below its upper one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// The whole device.
    pub state: AxisState,
    /// Its mode.
    pub mode: Mode,
    /// Its safety functions.
    pub safety: Safety,
    /// The acknowledgement of the newest command.
    pub acknowledged: Acknowledged,
    /// Its own fault code; 0 is none.
    pub fault_code: u32,
    /// Counts while the program of the device runs.
    pub heartbeat: u16,
    /// Each axis.
    pub axes: Axes<AxisReading>,
}

impl Reading {
    /// Where the axes are.
    #[must_use]
    pub fn position(&self) -> Position {
        self.axes.map(|_, axis| axis.actual)
    }

    /// Whether the device, or any axis, moves or may.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.state.moves() || self.axes.iter().any(|(_, axis)| axis.state.moves())
    }
}
