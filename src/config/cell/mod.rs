//! The cell in the configuration: which adaptor stands behind each device, where the manipulators stand and how far they may
//! go, and how long anything may take. Edge units, in every name.

mod check;
mod convert;
mod devices;
mod error;
mod links;
mod over;
mod ranges;
mod supports;

pub use devices::{Manipulator, ManipulatorAdaptor, Sensor, SensorAdaptor, Stage, StageAdaptor};
pub use error::CellError;
pub(super) use over::over_default;
pub use supports::{LinearLimits, SupportLimits, Tolerances, TurnLimits};

use crate::device::simulated;
use crate::motion::Pair;
use serde::{Deserialize, Serialize};

/// The devices that scan and move the part, and what they may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Whether there is one; without it the service measures what it is sent, and nothing moves.
    pub enabled: bool,
    /// Whether simulated devices may stand beside real ones. What a simulated sensor sees says nothing about a real part, so a
    /// plan made from it would move that part by chance; only for trying adaptors.
    pub simulated_beside_real: bool,
    /// Longest time between measuring and executing a plan made from it.
    pub plan_age_max_s: u64,
    /// Who may move, and for how long.
    pub lease: Lease,
    /// How often, and how long.
    pub timing: Timing,
    /// What the two manipulators may do together.
    pub together: Together,
    /// The scan of a measurement that says nothing about it.
    pub scan: ScanPath,
    /// The two manipulators.
    pub manipulators: Pair<Manipulator>,
    /// The stage that carries the sensor along the rail.
    pub stage: Stage,
    /// The profile sensor.
    pub sensor: Sensor,
    /// What stands behind all that is simulated.
    pub simulated: simulated::Settings,
}

/// Who may move, and for how long.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lease {
    /// Time to live of a lease that does not ask for one.
    pub ttl_ms: u64,
    /// Shortest time to live that may be asked for.
    pub ttl_min_ms: u64,
    /// Longest time to live that may be asked for.
    pub ttl_max_ms: u64,
}

/// How often devices are asked, and how long they may take. The bounds see to it that what moves holds within half a second of
/// the last good answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Between two readings of a device at rest.
    pub poll_ms: u64,
    /// Between two readings of a device that moves.
    pub poll_moving_ms: u64,
    /// Longest time for a device's answer.
    pub reply_ms: u64,
    /// Longest time for connecting and the first reading.
    pub connect_ms: u64,
    /// Longest time until a device has taken a command.
    pub acknowledge_ms: u64,
    /// How long a device moves on without hearing from us.
    pub watchdog_ms: u64,
    /// What a way may take longer than planned before its axes count as not arrived.
    pub arrival_ms: u64,
    /// Longest time without a profile during a scan.
    pub scan_stall_ms: u64,
}

/// What the two manipulators may do together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Together {
    /// Largest change of the distance of the two clamps along a path: what the part and the clamps bear.
    pub strain_max_mm: f64,
    /// How far a clamp may run on after an axis of either manipulator has stuck. It limits the speed of every path.
    pub run_on_max_mm: f64,
    /// Largest difference of the two turns along a path.
    pub twist_max_deg: f64,
    /// Least gap between the two manipulators along the rail.
    pub clearance_min_mm: f64,
    /// How close to its target an axis counts as there; no less than the backlash.
    pub tolerance: Tolerances,
}

/// Where a scan goes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanPath {
    /// Where it begins, along the rail.
    pub x_from_mm: f64,
    /// Where it ends.
    pub x_to_mm: f64,
    /// Profiles in between, both ends included.
    pub profiles_count: u64,
    /// How fast the stage goes.
    pub speed_mm_s: f64,
    /// How far the first and the last profile may be from where the scan was to begin and end: where the sensor reckons x by
    /// itself, it is held to the stage.
    pub place_tolerance_mm: f64,
}

impl Default for Cell {
    fn default() -> Self {
        Self {
            enabled: true,
            simulated_beside_real: false,
            plan_age_max_s: 60,
            lease: Lease::default(),
            timing: Timing::default(),
            together: Together::default(),
            scan: ScanPath::default(),
            manipulators: Pair::from_fn(Manipulator::of),
            stage: Stage::default(),
            sensor: Sensor::default(),
            simulated: simulated::Settings::default(),
        }
    }
}

impl Default for Lease {
    fn default() -> Self {
        Self { ttl_ms: 5_000, ttl_min_ms: 1_000, ttl_max_ms: 60_000 }
    }
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            poll_ms: 50,
            poll_moving_ms: 20,
            reply_ms: 200,
            connect_ms: 2_000,
            acknowledge_ms: 300,
            watchdog_ms: 300,
            arrival_ms: 2_000,
            scan_stall_ms: 1_000,
        }
    }
}

impl Default for Together {
    fn default() -> Self {
        Self {
            strain_max_mm: 0.5,
            run_on_max_mm: 1.0,
            twist_max_deg: 0.5,
            clearance_min_mm: 50.0,
            tolerance: Tolerances::default(),
        }
    }
}

impl Default for ScanPath {
    fn default() -> Self {
        Self { x_from_mm: 200.0, x_to_mm: 600.0, profiles_count: 200, speed_mm_s: 100.0, place_tolerance_mm: 5.0 }
    }
}
