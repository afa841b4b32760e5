//! What happens to the machine: devices come, go and fail, work ends, everything stands. None of it can be refused; where it
//! makes no difference any more, it was so already.

use super::{Course, Machine, State, done};
use crate::cell::events::EventKind;
use crate::cell::failure::{Failure, Fault};
use crate::cell::input::{Act, Activity, Member, Verdict};
use crate::cell::job::JobEnd;
use tokio::time::Instant;

/// How many faults are kept; what comes after them adds nothing an operator needs.
const FAULTS_KEPT: usize = 32;

impl Machine {
    /// Where something moves that nobody here has told to, it is halted, and idle waits for its rest.
    pub(super) fn up(&mut self, now: Instant, member: Member, moves: bool) -> Verdict {
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
    pub(super) fn lost(&mut self, now: Instant, member: Member, fault: Fault) -> Verdict {
        if let Member::Manipulator(carrier) = member {
            *self.present.get_mut(carrier) = false;
        }
        let matters = match member {
            Member::Manipulator(_) | Member::Stage => self.state != State::Offline,
            Member::Sensor => self.state == State::Scanning,
        };
        if matters { self.fault(now, fault) } else { done() }
    }

    pub(super) fn fault(&mut self, now: Instant, fault: Fault) -> Verdict {
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

    pub(super) fn finished(&mut self, now: Instant) -> Verdict {
        if !matches!(self.state, State::Moving | State::Scanning) {
            return Verdict::AlreadySo;
        }
        Verdict::Accepted(self.come_to_rest(now))
    }

    pub(super) fn given_up(&mut self, now: Instant, failure: Failure) -> Verdict {
        if !matches!(self.state, State::Moving | State::Scanning) {
            return Verdict::AlreadySo;
        }
        Verdict::Accepted(self.stopping(now, JobEnd::Failed(failure), None))
    }

    pub(super) fn at_rest(&mut self, now: Instant) -> Verdict {
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

    /// All devices were read after a reset.
    pub(super) fn reread(&mut self, now: Instant) -> Verdict {
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
