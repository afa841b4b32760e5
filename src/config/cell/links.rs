//! Where each device of the cell is reached: whether real and simulated ones are told apart, and no machine has two names.

use super::Cell;
use super::check::key_of;
use super::devices::{ManipulatorAdaptor, SensorAdaptor, StageAdaptor};
use super::error::CellError;
use crate::device::modbus;
use crate::motion::Carrier;

/// Where a device is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Link<'a> {
    Simulated,
    Modbus {
        address: &'a str,
        unit_id: u8,
        base: u16,
    },
    #[cfg(feature = "opcua")]
    Opcua {
        endpoint: &'a str,
        device: &'a str,
    },
    /// Where no second one can be.
    Other,
}

impl<'a> Link<'a> {
    fn modbus(settings: &'a modbus::Settings) -> Self {
        Self::Modbus { address: &settings.address, unit_id: settings.unit_id, base: settings.base }
    }

    /// What tells two devices of this kind apart.
    const fn what(self) -> Option<&'static str> {
        match self {
            Self::Simulated | Self::Other => None,
            Self::Modbus { .. } => Some("modbus.address, modbus.unit_id or modbus.base"),
            #[cfg(feature = "opcua")]
            Self::Opcua { .. } => Some("opcua.endpoint or opcua.device"),
        }
    }
}

impl Cell {
    /// Whether simulated and real devices are told apart, and no machine has two names.
    pub(super) fn check_devices(&self) -> Result<(), CellError> {
        let simulated = self.devices().into_iter().filter(|(_, link)| *link == Link::Simulated);
        let simulated: Vec<&str> = simulated.map(|(key, _)| key).collect();
        let real = self.devices().into_iter().filter(|(_, link)| *link != Link::Simulated);
        let real: Vec<&str> = real.map(|(key, _)| key).collect();
        if !self.simulated_beside_real && !simulated.is_empty() && !real.is_empty() {
            return Err(CellError::Mixed { simulated: simulated.join(", "), real: real.join(", ") });
        }
        let devices = self.devices();
        for (place, (first, link)) in devices.iter().enumerate() {
            let same = devices.iter().skip(place + 1).find(|(_, other)| other == link && link.what().is_some());
            if let (Some((second, _)), Some(what)) = (same, link.what()) {
                return Err(CellError::SameDevice { first, second, what });
            }
        }
        Ok(())
    }

    /// Every device that there is, with where it is reached.
    fn devices(&self) -> Vec<(&'static str, Link<'_>)> {
        let manipulators = Carrier::ALL.map(|carrier| {
            let manipulator = self.manipulators.get(carrier);
            let link = match manipulator.adaptor {
                ManipulatorAdaptor::Simulated => Link::Simulated,
                ManipulatorAdaptor::Modbus => Link::modbus(&manipulator.modbus),
                #[cfg(feature = "opcua")]
                ManipulatorAdaptor::Opcua => {
                    Link::Opcua { endpoint: &manipulator.opcua.endpoint, device: &manipulator.opcua.device }
                }
                #[cfg(not(feature = "opcua"))]
                ManipulatorAdaptor::Opcua => Link::Other,
            };
            (key_of(carrier), link)
        });
        let stage = match self.stage.adaptor {
            StageAdaptor::Simulated => Some(Link::Simulated),
            StageAdaptor::Modbus => Some(Link::modbus(&self.stage.modbus)),
            StageAdaptor::None => None,
        };
        let sensor = match self.sensor.adaptor {
            SensorAdaptor::Simulated => Some(Link::Simulated),
            SensorAdaptor::Gocator => Some(Link::Other),
            SensorAdaptor::None => None,
        };
        let others = [stage.map(|link| ("stage", link)), sensor.map(|link| ("sensor", link))];
        manipulators.into_iter().chain(others.into_iter().flatten()).collect()
    }
}
