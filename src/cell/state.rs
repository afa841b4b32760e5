//! What the cell does, and what it may do next: requests and events go in with their time, out comes a verdict: accepted with
//! what is to be done, already so, or refused because. Pure: no locks, no waiting, no clock.
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
//!  any --- a link lost (not while offline), a fault, an outcome unknown ---> faulted (every device is told to halt)
//! ```
//!
//! The good path: offline, idle, moving, idle. States ending in -ing are transient; `faulted` is left only by a reset. `requests`
//! decides what is asked, `events` what happens.

mod events;
mod requests;

use super::events::EventKind;
use super::failure::{Fault, StopCause};
use super::input::{Act, Activity, Input, Verdict};
use super::job::JobEnd;
use super::lease::{Bounds, Tenancy};
use crate::motion::Pair;
use tokio::time::Instant;

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
    motions_count: u64,
    /// A move or a homing has begun, and the cell has not been idle since.
    part_moves: bool,
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
            motions_count: 0,
            part_moves: false,
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

    /// Grows with everything that may have moved the part.
    pub(super) const fn motions_count(&self) -> u64 {
        self.motions_count
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

    fn enter(&mut self, now: Instant, to: State) -> Vec<Act> {
        let from = self.state;
        if from == to {
            return Vec::new();
        }
        (self.state, self.since) = (to, now);
        if self.part_moves || to == State::Moving {
            self.motions_count = self.motions_count.saturating_add(1);
            self.part_moves = to != State::Idle;
        }
        vec![Act::Note(EventKind::StateChanged { from, to })]
    }
}

const fn done() -> Verdict {
    Verdict::Accepted(Vec::new())
}
