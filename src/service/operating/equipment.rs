//! Creates the devices of the configuration: the only file that knows every adaptor. It connects to no device.

use crate::cell::Devices;
use crate::config::{Cell as CellConfig, Manipulator, ManipulatorAdaptor, SensorAdaptor, StageAdaptor};
#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::device::simulated::{SettingError, World};
use crate::device::{self, ProfileSensor, Stage, gocator, modbus};
use crate::motion::{Carrier, Pair};

/// The components of a cell.
pub struct Equipment {
    /// The devices.
    pub devices: Devices,
    /// Their configuration.
    pub config: CellConfig,
    /// The simulated world of the simulated devices; `None` if there are none.
    pub world: Option<World>,
}

/// Why a device cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum EquipmentError {
    /// The simulation is invalid.
    #[error("cell.simulated.{0}")]
    Simulated(#[from] SettingError),
    /// A device connected by Modbus is invalid.
    #[error("cell.{key}.{cause}")]
    Modbus {
        /// Its key below `cell`.
        key: &'static str,
        /// The reason.
        cause: modbus::SettingsError,
    },
    /// A device connected by OPC UA is invalid.
    #[cfg(feature = "opcua")]
    #[error("cell.{key}.opcua.{cause}")]
    Opcua {
        /// Its key below `cell`.
        key: &'static str,
        /// The reason.
        cause: opcua::SettingRefusal,
    },
    /// The sensor is invalid.
    #[error("cell.sensor.gocator: {0}")]
    Gocator(#[from] gocator::SettingsError),
    /// This program was built without the adaptor.
    #[error("cell.{key}.adaptor: this program was built without it")]
    NotBuilt {
        /// Its key below `cell`.
        key: &'static str,
    },
}

impl Equipment {
    /// The devices of a configuration; `None` if the cell is not enabled.
    ///
    /// # Errors
    /// [`EquipmentError`] names the device that cannot be created.
    pub fn of(config: &CellConfig) -> Result<Option<Self>, EquipmentError> {
        if !config.enabled {
            return Ok(None);
        }
        let world = if simulates(config) { Some(World::new(&config.simulated, &config.mountings())?) } else { None };
        let manipulators = Pair {
            m1: manipulator(Carrier::M1, config, world.as_ref())?,
            m2: manipulator(Carrier::M2, config, world.as_ref())?,
        };
        let devices =
            Devices { manipulators, sensor: sensor(config, world.as_ref())?, stage: stage(config, world.as_ref())? };
        Ok(Some(Self { devices, config: config.clone(), world }))
    }
}

fn simulates(config: &CellConfig) -> bool {
    config.manipulators.iter().any(|(_, one)| one.adaptor == ManipulatorAdaptor::Simulated)
        || config.stage.adaptor == StageAdaptor::Simulated
        || config.sensor.adaptor == SensorAdaptor::Simulated
}

fn manipulator(
    carrier: Carrier,
    config: &CellConfig,
    world: Option<&World>,
) -> Result<Box<dyn device::Manipulator>, EquipmentError> {
    let key = match carrier {
        Carrier::M1 => "manipulators.m1",
        Carrier::M2 => "manipulators.m2",
    };
    let settings: &Manipulator = config.manipulators.get(carrier);
    match (settings.adaptor, world) {
        (ManipulatorAdaptor::Simulated, Some(world)) => Ok(Box::new(world.manipulator(carrier))),
        (ManipulatorAdaptor::Simulated, None) => Err(EquipmentError::NotBuilt { key }),
        (ManipulatorAdaptor::Modbus, _) => {
            modbus::open(carrier.name(), &settings.modbus).map_err(|cause| EquipmentError::Modbus { key, cause })
        }
        #[cfg(feature = "opcua")]
        (ManipulatorAdaptor::Opcua, _) => {
            opcua::open(carrier.name(), &settings.opcua).map_err(|cause| EquipmentError::Opcua { key, cause })
        }
        #[cfg(not(feature = "opcua"))]
        (ManipulatorAdaptor::Opcua, _) => Err(EquipmentError::NotBuilt { key }),
    }
}

fn stage(config: &CellConfig, world: Option<&World>) -> Result<Option<Box<dyn Stage>>, EquipmentError> {
    match config.stage.adaptor {
        StageAdaptor::Simulated => Ok(world.map(|world| Box::new(world.stage()) as Box<dyn Stage>)),
        StageAdaptor::Modbus => {
            let opened = modbus::open_stage("stage", &config.stage.modbus);
            opened.map(Some).map_err(|cause| EquipmentError::Modbus { key: "stage", cause })
        }
        StageAdaptor::None => Ok(None),
    }
}

fn sensor(config: &CellConfig, world: Option<&World>) -> Result<Option<Box<dyn ProfileSensor>>, EquipmentError> {
    match config.sensor.adaptor {
        SensorAdaptor::Simulated => Ok(world.map(|world| Box::new(world.sensor()) as Box<dyn ProfileSensor>)),
        SensorAdaptor::Gocator => Ok(Some(gocator::open("sensor", &config.sensor.gocator)?)),
        SensorAdaptor::None => Ok(None),
    }
}
