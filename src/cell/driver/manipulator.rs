//! Attends one manipulator. Every command is sent once; an answer that was lost is looked for in what the device acknowledges.

use super::attend::{Attendant, Driver, Met};
use super::call::Answer;
use super::post::Post;
use super::{Gone, Handling, News, Order, Outcome, Seen};
use crate::cell::failure::Failure;
use crate::cell::now;
use crate::device::sequence::{is_newer, next};
use crate::device::{Action, AxisState, Command, CommandResult, DeviceError, Manipulator, Mode, Pending, Reading};
use crate::motion::Carrier;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// A command whose word is waited for.
#[derive(Debug, Clone, Copy)]
struct Awaited {
    order: u64,
    sequence: u16,
    until: Instant,
}

/// A halt after which the device was not seen at rest yet.
#[derive(Debug, Clone, Copy)]
struct Halting {
    number: u64,
    sequence: u16,
    /// Unless it is acknowledged by then, it did not arrive.
    until: Instant,
}

/// The driver of a manipulator.
pub(in crate::cell) type ManipulatorDriver = Driver<ManipulatorAttendant>;

/// What is particular to it.
pub(in crate::cell) struct ManipulatorAttendant {
    carrier: Carrier,
    device: Box<dyn Manipulator>,
    /// Of the newest command, ours or another's; 0 before there was one.
    sequence: u16,
    awaited: Option<Awaited>,
    halting: Option<Halting>,
    /// A command whose link was lost before its word came.
    in_doubt: Option<u16>,
    /// As it was read last: it moves, and listens to us.
    moves: bool,
    /// It comes to rest.
    stops: bool,
    /// The number that it acknowledged last.
    acknowledged: u16,
}

impl ManipulatorDriver {
    pub(in crate::cell) const fn new(
        carrier: Carrier,
        device: Box<dyn Manipulator>,
        post: Post,
        orders: mpsc::Receiver<Order<Handling>>,
    ) -> Self {
        let attendant = ManipulatorAttendant {
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
        Self::of(attendant, post, orders)
    }
}

impl Attendant for ManipulatorAttendant {
    type Errand = Handling;

    fn connect(&mut self) -> Pending<'_, Answer<Met>> {
        Box::pin(async move {
            let reading = self.device.connect().await?;
            self.follow(&reading);
            let seen = reading.acknowledged.sequence;
            let resolved = |sequence| News::Resolved { sequence, taken: seen == sequence };
            Ok((Seen::Manipulator(reading), self.in_doubt.take().map(resolved)))
        })
    }

    async fn read(&mut self, post: &mut Post) -> Result<(), Gone> {
        let reading = post.ask(self.device.read()).await?.map_err(Gone::Lost)?;
        let overtaken = is_newer(reading.acknowledged.sequence, self.sequence);
        self.follow(&reading);
        self.moves = moves(&reading) && listens(&reading);
        self.stops = reading.state == AxisState::Stopping;
        self.acknowledged = reading.acknowledged.sequence;
        let word = self.awaited.and_then(|awaited| self.word(post, awaited, &reading));
        let rested = self.halting.filter(|halting| rests(halting, &reading));
        if rested.is_some() {
            self.halting = None;
        }
        if word.is_some() {
            self.awaited = None;
        }
        // What was read comes before what it means, so that nobody acts on the word by an older reading.
        let busy = self.awaited.is_some() || self.halting.is_some() || moves(&reading);
        post.seen(Seen::Manipulator(reading), busy).await;
        if let Some(Halting { number, .. }) = rested {
            post.rested(number).await;
        }
        if let Some((order, outcome)) = word {
            post.told(order, outcome).await;
        }
        self.mind_halt(post, overtaken)
    }

    async fn halt(&mut self, post: &mut Post) -> Result<(), Gone> {
        let halts = post.halts();
        self.leave(post, None).await;
        // What the device acknowledges from here on is the halt.
        self.in_doubt = None;
        let command = self.command(post, halts.fence, Action::Halt);
        let answer = post.ask_for_halt(self.device.send(&command)).await?;
        let refusal = answer.clone().err();
        self.halting = None;
        if post.halted(halts.number, answer).await? {
            let until = now() + post.timing.acknowledge;
            self.halting = Some(Halting { number: halts.number, sequence: command.sequence, until });
        }
        self.read(post).await?;
        match refusal.filter(|_| self.moves) {
            // To go on reading is to keep it alive: left alone, it stops by its watchdog.
            Some(refusal) => Err(Gone::Lost(refusal)),
            None => Ok(()),
        }
    }

    /// Sends a command once. Where its answer is lost and the link is not, what the device acknowledges decides.
    async fn obey(&mut self, post: &mut Post, order: Order<Handling>) -> Result<(), Gone> {
        let Handling::Send(action) = order.errand else { return self.read(post).await };
        let command = self.command(post, order.fence, action);
        let until = now() + post.timing.acknowledge;
        self.awaited = Some(Awaited { order: order.number, sequence: command.sequence, until });
        match post.ask(self.device.send(&command)).await? {
            Err(error @ DeviceError::LinkLost { .. }) => Err(Gone::Lost(error)),
            Err(error) if !error.leaves_unknown() => {
                self.awaited = None;
                post.told(order.number, Outcome::Refused(error)).await;
                Ok(())
            }
            Ok(()) | Err(_) if post.halt_is_due() => Ok(()),
            Ok(()) | Err(_) => self.read(post).await,
        }
    }

    fn is_free(&self) -> bool {
        self.awaited.is_none()
    }

    async fn leave(&mut self, post: &mut Post, error: Option<&DeviceError>) {
        let Some(Awaited { order, sequence, .. }) = self.awaited.take() else { return };
        self.in_doubt = Some(sequence);
        let failure = error.cloned().map(Failure::Device);
        post.told(order, failure.map_or(Outcome::Cut, Outcome::Unknown)).await;
    }
}

impl ManipulatorAttendant {
    /// A halt that somebody else's command has overtaken goes out again. One that is not acknowledged in time while the device
    /// moves costs the link: our reading would keep the motion alive, and left alone the device stops by its watchdog.
    fn mind_halt(&mut self, post: &mut Post, overtaken: bool) -> Result<(), Gone> {
        let Some(Halting { sequence, until, .. }) = self.halting else { return Ok(()) };
        let late = self.moves && now() >= until;
        // A number that it knows already, from somebody else, is acknowledged and not obeyed.
        if overtaken || (late && !self.stops) {
            post.halt_again();
        }
        let unheard = late && self.acknowledged != sequence;
        if unheard { Err(Gone::Lost(post.unheard())) } else { Ok(()) }
    }

    /// Counts on from the device's number, where somebody else has commanded it: it would not listen to an older one, and not
    /// to a halt either.
    const fn follow(&mut self, reading: &Reading) {
        if is_newer(reading.acknowledged.sequence, self.sequence) {
            self.sequence = reading.acknowledged.sequence;
        }
    }

    const fn command(&mut self, post: &Post, fence: u64, action: Action) -> Command {
        self.sequence = next(self.sequence);
        Command { sequence: self.sequence, fence, watchdog: post.timing.watchdog, action }
    }

    /// What the device says about the command that is waited for; none while that may still come.
    fn word(&self, post: &Post, awaited: Awaited, reading: &Reading) -> Option<(u64, Outcome)> {
        let (Awaited { order, sequence, until }, carrier) = (awaited, self.carrier);
        let acknowledged = reading.acknowledged;
        let outcome = if acknowledged.sequence == sequence {
            match acknowledged.result {
                CommandResult::Rejected => {
                    Outcome::Refused(DeviceError::Rejected { device: post.name.clone(), code: reading.fault_code })
                }
                CommandResult::Aborted => Outcome::Unknown(Failure::Aborted { carrier, sequence }),
                CommandResult::None | CommandResult::Accepted | CommandResult::Running | CommandResult::Done => {
                    Outcome::Taken { sequence }
                }
            }
        } else if now() >= until {
            Outcome::Unknown(Failure::NotAcknowledged { carrier, sequence, within: post.timing.acknowledge })
        } else {
            return None;
        };
        Some((order, outcome))
    }
}

/// Whether the device stands after a halt: it has seen the halt, or does not listen to us, and no axis moves.
fn rests(halting: &Halting, reading: &Reading) -> bool {
    let heard = reading.acknowledged.sequence == halting.sequence;
    (heard || !listens(reading)) && !moves(reading)
}

fn listens(reading: &Reading) -> bool {
    reading.mode == Mode::Automatic && reading.safety.remote_enabled
}

/// Whether the device, or any axis, moves or may.
pub(in crate::cell) fn moves(reading: &Reading) -> bool {
    reading.state.moves() || reading.axes.iter().any(|(_, axis)| axis.state.moves())
}
