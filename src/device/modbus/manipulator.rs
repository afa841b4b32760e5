//! A manipulator behind a PLC that speaks Modbus TCP. In: commands; out: readings.

use super::block::Block;
use crate::device::Pending;
use crate::device::error::DeviceError;
use crate::device::fence::FenceGate;
use crate::device::manipulator::{Command, Manipulator, Reading};

/// A manipulator's adaptor.
pub struct ModbusManipulator {
    block: Block,
    gate: FenceGate,
}

impl ModbusManipulator {
    pub(super) fn new(block: Block) -> Self {
        Self { block, gate: FenceGate::default() }
    }
}

impl Manipulator for ModbusManipulator {
    fn name(&self) -> &str {
        self.block.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(self.block.connect(|status| status.reading()))
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(self.block.read(|status| status.reading()))
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        let command = command.clone();
        Box::pin(async move {
            self.gate.admit(self.block.name(), command.fence)?;
            self.block.command(&command).await
        })
    }
}
