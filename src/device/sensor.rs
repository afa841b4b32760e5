//! The guarantees of the adaptors of a profile sensor and of the linear stage that moves the sensor along the rail.

use std::time::Duration;

use super::error::{DeviceError, Pending};

/// A laser profile sensor behind its adaptor.
pub trait ProfileSensor: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects or reconnects, and checks that the sensor is the configured one. It does not switch the laser on.
    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Reads the state, between scans.
    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Prepares it for `profiles_count` profiles; its trigger decides when each is taken.
    fn start(&mut self, profiles_count: u64) -> Pending<'_, Result<(), DeviceError>>;

    /// Returns the profiles received since the last call, and waits for at least one. Gaps, losses and faults are errors.
    fn receive(&mut self) -> Pending<'_, Result<Vec<Profile>, DeviceError>>;

    /// Ends a scan, finished or not, and reports whether the sensor lost any data during it. A running sensor that was not started
    /// by this adaptor (but by an earlier process or another client) is stopped as well, because its laser is on. Has no effect if
    /// no scan is running.
    fn stop(&mut self) -> Pending<'_, Result<(), DeviceError>>;

    /// The time limits of the adaptor itself.
    fn deadlines(&self) -> SensorDeadlines {
        SensorDeadlines::default()
    }
}

/// The time limits of a sensor's adaptor. A caller with a deadline of its own waits at least as long; zero leaves the deadline to
/// the caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SensorDeadlines {
    /// Time for a connection and the first reading.
    pub connect: Duration,
    /// Time for a reading.
    pub reply: Duration,
    /// Time until the sensor is ready for profiles.
    pub start: Duration,
    /// Time until the sensor has stopped.
    pub stop: Duration,
    /// Time from the start to the first profile. A sensor that sends a surface sends it at the end of the scan.
    pub first_profile: Duration,
}

/// One profile in millimetres and in the rail frame, transformed by the extrinsic of the configuration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Profile {
    /// Index without gaps within a scan.
    pub index: u64,
    /// Position of the stage, mm along the rail; from the encoder or from the time, as configured.
    pub travel_mm: f64,
    /// x of every point, mm; empty if all points are at `travel_mm`.
    pub x: Vec<f32>,
    /// y of every point, mm.
    pub y: Vec<f32>,
    /// z of every point, mm.
    pub z: Vec<f32>,
    /// Points of the sensor's line that were not measured.
    pub missing_count: u64,
}

/// The state of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorReading {
    /// Model, as the sensor reports it.
    pub model: String,
    /// Serial number, as the sensor reports it.
    pub serial: String,
    /// Firmware version, as the sensor reports it.
    pub firmware: String,
    /// Whether it is taking profiles, with its laser on.
    pub running: bool,
    /// Temperature in °C, if the sensor reports it.
    pub temperature_c: Option<f64>,
}

/// The linear stage behind its adaptor. The rules for commands are those of a manipulator.
pub trait Stage: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects or reconnects, and reads. It moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<StageReading, DeviceError>>;

    /// Reads the state once, which is also a heartbeat for the device.
    fn read(&mut self) -> Pending<'_, Result<StageReading, DeviceError>>;

    /// Starts a move to `target_mm` at `speed_mm_s`; returns when the command has been sent.
    fn move_to(&mut self, fence: u64, target_mm: f64, speed_mm_s: f64) -> Pending<'_, Result<(), DeviceError>>;

    /// Stops it.
    fn halt(&mut self) -> Pending<'_, Result<(), DeviceError>>;
}

/// The state of a stage, read at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageReading {
    /// Actual position, mm along the rail.
    pub actual_mm: f64,
    /// Lower limit, mm.
    pub lower_mm: f64,
    /// Upper limit, mm.
    pub upper_mm: f64,
    /// Greatest speed, mm/s.
    pub speed_mm_s: f64,
    /// Whether it moves.
    pub moves: bool,
    /// Whether it is at its target.
    pub in_position: bool,
    /// Fault code of the device; 0 means none.
    pub fault_code: u32,
}
