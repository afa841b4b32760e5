//! Which adaptor stands behind each device, and where it finds it.

use super::Cell;
use super::supports::SupportLimits;
use crate::device::gocator;
use crate::device::modbus;
#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::motion::Carrier;
use serde::{Deserialize, Serialize};
use std::path::Path;

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
    /// How far its axes may go; the device has limits of its own, and the narrower ones hold.
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
    /// A made one, inside this process.
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
    /// A made one, inside this process.
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
    /// A made one, inside this process.
    Simulated,
    /// A Gocator on the network.
    Gocator,
    /// There is none; scans come as files.
    None,
}

impl Manipulator {
    /// A made one, as it stands by default.
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
    /// What devices keep on this machine lies below the service's data folder where nothing else is said.
    #[cfg_attr(
        not(feature = "opcua"),
        expect(unused_variables, clippy::unused_self, reason = "no device keeps anything")
    )]
    pub(in super::super) fn keep_below(&mut self, data: &Path) {
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
