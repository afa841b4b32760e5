//! The driver of the stage, with the rules of a manipulator. The stage acknowledges no commands, so a lost answer means a lost
//! link.

use super::context::{Answer, DriverContext};
use super::device_driver::{DeviceDriver, DriverTask, FirstReading};
use super::messages::{DeviceReading, DriverOrder, Outcome, SessionEnd, StageCommand};
use crate::cell::failure::Failure;
use crate::device::Pending;
use crate::device::Stage;
use tokio::sync::mpsc;

/// The driver of the stage.
pub(in crate::cell) struct StageDriver {
    device: Box<dyn Stage>,
    /// A halt after which it has not been read at rest yet.
    halting: Option<u64>,
    /// Whether it moves, by the last reading.
    moves: bool,
}

impl StageDriver {
    /// The task of the driver.
    pub(in crate::cell) const fn task(
        device: Box<dyn Stage>,
        context: DriverContext,
        orders: mpsc::Receiver<DriverOrder<StageCommand>>,
    ) -> DriverTask<Self> {
        DriverTask::new(Self { device, halting: None, moves: false }, context, orders)
    }
}

impl DeviceDriver for StageDriver {
    type Command = StageCommand;

    fn connect(&mut self) -> Pending<'_, Answer<FirstReading>> {
        Box::pin(async move { Ok((DeviceReading::Stage(self.device.connect().await?), None)) })
    }

    async fn read(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let reading = context.ask(self.device.read()).await?.map_err(SessionEnd::Lost)?;
        let rested = self.halting.take_if(|_| !reading.moves);
        self.moves = reading.moves;
        context.report_reading(DeviceReading::Stage(reading), reading.moves).await;
        if let Some(number) = rested {
            context.rested(number).await;
        }
        Ok(())
    }

    async fn halt(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let number = context.halts().number;
        let answer = context.ask_for_halt(self.device.halt()).await?;
        let refusal = answer.clone().err();
        if context.halted(number, answer).await? {
            self.halting = Some(number);
        }
        self.read(context).await?;
        match refusal.filter(|_| self.moves) {
            // Further readings would keep the motion alive; without them the watchdog stops the stage.
            Some(refusal) => Err(SessionEnd::Lost(refusal)),
            None => Ok(()),
        }
    }

    async fn obey(&mut self, context: &mut DriverContext, order: DriverOrder<StageCommand>) -> Result<(), SessionEnd> {
        let DriverOrder { number, fence, command, .. } = order;
        let StageCommand::MoveTo { target_mm, speed_mm_s } = command else { return self.read(context).await };
        let answer = context.ask(self.device.move_to(fence, target_mm, speed_mm_s)).await;
        let (outcome, gone) = match answer {
            Ok(Ok(())) => (Outcome::Taken { sequence: 0 }, None),
            Ok(Err(error)) if !error.leaves_unknown() => (Outcome::Refused(error), None),
            Ok(Err(error)) | Err(SessionEnd::Lost(error)) => {
                (Outcome::Unknown(Failure::Device(error.clone())), Some(SessionEnd::Lost(error)))
            }
            // The command may have been sent.
            Err(gone @ (SessionEnd::Cut | SessionEnd::Closed)) => (Outcome::Cut, Some(gone)),
        };
        context.report_outcome(number, outcome).await;
        match gone {
            Some(gone) => Err(gone),
            None if context.halt_is_due() => Ok(()),
            None => self.read(context).await,
        }
    }
}
