//! The adaptors of a manipulator and of the linear stage behind a PLC that speaks Modbus TCP. The stage is a block of the same map,
//! of which only axis x is used; its trait does not report the result of a command, so the adaptor waits until the device has
//! received each command.

use std::time::Duration;

use tokio::time::sleep;

use crate::device::error::{DeviceError, Pending};
use crate::device::manipulator::{Action, AxisReading, AxisState, Command, CommandResult, Manipulator, Reading};
use crate::device::sensor::{Stage, StageReading};
use crate::device::sequence::{FenceGate, is_newer, next};
use crate::motion::{Axes, Axis};

use super::error::MapError;
use super::link::Block;
use super::status::{Head, StatusRegisters};
use crate::device::clock::now;

/// The adaptor of a manipulator.
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

/// Interval between two readings while waiting for the device to receive a command, about the cycle of a PLC.
const LOOK: Duration = Duration::from_millis(5);

/// The adaptor of the stage.
pub struct ModbusStage {
    block: Block,
    gate: FenceGate,
    watchdog: Duration,
    seen_within: Duration,
    /// The newest sequence number that was sent, or that the device had received before this adaptor connected.
    sequence: u16,
    /// Whether the stage is disabled, by the newest reading.
    disabled: bool,
}

/// The status of a stage with the result of the newest command.
type Status = (Head, AxisReading);

impl ModbusStage {
    pub(super) fn new(block: Block, watchdog: Duration, seen_within: Duration) -> Self {
        Self { block, gate: FenceGate::default(), watchdog, seen_within, sequence: 0, disabled: false }
    }

    async fn command(&mut self, fence: u64, action: Action) -> Result<(), DeviceError> {
        self.gate.admit(self.block.name(), fence)?;
        // The number counts as used even if the command is not sent, because no two commands may have the same number.
        self.sequence = next(self.sequence);
        let command = Command { sequence: self.sequence, fence, watchdog: self.watchdog, action };
        self.block.command(&command).await?;
        let deadline = now() + self.seen_within;
        while now() < deadline {
            let (head, _) = self.block.read(status).await?;
            match head.acknowledged {
                seen if seen.sequence != command.sequence => sleep(LOOK).await,
                seen if seen.result == CommandResult::Rejected => {
                    return Err(DeviceError::Rejected { device: self.block.name().to_owned(), code: head.fault_code });
                }
                _ => return Ok(()),
            }
        }
        Err(DeviceError::Silent { device: self.block.name().to_owned(), within: self.seen_within })
    }

    fn follow(&mut self, (head, axis): Status) -> StageReading {
        let seen = head.acknowledged.sequence;
        if is_newer(seen, self.sequence) {
            self.sequence = seen;
        }
        self.disabled = head.state == AxisState::Disabled;
        StageReading {
            actual_mm: axis.actual,
            lower_mm: axis.lower,
            upper_mm: axis.upper,
            speed_mm_s: axis.speed,
            moves: head.state.moves() || axis.state.moves(),
            in_position: axis.in_position,
            fault_code: head.fault_code,
        }
    }
}

impl Stage for ModbusStage {
    fn name(&self) -> &str {
        self.block.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<StageReading, DeviceError>> {
        Box::pin(async move {
            let status = self.block.connect(status).await?;
            Ok(self.follow(status))
        })
    }

    fn read(&mut self) -> Pending<'_, Result<StageReading, DeviceError>> {
        Box::pin(async move {
            let status = self.block.read(status).await?;
            Ok(self.follow(status))
        })
    }

    fn move_to(&mut self, fence: u64, target_mm: f64, speed_mm_s: f64) -> Pending<'_, Result<(), DeviceError>> {
        let only_x = |x| Axes { x, ..Axes::default() };
        let axes = Axes { x: true, ..Axes::default() };
        Box::pin(async move {
            // The stage trait has no command for this: a client that may move the stage may also enable its drive.
            if self.disabled {
                self.command(fence, Action::Enable).await?;
                self.disabled = false;
            }
            self.command(fence, Action::MoveTo { axes, targets: only_x(target_mm), speeds: only_x(speed_mm_s) }).await
        })
    }

    fn halt(&mut self) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(self.command(self.gate.newest(), Action::Halt))
    }
}

fn status(registers: StatusRegisters<'_>) -> Result<Status, MapError> {
    Ok((registers.head()?, registers.axis(Axis::X)?))
}
