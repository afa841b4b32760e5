//! The driver of a manipulator. Every command is sent once; if its answer is lost, the acknowledgement in the next reading decides.

use super::context::{Answer, DriverContext};
use super::device_driver::{DeviceDriver, DriverTask, FirstReading};
use super::messages::{DeviceReading, DriverEvent, DriverOrder, ManipulatorCommand, Outcome, SessionEnd};
use crate::cell::failure::Failure;
use crate::device::clock::now;
use crate::device::sequence::{is_newer, next};
use crate::device::{Action, AxisState, Command, CommandResult, DeviceError, Manipulator, Mode, Pending, Reading};
use crate::motion::Carrier;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// A command that has not been acknowledged yet.
#[derive(Debug, Clone, Copy)]
struct Awaited {
    order: u64,
    sequence: u16,
    until: Instant,
}

/// A halt after which the device has not been read at rest yet.
#[derive(Debug, Clone, Copy)]
struct Halting {
    number: u64,
    sequence: u16,
    /// If the halt is not acknowledged by this time, it has not arrived.
    until: Instant,
}

/// The driver of a manipulator.
pub(in crate::cell) struct ManipulatorDriver {
    carrier: Carrier,
    device: Box<dyn Manipulator>,
    /// Sequence number of the newest command from any client; 0 before the first.
    sequence: u16,
    awaited: Option<Awaited>,
    halting: Option<Halting>,
    /// A command whose link was lost before its acknowledgement.
    in_doubt: Option<u16>,
    /// Whether it moves and accepts commands of coaxis, by the last reading.
    moves: bool,
    /// Whether it is stopping, by the last reading.
    stops: bool,
    /// Sequence number that it has acknowledged, by the last reading.
    acknowledged: u16,
}

impl ManipulatorDriver {
    /// The task of the driver.
    pub(in crate::cell) const fn task(
        carrier: Carrier,
        device: Box<dyn Manipulator>,
        context: DriverContext,
        orders: mpsc::Receiver<DriverOrder<ManipulatorCommand>>,
    ) -> DriverTask<Self> {
        let driver = Self {
            carrier,
            device,
            sequence: 0,
            awaited: None,
            halting: None,
            in_doubt: None,
            moves: false,
            stops: false,
            acknowledged: 0,
        };
        DriverTask::new(driver, context, orders)
    }
}

impl DeviceDriver for ManipulatorDriver {
    type Command = ManipulatorCommand;

    fn connect(&mut self) -> Pending<'_, Answer<FirstReading>> {
        Box::pin(async move {
            let reading = self.device.connect().await?;
            self.follow(&reading);
            let seen = reading.acknowledged.sequence;
            let resolved = |sequence| DriverEvent::Resolved { sequence, taken: seen == sequence };
            Ok((DeviceReading::Manipulator(reading), self.in_doubt.take().map(resolved)))
        })
    }

    async fn read(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let reading = context.ask(self.device.read()).await?.map_err(SessionEnd::Lost)?;
        let overtaken = is_newer(reading.acknowledged.sequence, self.sequence);
        self.follow(&reading);
        self.moves = reading.moves() && listens(&reading);
        self.stops = reading.state == AxisState::Stopping;
        self.acknowledged = reading.acknowledged.sequence;
        let outcome = self.awaited.and_then(|awaited| self.outcome_of(context, awaited, &reading));
        let rested = self.halting.filter(|halting| rests(halting, &reading));
        if rested.is_some() {
            self.halting = None;
        }
        if outcome.is_some() {
            self.awaited = None;
        }
        // The reading is reported before its consequences, so that the outcome is not judged by an older reading.
        let busy = self.awaited.is_some() || self.halting.is_some() || reading.moves();
        context.report_reading(DeviceReading::Manipulator(reading), busy).await;
        if let Some(Halting { number, .. }) = rested {
            context.rested(number).await;
        }
        if let Some((order, outcome)) = outcome {
            context.report_outcome(order, outcome).await;
        }
        self.check_halt(context, overtaken)
    }

    async fn halt(&mut self, context: &mut DriverContext) -> Result<(), SessionEnd> {
        let halts = context.halts();
        self.leave(context, None).await;
        // From here on the device acknowledges only the halt.
        self.in_doubt = None;
        let command = self.command(context, halts.fence, Action::Halt);
        let answer = context.ask_for_halt(self.device.send(&command)).await?;
        let refusal = answer.clone().err();
        self.halting = None;
        if context.halted(halts.number, answer).await? {
            let until = now() + context.timing.acknowledge;
            self.halting = Some(Halting { number: halts.number, sequence: command.sequence, until });
        }
        self.read(context).await?;
        match refusal.filter(|_| self.moves) {
            // Further readings would keep the motion alive; without them the watchdog stops the device.
            Some(refusal) => Err(SessionEnd::Lost(refusal)),
            None => Ok(()),
        }
    }

    /// Sends a command once. If only its answer is lost, the acknowledgement of the device decides.
    async fn obey(
        &mut self,
        context: &mut DriverContext,
        order: DriverOrder<ManipulatorCommand>,
    ) -> Result<(), SessionEnd> {
        let ManipulatorCommand::Send(action) = order.command else { return self.read(context).await };
        let command = self.command(context, order.fence, action);
        let until = now() + context.timing.acknowledge;
        self.awaited = Some(Awaited { order: order.number, sequence: command.sequence, until });
        match context.ask(self.device.send(&command)).await? {
            Err(error @ DeviceError::LinkLost { .. }) => Err(SessionEnd::Lost(error)),
            Err(error) if !error.leaves_unknown() => {
                self.awaited = None;
                context.report_outcome(order.number, Outcome::Refused(error)).await;
                Ok(())
            }
            Ok(()) | Err(_) if context.halt_is_due() => Ok(()),
            Ok(()) | Err(_) => self.read(context).await,
        }
    }

    fn is_free(&self) -> bool {
        self.awaited.is_none()
    }

    async fn leave(&mut self, context: &mut DriverContext, error: Option<&DeviceError>) {
        let Some(Awaited { order, sequence, .. }) = self.awaited.take() else { return };
        self.in_doubt = Some(sequence);
        let failure = error.cloned().map(Failure::Device);
        context.report_outcome(order, failure.map_or(Outcome::Cut, Outcome::Unknown)).await;
    }
}

impl ManipulatorDriver {
    /// Sends a halt again if a command of another client came after it. If the device moves and does not acknowledge the halt in
    /// time, the link is closed: readings would keep the motion alive, and without them the watchdog stops the device.
    fn check_halt(&mut self, context: &mut DriverContext, overtaken: bool) -> Result<(), SessionEnd> {
        let Some(Halting { sequence, until, .. }) = self.halting else { return Ok(()) };
        let late = self.moves && now() >= until;
        // The device acknowledges, but does not execute, a sequence number that it has already received from another client.
        if overtaken || (late && !self.stops) {
            context.halt_again();
        }
        let unheard = late && self.acknowledged != sequence;
        if unheard { Err(SessionEnd::Lost(context.unheard())) } else { Ok(()) }
    }

    /// Continues from the sequence number of the device if another client has commanded it, because the device would ignore any
    /// command with an older number, including a halt.
    const fn follow(&mut self, reading: &Reading) {
        if is_newer(reading.acknowledged.sequence, self.sequence) {
            self.sequence = reading.acknowledged.sequence;
        }
    }

    const fn command(&mut self, context: &DriverContext, fence: u64, action: Action) -> Command {
        self.sequence = next(self.sequence);
        Command { sequence: self.sequence, fence, watchdog: context.timing.watchdog, action }
    }

    /// The outcome of the command that has not been acknowledged yet; `None` while it may still be acknowledged.
    fn outcome_of(&self, context: &DriverContext, awaited: Awaited, reading: &Reading) -> Option<(u64, Outcome)> {
        let (Awaited { order, sequence, until }, carrier) = (awaited, self.carrier);
        let acknowledged = reading.acknowledged;
        let outcome = if acknowledged.sequence == sequence {
            match acknowledged.result {
                CommandResult::Rejected => {
                    Outcome::Refused(DeviceError::Rejected { device: context.name.clone(), code: reading.fault_code })
                }
                CommandResult::Aborted => Outcome::Unknown(Failure::Aborted { carrier, sequence }),
                CommandResult::None | CommandResult::Accepted | CommandResult::Running | CommandResult::Done => {
                    Outcome::Taken { sequence }
                }
            }
        } else if now() >= until {
            Outcome::Unknown(Failure::NotAcknowledged { carrier, sequence, within: context.timing.acknowledge })
        } else {
            return None;
        };
        Some((order, outcome))
    }
}

/// Whether the device is at rest after a halt: no axis moves, and it has acknowledged the halt or does not accept our commands.
fn rests(halting: &Halting, reading: &Reading) -> bool {
    let heard = reading.acknowledged.sequence == halting.sequence;
    (heard || !listens(reading)) && !reading.moves()
}

fn listens(reading: &Reading) -> bool {
    reading.mode == Mode::Automatic && reading.safety.remote_enabled
}
