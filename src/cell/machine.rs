//! The state machine of the cell. It takes an input with its time, and returns a verdict: accepted with the effects to execute,
//! already in the requested state, or refused with the reason. Requests can be refused; events (a device is reached, lost or
//! faulty, work ends, everything is at rest) cannot. Pure: no locks, no waiting, no clock. `state` has the diagram.

use super::events::EventKind;
use super::failure::{Failure, Fault, JobEnd, StopCause};
use super::input::{Activity, Effect, Input, Manual, Member, Taken, Verdict};
use super::lease::{Lease, LeaseKeeper, LeaseRequest, TimeToLiveBounds};
use super::refusal::Refusal;
use super::state::State;
use crate::motion::{Carrier, Pair};
use tokio::time::Instant;

/// The current activity, and how its job ends when the cell comes to rest.
#[derive(Debug, Clone, PartialEq)]
struct CurrentActivity {
    activity: Option<Activity>,
    end: JobEnd,
}

/// The state machine.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Machine {
    state: State,
    since: Instant,
    motions_count: u64,
    /// A move or a homing has begun, and the cell has not been idle since.
    part_moves: bool,
    present: Pair<bool>,
    current: Option<CurrentActivity>,
    leases: LeaseKeeper,
    faults: Vec<Fault>,
    resetting: bool,
    closing: bool,
}

impl Machine {
    /// Offline, without a lease. Every new fencing token is greater than `fence_floor`.
    pub(super) fn new(now: Instant, bounds: TimeToLiveBounds, fence_floor: u64) -> Self {
        Self {
            state: State::Offline,
            since: now,
            motions_count: 0,
            part_moves: false,
            present: Pair::default(),
            current: None,
            leases: LeaseKeeper::new(bounds, fence_floor),
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

    /// A counter that increases with everything that may have moved the part.
    pub(super) const fn motions_count(&self) -> u64 {
        self.motions_count
    }

    pub(super) const fn leases(&self) -> &LeaseKeeper {
        &self.leases
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

    /// The activity that is under way or coming to rest.
    pub(super) fn activity(&self) -> Option<&Activity> {
        self.current.as_ref()?.activity.as_ref()
    }

    /// Decides on an input, and changes the state if it is accepted.
    pub(super) fn put(&mut self, now: Instant, input: Input) -> Verdict {
        match input {
            Input::TakeLease(request) => self.take_lease(now, &request),
            Input::RenewLease(id) => self.leases.renew(now, &id).map_or_else(Verdict::Refused, |_| done()),
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

    /// Enters `stopping`. If the cell is already in that state, it halts again and keeps the first reason.
    fn stopping(&mut self, now: Instant, end: JobEnd, cause: Option<StopCause>) -> Vec<Effect> {
        let mut effects = vec![Effect::Halt, Effect::Note(EventKind::Stopping { cause })];
        if self.state != State::Stopping {
            let activity = self.current.take().and_then(|current| current.activity);
            self.current = Some(CurrentActivity { activity, end });
            effects.extend(self.enter(now, State::Stopping));
        }
        effects
    }

    fn enter(&mut self, now: Instant, to: State) -> Vec<Effect> {
        let from = self.state;
        if from == to {
            return Vec::new();
        }
        (self.state, self.since) = (to, now);
        if self.part_moves || to == State::Moving {
            self.motions_count = self.motions_count.saturating_add(1);
            self.part_moves = to != State::Idle;
        }
        vec![Effect::Note(EventKind::StateChanged { from, to })]
    }
}

const fn done() -> Verdict {
    Verdict::Accepted(Vec::new())
}

/// Number of faults that are kept; an operator needs no more.
const FAULTS_KEPT: usize = 32;

impl Machine {
    /// If a device moves without a command from coaxis, it is halted, and the cell becomes idle when it is at rest.
    fn up(&mut self, now: Instant, member: Member, moves: bool) -> Verdict {
        if let Member::Manipulator(carrier) = member {
            *self.present.get_mut(carrier) = true;
        }
        let complete = self.present.m1 && self.present.m2;
        match self.state {
            State::Offline if complete && !moves => Verdict::Accepted(self.enter(now, State::Idle)),
            State::Offline if complete => Verdict::Accepted(self.stopping(now, JobEnd::Done, None)),
            State::Offline if moves => Verdict::Accepted(vec![Effect::Halt]),
            State::Idle if moves => Verdict::Accepted(self.stopping(now, JobEnd::Done, None)),
            State::Offline | State::Idle | State::Scanning | State::Moving | State::Stopping | State::Faulted => done(),
        }
    }

    /// The state of a movable device is unknown from here on; a lost sensor is a fault only during a scan.
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
        // A fault that is not kept would count as new, and halt the devices, each time that it is reported.
        if (known || self.faults.len() >= FAULTS_KEPT) && self.state == State::Faulted {
            return Verdict::AlreadySo;
        }
        let mut effects = vec![Effect::Halt];
        if self.faults.len() < FAULTS_KEPT {
            effects.push(Effect::Note(EventKind::Faulted(fault.clone())));
            self.faults.push(fault.clone());
        }
        if let Some(CurrentActivity { activity: Some(activity), .. }) = self.current.take() {
            effects.extend(ended(&activity, end_by(fault.failure)));
        }
        effects.extend(self.enter(now, State::Faulted));
        Verdict::Accepted(effects)
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

    /// Ends the activity, and enters `idle`.
    fn come_to_rest(&mut self, now: Instant) -> Vec<Effect> {
        let mut effects = Vec::new();
        if let Some(CurrentActivity { activity: Some(activity), end }) = self.current.take() {
            effects.extend(ended(&activity, end));
        }
        effects.extend(self.enter(now, State::Idle));
        effects
    }

    /// Handles that all devices were read after a reset.
    fn reread(&mut self, now: Instant) -> Verdict {
        let there = self.present.m1 && self.present.m2;
        if self.state != State::Faulted || !self.resetting || !there {
            return Verdict::AlreadySo;
        }
        self.resetting = false;
        self.faults.clear();
        let mut effects = vec![Effect::Note(EventKind::Reset)];
        effects.extend(self.enter(now, State::Idle));
        Verdict::Accepted(effects)
    }
}

/// How a failure ends the current job.
fn end_by(failure: Failure) -> JobEnd {
    if failure.leaves_unknown() { JobEnd::Unknown(failure) } else { JobEnd::Failed(failure) }
}

fn ended(activity: &Activity, end: JobEnd) -> Vec<Effect> {
    match activity.job() {
        Some(job) => {
            let note = Effect::Note(EventKind::JobEnded { job: job.to_owned(), end: end.clone() });
            vec![note, Effect::End(end)]
        }
        None => Vec::new(),
    }
}

impl Machine {
    fn take_lease(&mut self, now: Instant, request: &LeaseRequest) -> Verdict {
        if self.closing {
            return Verdict::Refused(Refusal::Closing);
        }
        // A motion of the previous lease stops, however soon the next lease is taken.
        let mut effects = self.time(now);
        let before = self.leases.fence();
        match self.leases.take(now, request) {
            Ok(Lease { fence, .. }) if fence == before => Verdict::AlreadySo,
            Ok(Lease { holder, fence, .. }) => {
                effects.push(Effect::Note(EventKind::LeaseTaken { holder, fence }));
                Verdict::Accepted(effects)
            }
            Err(refusal) => Verdict::Refused(refusal),
        }
    }

    fn release_lease(&mut self, now: Instant, id: &str) -> Verdict {
        let held = self.leases.held(now).cloned();
        match (self.leases.release(now, id), held) {
            (Ok(()), Some(lease)) => Verdict::Accepted(self.lease_ended(now, lease, StopCause::LeaseReleased)),
            (Ok(()), None) => done(),
            (Err(refusal), _) => Verdict::Refused(refusal),
        }
    }

    /// A motion that was started under the lease stops when the lease ends.
    fn lease_ended(&mut self, now: Instant, lease: Lease, cause: StopCause) -> Vec<Effect> {
        let ran_out = cause == StopCause::LeaseOver;
        let mut effects =
            vec![Effect::Note(EventKind::LeaseEnded { holder: lease.holder, fence: lease.fence, ran_out })];
        if matches!(self.state, State::Moving | State::Scanning) {
            effects.extend(self.stopping(now, JobEnd::Stopped(cause), Some(cause)));
        }
        effects
    }

    /// Checks the preconditions of every command: a cell that is not closing, the lease, no fault, and no activity.
    fn admit(&mut self, now: Instant, lease: &str, verb: &'static str) -> Result<(), Refusal> {
        self.leased(now, lease)?;
        match self.state {
            State::Idle => Ok(()),
            State::Faulted => Err(Refusal::Faulted { count: self.faults.len() }),
            State::Offline | State::Scanning | State::Moving | State::Stopping => Err(self.wrong_state(verb)),
        }
    }

    fn leased(&self, now: Instant, lease: &str) -> Result<(), Refusal> {
        if self.closing { Err(Refusal::Closing) } else { self.leases.check(now, lease) }
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
                    Taken::Accepted => Verdict::Accepted(vec![Effect::Command(carrier, manual)]),
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
        let mut effects = self.enter(now, activity.state());
        effects.extend(activity.job().map(|job| Effect::Note(EventKind::JobStarted { job: job.to_owned() })));
        effects.push(Effect::Begin);
        self.current = Some(CurrentActivity { activity: Some(activity), end: JobEnd::Done });
        Verdict::Accepted(effects)
    }

    /// Renews a lease that was checked.
    fn used(&mut self, now: Instant, lease: &str) {
        // It was checked at the same `now`, so it cannot be refused.
        let _renewed = self.leases.renew(now, lease);
    }

    /// Halts in every state, and enters `stopping` unless the cell is offline or faulted.
    fn halt(&mut self, now: Instant, cause: StopCause) -> Verdict {
        Verdict::Accepted(match self.state {
            State::Offline | State::Faulted => {
                vec![Effect::Halt, Effect::Note(EventKind::Stopping { cause: Some(cause) })]
            }
            State::Idle | State::Scanning | State::Moving | State::Stopping => {
                self.stopping(now, JobEnd::Stopped(cause), Some(cause))
            }
        })
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
        Verdict::Accepted(vec![Effect::Reread])
    }

    /// Ends a lease that has expired.
    fn time(&mut self, now: Instant) -> Vec<Effect> {
        let over = self.leases.expire(now);
        over.map_or_else(Vec::new, |lease| self.lease_ended(now, lease, StopCause::LeaseOver))
    }
}
