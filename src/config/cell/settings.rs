//! The settings of the cell with their defaults: the lease, times, common limits of the two manipulators, the scan, and for each
//! device its adaptor and limits. A configuration gives only the keys that differ from the defaults: it is merged into them key by
//! key, also where the defaults of the two manipulators differ.

use std::path::Path;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use toml::{Table, Value};

#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::device::{gocator, modbus, simulated};
use crate::motion::{Carrier, Pair};

/// The devices that scan and move the part, and their limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cell {
    /// Whether there is a cell. Without one the service measures uploaded scans, and nothing moves.
    pub enabled: bool,
    /// Whether simulated devices may be used together with real ones. A simulated sensor does not see the real part, so that a plan
    /// made from it would move that part arbitrarily; only for trying adaptors.
    pub simulated_beside_real: bool,
    /// Longest time between a measurement and the execution of a plan made from it.
    pub plan_age_max_s: u64,
    /// The time to live of a lease.
    pub lease: Lease,
    /// Polling periods and deadlines.
    pub timing: Timing,
    /// Common limits of the two manipulators.
    pub together: Together,
    /// The scan of a measurement whose request specifies none.
    pub scan: ScanPath,
    /// The two manipulators.
    pub manipulators: Pair<Manipulator>,
    /// The stage that moves the sensor along the rail.
    pub stage: Stage,
    /// The profile sensor.
    pub sensor: Sensor,
    /// The simulation behind all simulated devices.
    pub simulated: simulated::Settings,
}

/// The time to live of a lease.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lease {
    /// Default time to live of a lease.
    pub ttl_ms: u64,
    /// Shortest time to live that a client may request.
    pub ttl_min_ms: u64,
    /// Longest time to live that a client may request.
    pub ttl_max_ms: u64,
}

/// Polling periods and deadlines of the devices. The ranges ensure that a moving device stops within half a second of the last
/// valid answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Timing {
    /// Polling period of a device at rest.
    pub poll_ms: u64,
    /// Polling period of a moving device.
    pub poll_moving_ms: u64,
    /// Longest time for a device's answer.
    pub reply_ms: u64,
    /// Longest time for connecting and the first reading.
    pub connect_ms: u64,
    /// Longest time until a device has acknowledged a command.
    pub acknowledge_ms: u64,
    /// How long a device continues to move without a heartbeat from coaxis.
    pub watchdog_ms: u64,
    /// Time added to the planned time of a motion before its axes count as not arrived.
    pub arrival_ms: u64,
    /// Longest time without a profile during a scan.
    pub scan_stall_ms: u64,
}

/// Common limits of the two manipulators.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Together {
    /// Largest change of the distance between the two clamps along a path, which strains the part and the clamps.
    pub strain_max_mm: f64,
    /// Largest travel of a clamp after an axis of either manipulator has stopped unexpectedly. It limits the speed of every path.
    pub run_on_max_mm: f64,
    /// Largest difference of the two rotations along a path.
    pub twist_max_deg: f64,
    /// Smallest gap between the two manipulators along the rail.
    pub clearance_min_mm: f64,
    /// Distance from its target within which an axis has arrived; not less than the backlash.
    pub tolerance: Tolerances,
}

/// The path of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanPath {
    /// Start, along the rail.
    pub x_from_mm: f64,
    /// End, along the rail.
    pub x_to_mm: f64,
    /// Number of profiles, including those at both ends.
    pub profiles_count: u64,
    /// Speed of the stage.
    pub speed_mm_s: f64,
    /// Greatest distance of the first and the last profile from the start and the end of the scan. It compares the stage with a
    /// sensor that determines x by itself.
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

/// Number of registers from one manipulator of a PLC to the next.
const MODBUS_STRIDE: u16 = 256;

/// A manipulator: its position and its adaptor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manipulator {
    /// Its adaptor.
    pub adaptor: ManipulatorAdaptor,
    /// Position of the clamp's centre in the rail frame when all axes are at zero: x, y, z.
    pub mount_mm: [f64; 3],
    /// Extent of its body along the rail on each side of the clamp.
    pub half_span_mm: f64,
    /// The limits of its axes. The device has limits of its own; the narrower ones apply.
    pub limits: SupportLimits,
    /// Settings of the adaptor `modbus`.
    pub modbus: modbus::Settings,
    /// Settings of the adaptor `opcua`.
    #[cfg(feature = "opcua")]
    pub opcua: opcua::Settings,
}

/// The adaptor of a manipulator.
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
    /// Its adaptor.
    pub adaptor: StageAdaptor,
    /// Settings of the adaptor `modbus`.
    pub modbus: modbus::Settings,
}

/// The adaptor of the stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StageAdaptor {
    /// Simulated, inside this process.
    Simulated,
    /// A PLC with a register map.
    Modbus,
    /// There is no stage that coaxis commands.
    None,
}

/// The profile sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its adaptor.
    pub adaptor: SensorAdaptor,
    /// Settings of the adaptor `gocator`.
    pub gocator: gocator::Settings,
}

/// The adaptor of the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorAdaptor {
    /// Simulated, inside this process.
    Simulated,
    /// A Gocator on the network.
    Gocator,
    /// There is no sensor; scans are uploaded as files.
    None,
}

impl Manipulator {
    /// The default settings of this manipulator.
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
    /// Places the local files of devices below the data folder of the service, unless configured otherwise.
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

/// The limits of the four axes of a manipulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportLimits {
    /// Along the rail.
    pub x: LinearLimits,
    /// Across the rail, horizontal.
    pub y: LinearLimits,
    /// Vertical.
    pub z: LinearLimits,
    /// The rotation.
    pub c: TurnLimits,
}

/// The limits of a linear axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinearLimits {
    /// Lower limit.
    pub lower_mm: f64,
    /// Upper limit.
    pub upper_mm: f64,
    /// Longest travel in one request.
    pub step_mm: f64,
    /// Greatest speed.
    pub speed_mm_s: f64,
    /// Greatest acceleration.
    pub acceleration_mm_s2: f64,
    /// Greatest jerk.
    pub jerk_mm_s3: f64,
}

/// The limits of the rotary axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurnLimits {
    /// Lower limit.
    pub lower_deg: f64,
    /// Upper limit.
    pub upper_deg: f64,
    /// Largest rotation in one request.
    pub step_deg: f64,
    /// Greatest speed.
    pub speed_deg_s: f64,
    /// Greatest acceleration.
    pub acceleration_deg_s2: f64,
    /// Greatest jerk.
    pub jerk_deg_s3: f64,
}

/// Distance from its target within which an axis has arrived.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerances {
    /// Along the rail.
    pub x_mm: f64,
    /// Across the rail, horizontal.
    pub y_mm: f64,
    /// Vertical.
    pub z_mm: f64,
    /// The rotation.
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

/// Sections that have their own defaults and therefore replace the default section instead of being merged into it.
const WHOLE: [&str; 4] = ["modbus", "opcua", "gocator", "simulated"];

/// The key whose default differs between devices even in these sections.
const BASE: &str = "base";

/// Merges the configured values into the defaults.
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
