//! Drives one manipulator. Every command is sent once; an answer that was lost is looked for in what the device acknowledges.
//!
//! ```text
//!  connect, read --ok--> attend: halt due? -> send the halt, read
//!     ^                          order?    -> send it, read until it is acknowledged or the deadline passes
//!     | back-off; at least       else      -> read at the pace; that is our heartbeat too
//!     | the device's watchdog      |
//!     +----------- report --- link lost
//! ```
//!
//! After a loss it stays silent for the device's watchdog: to read is to tell the device that we live, and it would move on.

use super::backoff::Backoff;
use super::call::{Answer, Patience, call, raised};
use super::{Gone, Handling, News, Order, Outcome, Post, Seen, WATCHDOG_MARGIN};
use crate::cell::{Failure, now};
use crate::device::{Action, Command, CommandResult, DeviceError, Manipulator, Mode, Reading};
use crate::motion::Carrier;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

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
}

/// The driver.
pub(in crate::cell) struct ManipulatorDriver {
    carrier: Carrier,
    device: Box<dyn Manipulator>,
    post: Post,
    orders: mpsc::Receiver<Order<Handling>>,
    /// Of the newest command, ours or another's.
    sequence: Option<u16>,
    awaited: Option<Awaited>,
    halting: Option<Halting>,
    /// A command whose link was lost before its word came.
    in_doubt: Option<u16>,
    next_read: Instant,
    spoke_at: Instant,
    was_up: bool,
}

impl ManipulatorDriver {
    pub(in crate::cell) fn new(
        carrier: Carrier,
        device: Box<dyn Manipulator>,
        post: Post,
        orders: mpsc::Receiver<Order<Handling>>,
    ) -> Self {
        let now = now();
        Self {
            carrier,
            device,
            post,
            orders,
            sequence: None,
            awaited: None,
            halting: None,
            in_doubt: None,
            next_read: now,
            spoke_at: now,
            was_up: false,
        }
    }

    /// Drives until the cell has ended.
    pub(in crate::cell) async fn run(mut self) {
        let mut backoff = Backoff::new(self.post.timing.backoff_first, self.post.timing.backoff_last);
        let mut told = false;
        // Whoever commanded it before us may have died in a motion: our reading would keep that alive.
        if !self.wait(now() + self.post.timing.first_silence()).await {
            return;
        }
        loop {
            let gone = match self.connect().await {
                Ok(()) => {
                    (told, self.was_up) = (false, true);
                    backoff.relax();
                    self.attend().await
                }
                Err(gone) => gone,
            };
            let gone = match gone {
                Gone::Closed => return,
                // One attempt at once, for the halt's sake; if that fails too, it is a loss like any other.
                Gone::Cut => {
                    if let Some(sequence) = self.leave_unknown().await {
                        self.in_doubt = Some(sequence);
                    }
                    match self.connect().await {
                        Ok(()) => self.attend().await,
                        Err(gone) => gone,
                    }
                }
                Gone::Lost(_) => gone,
            };
            match gone {
                Gone::Closed => return,
                Gone::Cut => self.lose(self.silent(self.post.timing.grace), &mut told).await,
                Gone::Lost(error) => self.lose(error, &mut told).await,
            }
            let silence = self.spoke_at + self.post.timing.watchdog + WATCHDOG_MARGIN;
            if !self.wait(silence.max(now() + backoff.wait())).await {
                return;
            }
        }
    }

    /// Reports a loss, once, and what it leaves open.
    async fn lose(&mut self, error: DeviceError, told: &mut bool) {
        if !*told {
            self.post.tell(News::Lost { error: error.clone(), was_up: self.was_up }).await;
            *told = true;
        }
        if let Some(awaited) = self.awaited.take() {
            self.in_doubt = Some(awaited.sequence);
            self.told(awaited.order, Outcome::Unknown(Failure::Device(error))).await;
        }
    }

    /// Waits without a link, and answers orders with that. False when the cell has ended.
    async fn wait(&mut self, until: Instant) -> bool {
        loop {
            tokio::select! {
                order = self.orders.recv() => match order {
                    Some(order) => self.decline(&order).await,
                    None => return false,
                },
                () = sleep_until(until) => return true,
            }
        }
    }

    /// An order that came while there was no link is never sent later.
    async fn decline(&mut self, order: &Order<Handling>) {
        let error = DeviceError::LinkLost { device: self.name(), cause: "not connected".to_owned() };
        self.told(order.number, Outcome::Refused(error)).await;
    }

    async fn connect(&mut self) -> Result<(), Gone> {
        let asked_at = self.speak();
        let deadline = self.post.timing.connect;
        // A connection is needed to halt, so a halt does not cut it short.
        let patience = Patience { deadline, grace: deadline, handled: u64::MAX };
        let name = self.name();
        let reading = call(&name, self.device.connect(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        let seen = reading.acknowledged.sequence;
        if self.sequence.is_none_or(|ours| is_newer(seen, ours)) {
            self.sequence = Some(seen);
        }
        while let Ok(order) = self.orders.try_recv() {
            self.decline(&order).await;
        }
        self.post.tell(News::Up { asked_at, seen: Seen::Manipulator(reading.clone()) }).await;
        if let Some(sequence) = self.in_doubt.take() {
            self.post.tell(News::Resolved { sequence, taken: seen == sequence }).await;
        }
        self.next_read = now() + self.post.timing.poll;
        Ok(())
    }

    /// With a link: the halt flag first, then orders, then the pace.
    async fn attend(&mut self) -> Gone {
        loop {
            let step = if self.post.halt_is_due() {
                self.halt().await
            } else {
                let handled = self.post.handled;
                tokio::select! {
                    biased;
                    raised = raised(&mut self.post.halts, handled) => if raised { Ok(()) } else { Err(Gone::Closed) },
                    order = self.orders.recv(), if self.awaited.is_none() => match order {
                        Some(order) => self.obey(order).await,
                        None => Err(Gone::Closed),
                    },
                    () = sleep_until(self.next_read) => self.read().await,
                }
            };
            if let Err(gone) = step {
                return gone;
            }
        }
    }

    /// Sends the halt that is due, and reads what came of it.
    async fn halt(&mut self) -> Result<(), Gone> {
        let halts = self.post.halts();
        self.leave_unknown().await;
        let sequence = self.next_sequence();
        let answer = self.send(sequence, halts.fence, Action::Halt, halts.number).await?;
        let taken = answer.is_ok();
        match answer {
            Ok(()) => self.halting = Some(Halting { number: halts.number, sequence }),
            Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
            Err(error) => self.post.tell(News::WillNotHalt { error }).await,
        }
        self.post.handed(halts.number, taken);
        self.read().await
    }

    /// A halt comes before the word on a command whose bytes may have gone: nobody knows whether it was done.
    async fn leave_unknown(&mut self) -> Option<u16> {
        let Awaited { order, sequence, .. } = self.awaited.take()?;
        let within = self.post.timing.grace;
        let failure = Failure::NotAcknowledged { carrier: self.carrier, sequence, within };
        self.told(order, Outcome::Unknown(failure)).await;
        Some(sequence)
    }

    async fn obey(&mut self, order: Order<Handling>) -> Result<(), Gone> {
        if order.halts < self.post.halts().number {
            self.told(order.number, Outcome::Overtaken).await;
            return Ok(());
        }
        match order.errand {
            Handling::Look => self.read().await,
            Handling::Send(action) => self.command(order.number, order.fence, action).await,
        }
    }

    /// Sends a command once. Where its answer is lost and the link is not, what the device acknowledges decides.
    async fn command(&mut self, order: u64, fence: u64, action: Action) -> Result<(), Gone> {
        let sequence = self.next_sequence();
        let until = now() + self.post.timing.acknowledge;
        self.awaited = Some(Awaited { order, sequence, until });
        let answer = self.send(sequence, fence, action, self.post.handled).await?;
        match answer {
            Err(error @ DeviceError::LinkLost { .. }) => Err(Gone::Lost(error)),
            Err(error) if !error.leaves_unknown() => {
                self.awaited = None;
                self.told(order, Outcome::Refused(error)).await;
                Ok(())
            }
            Ok(()) | Err(_) => self.read().await,
        }
    }

    async fn send(&mut self, sequence: u16, fence: u64, action: Action, handled: u64) -> Result<Answer<()>, Gone> {
        self.speak();
        let command = Command { sequence, fence, watchdog: self.post.timing.watchdog, action };
        let (name, patience) = (self.name(), self.patience(handled));
        call(&name, self.device.send(&command), &self.post.halts, patience).await
    }

    async fn read(&mut self) -> Result<(), Gone> {
        let asked_at = self.speak();
        let (name, patience) = (self.name(), self.patience(self.post.handled));
        let reading = call(&name, self.device.read(), &self.post.halts, patience).await?.map_err(Gone::Lost)?;
        self.resolve(&reading).await;
        self.rest(&reading).await;
        let busy = self.awaited.is_some() || self.halting.is_some() || moves(&reading);
        let timing = self.post.timing;
        self.next_read = now() + if busy { timing.poll_moving } else { timing.poll };
        self.post.tell(News::Read { asked_at, seen: Seen::Manipulator(reading) }).await;
        Ok(())
    }

    /// Looks for the word on the command that is waited for.
    async fn resolve(&mut self, reading: &Reading) {
        let Some(Awaited { order, sequence, until }) = self.awaited else { return };
        let acknowledged = reading.acknowledged;
        let outcome = if acknowledged.sequence == sequence {
            match acknowledged.result {
                CommandResult::Rejected => {
                    Outcome::Refused(DeviceError::Rejected { device: self.name(), code: reading.fault_code })
                }
                CommandResult::Aborted => Outcome::Unknown(Failure::Aborted { carrier: self.carrier, sequence }),
                CommandResult::None | CommandResult::Accepted | CommandResult::Running | CommandResult::Done => {
                    Outcome::Taken { sequence }
                }
            }
        } else if now() >= until {
            let within = self.post.timing.acknowledge;
            Outcome::Unknown(Failure::NotAcknowledged { carrier: self.carrier, sequence, within })
        } else {
            return;
        };
        self.awaited = None;
        self.told(order, outcome).await;
    }

    /// Looks whether the device stands after a halt: it has seen the halt, or does not listen to us, and no axis moves.
    async fn rest(&mut self, reading: &Reading) {
        let Some(Halting { number, sequence }) = self.halting else { return };
        let heard = reading.acknowledged.sequence == sequence;
        let deaf = reading.mode != Mode::Automatic || !reading.safety.remote_enabled;
        if (heard || deaf) && !moves(reading) {
            self.halting = None;
            self.post.rested(number).await;
        }
    }

    async fn told(&mut self, order: u64, outcome: Outcome) {
        self.post.tell(News::Told { order, outcome }).await;
    }

    fn name(&self) -> String {
        self.device.name().to_owned()
    }

    fn silent(&self, within: Duration) -> DeviceError {
        DeviceError::Silent { device: self.name(), within }
    }

    fn speak(&mut self) -> Instant {
        self.spoke_at = now();
        self.spoke_at
    }

    const fn patience(&self, handled: u64) -> Patience {
        Patience { deadline: self.post.timing.reply, grace: self.post.timing.grace, handled }
    }

    fn next_sequence(&mut self) -> u16 {
        let next = self.sequence.unwrap_or(0).checked_add(1).unwrap_or(1);
        self.sequence = Some(next);
        next
    }
}

/// Whether the device, or any axis, moves or may.
pub(in crate::cell) fn moves(reading: &Reading) -> bool {
    reading.state.moves() || reading.axes.iter().any(|(_, axis)| axis.state.moves())
}

/// Whether `one` was given out after `other`: half of the circle of 1 to 65535 lies ahead, as the devices count too.
const fn is_newer(one: u16, other: u16) -> bool {
    const CIRCLE: u32 = 65_535;
    if one == 0 || other == 0 {
        return one != 0;
    }
    let ahead = (one as u32 + CIRCLE - other as u32) % CIRCLE;
    ahead != 0 && ahead <= CIRCLE / 2
}
