//! The adaptor of a made manipulator.

use super::faults::Device;
use super::link::Link;
use crate::device::Pending;
use crate::device::error::DeviceError;
use crate::device::fence::FenceGate;
use crate::device::manipulator::{Command, Manipulator, Reading};
use crate::motion::Carrier;

/// A made manipulator behind its link.
#[derive(Debug)]
pub struct SimulatedManipulator {
    carrier: Carrier,
    link: Link,
    gate: FenceGate,
}

impl SimulatedManipulator {
    pub(super) fn new(carrier: Carrier, link: Link) -> Self {
        Self { carrier, link, gate: FenceGate::default() }
    }

    /// Which device of the simulated cell it is.
    #[must_use]
    pub const fn device(&self) -> Device {
        Device::Manipulator(self.carrier)
    }
}

impl Manipulator for SimulatedManipulator {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            self.link.open().await?;
            let carrier = self.carrier;
            // No heartbeat: what still moves when we come back stops, unless somebody takes charge of it.
            self.link.ask(move |cell, now| cell.controllers.get_mut(carrier).reading(now)).await
        })
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        let carrier = self.carrier;
        Box::pin(self.link.ask(move |cell, now| {
            let controller = cell.controllers.get_mut(carrier);
            controller.beat(now);
            controller.reading(now)
        }))
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        let (carrier, command) = (self.carrier, command.clone());
        Box::pin(async move {
            self.gate.admit(self.link.name(), command.fence)?;
            self.link.ask(move |cell, now| cell.controllers.get_mut(carrier).take(&command, now)).await?;
            Ok(())
        })
    }
}
