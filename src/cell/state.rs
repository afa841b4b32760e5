//! What the cell does, and what it may do next: requests and events go in with their time, out comes a verdict: accepted with
//! what is to be done, already so, or refused because. Pure: no locks, no waiting, no clock. Must not know how devices are
//! spoken to; that a path may be gone and that a device is fit for it is found out before, and comes in as `fit`.
//!
//! ```text
//!            both manipulators read          start_move, home
//!  offline ------------------------> idle ----------------------> moving ---+
//!                                    ^ ^ \----- start_scan -----> scanning -+
//!                                    | |                             |   |  |
//!                                    | +---------- finished ---------+---+  | stop, lease over or given back,
//!                                    |                                      | failed without a fault
//!                                    +-- all seen at rest -- stopping <-----+   (from idle too: stop)
//!                                    |
//!                                    +-- reset with the lease, and every device read at rest -- faulted
//!
//!  any but offline --- a link lost, a device's fault, an outcome unknown ---> faulted (every device is told to halt)
//! ```
//!
//! The good path: offline, idle, moving, idle. Words in -ing pass by themselves; `faulted` is left only by a reset.

use super::input::{Act, Activity, Input, Manual, Member, Taken, Verdict};
use super::lease::{Bounds, Tenancy};
use super::{EventKind, Failure, Fault, JobEnd, Lease, LeaseRequest, Refusal, StopCause};
use crate::motion::{Carrier, Pair};
use tokio::time::Instant;

/// How many faults are kept; what comes after them adds nothing an operator needs.
const FAULTS_KEPT: usize = 32;

/// What the cell does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// A manipulator was not reached yet.
    Offline,
    /// Everything is at rest; a job may begin.
    Idle,
    /// The stage carries the sensor, profiles come.
    Scanning,
    /// A move, or the finding of a reference, is under way.
    Moving,
    /// Every device was told to stop; not all of them were seen at rest yet.
    Stopping,
    /// A fault is latched; nothing moves until a reset.
    Faulted,
}

impl State {
    /// The word used in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Offline => "offline",
            Self::Idle => "idle",
            Self::Scanning => "scanning",
            Self::Moving => "moving",
            Self::Stopping => "stopping",
            Self::Faulted => "faulted",
        }
    }
}

/// What is under way, and how it will have ended where it comes to rest.
#[derive(Debug, Clone, PartialEq)]
struct Course {
    activity: Option<Activity>,
    end: JobEnd,
}

/// The machine.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Machine {
    state: State,
    since: Instant,
    present: Pair<bool>,
    course: Option<Course>,
    tenancy: Tenancy,
    faults: Vec<Fault>,
    resetting: bool,
    closing: bool,
}

impl Machine {
    /// Offline, without a lease; every fence to come is above `fence_floor`.
    pub(super) fn new(now: Instant, bounds: Bounds, fence_floor: u64) -> Self {
        Self {
            state: State::Offline,
            since: now,
            present: Pair::default(),
            course: None,
            tenancy: Tenancy::new(bounds, fence_floor),
            faults: Vec::new(),
            resetting: false,
            closing: false,
        }
    }

    pub(super) const fn state(&self) -> State {
        self.state
    }

    pub(super) const fn since(&self) -> Instant {
        self.since
    }

    pub(super) const fn tenancy(&self) -> &Tenancy {
        &self.tenancy
    }

    pub(super) fn faults(&self) -> &[Fault] {
        &self.faults
    }

    pub(super) const fn resetting(&self) -> bool {
        self.resetting
    }

    pub(super) const fn closing(&self) -> bool {
        self.closing
    }

    /// What is under way or coming to rest.
    pub(super) fn activity(&self) -> Option<&Activity> {
        self.course.as_ref()?.activity.as_ref()
    }

    /// Decides, and changes the machine where it accepts.
    pub(super) fn put(&mut self, now: Instant, input: Input) -> Verdict {
        match input {
            Input::TakeLease(request) => self.take_lease(now, &request),
            Input::RenewLease(id) => self.tenancy.renew(now, &id).map_or_else(Verdict::Refused, |_| done()),
            Input::ReleaseLease(id) => self.release_lease(now, &id),
            Input::Command { lease, carrier, manual, fit } => self.command(now, &lease, carrier, manual, fit),
            Input::Start { lease, activity, fit } => self.start(now, &lease, activity, fit),
            Input::Stop => self.halt(now, StopCause::Requested),
            Input::Reset { lease, fit } => self.reset(now, &lease, fit),
            Input::Close => {
                self.closing = true;
                self.halt(now, StopCause::Closing)
            }
            Input::Up { member, moves } => self.up(now, member, moves),
            Input::Lost(member, fault) => self.lost(now, member, fault),
            Input::Fault(fault) => self.fault(now, fault),
            Input::Finished => self.finished(now),
            Input::GivenUp(failure) => self.given_up(now, failure),
            Input::AtRest => self.at_rest(now),
            Input::Reread => self.reread(now),
            Input::Time => Verdict::Accepted(self.time(now)),
        }
    }

    fn take_lease(&mut self, now: Instant, request: &LeaseRequest) -> Verdict {
        if self.closing {
            return Verdict::Refused(Refusal::Closing);
        }
        // What the lease before has moved stops, however soon the next one comes.
        let mut acts = self.time(now);
        let before = self.tenancy.fence();
        match self.tenancy.take(now, request) {
            Ok(Lease { fence, .. }) if fence == before => Verdict::AlreadySo,
            Ok(Lease { holder, fence, .. }) => {
                acts.push(Act::Note(EventKind::LeaseTaken { holder, fence }));
                Verdict::Accepted(acts)
            }
            Err(refusal) => Verdict::Refused(refusal),
        }
    }

    fn release_lease(&mut self, now: Instant, id: &str) -> Verdict {
        let held = self.tenancy.held(now).cloned();
        match (self.tenancy.release(now, id), held) {
            (Ok(()), Some(lease)) => Verdict::Accepted(self.lease_ended(now, lease, StopCause::LeaseReleased)),
            (Ok(()), None) => done(),
            (Err(refusal), _) => Verdict::Refused(refusal),
        }
    }

    /// What the lease moved stops with it.
    fn lease_ended(&mut self, now: Instant, lease: Lease, cause: StopCause) -> Vec<Act> {
        let ran_out = cause == StopCause::LeaseOver;
        let mut acts = vec![Act::Note(EventKind::LeaseEnded { holder: lease.holder, fence: lease.fence, ran_out })];
        if matches!(self.state, State::Moving | State::Scanning) {
            acts.extend(self.stopping(now, JobEnd::Stopped(cause), Some(cause)));
        }
        acts
    }

    /// What every command needs: an open cell, the lease (which this renews), no fault, and nothing under way.
    fn admit(&mut self, now: Instant, lease: &str, verb: &'static str) -> Result<(), Refusal> {
        self.leased(now, lease)?;
        match self.state {
            State::Idle => Ok(()),
            State::Faulted => Err(Refusal::Faulted { count: self.faults.len() }),
            State::Offline | State::Scanning | State::Moving | State::Stopping => Err(self.wrong_state(verb)),
        }
    }

    fn leased(&self, now: Instant, lease: &str) -> Result<(), Refusal> {
        if self.closing { Err(Refusal::Closing) } else { self.tenancy.check(now, lease) }
    }

    fn wrong_state(&self, verb: &'static str) -> Refusal {
        let job = self.activity().and_then(Activity::job).map(str::to_owned);
        Refusal::WrongState { state: self.state, verb, job }
    }

    fn command(
        &mut self,
        now: Instant,
        lease: &str,
        carrier: Carrier,
        manual: Manual,
        fit: Result<Taken, Refusal>,
    ) -> Verdict {
        match self.admit(now, lease, manual.name()).and(fit) {
            Err(refusal) => Verdict::Refused(refusal),
            Ok(taken) => {
                self.used(now, lease);
                match taken {
                    Taken::AlreadySo => Verdict::AlreadySo,
                    Taken::Accepted => Verdict::Accepted(vec![Act::Tell(carrier, manual)]),
                }
            }
        }
    }

    fn start(&mut self, now: Instant, lease: &str, activity: Activity, fit: Result<(), Refusal>) -> Verdict {
        if let Err(refusal) = self.leased(now, lease) {
            return Verdict::Refused(refusal);
        }
        if self.state == State::Moving && self.activity() == Some(&activity) {
            self.used(now, lease);
            return Verdict::AlreadySo;
        }
        if let Err(refusal) = self.admit(now, lease, activity.verb()).and(fit) {
            return Verdict::Refused(refusal);
        }
        self.used(now, lease);
        let mut acts = self.enter(now, activity.state());
        acts.extend(activity.job().map(|job| Act::Note(EventKind::JobStarted { job: job.to_owned() })));
        acts.push(Act::Begin);
        self.course = Some(Course { activity: Some(activity), end: JobEnd::Done });
        Verdict::Accepted(acts)
    }

    /// Renews a lease that was checked.
    fn used(&mut self, now: Instant, lease: &str) {
        // It was checked at the same `now`, so it cannot be refused.
        let _renewed = self.tenancy.renew(now, lease);
    }

    /// Halts in every state; where something can come to rest, says so.
    fn halt(&mut self, now: Instant, cause: StopCause) -> Verdict {
        Verdict::Accepted(match self.state {
            State::Offline | State::Faulted => {
                vec![Act::Halt, Act::Note(EventKind::Stopping { cause: Some(cause) })]
            }
            State::Idle | State::Scanning | State::Moving | State::Stopping => {
                self.stopping(now, JobEnd::Stopped(cause), Some(cause))
            }
        })
    }

    /// Goes to `stopping`. Asked again on the way, it halts again and keeps the first reason.
    fn stopping(&mut self, now: Instant, end: JobEnd, cause: Option<StopCause>) -> Vec<Act> {
        let mut acts = vec![Act::Halt, Act::Note(EventKind::Stopping { cause })];
        if self.state != State::Stopping {
            let activity = self.course.take().and_then(|course| course.activity);
            self.course = Some(Course { activity, end });
            acts.extend(self.enter(now, State::Stopping));
        }
        acts
    }

    fn reset(&mut self, now: Instant, lease: &str, fit: Result<(), Refusal>) -> Verdict {
        if let Err(refusal) = self.leased(now, lease) {
            return Verdict::Refused(refusal);
        }
        if self.state != State::Faulted || self.resetting {
            self.used(now, lease);
            return Verdict::AlreadySo;
        }
        if let Err(refusal) = fit {
            return Verdict::Refused(refusal);
        }
        self.used(now, lease);
        self.resetting = true;
        Verdict::Accepted(vec![Act::Reread])
    }

    /// All devices were read after a reset.
    fn reread(&mut self, now: Instant) -> Verdict {
        let there = self.present.m1 && self.present.m2;
        if self.state != State::Faulted || !self.resetting || !there {
            return Verdict::AlreadySo;
        }
        self.resetting = false;
        self.faults.clear();
        let mut acts = vec![Act::Note(EventKind::Reset)];
        acts.extend(self.enter(now, State::Idle));
        Verdict::Accepted(acts)
    }

    /// Where something moves that nobody here has told to, it is halted, and idle waits for its rest.
    fn up(&mut self, now: Instant, member: Member, moves: bool) -> Verdict {
        if let Member::Manipulator(carrier) = member {
            *self.present.get_mut(carrier) = true;
        }
        let complete = self.present.m1 && self.present.m2;
        match self.state {
            State::Offline if complete && !moves => Verdict::Accepted(self.enter(now, State::Idle)),
            State::Offline if complete => Verdict::Accepted(self.stopping(now, JobEnd::Done, None)),
            State::Offline if moves => Verdict::Accepted(vec![Act::Halt]),
            State::Idle if moves => Verdict::Accepted(self.stopping(now, JobEnd::Done, None)),
            State::Offline | State::Idle | State::Scanning | State::Moving | State::Stopping | State::Faulted => done(),
        }
    }

    /// A device that can move is in doubt from here on; the sensor only while it scans.
    fn lost(&mut self, now: Instant, member: Member, fault: Fault) -> Verdict {
        if let Member::Manipulator(carrier) = member {
            *self.present.get_mut(carrier) = false;
        }
        let matters = match member {
            Member::Manipulator(_) | Member::Stage => self.state != State::Offline,
            Member::Sensor => self.state == State::Scanning,
        };
        if matters { self.fault(now, fault) } else { done() }
    }

    fn fault(&mut self, now: Instant, fault: Fault) -> Verdict {
        self.resetting = false;
        let known = self.faults.iter().any(|one| one.device == fault.device && one.failure == fault.failure);
        // What is not kept would be new each time it is said, and would halt each time.
        if (known || self.faults.len() >= FAULTS_KEPT) && self.state == State::Faulted {
            return Verdict::AlreadySo;
        }
        let mut acts = vec![Act::Halt];
        if self.faults.len() < FAULTS_KEPT {
            acts.push(Act::Note(EventKind::Faulted(fault.clone())));
            self.faults.push(fault.clone());
        }
        if let Some(Course { activity: Some(activity), .. }) = self.course.take() {
            acts.extend(ended(&activity, end_by(fault.failure)));
        }
        acts.extend(self.enter(now, State::Faulted));
        Verdict::Accepted(acts)
    }

    fn finished(&mut self, now: Instant) -> Verdict {
        if !matches!(self.state, State::Moving | State::Scanning) {
            return Verdict::AlreadySo;
        }
        Verdict::Accepted(self.come_to_rest(now))
    }

    fn given_up(&mut self, now: Instant, failure: Failure) -> Verdict {
        if !matches!(self.state, State::Moving | State::Scanning) {
            return Verdict::AlreadySo;
        }
        Verdict::Accepted(self.stopping(now, JobEnd::Failed(failure), None))
    }

    fn at_rest(&mut self, now: Instant) -> Verdict {
        if self.state != State::Stopping {
            return Verdict::AlreadySo;
        }
        Verdict::Accepted(self.come_to_rest(now))
    }

    /// Ends what was under way, and is idle.
    fn come_to_rest(&mut self, now: Instant) -> Vec<Act> {
        let mut acts = Vec::new();
        if let Some(Course { activity: Some(activity), end }) = self.course.take() {
            acts.extend(ended(&activity, end));
        }
        acts.extend(self.enter(now, State::Idle));
        acts
    }

    /// Ends a lease that has run out.
    fn time(&mut self, now: Instant) -> Vec<Act> {
        let over = self.tenancy.expire(now);
        over.map_or_else(Vec::new, |lease| self.lease_ended(now, lease, StopCause::LeaseOver))
    }

    fn enter(&mut self, now: Instant, to: State) -> Vec<Act> {
        let from = self.state;
        if from == to {
            return Vec::new();
        }
        (self.state, self.since) = (to, now);
        vec![Act::Note(EventKind::StateChanged { from, to })]
    }
}

/// How a fault ends what was under way.
fn end_by(failure: Failure) -> JobEnd {
    if failure.leaves_unknown() { JobEnd::Unknown(failure) } else { JobEnd::Failed(failure) }
}

fn ended(activity: &Activity, end: JobEnd) -> Vec<Act> {
    match activity.job() {
        Some(job) => {
            let note = Act::Note(EventKind::JobEnded { job: job.to_owned(), end: end.clone() });
            vec![note, Act::End(end)]
        }
        None => Vec::new(),
    }
}

const fn done() -> Verdict {
    Verdict::Accepted(Vec::new())
}
