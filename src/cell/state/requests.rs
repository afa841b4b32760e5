//! What is asked of the machine: the lease, commands, jobs, stops and resets. Each is accepted, was so already, or is refused.

use super::{Course, Machine, State, done};
use crate::cell::events::EventKind;
use crate::cell::failure::StopCause;
use crate::cell::input::{Act, Activity, Manual, Taken, Verdict};
use crate::cell::job::JobEnd;
use crate::cell::lease::{Lease, LeaseRequest};
use crate::cell::refusal::Refusal;
use crate::motion::Carrier;
use tokio::time::Instant;

impl Machine {
    pub(super) fn take_lease(&mut self, now: Instant, request: &LeaseRequest) -> Verdict {
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

    pub(super) fn release_lease(&mut self, now: Instant, id: &str) -> Verdict {
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

    pub(super) fn command(
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

    pub(super) fn start(&mut self, now: Instant, lease: &str, activity: Activity, fit: Result<(), Refusal>) -> Verdict {
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
    pub(super) fn halt(&mut self, now: Instant, cause: StopCause) -> Verdict {
        Verdict::Accepted(match self.state {
            State::Offline | State::Faulted => {
                vec![Act::Halt, Act::Note(EventKind::Stopping { cause: Some(cause) })]
            }
            State::Idle | State::Scanning | State::Moving | State::Stopping => {
                self.stopping(now, JobEnd::Stopped(cause), Some(cause))
            }
        })
    }

    pub(super) fn reset(&mut self, now: Instant, lease: &str, fit: Result<(), Refusal>) -> Verdict {
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

    /// Ends a lease that has run out.
    pub(super) fn time(&mut self, now: Instant) -> Vec<Act> {
        let over = self.tenancy.expire(now);
        over.map_or_else(Vec::new, |lease| self.lease_ended(now, lease, StopCause::LeaseOver))
    }
}
