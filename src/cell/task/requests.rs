//! Answers requests: checks the path and the devices, passes the request to the machine, and replies at once.
//!
//! A request may need a reading that is newer than the last command of a manipulator. It then waits until the manipulator has
//! acknowledged that command and was read again, so that it is judged by the state after the command. It waits for a limited time,
//! and only if the cell is idle and the request has the lease; a stop, a fault or the end of the lease answers it at once.

use super::{Commanded, Waiting};
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::cell::driver::messages::{Acquisition, Outcome};
use crate::cell::input::{Activity, Input, Manual, Taken};
use crate::cell::lease::{Lease, LeaseRequest};
use crate::cell::obstacles;
use crate::cell::refusal::Refusal;
use crate::cell::request::{Job, Reply, Request, ScanBegun, answer};
use crate::cell::run::Homing;
use crate::cell::run::Run;
use crate::cell::scanning::Scanning;
use crate::cell::settings::ScanOrder;
use crate::cell::state::State;
use crate::cell::work::{ActiveWork, Purpose, Work};
use crate::device::CommandResult;
use crate::device::clock::now;
use crate::motion::{Carrier, Path, check_path};

use super::CellTask;

/// Batches of profiles that may wait for their receiver.
const PROFILES_WAITING: usize = 64;
/// Number of job ids that are kept, so that no job is started twice.
const JOBS_REMEMBERED: usize = 256;

impl CellTask {
    /// Takes the next request. `None` means that the last handle of the cell was dropped, which closes the cell.
    pub(super) fn take_request(&mut self, request: Option<Request>) {
        // A lease that has expired ends before anything else is decided.
        self.put_event(Input::Time);
        match request {
            None => {
                self.held = false;
                self.put_event(Input::Close);
            }
            Some(Request::Close(closer)) => {
                self.closers.push(closer);
                self.put_event(Input::Close);
            }
            Some(Request::TakeLease(request, reply)) => answer(reply, self.take_lease(request)),
            Some(Request::RenewLease(id, reply)) => answer(reply, self.renew_lease(id)),
            Some(Request::ReleaseLease(id, reply)) => answer(reply, self.put(Input::ReleaseLease(id)).map(drop)),
            Some(request @ (Request::Act { .. } | Request::Move { .. })) => self.answer_or_wait(request),
            Some(Request::Scan { lease, job, order, reply }) => self.start_scan(lease, &job, order, reply),
            Some(Request::Reset { lease, reply }) => {
                let fit = obstacles::of_reset(&self.live, self.live_stage.as_ref(), now());
                answer(reply, self.put(Input::Reset { lease, fit }));
            }
        }
    }

    fn take_lease(&mut self, request: LeaseRequest) -> Result<Lease, Refusal> {
        self.put(Input::TakeLease(request))?;
        self.flag.set_fence(self.machine.leases().fence());
        self.machine.leases().held(now()).cloned().ok_or(Refusal::LeaseOver)
    }

    fn renew_lease(&mut self, id: String) -> Result<Lease, Refusal> {
        self.put(Input::RenewLease(id))?;
        self.machine.leases().held(now()).cloned().ok_or(Refusal::LeaseOver)
    }

    pub(super) fn manual(&mut self, lease: String, carrier: Carrier, manual: Manual) -> Result<Taken, Refusal> {
        let fit = match self.outdated(carrier, now()) {
            Some(refusal) => Err(refusal),
            None => obstacles::of_manual(&self.live, carrier, manual, now()),
        };
        match manual {
            Manual::Home if fit == Ok(Taken::AlreadySo) && !self.works() => {
                self.put(Input::Command { lease, carrier, manual, fit })
            }
            Manual::Enable | Manual::Disable => self.put(Input::Command { lease, carrier, manual, fit }),
            Manual::Home => {
                let names = self.live.map(|_, one| one.name.clone());
                self.prepared = Some(ActiveWork::homing(Homing::new(carrier, names, &self.settings, now())));
                self.put(Input::Start { lease, activity: Activity::Home(carrier), fit: fit.map(drop) })
            }
        }
    }

    pub(super) fn start_move(&mut self, lease: String, job: &str, path: Path) -> Result<Job, Refusal> {
        if let Some(job) = self.under_way(&lease, job)? {
            return Ok(job);
        }
        let fit = self.fit_to_move(job, &path);
        let names = self.live.map(|_, one| one.name.clone());
        let (active, job_handle) =
            ActiveWork::job(Work::Run(Box::new(Run::new(path, names, &self.settings, now()))), job);
        self.prepared = Some(active);
        self.put(Input::Start { lease, activity: Activity::Move(job.to_owned()), fit })?;
        self.remember(job);
        Ok(job_handle)
    }

    /// Returns the job if it is under way: a client that has lost the answer repeats its request.
    fn under_way(&mut self, lease: &str, job: &str) -> Result<Option<Job>, Refusal> {
        let Some(job) = self.active.as_ref().filter(|_| self.works()).and_then(|active| active.job_named(job)) else {
            return Ok(None);
        };
        self.put(Input::RenewLease(lease.to_owned()))?;
        Ok(Some(job))
    }

    fn fit_to_move(&self, job: &str, path: &Path) -> Result<(), Refusal> {
        let now = now();
        self.not_begun(job)?;
        if let Some(outdated) = Carrier::ALL.into_iter().find_map(|carrier| self.outdated(carrier, now)) {
            return Err(outdated);
        }
        if let Some(obstacle) = obstacles::of_move(&self.live, now).into_iter().next() {
            return Err(obstacle);
        }
        let actual = obstacles::positions(&self.live, now)?;
        check_path(&self.settings.arrangement, &actual, path)?;
        obstacles::of_own_limits(&self.live, path, now)
    }

    fn start_scan(&mut self, lease: String, job: &str, order: ScanOrder, reply: Reply<ScanBegun>) {
        let prepared = self.prepare_scan(job, order);
        let (fit, begun) = match prepared {
            Ok(begun) => (Ok(()), Some(begun)),
            Err(refusal) => (Err(refusal), None),
        };
        let taken = self.put(Input::Start { lease, activity: Activity::Scan(job.to_owned()), fit });
        match (taken, begun) {
            (Ok(_), Some(begun)) => {
                self.remember(job);
                answer(reply, Ok(begun));
            }
            // The machine accepts no request that failed its check.
            (Ok(_), None) => answer(reply, Err(Refusal::NotThere { what: "scan" })),
            (Err(refusal), _) => answer(reply, Err(refusal)),
        }
    }

    fn prepare_scan(&mut self, job: &str, order: ScanOrder) -> Result<ScanBegun, Refusal> {
        self.not_begun(job)?;
        obstacles::of_scan(&self.live, self.live_stage.as_ref(), self.live_sensor.as_ref(), &order, now())?;
        let from = self.live_stage.as_ref().and_then(|stage| stage.reading);
        let from = from.ok_or(Refusal::NotThere { what: "stage" })?;
        let (sink, profiles) = mpsc::channel(PROFILES_WAITING);
        let patience = self.settings.scan_stall;
        let acquisition = Acquisition { profiles_count: order.profiles_count, sink, patience };
        let names = (self.stage_name(), self.sensor_name());
        let waits = (&self.settings, &self.drivers.sensor_deadlines);
        let scanning = Scanning::new(order, names, from, waits, now());
        let (active, job_handle) = ActiveWork::job(Work::Scan(Box::new(scanning), Some(acquisition)), job);
        self.prepared = Some(active);
        Ok((job_handle, profiles))
    }

    fn not_begun(&self, job: &str) -> Result<(), Refusal> {
        if self.begun.iter().any(|begun| begun == job) {
            return Err(Refusal::Repeated { job: job.to_owned() });
        }
        Ok(())
    }

    fn remember(&mut self, job: &str) {
        if self.begun.len() == JOBS_REMEMBERED {
            self.begun.pop_front();
        }
        self.begun.push_back(job.to_owned());
    }
}

/// Number of requests that may wait. When it is reached, no other request is accepted.
const WAITING_MAX: usize = 256;

/// Whether the newest reading of a manipulator is newer than its last command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knowledge {
    /// The reading is older than the outcome of the command.
    Outdated,
    /// The device is still executing the command.
    Executing,
    /// The device has finished the command.
    Current,
}

impl CellTask {
    /// Records the time at which the outcome of a command became known.
    pub(super) fn remember_outcome(&mut self, purpose: Purpose, outcome: &Outcome) {
        let (carrier, is_manual) = match purpose {
            Purpose::Manual(carrier, _) => (carrier, true),
            Purpose::Work(carrier) | Purpose::Reset(carrier) => (carrier, false),
            Purpose::Carry | Purpose::Arm => return,
        };
        let sequence = match outcome {
            Outcome::Taken { sequence } if is_manual => Some(*sequence),
            Outcome::Taken { .. } | Outcome::Refused(_) | Outcome::Overtaken | Outcome::Cut | Outcome::Unknown(_) => {
                None
            }
        };
        *self.commanded.get_mut(carrier) = Commanded { known_at: Some(now()), sequence };
    }

    pub(super) fn takes_requests(&self) -> bool {
        self.held && self.waiting.len() < WAITING_MAX
    }

    /// Answers a request, or queues it behind the requests that came before it.
    pub(super) fn answer_or_wait(&mut self, request: Request) {
        if self.waiting.is_empty() && !self.must_wait(&request) {
            self.answer_command(request);
        } else {
            let until = now() + self.settings.acknowledge + self.settings.reply;
            self.waiting.push_back(Waiting { request, until });
        }
    }

    /// Answers the requests that no longer have to wait.
    pub(super) fn take_waiting(&mut self, now: Instant) {
        while self.waiting.front().is_some_and(|first| now >= first.until || !self.must_wait(&first.request)) {
            if let Some(Waiting { request, .. }) = self.waiting.pop_front() {
                self.answer_command(request);
            }
        }
    }

    /// The deadline of the first waiting request.
    pub(super) fn waiting_until(&self) -> Option<Instant> {
        self.waiting.front().map(|first| first.until)
    }

    /// The refusal of a request that would be judged by an outdated reading of a manipulator.
    pub(super) fn outdated(&self, carrier: Carrier, now: Instant) -> Option<Refusal> {
        let live = self.live.get(carrier);
        (self.knowledge(carrier) == Knowledge::Outdated)
            .then(|| Refusal::DeviceStale { device: live.name.clone(), age: live.age(now) })
    }

    fn must_wait(&self, request: &Request) -> bool {
        let (lease, carriers) = match request {
            Request::Act { lease, manual: Manual::Home, .. } | Request::Move { lease, .. } => {
                (lease, Carrier::ALL.as_slice())
            }
            Request::Act { lease, carrier, manual: Manual::Enable | Manual::Disable, .. } => {
                (lease, std::slice::from_ref(carrier))
            }
            Request::TakeLease(..)
            | Request::RenewLease(..)
            | Request::ReleaseLease(..)
            | Request::Scan { .. }
            | Request::Reset { .. }
            | Request::Close(_) => return false,
        };
        let may_be_accepted = self.machine.state() == State::Idle
            && !self.machine.closing()
            && self.machine.leases().check(now(), lease).is_ok();
        may_be_accepted && carriers.iter().any(|carrier| self.knowledge(*carrier) != Knowledge::Current)
    }

    fn knowledge(&self, carrier: Carrier) -> Knowledge {
        let is_out = |purpose: &Purpose| matches!(purpose, Purpose::Manual(one, _) | Purpose::Reset(one) | Purpose::Work(one) if *one == carrier);
        if self.purposes.values().any(is_out) {
            return Knowledge::Outdated;
        }
        let (live, Commanded { known_at, sequence }) = (self.live.get(carrier), *self.commanded.get(carrier));
        let acknowledged = live.reading.as_ref().map(|reading| reading.acknowledged);
        match acknowledged.filter(|one| Some(one.sequence) == sequence).map(|one| one.result) {
            Some(CommandResult::Accepted | CommandResult::Running) => Knowledge::Executing,
            // The reading that shows the end of the command is later than its acknowledgement.
            Some(_) => Knowledge::Current,
            None if known_at.is_some() && live.read_at < known_at => Knowledge::Outdated,
            None => Knowledge::Current,
        }
    }

    fn answer_command(&mut self, request: Request) {
        match request {
            Request::Act { lease, carrier, manual, reply } => answer(reply, self.manual(lease, carrier, manual)),
            Request::Move { lease, job, path, reply } => answer(reply, self.start_move(lease, &job, path)),
            // No other request is passed to this function.
            Request::TakeLease(..)
            | Request::RenewLease(..)
            | Request::ReleaseLease(..)
            | Request::Scan { .. }
            | Request::Reset { .. }
            | Request::Close(_) => {}
        }
    }
}
