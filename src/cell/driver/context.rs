//! The context of a driver: its deadlines, the waits before it reconnects, calls to the device, and reports to the cell.
//!
//! A call ends with its answer, at its deadline, or when the grace time of a halt is over. The wait before the next connection
//! doubles from a first to a longest one, without a random part, because each device has only this client.

use std::time::Duration;

use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, sleep};

use crate::cell::input::Member;
use crate::cell::settings::Settings;
use crate::cell::stop::{HaltFlag, Halted, Halts};
use crate::device::clock::now;
use crate::device::{DeviceError, Pending, SensorDeadlines};

use super::messages::{DeviceReading, DriverEvent, Outcome, Report, SessionEnd};

/// Longer than the longest watchdog of a device, which is 500 ms. The configured watchdogs are shorter, but another one may be in
/// effect: an earlier process may have set it, and a stage or a register map without a configurable watchdog has its own. Nothing
/// is sent to a device for this time at the start and after a loss, so that a device that moves is stopped by its watchdog.
pub const SILENCE: Duration = Duration::from_millis(550);

/// The deadlines of a driver.
#[derive(Debug, Clone, Copy)]
pub(in crate::cell) struct Timing {
    pub(super) poll: Duration,
    pub(super) poll_moving: Duration,
    pub(super) reply: Duration,
    pub(super) connect: Duration,
    pub(super) acknowledge: Duration,
    pub(super) grace: Duration,
    /// The watchdog time that is requested from the devices.
    pub(super) watchdog: Duration,
    /// How long nothing is sent at the start and after a loss.
    pub(super) silence: Duration,
    pub(super) backoff_first: Duration,
    pub(super) backoff_last: Duration,
}

impl Timing {
    pub(in crate::cell) fn of(settings: &Settings) -> Self {
        Self {
            poll: settings.poll,
            poll_moving: settings.poll_moving,
            reply: settings.reply,
            connect: settings.connect,
            acknowledge: settings.acknowledge,
            grace: settings.halt_grace,
            watchdog: settings.watchdog,
            silence: SILENCE,
            backoff_first: settings.backoff_first,
            backoff_last: settings.backoff_last,
        }
    }

    /// Deadlines of the sensor, which moves nothing: slower, with deadlines no shorter than those of its adaptor, and without
    /// silence, since a laser has no watchdog that could expire.
    pub(in crate::cell) fn of_sensor(settings: &Settings, own: &SensorDeadlines) -> Self {
        Self {
            poll: settings.sensor_poll,
            reply: settings.sensor_reply.max(own.reply),
            connect: settings.sensor_reply.max(own.connect),
            silence: Duration::ZERO,
            ..Self::of(settings)
        }
    }
}

/// How long to wait before the next connection.
#[derive(Debug, Clone, Copy)]
pub(super) struct Backoff {
    first: Duration,
    last: Duration,
    next: Duration,
}

impl Backoff {
    pub(super) const fn new(first: Duration, last: Duration) -> Self {
        Self { first, last, next: first }
    }

    /// Resets the wait after a successful connection.
    pub(super) const fn relax(&mut self) {
        self.next = self.first;
    }

    /// Returns the wait, and doubles the next one.
    pub(super) fn wait(&mut self) -> Duration {
        let wait = self.next;
        self.next = (wait * 2).min(self.last);
        wait
    }
}

/// The time limits of a call.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// The longest time.
    pub(super) deadline: Duration,
    /// The longest time after a halt was raised.
    pub(super) grace: Duration,
    /// The newest halt that does not shorten the call.
    pub(super) handled: u64,
}

/// The answer to a call.
pub(in crate::cell) type Answer<T> = Result<T, DeviceError>;

/// Waits for the answer. The outer error means that the call was dropped, and with it the connection.
pub(super) async fn call<T>(
    device: &str,
    pending: Pending<'_, Answer<T>>,
    halts: &watch::Receiver<Halts>,
    patience: Patience,
) -> Result<Answer<T>, SessionEnd> {
    tokio::select! {
        biased;
        answer = pending => Ok(answer),
        () = hurry(halts.clone(), patience) => Err(SessionEnd::Cut),
        () = sleep(patience.deadline) => {
            Err(SessionEnd::Lost(DeviceError::Silent { device: device.to_owned(), within: patience.deadline }))
        }
    }
}

/// Completes when a halt has waited long enough.
async fn hurry(mut halts: watch::Receiver<Halts>, patience: Patience) {
    if !raised(&mut halts, patience.handled).await {
        // No halt can be raised any more.
        std::future::pending::<()>().await;
    }
    sleep(patience.grace).await;
}

/// Waits for a halt that is newer than `handled`. Returns false if no halt can be raised any more.
pub(super) async fn raised(halts: &mut watch::Receiver<Halts>, handled: u64) -> bool {
    halts.wait_for(|halts| halts.number > handled).await.is_ok()
}

/// The connections of a driver to the cell and to its device.
#[derive(Debug)]
pub(in crate::cell) struct DriverContext {
    member: Member,
    /// The name of the device in the configuration.
    pub(super) name: String,
    reports: mpsc::Sender<Report>,
    pub(super) halts: watch::Receiver<Halts>,
    halted: watch::Sender<Halted>,
    /// The newest halt that was sent to the device.
    pub(super) handled: u64,
    pub(super) timing: Timing,
    pub(super) next_read: Instant,
    /// When the newest call began.
    pub(super) spoke_at: Instant,
    /// The latest time at which the device may have received something: the end of a call, or the start of this process.
    heard_until: Instant,
}

impl DriverContext {
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

    /// Reports an event to the task. If the cell has ended, the report is dropped, and the channel of commands is closed too.
    pub(super) async fn report(&self, event: DriverEvent) {
        let _nobody_listens = self.reports.send(Report { member: self.member, event }).await;
    }

    /// Reports the outcome of a command.
    pub(super) async fn report_outcome(&self, order: u64, outcome: Outcome) {
        self.report(DriverEvent::Outcome { order, outcome }).await;
    }

    /// Reports a reading, and sets the time of the next one.
    pub(super) async fn report_reading(&mut self, seen: DeviceReading, busy: bool) {
        self.pace(busy);
        self.report(DriverEvent::Read { asked_at: self.spoke_at, seen }).await;
    }

    /// Refuses a command because there is no link. The command is never sent later.
    pub(super) async fn decline(&self, order: u64) {
        let error = DeviceError::LinkLost { device: self.name.clone(), cause: "not connected".to_owned() };
        self.report_outcome(order, Outcome::Refused(error)).await;
    }

    /// Handles the answer to a halt, and returns whether the device accepted it. A halt that the device refuses is not sent again,
    /// and does not count as sent.
    pub(super) async fn halted(&mut self, number: u64, answer: Answer<()>) -> Result<bool, SessionEnd> {
        let taken = answer.is_ok();
        match answer {
            Ok(()) => self.halted.send_modify(|halted| halted.sent = number),
            Err(error) if error.leaves_unknown() => return Err(SessionEnd::Lost(error)),
            Err(error) => self.report(DriverEvent::HaltRefused { error }).await,
        }
        self.handled = number;
        Ok(taken)
    }

    /// Reports that the device was read at rest after this halt.
    pub(super) async fn rested(&self, number: u64) {
        self.halted.send_modify(|halted| halted.rested = number);
        self.report(DriverEvent::AtRest { halt: number }).await;
    }

    /// The current value of the halt flag.
    pub(super) fn halts(&self) -> Halts {
        *self.halts.borrow()
    }

    pub(super) fn halt_is_due(&self) -> bool {
        self.halts().number > self.handled
    }

    /// Calls the device. The outer error means that the call was dropped, and with it the connection.
    pub(super) async fn ask<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, SessionEnd> {
        self.speak(pending, self.patience()).await
    }

    /// As [`Self::ask`], with a deadline of `within` if that is longer than the usual one.
    pub(super) async fn ask_within<T>(
        &mut self,
        pending: Pending<'_, Answer<T>>,
        within: Duration,
    ) -> Result<Answer<T>, SessionEnd> {
        let patience = self.patience();
        self.speak(pending, Patience { deadline: within.max(patience.deadline), ..patience }).await
    }

    /// As [`Self::ask`] for a halt, which a newer halt does not shorten.
    pub(super) async fn ask_for_halt<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, SessionEnd> {
        self.ask_for_halt_within(pending, Duration::ZERO).await
    }

    /// As [`Self::ask_for_halt`], with a deadline of `within` if that is longer than the usual one.
    pub(super) async fn ask_for_halt_within<T>(
        &mut self,
        pending: Pending<'_, Answer<T>>,
        within: Duration,
    ) -> Result<Answer<T>, SessionEnd> {
        let patience = self.patience();
        let deadline = within.max(patience.deadline);
        self.speak(pending, Patience { deadline, handled: u64::MAX, ..patience }).await
    }

    /// Marks the newest halt as due again, because it did not reach the device.
    pub(super) fn halt_again(&mut self) {
        self.handled = self.handled.min(self.halts().number.saturating_sub(1));
    }

    /// Connects. A halt needs the connection, so it does not shorten this call.
    pub(super) async fn meet<T>(&mut self, pending: Pending<'_, Answer<T>>) -> Result<Answer<T>, SessionEnd> {
        let deadline = self.timing.connect;
        self.speak(pending, Patience { deadline, grace: deadline, handled: u64::MAX }).await
    }

    async fn speak<T>(&mut self, pending: Pending<'_, Answer<T>>, patience: Patience) -> Result<Answer<T>, SessionEnd> {
        self.spoke_at = now();
        let answer = call(&self.name, pending, &self.halts, patience).await;
        // One call may send several requests.
        self.heard_until = now();
        answer
    }

    const fn patience(&self) -> Patience {
        Patience { deadline: self.timing.reply, grace: self.timing.grace, handled: self.handled }
    }

    /// The time until which nothing may be sent, so that a device that moves is stopped by its watchdog.
    pub(super) fn silent_until(&self) -> Instant {
        self.heard_until + self.timing.silence
    }

    /// The error of a call that was dropped so that a halt could be sent.
    pub(super) fn silent(&self) -> DeviceError {
        DeviceError::Silent { device: self.name.clone(), within: self.timing.grace }
    }

    /// The error of a halt that the device does not acknowledge.
    pub(super) fn unheard(&self) -> DeviceError {
        DeviceError::Silent { device: self.name.clone(), within: self.timing.acknowledge }
    }

    /// Sets the time of the next reading.
    pub(super) fn pace(&mut self, busy: bool) {
        self.next_read = now() + if busy { self.timing.poll_moving } else { self.timing.poll };
    }
}
