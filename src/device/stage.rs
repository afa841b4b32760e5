//! What the adaptor of the linear stage promises, which carries the sensor along the rail.

use super::Pending;
use super::error::DeviceError;

/// The linear stage behind its adaptor. The rules for commands are those of a manipulator.
pub trait Stage: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects anew, and reads. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<StageReading, DeviceError>>;

    /// Reads the state once. Also tells the device that we live.
    fn read(&mut self) -> Pending<'_, Result<StageReading, DeviceError>>;

    /// Sends it to `target_mm` at `speed_mm_s`; returns when the command was handed over.
    fn move_to(&mut self, fence: u64, target_mm: f64, speed_mm_s: f64) -> Pending<'_, Result<(), DeviceError>>;

    /// Stops it.
    fn halt(&mut self) -> Pending<'_, Result<(), DeviceError>>;
}

/// A stage's state, read at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageReading {
    /// Where it is, mm along the rail.
    pub actual_mm: f64,
    /// Its limits, mm.
    pub lower_mm: f64,
    /// Its limits, mm.
    pub upper_mm: f64,
    /// Greatest speed, mm/s.
    pub speed_mm_s: f64,
    /// It moves.
    pub moves: bool,
    /// It is at its target.
    pub in_position: bool,
    /// Its own fault code; 0 is none.
    pub fault_code: u32,
}
