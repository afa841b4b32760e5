//! The one task: looks for stops first, then for what the drivers report, then for requests, then at the time; puts each to
//! the state machine, does what the verdict says, and publishes. Waits for no device, ever.
//!
//! `requests` answers what is asked, `waiting` lets those wait that need a newer reading, `reports` takes what the drivers say,
//! `acts` does what was decided, `publish` shows it.

mod acts;
mod publish;
mod reports;
mod requests;
mod waiting;

use super::driver::{HaltAtEnd, HaltFlag, Halts, Handling, Order, Report, Taking, Travel};
use super::events::EventKind;
use super::events::EventLog;
use super::failure::Fault;
use super::input::Taken;
use super::input::{Act, Input, Member, Verdict};
use super::lease::Bounds;
use super::now;
use super::refusal::Refusal;
use super::request::Request;
use super::settings::Settings;
use super::snapshot::{Live, Snapshot};
use super::state::{Machine, State};
use super::work::{Course, Purpose};
use crate::device::{Reading, SensorDeadlines, SensorReading, StageReading};
use crate::motion::Pair;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, sleep_until};
use waiting::{Commanded, Waiting};

/// The lines to the drivers.
pub(super) struct Lines {
    pub(super) manipulators: Pair<mpsc::Sender<Order<Handling>>>,
    pub(super) stage: Option<mpsc::Sender<Order<Travel>>>,
    pub(super) sensor: Option<mpsc::Sender<Order<Taking>>>,
    /// How long the sensor's adaptor itself waits.
    pub(super) sensor_deadlines: SensorDeadlines,
}

/// After a halt, who was seen at rest, and until when that is waited for.
#[derive(Debug, Clone, Copy)]
struct Rest {
    halt: u64,
    until: Instant,
}

/// After a reset, which devices have to be read, and since when.
#[derive(Debug, Clone, Copy)]
struct Rereading {
    since: Pair<Instant>,
    read: Pair<bool>,
    stage_since: Instant,
    stage_read: bool,
    until: Instant,
}

/// The task and all that it knows.
pub(super) struct Task {
    settings: Settings,
    lines: Lines,
    flag: Arc<HaltFlag>,
    halts: watch::Receiver<Halts>,
    /// Stops that were requested and put to the machine.
    stops_seen: u64,
    /// Halts that the task knows of; orders carry it, so that a halt it does not know yet overtakes them.
    halts_known: u64,
    log: Arc<EventLog>,
    machine: Machine,
    live: Pair<Live<Reading>>,
    live_stage: Option<Live<StageReading>>,
    live_sensor: Option<Live<SensorReading>>,
    rested: BTreeMap<Member, u64>,
    rest: Option<Rest>,
    rereading: Option<Rereading>,
    prepared: Option<Course>,
    course: Option<Course>,
    orders_count: u64,
    purposes: BTreeMap<u64, Purpose>,
    /// The last command to each manipulator.
    commanded: Pair<Commanded>,
    waiting: VecDeque<Waiting>,
    /// Jobs that were begun, newest last: none of them is begun again.
    begun: VecDeque<String>,
    closers: Vec<oneshot::Sender<()>>,
    /// Somebody holds the cell, and may ask.
    held: bool,
}

/// What the devices said last: nothing yet.
type Lives = (Pair<Live<Reading>>, Option<Live<StageReading>>, Option<Live<SensorReading>>);

impl Task {
    pub(super) fn new(
        settings: Settings,
        lines: Lines,
        (live, live_stage, live_sensor): Lives,
        flag: &Arc<HaltFlag>,
        log: Arc<EventLog>,
        fence_floor: u64,
    ) -> Self {
        let bounds = Bounds { least: settings.lease_least, most: settings.lease_most };
        Self {
            settings,
            lines,
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
            course: None,
            orders_count: 0,
            purposes: BTreeMap::new(),
            commanded: Pair::default(),
            waiting: VecDeque::new(),
            begun: VecDeque::new(),
            closers: Vec::new(),
            held: true,
        }
    }

    /// Runs until it was closed, or nobody holds the cell any more.
    pub(super) async fn run(
        mut self,
        mut requests: mpsc::Receiver<Request>,
        mut reports: mpsc::Receiver<Report>,
        published: watch::Sender<Arc<Snapshot>>,
    ) {
        // Dropped before the lines to the drivers: they see the halt first, and then that nobody orders any more.
        let halt = HaltAtEnd::new(Arc::clone(&self.flag));
        let mut sequence = 0;
        while !self.is_over(now()) {
            let wake = self.wake();
            tokio::select! {
                biased;
                // The flag lives as long as the task: it cannot be closed.
                _ = self.halts.changed() => self.take_stops(),
                Some(report) = reports.recv() => self.take_report(report),
                request = requests.recv(), if self.takes_requests() => self.take_request(request),
                () = sleep_until(wake) => {}
            }
            self.take_time();
            sequence += 1;
            published.send_replace(Arc::new(self.snapshot(sequence, now())));
        }
        // Nothing of what still waits was begun.
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

    /// Puts an input to the machine and does what it says.
    fn put(&mut self, input: Input) -> Result<Taken, Refusal> {
        let raised = matches!(input, Input::Stop);
        match self.machine.put(now(), input) {
            Verdict::Accepted(acts) => {
                for act in acts {
                    self.perform(act, raised);
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

    /// Puts an event, which cannot be refused.
    fn tell(&mut self, event: Input) {
        let _taken = self.put(event);
    }

    /// Lets go of what is over.
    fn settle(&mut self) {
        if self.machine.activity().is_none() {
            self.course = None;
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
            self.tell(Input::Stop);
        }
    }

    /// What is due by now.
    fn take_time(&mut self) {
        let now = now();
        if self.machine.tenancy().until().is_some_and(|until| now >= until) {
            self.tell(Input::Time);
        }
        self.take_work_time(now);
        self.look_for_rest(now);
        self.look_for_reread(now);
        self.take_waiting(now);
    }

    /// When something is due next.
    fn wake(&self) -> Instant {
        let work = self.works().then(|| self.course.as_ref().map(Course::deadline)).flatten();
        let due = [
            self.machine.tenancy().until(),
            work,
            self.rest.map(|rest| rest.until),
            self.rereading.map(|rereading| rereading.until),
            self.waiting_until(),
        ];
        // Without any of them, the pace keeps the snapshot's ages honest.
        let pace = now() + self.settings.poll;
        due.into_iter().flatten().min().map_or(pace, |due| due.min(pace))
    }

    /// Whether something is under way that is not being stopped.
    fn works(&self) -> bool {
        matches!(self.machine.state(), State::Moving | State::Scanning)
    }

    /// Closed, and everything that can be reached was seen at rest, or the time for that is over.
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

    fn perform(&mut self, act: Act, raised: bool) {
        match act {
            Act::Halt => self.halt(raised),
            Act::Begin => self.begin(),
            Act::Tell(carrier, manual) => self.order_manual(carrier, manual),
            Act::Reread => self.reread(),
            Act::End(end) => {
                if let Some(course) = &self.course {
                    course.tell_end(end);
                }
            }
            Act::Note(kind) => self.note(kind),
        }
    }
}
