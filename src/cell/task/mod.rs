//! The task of the cell. It handles stops first, then reports of the drivers, then requests, then deadlines; passes each to the
//! state machine, executes the effects of the verdict, and publishes a snapshot. It never waits for a device.
//!
//! `requests` answers requests, `reports` handles the reports of the drivers, `effects` executes what the machine has decided.

mod effects;
mod reports;
mod requests;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};

use crate::device::{Reading, SensorDeadlines, SensorReading, StageReading};
use crate::motion::Pair;

use super::driver::messages::{Acquisition, DriverOrder, ManipulatorCommand, Report, StageCommand};
use super::events::{EventKind, EventLog};
use super::failure::Fault;

use super::input::{Activity, Effect, Input, Member, Taken, Verdict};
use super::lease::TimeToLiveBounds;
use super::machine::Machine;
use super::obstacles;
use super::refusal::Refusal;
use super::request::Request;

use super::settings::Settings;
use super::snapshot::{Live, Snapshot};
use super::state::State;
use super::stop::{HaltAtEnd, HaltFlag, Halts};
use super::work::{ActiveWork, Purpose};
use crate::device::clock::now;

/// The channels to the drivers.
pub(super) struct Drivers {
    pub(super) manipulators: Pair<mpsc::Sender<DriverOrder<ManipulatorCommand>>>,
    pub(super) stage: Option<mpsc::Sender<DriverOrder<StageCommand>>>,
    pub(super) sensor: Option<mpsc::Sender<DriverOrder<Acquisition>>>,
    /// The time limits of the sensor's adaptor.
    pub(super) sensor_deadlines: SensorDeadlines,
}

/// The halt after which every device must come to rest, and the deadline for that.
#[derive(Debug, Clone, Copy)]
struct Rest {
    halt: u64,
    until: Instant,
}

/// The readings that a reset needs: which devices were read, and the times from which a reading counts.
#[derive(Debug, Clone, Copy)]
struct Rereading {
    since: Pair<Instant>,
    read: Pair<bool>,
    stage_since: Instant,
    stage_read: bool,
    until: Instant,
}

/// The task of the cell with its data.
pub(super) struct CellTask {
    settings: Settings,
    drivers: Drivers,
    flag: Arc<HaltFlag>,
    halts: watch::Receiver<Halts>,
    /// Number of requested stops that were passed to the machine.
    stops_seen: u64,
    /// The newest halt that the task knows. Commands carry it, so that they are not sent after a newer halt.
    halts_known: u64,
    log: Arc<EventLog>,
    machine: Machine,
    live: Pair<Live<Reading>>,
    live_stage: Option<Live<StageReading>>,
    live_sensor: Option<Live<SensorReading>>,
    rested: BTreeMap<Member, u64>,
    rest: Option<Rest>,
    rereading: Option<Rereading>,
    prepared: Option<ActiveWork>,
    active: Option<ActiveWork>,
    orders_count: u64,
    purposes: BTreeMap<u64, Purpose>,
    /// The last command to each manipulator.
    commanded: Pair<Commanded>,
    waiting: VecDeque<Waiting>,
    /// Ids of the jobs that were started, newest last, so that none is started twice.
    begun: VecDeque<String>,
    closers: Vec<oneshot::Sender<()>>,
    /// Whether a handle of the cell still exists.
    held: bool,
}

/// The last readings of the devices.
type Lives = (Pair<Live<Reading>>, Option<Live<StageReading>>, Option<Live<SensorReading>>);

impl CellTask {
    pub(super) fn new(
        settings: Settings,
        drivers: Drivers,
        (live, live_stage, live_sensor): Lives,
        flag: &Arc<HaltFlag>,
        log: Arc<EventLog>,
        fence_floor: u64,
    ) -> Self {
        let bounds = TimeToLiveBounds { least: settings.lease_least, most: settings.lease_most };
        Self {
            settings,
            drivers,
            halts: flag.watch(),
            flag: Arc::clone(flag),
            stops_seen: 0,
            halts_known: 0,
            log,
            machine: Machine::new(now(), bounds, fence_floor),
            live,
            live_stage,
            live_sensor,
            rested: BTreeMap::new(),
            rest: None,
            rereading: None,
            prepared: None,
            active: None,
            orders_count: 0,
            purposes: BTreeMap::new(),
            commanded: Pair::default(),
            waiting: VecDeque::new(),
            begun: VecDeque::new(),
            closers: Vec::new(),
            held: true,
        }
    }

    /// Runs until the cell is closed, or its last handle is dropped.
    pub(super) async fn run(
        mut self,
        mut requests: mpsc::Receiver<Request>,
        mut reports: mpsc::Receiver<Report>,
        published: watch::Sender<Arc<Snapshot>>,
    ) {
        // It is dropped before the channels to the drivers, so that they see the halt before the end of the commands.
        let halt = HaltAtEnd::new(Arc::clone(&self.flag));
        let mut sequence = 0;
        while !self.is_over(now()) {
            let wake = self.wake();
            tokio::select! {
                biased;
                // The flag lives as long as the task, so its channel cannot be closed.
                _ = self.halts.changed() => self.take_stops(),
                Some(report) = reports.recv() => self.take_report(report),
                request = requests.recv(), if self.takes_requests() => self.take_request(request),
                () = sleep_until(wake) => {}
            }
            self.take_time();
            sequence += 1;
            published.send_replace(Arc::new(self.snapshot(sequence, now())));
        }
        // None of the waiting requests was started.
        requests.close();
        while let Some(request) = requests.recv().await {
            request.refuse();
        }
        self.note(EventKind::Closed);
        halt.disarm();
        for closer in self.closers {
            let _nobody_waits = closer.send(());
        }
    }

    /// Passes an input to the machine, and executes its effects.
    fn put(&mut self, input: Input) -> Result<Taken, Refusal> {
        let raised = matches!(input, Input::Stop);
        match self.machine.put(now(), input) {
            Verdict::Accepted(effects) => {
                for effect in effects {
                    self.perform(effect, raised);
                }
                self.settle();
                Ok(Taken::Accepted)
            }
            Verdict::AlreadySo => {
                self.settle();
                Ok(Taken::AlreadySo)
            }
            Verdict::Refused(refusal) => Err(refusal),
        }
    }

    /// Passes an event, which cannot be refused, to the machine.
    fn put_event(&mut self, event: Input) {
        let _taken = self.put(event);
    }

    /// Removes what has ended.
    fn settle(&mut self) {
        if self.machine.activity().is_none() {
            self.active = None;
            self.purposes.retain(|_, purpose| !purpose.is_work());
        }
        if !self.machine.resetting() {
            self.rereading = None;
        }
        if !matches!(self.machine.state(), State::Stopping | State::Faulted) && !self.machine.closing() {
            self.rest = None;
        }
    }

    fn take_stops(&mut self) {
        let requested = self.halts.borrow_and_update().requested;
        if requested != self.stops_seen {
            self.stops_seen = requested;
            self.put_event(Input::Stop);
        }
    }

    /// Handles everything that is due.
    fn take_time(&mut self) {
        let now = now();
        if self.machine.leases().until().is_some_and(|until| now >= until) {
            self.put_event(Input::Time);
        }
        self.take_work_time(now);
        self.look_for_rest(now);
        self.look_for_reread(now);
        self.take_waiting(now);
    }

    /// The time of the next deadline.
    fn wake(&self) -> Instant {
        let work = self.works().then(|| self.active.as_ref().map(ActiveWork::deadline)).flatten();
        let due = [
            self.machine.leases().until(),
            work,
            self.rest.map(|rest| rest.until),
            self.rereading.map(|rereading| rereading.until),
            self.waiting_until(),
        ];
        // Without a deadline, the polling period keeps the ages in the snapshot up to date.
        let pace = now() + self.settings.poll;
        due.into_iter().flatten().min().map_or(pace, |due| due.min(pace))
    }

    /// Whether work is under way and not being stopped.
    fn works(&self) -> bool {
        matches!(self.machine.state(), State::Moving | State::Scanning)
    }

    /// Whether the cell is closed, and every reachable device was read at rest, or the time limit for that is over.
    fn is_over(&self, now: Instant) -> bool {
        let due = self.rest.is_none_or(|rest| now >= rest.until);
        self.machine.closing() && self.machine.state() != State::Stopping && (due || self.restless().is_none())
    }

    fn note(&self, kind: EventKind) {
        match &kind {
            EventKind::Faulted(Fault { device, failure, .. }) => {
                tracing::error!(%device, code = failure.code(), "fault latched: {failure}");
            }
            EventKind::LinkLost { device, cause } => tracing::warn!(%device, "link lost: {cause}"),
            other => tracing::debug!(event = ?other, "cell"),
        }
        self.log.add(now(), kind);
    }

    fn perform(&mut self, effect: Effect, raised: bool) {
        match effect {
            Effect::Halt => self.halt(raised),
            Effect::Begin => self.begin(),
            Effect::Command(carrier, manual) => self.order_manual(carrier, manual),
            Effect::Reread => self.reread(),
            Effect::End(end) => {
                if let Some(active) = &self.active {
                    active.report_end(end);
                }
            }
            Effect::Note(kind) => self.note(kind),
        }
    }
}

/// A request that waits for a newer reading.
#[derive(Debug)]
struct Waiting {
    request: Request,
    until: Instant,
}

/// The last command to a manipulator.
#[derive(Debug, Clone, Copy, Default)]
struct Commanded {
    /// When its outcome became known.
    known_at: Option<Instant>,
    /// Its sequence number, if it is a manual command that the device has acknowledged.
    sequence: Option<u16>,
}

impl CellTask {
    pub(super) fn snapshot(&self, sequence: u64, now: Instant) -> Snapshot {
        let reasons = self.reasons(now);
        Snapshot {
            sequence,
            at: now,
            state: self.machine.state(),
            since: self.machine.since(),
            motions_count: self.machine.motions_count(),
            job: self.active.as_ref().and_then(ActiveWork::view),
            lease: self.machine.leases().view(now),
            faults: self.machine.faults().to_vec(),
            resetting: self.machine.resetting(),
            manipulators: self.live.clone(),
            stage: self.live_stage.clone(),
            sensor: self.live_sensor.clone(),
            commands_allowed: reasons.is_empty(),
            reasons,
        }
    }

    /// The reasons why a move requested with the lease would be refused.
    fn reasons(&self, now: Instant) -> Vec<Refusal> {
        let mut reasons = Vec::new();
        let job = self.machine.activity().and_then(Activity::job).map(str::to_owned);
        match self.machine.state() {
            _ if self.machine.closing() => reasons.push(Refusal::Closing),
            State::Idle => {}
            State::Faulted => reasons.push(Refusal::Faulted { count: self.machine.faults().len() }),
            state @ (State::Offline | State::Scanning | State::Moving | State::Stopping) => {
                reasons.push(Refusal::WrongState { state, verb: "move", job });
            }
        }
        reasons.extend(obstacles::of_move(&self.live, now));
        reasons
    }
}
