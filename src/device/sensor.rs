//! What the adaptor of a profile sensor guarantees, and that of the linear stage that carries the sensor along the rail.

use std::time::Duration;

use super::error::{DeviceError, Pending};

/// A laser profile sensor behind its adaptor.
pub trait ProfileSensor: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects again, and checks that the sensor is the configured one. Does not switch the laser on.
    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Reads the state, between scans.
    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Prepares it for `profiles_count` profiles; its trigger decides when each is taken.
    fn start(&mut self, profiles_count: u64) -> Pending<'_, Result<(), DeviceError>>;

    /// The profiles that have come since the last call, at least one; waits for it. Gaps, drops and faults are errors.
    fn receive(&mut self) -> Pending<'_, Result<Vec<Profile>, DeviceError>>;

    /// Ends a scan, finished or not, and reports whether the sensor lost anything during it. A sensor that runs without having
    /// been started here (by a process before us, or by another client) is stopped as well: its laser is on. Harmless where
    /// no scan runs.
    fn stop(&mut self) -> Pending<'_, Result<(), DeviceError>>;

    /// How long the adaptor itself waits for the sensor.
    fn deadlines(&self) -> SensorDeadlines {
        SensorDeadlines::default()
    }
}

/// How long an adaptor waits for its sensor. A caller with a deadline of its own waits at least as long; zero leaves the
/// deadline to the caller.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SensorDeadlines {
    /// For a connection and the first reading.
    pub connect: Duration,
    /// For a reading.
    pub reply: Duration,
    /// Until the sensor is ready for profiles.
    pub start: Duration,
    /// Until the sensor has stopped.
    pub stop: Duration,
    /// From the start to the first profile. A sensor that sends a whole surface sends it at the end of the scan.
    pub first_profile: Duration,
}

/// One profile as the sensor took it: already in millimetres and in the rail frame, by the extrinsic of the configuration.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Profile {
    /// Counts without a gap within a scan.
    pub index: u64,
    /// How far the stage had come, mm along the rail; by encoder or by time, as configured.
    pub travel_mm: f64,
    /// x of every point, mm; empty where all of them are at `travel_mm`.
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
    /// Model and serial number, as it gives them.
    pub model: String,
    /// As the sensor reports it.
    pub serial: String,
    /// As the sensor reports it.
    pub firmware: String,
    /// It is taking profiles, and its laser is on.
    pub running: bool,
    /// °C, if it reports it.
    pub temperature_c: Option<f64>,
}

/// The linear stage behind its adaptor. The rules for commands are those of a manipulator.
pub trait Stage: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects again, and reads. Moves nothing.
    fn connect(&mut self) -> Pending<'_, Result<StageReading, DeviceError>>;

    /// Reads the state once. Also a heartbeat for the device.
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
