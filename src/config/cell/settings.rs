//! The settings of the cell with their defaults: the lease, times, the two manipulators together, the scan, and for each device its
//! adaptor and limits. A configuration gives only the keys that differ from the defaults: it is merged into them key by key,
//! although the two manipulators have different defaults.

use std::path::Path;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use toml::{Table, Value};

#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::device::{gocator, modbus, simulated};
use crate::motion::{Carrier, Pair};

/// The devices that scan and move the part, and what they may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Whether there is a cell; without one the service measures uploaded scans, and nothing moves.
    pub enabled: bool,
    /// Whether simulated devices may stand beside real ones. A simulated sensor does not see the real part, so a
    /// plan made from it would move that part by chance; only for trying adaptors.
    pub simulated_beside_real: bool,
    /// Longest time between measuring and executing a plan made from it.
    pub plan_age_max_s: u64,
    /// The time to live of a lease.
    pub lease: Lease,
    /// How often, and how long.
    pub timing: Timing,
    /// What the two manipulators may do together.
    pub together: Together,
    /// The scan of a measurement whose request gives none.
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

/// The time to live of a lease.
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

/// How often devices are read, and how long they may take. The ranges ensure that a device that moves stops within half a second of
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
    /// How long a device goes on moving without a heartbeat from coaxis.
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

/// Registers between two manipulators of one PLC.
const MODBUS_STRIDE: u16 = 256;

/// A manipulator: where it stands, and how it is reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manipulator {
    /// How it is reached.
    pub adaptor: ManipulatorAdaptor,
    /// Where its clamp's centre is in the rail frame while all its axes are at zero: x, y, z.
    pub mount_mm: [f64; 3],
    /// How far its body reaches along the rail on both sides of the clamp.
    pub half_span_mm: f64,
    /// The limits of its axes; the device has limits of its own, and the narrower ones apply.
    pub limits: SupportLimits,
    /// Where it is, behind `modbus`.
    pub modbus: modbus::Settings,
    /// Where it is, behind `opcua`.
    #[cfg(feature = "opcua")]
    pub opcua: opcua::Settings,
}

/// How a manipulator is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ManipulatorAdaptor {
    /// Simulated, inside this process.
    Simulated,
    /// A PLC with a register map.
    Modbus,
    /// A PLC with an OPC UA server.
    Opcua,
}

/// The linear stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// How it is reached.
    pub adaptor: StageAdaptor,
    /// Where it is, behind `modbus`.
    pub modbus: modbus::Settings,
}

/// How the stage is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageAdaptor {
    /// Simulated, inside this process.
    Simulated,
    /// A PLC with a register map.
    Modbus,
    /// There is none that we command.
    None,
}

/// The profile sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// How it is reached.
    pub adaptor: SensorAdaptor,
    /// Where it is, behind `gocator`.
    pub gocator: gocator::Settings,
}

/// How the sensor is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorAdaptor {
    /// Simulated, inside this process.
    Simulated,
    /// A Gocator on the network.
    Gocator,
    /// There is none; scans come as files.
    None,
}

impl Manipulator {
    /// The simulated one, with its default.
    pub(super) fn of(carrier: Carrier) -> Self {
        let (x, base) = match carrier {
            Carrier::M1 => (150.0, 0),
            Carrier::M2 => (650.0, MODBUS_STRIDE),
        };
        Self {
            adaptor: ManipulatorAdaptor::Simulated,
            mount_mm: [x, 0.0, 0.0],
            half_span_mm: 100.0,
            limits: SupportLimits::default(),
            modbus: modbus::Settings { base, ..modbus::Settings::default() },
            #[cfg(feature = "opcua")]
            opcua: opcua::Settings::of(carrier.name()),
        }
    }
}

impl Cell {
    /// Files of devices on this machine are below the data folder of the service, unless configured otherwise.
    #[cfg_attr(
        not(feature = "opcua"),
        expect(unused_variables, clippy::unused_self, reason = "no device keeps anything")
    )]
    pub(in crate::config) fn keep_below(&mut self, data: &Path) {
        #[cfg(feature = "opcua")]
        for manipulator in [&mut self.manipulators.m1, &mut self.manipulators.m2] {
            manipulator.opcua.security.keep_below(data);
        }
    }
}

impl Default for Stage {
    fn default() -> Self {
        let modbus = modbus::Settings { base: 2 * MODBUS_STRIDE, ..modbus::Settings::default() };
        Self { adaptor: StageAdaptor::Simulated, modbus }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        Self { adaptor: SensorAdaptor::Simulated, gocator: gocator::Settings::default() }
    }
}

/// How far the four axes of a manipulator may go.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportLimits {
    /// Along the rail.
    pub x: LinearLimits,
    /// Across.
    pub y: LinearLimits,
    /// Up.
    pub z: LinearLimits,
    /// The turn.
    pub c: TurnLimits,
}

/// What a linear axis may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearLimits {
    /// Least value.
    pub lower_mm: f64,
    /// Greatest value.
    pub upper_mm: f64,
    /// Longest way of one request.
    pub step_mm: f64,
    /// Greatest speed.
    pub speed_mm_s: f64,
    /// Greatest acceleration.
    pub acceleration_mm_s2: f64,
    /// Greatest jerk.
    pub jerk_mm_s3: f64,
}

/// What a turning axis may do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurnLimits {
    /// Least value.
    pub lower_deg: f64,
    /// Greatest value.
    pub upper_deg: f64,
    /// Longest way of one request.
    pub step_deg: f64,
    /// Greatest speed.
    pub speed_deg_s: f64,
    /// Greatest acceleration.
    pub acceleration_deg_s2: f64,
    /// Greatest jerk.
    pub jerk_deg_s3: f64,
}

/// How close to its target an axis counts as there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerances {
    /// Along the rail.
    pub x_mm: f64,
    /// Across.
    pub y_mm: f64,
    /// Up.
    pub z_mm: f64,
    /// The turn.
    pub c_deg: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self { x_mm: 0.1, y_mm: 0.1, z_mm: 0.1, c_deg: 0.05 }
    }
}

impl Default for SupportLimits {
    fn default() -> Self {
        let linear = |reach: f64| LinearLimits {
            lower_mm: -reach,
            upper_mm: reach,
            step_mm: reach,
            speed_mm_s: 20.0,
            acceleration_mm_s2: 100.0,
            jerk_mm_s3: 1_000.0,
        };
        let c = TurnLimits {
            lower_deg: -30.0,
            upper_deg: 30.0,
            step_deg: 15.0,
            speed_deg_s: 5.0,
            acceleration_deg_s2: 25.0,
            jerk_deg_s3: 250.0,
        };
        Self { x: linear(50.0), y: linear(25.0), z: linear(25.0), c }
    }
}

/// Sections that know their own defaults, and are taken as they stand.
const WHOLE: [&str; 4] = ["modbus", "opcua", "gocator", "simulated"];

/// The default that differs between devices even there.
const BASE: &str = "base";

/// The cell that results.
pub(in crate::config) fn over_default<'de, D: Deserializer<'de>>(text: D) -> Result<Cell, D::Error> {
    let said = Table::deserialize(text)?;
    let mut table = Table::try_from(Cell::default()).map_err(Error::custom)?;
    lay_over(&mut table, said);
    Cell::deserialize(table).map_err(|error| Error::custom(error.to_string().trim_end()))
}

fn lay_over(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(under)), Value::Table(mut over)) if WHOLE.contains(&key.as_str()) => {
                if let Some(base) = under.remove(BASE) {
                    over.entry(BASE).or_insert(base);
                }
                *under = over;
            }
            (Some(Value::Table(under)), Value::Table(over)) => lay_over(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}
