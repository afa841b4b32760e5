//! The drivers: a task for each device, which owns its adaptor, reads it at a pace, does one errand at a time with a deadline,
//! and looks at the halt flag before anything else. A lost link is reported, dropped and tried again; nothing is sent again.
//! In: orders, and the halt flag. Out: reports. Must not know leases, jobs or what an errand is for.

mod backoff;
mod call;
mod halts;
mod manipulator;
mod sensor;
mod stage;

pub(super) use halts::{HaltAtEnd, HaltFlag, Halted, Halts};
pub(super) use manipulator::{ManipulatorDriver, moves};
pub(super) use sensor::SensorDriver;
pub(super) use stage::StageDriver;

use super::input::Member;
use super::{Failure, Settings};
use crate::device::{Action, DeviceError, Profile, Reading, SensorReading, StageReading};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

/// Something that a device is to do.
#[derive(Debug)]
pub(super) struct Order<E> {
    /// Names it in its outcome.
    pub(super) number: u64,
    /// How many halts had been raised when it was given: a later halt overtakes it.
    pub(super) halts: u64,
    /// Of the lease that commands.
    pub(super) fence: u64,
    /// What.
    pub(super) errand: E,
}

/// What a manipulator is to do.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Handling {
    /// Be read now.
    Look,
    /// Take a command.
    Send(Action),
}

/// What the stage is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Travel {
    /// Be read now.
    Look,
    /// Go there.
    To { target_mm: f64, speed_mm_s: f64 },
}

/// What the sensor is to do: take profiles, and hand them over as they come.
#[derive(Debug)]
pub(super) struct Taking {
    pub(super) profiles_count: u64,
    pub(super) sink: mpsc::Sender<Vec<Profile>>,
    /// How long the one that takes the profiles may let us wait.
    pub(super) patience: Duration,
}

/// What became of an order.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// The device has it. The sequence number of a manipulator's command; 0 for others.
    Taken { sequence: u16 },
    /// It was not sent, or the device refused it: nothing was done.
    Refused(DeviceError),
    /// A halt came before it; not a byte of it was sent.
    Overtaken,
    /// It may have been done.
    Unknown(Failure),
}

/// What a device said.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Seen {
    Manipulator(Reading),
    Stage(StageReading),
    Sensor(SensorReading),
}

/// What a driver tells the cell's task.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum News {
    /// The link is up; this was read first.
    Up { asked_at: Instant, seen: Seen },
    /// It was read.
    Read { asked_at: Instant, seen: Seen },
    /// The link is down. `was_up` is false where it never was up.
    Lost { error: DeviceError, was_up: bool },
    /// What became of an order.
    Told { order: u64, outcome: Outcome },
    /// After this halt, it was seen at rest.
    Rested { halt: u64 },
    /// It refuses to halt.
    WillNotHalt { error: DeviceError },
    /// After a reconnect: what became of the command whose answer was lost.
    Resolved { sequence: u16, taken: bool },
    /// Profiles have come, so many so far.
    Profiles { received_count: u64 },
    /// All profiles came, or the scan cannot be whole.
    ScanEnded { result: Result<(), Failure> },
}

/// News, and of whom.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Report {
    pub(super) member: Member,
    pub(super) news: News,
}

/// How a driver waits.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timing {
    poll: Duration,
    poll_moving: Duration,
    reply: Duration,
    connect: Duration,
    acknowledge: Duration,
    grace: Duration,
    watchdog: Duration,
    backoff_first: Duration,
    backoff_last: Duration,
}

/// What is taken for a device's watchdog at the start, at least: a process before us, or whoever set it at the device, may have
/// chosen a slower one than ours.
const WATCHDOG_LEAST: Duration = Duration::from_millis(500);
/// Silence on top of the device's watchdog before it is spoken to.
const WATCHDOG_MARGIN: Duration = Duration::from_millis(50);

impl Timing {
    /// How long nothing is said at the start, so that whatever a process before us has moved stops by its watchdog.
    fn first_silence(&self) -> Duration {
        self.watchdog.max(WATCHDOG_LEAST) + WATCHDOG_MARGIN
    }

    pub(super) const fn of(settings: &Settings) -> Self {
        Self {
            poll: settings.poll,
            poll_moving: settings.poll_moving,
            reply: settings.reply,
            connect: settings.connect,
            acknowledge: settings.acknowledge,
            grace: settings.halt_grace,
            watchdog: settings.watchdog,
            backoff_first: settings.backoff_first,
            backoff_last: settings.backoff_last,
        }
    }

    /// For the sensor, which moves nothing: slower, and with more patience.
    pub(super) const fn of_sensor(settings: &Settings) -> Self {
        let reply = settings.sensor_reply;
        Self { poll: settings.sensor_poll, reply, connect: reply, ..Self::of(settings) }
    }
}

/// A driver's ends of the lines to the cell.
#[derive(Debug)]
pub(super) struct Post {
    member: Member,
    reports: mpsc::Sender<Report>,
    halts: watch::Receiver<Halts>,
    halted: watch::Sender<Halted>,
    /// The newest halt that was handed to the device.
    handled: u64,
    timing: Timing,
}

/// Why a driver does not attend its device any more.
#[derive(Debug)]
enum Gone {
    /// The link.
    Lost(DeviceError),
    /// A call was dropped so that a halt could go out; the connection was the price.
    Cut,
    /// The cell has ended.
    Closed,
}

impl Post {
    pub(super) fn new(
        member: Member,
        reports: mpsc::Sender<Report>,
        flag: &HaltFlag,
        timing: Timing,
    ) -> (Self, watch::Receiver<Halted>) {
        let (halted, seen) = watch::channel(Halted::default());
        (Self { member, reports, halts: flag.watch(), halted, handled: 0, timing }, seen)
    }

    /// Tells the cell. Where the cell has ended there is nobody to tell, and the orders are closed too.
    async fn tell(&self, news: News) {
        let _nobody_listens = self.reports.send(Report { member: self.member, news }).await;
    }

    /// What the halt flag says now.
    fn halts(&self) -> Halts {
        *self.halts.borrow()
    }

    fn halt_is_due(&self) -> bool {
        self.halts().number > self.handled
    }

    /// The halt was handed to the device; where the device refuses it, it is not tried again and does not count as sent.
    fn handed(&mut self, number: u64, taken: bool) {
        self.handled = number;
        if taken {
            self.halted.send_modify(|halted| halted.sent = number);
        }
    }

    /// It was seen at rest after this halt.
    async fn rested(&self, number: u64) {
        self.halted.send_modify(|halted| halted.rested = number);
        self.tell(News::Rested { halt: number }).await;
    }
}
