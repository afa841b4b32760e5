//! What a profile sensor's adaptor promises.

use super::Pending;
use super::error::DeviceError;
use std::time::Duration;

/// A laser profile sensor behind its adaptor.
pub trait ProfileSensor: Send {
    /// The name in the configuration, for messages.
    fn name(&self) -> &str;

    /// Connects, or connects anew, and checks that the sensor is what the configuration says. Starts no laser.
    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Asks how it is. Between scans.
    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>>;

    /// Makes it ready to take `profiles_count` profiles; they come as its trigger says.
    fn start(&mut self, profiles_count: u64) -> Pending<'_, Result<(), DeviceError>>;

    /// The profiles that have come since the last call, at least one; waits for it. Gaps, drops and faults are errors.
    fn receive(&mut self) -> Pending<'_, Result<Vec<Profile>, DeviceError>>;

    /// Ends a scan, finished or not, and says whether the sensor lost anything during it. A sensor that runs without having
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
    /// Places of the sensor's line that saw nothing.
    pub missing_count: u64,
}

/// How a sensor is.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorReading {
    /// Model and serial number, as it gives them.
    pub model: String,
    /// As it gives it.
    pub serial: String,
    /// As it gives it.
    pub firmware: String,
    /// It takes profiles now.
    pub running: bool,
    /// °C, where it says so.
    pub temperature_c: Option<f64>,
}
