//! What a manipulator's adaptor promises.
//!
//! The device keeps its own limits, watchdog and safety; we read, check, and send supervised set-points. What every adaptor
//! holds to, and the contract test asks of each:
//!
//! - connecting reads and moves nothing; nothing is sent again after a reconnect;
//! - a command has absolute targets, a sequence number and a fence; an older fence is refused before a byte is sent;
//! - a command whose answer was lost is resolved by reading [`Reading::acknowledged`], never by sending it again;
//! - a device executes a command only where its sequence number is newer than the last one that it has seen;
//! - a device that does not see our heartbeat for the watchdog's time stops by itself.

use super::Pending;
use super::error::DeviceError;
use crate::motion::{Axes, Position};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A manipulator behind its adaptor. One request at a time; what is dropped half-way costs the connection.
pub trait Manipulator: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects anew, checks that the device is what the configuration says, and reads its state. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Reads the state once, whole. Also tells the device that we live.
    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>>;

    /// Sends a command once. `Ok` says that it was handed over, not that the device has taken it: that is read in
    /// [`Reading::acknowledged`]. Where the error [`DeviceError::leaves_unknown`], it may have arrived.
    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>>;
}

/// What a device is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Command {
    /// 1 to 65535, then 1 again; never repeated for another command.
    pub sequence: u16,
    /// Of the lease that commands; grows with every lease. Halts carry the newest.
    pub fence: u64,
    /// How long the device moves on without hearing from us.
    pub watchdog: Duration,
    /// What to do.
    pub action: Action,
}

/// What a manipulator can be told to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Put the drives under control.
    Enable,
    /// Take the drives out of control.
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
    /// Stop at the greatest deceleration and hold. Category 2; no safety function.
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
    /// Finds its reference.
    Homing,
    /// On its way to a target.
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

/// Who commands the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Nobody.
    Off,
    /// Somebody at its panel.
    Manual,
    /// We.
    Automatic,
}

/// What the device says about its safety functions; they are its own, we only read them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Safety {
    /// The emergency stop is not pressed.
    pub emergency_stop_ok: bool,
    /// The guard is closed.
    pub guard_closed: bool,
    /// The drives are ready.
    pub drives_ready: bool,
    /// The device takes commands from us.
    pub remote_enabled: bool,
}

impl Safety {
    /// Whether all of it lets the device move.
    #[must_use]
    pub const fn allows_motion(self) -> bool {
        self.emergency_stop_ok && self.guard_closed && self.drives_ready && self.remote_enabled
    }
}

/// What became of the newest command that the device has seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledged {
    /// Its sequence number; 0 where there was none yet.
    pub sequence: u16,
    /// What became of it.
    pub result: CommandResult,
}

/// What became of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommandResult {
    /// There was none.
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

/// One axis as the device sees it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisReading {
    /// Where it is; mm, or rad.
    pub actual: f64,
    /// Where it is told to be at this moment; mm, or rad.
    pub commanded: f64,
    /// The device's own lower limit; mm, or rad.
    pub lower: f64,
    /// The device's own upper limit; mm, or rad.
    pub upper: f64,
    /// The device's own greatest speed; mm/s, or rad/s.
    pub speed: f64,
    /// What it does.
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
    /// Who commands it.
    pub mode: Mode,
    /// What it says about safety.
    pub safety: Safety,
    /// The newest command that it has seen.
    pub acknowledged: Acknowledged,
    /// Its own fault code; 0 is none.
    pub fault_code: u32,
    /// Counts while the device lives.
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
}
