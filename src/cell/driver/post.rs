//! A driver's ends of the lines: to the cell, to whom it tells, and to the device, to which it speaks within its deadlines and
//! minds when it did.

use super::call::{Answer, Patience, call};
use super::halts::{HaltFlag, Halted, Halts};
use super::timing::Timing;
use super::{Gone, News, Outcome, Report, Seen};
use crate::cell::input::Member;
use crate::cell::now;
use crate::device::{DeviceError, Pending};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

/// A driver's ends of the lines.
#[derive(Debug)]
pub(in crate::cell) struct Post {
    member: Member,
    /// The device's, in the configuration.
    pub(super) name: String,
    reports: mpsc::Sender<Report>,
    pub(super) halts: watch::Receiver<Halts>,
    halted: watch::Sender<Halted>,
    /// The newest halt that was handed to the device.
    pub(super) handled: u64,
    pub(super) timing: Timing,
    pub(super) next_read: Instant,
    /// When the newest call began.
    pub(super) spoke_at: Instant,
    /// The device may have heard us until then: a call ended, or whoever was here before us did.
    heard_until: Instant,
}

impl Post {
    pub(in crate::cell) fn new(
        member: Member,
        name: String,
        reports: mpsc::Sender<Report>,
        flag: &HaltFlag,
        timing: Timing,
    ) -> (Self, watch::Receiver<Halted>) {
        let (halted, seen) = watch::channel(Halted::default());
        let (halts, now) = (flag.watch(), now());
        (
            Self {
                member,
                name,
                reports,
                halts,
                halted,
                handled: 0,
                timing,
                next_read: now,
                spoke_at: now,
                heard_until: now,
            },
            seen,
        )
    }

    /// Tells the cell. Where the cell has ended there is nobody to tell, and the orders are closed too.
    pub(super) async fn tell(&self, news: News) {
        let _nobody_listens = self.reports.send(Report { member: self.member, news }).await;
    }

    /// Tells what became of an order.
    pub(super) async fn told(&self, order: u64, outcome: Outcome) {
        self.tell(News::Told { order, outcome }).await;
    }

    /// Tells what was read, and when it is read next.
    pub(super) async fn seen(&mut self, seen: Seen, busy: bool) {
        self.pace(busy);
        self.tell(News::Read { asked_at: self.spoke_at, seen }).await;
    }

    /// Says that there is no link: an order that came while there was none is never sent later.
    pub(super) async fn decline(&self, order: u64) {
        let error = DeviceError::LinkLost { device: self.name.clone(), cause: "not connected".to_owned() };
        self.told(order, Outcome::Refused(error)).await;
    }

    /// Says what a device made of a halt that was handed to it; whether it took it. Where it refuses, the halt is not tried
    /// again and does not count as sent.
    pub(super) async fn halted(&mut self, number: u64, answer: Answer<()>) -> Result<bool, Gone> {
        let taken = answer.is_ok();
        match answer {
            Ok(()) => self.halted.send_modify(|halted| halted.sent = number),
            Err(error) if error.leaves_unknown() => return Err(Gone::Lost(error)),
            Err(error) => self.tell(News::WillNotHalt { error }).await,
        }
        self.handled = number;
        Ok(taken)
    }

    /// It was seen at rest after this halt.
    pub(super) async fn rested(&self, number: u64) {
        self.halted.send_modify(|halted| halted.rested = number);
        self.tell(News::Rested { halt: number }).await;
    }

    /// What the halt flag says now.
    pub(super) fn halts(&self) -> Halts {
        *self.halts.borrow()
    }

    pub(super) fn halt_is_due(&self) -> bool {
        self.halts().number > self.handled
    }

    /// Asks the device. The outer error says that the call was dropped, which costs the connection.
    pub(super) async fn ask<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, Gone> {
        self.speak(pending, self.patience()).await
    }

    /// The same for a call that may take so long, where that is longer than a usual answer.
    pub(super) async fn ask_within<T>(
        &mut self,
        pending: Pending<'_, Answer<T>>,
        within: Duration,
    ) -> Result<Answer<T>, Gone> {
        let patience = self.patience();
        self.speak(pending, Patience { deadline: within.max(patience.deadline), ..patience }).await
    }

    /// The same for a halt: one that is on its way serves for every newer one, and is not cut short by it.
    pub(super) async fn ask_for_halt<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, Gone> {
        self.ask_for_halt_within(pending, Duration::ZERO).await
    }

    /// The same for a halt that may take so long, where that is longer than a usual answer.
    pub(super) async fn ask_for_halt_within<T>(
        &mut self,
        pending: Pending<'_, Answer<T>>,
        within: Duration,
    ) -> Result<Answer<T>, Gone> {
        let patience = self.patience();
        let deadline = within.max(patience.deadline);
        self.speak(pending, Patience { deadline, handled: u64::MAX, ..patience }).await
    }

    /// The newest halt did not reach the device after all, and is due again.
    pub(super) fn halt_again(&mut self) {
        self.handled = self.handled.min(self.halts().number.saturating_sub(1));
    }

    /// Connects. A connection is needed to halt, so a halt does not cut it short.
    pub(super) async fn meet<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, Gone> {
        let deadline = self.timing.connect;
        self.speak(pending, Patience { deadline, grace: deadline, handled: u64::MAX }).await
    }

    async fn speak<T>(&mut self, pending: Pending<'_, Answer<T>>, patience: Patience) -> Result<Answer<T>, Gone> {
        self.spoke_at = now();
        let answer = call(&self.name, pending, &self.halts, patience).await;
        // One call may speak to the device many times.
        self.heard_until = now();
        answer
    }

    const fn patience(&self) -> Patience {
        Patience { deadline: self.timing.reply, grace: self.timing.grace, handled: self.handled }
    }

    /// Until when nothing may be said, so that whatever moves stops by its watchdog.
    pub(super) fn silent_until(&self) -> Instant {
        self.heard_until + self.timing.silence
    }

    /// The error of a call that was dropped for a halt's sake.
    pub(super) fn silent(&self) -> DeviceError {
        DeviceError::Silent { device: self.name.clone(), within: self.timing.grace }
    }

    /// The error of a halt that the device does not acknowledge.
    pub(super) fn unheard(&self) -> DeviceError {
        DeviceError::Silent { device: self.name.clone(), within: self.timing.acknowledge }
    }

    /// Sets when the device is read next.
    pub(super) fn pace(&mut self, busy: bool) {
        self.next_read = now() + if busy { self.timing.poll_moving } else { self.timing.poll };
    }
}
