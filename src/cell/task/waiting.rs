//! Requests that wait until a manipulator has acknowledged its last command and was read after that, so that they are answered
//! by how the device is, and not by how it was before the command. A request waits for a bounded time, and only where the cell
//! is idle and the request has the lease; a stop, a fault and the end of the lease answer it at once.

use super::Task;
use crate::cell::driver::Outcome;
use crate::cell::input::Manual;
use crate::cell::now;
use crate::cell::refusal::Refusal;
use crate::cell::request::{Request, answer};
use crate::cell::state::State;
use crate::cell::work::Purpose;
use crate::device::CommandResult;
use crate::motion::Carrier;
use tokio::time::Instant;

/// Requests that may wait; while there are as many, no other request is taken.
const WAITING_MAX: usize = 256;

/// A request that waits.
#[derive(Debug)]
pub(super) struct Waiting {
    request: Request,
    until: Instant,
}

/// The last command to a manipulator.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Commanded {
    /// When its outcome became known.
    told_at: Option<Instant>,
    /// Its sequence number, where it is a manual command that the device has acknowledged.
    sequence: Option<u16>,
}

/// What the newest reading of a manipulator says about the time after its last command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knowledge {
    /// Nothing: it is older.
    Outdated,
    /// The device is still executing the command.
    Executing,
    /// The device has come to the end of the command.
    Current,
}

impl Task {
    /// Keeps the time at which the outcome of a command became known.
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
        *self.commanded.get_mut(carrier) = Commanded { told_at: Some(now()), sequence };
    }

    pub(super) fn takes_requests(&self) -> bool {
        self.held && self.waiting.len() < WAITING_MAX
    }

    /// Answers a request, or lets it wait, behind those that came before it.
    pub(super) fn answer_or_wait(&mut self, request: Request) {
        if self.waiting.is_empty() && !self.must_wait(&request) {
            self.answer_command(request);
        } else {
            let until = now() + self.settings.acknowledge + self.settings.reply;
            self.waiting.push_back(Waiting { request, until });
        }
    }

    /// Answers those that need not wait any more.
    pub(super) fn take_waiting(&mut self, now: Instant) {
        while self.waiting.front().is_some_and(|first| now >= first.until || !self.must_wait(&first.request)) {
            if let Some(Waiting { request, .. }) = self.waiting.pop_front() {
                self.answer_command(request);
            }
        }
    }

    /// When the first one has waited long enough.
    pub(super) fn waiting_until(&self) -> Option<Instant> {
        self.waiting.front().map(|first| first.until)
    }

    /// What keeps a request from being answered by what was read of a manipulator.
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
            && self.machine.tenancy().check(now(), lease).is_ok();
        may_be_accepted && carriers.iter().any(|carrier| self.knowledge(*carrier) != Knowledge::Current)
    }

    fn knowledge(&self, carrier: Carrier) -> Knowledge {
        let is_out = |purpose: &Purpose| matches!(purpose, Purpose::Manual(one, _) | Purpose::Reset(one) | Purpose::Work(one) if *one == carrier);
        if self.purposes.values().any(is_out) {
            return Knowledge::Outdated;
        }
        let (live, Commanded { told_at, sequence }) = (self.live.get(carrier), *self.commanded.get(carrier));
        let acknowledged = live.reading.as_ref().map(|reading| reading.acknowledged);
        match acknowledged.filter(|one| Some(one.sequence) == sequence).map(|one| one.result) {
            Some(CommandResult::Accepted | CommandResult::Running) => Knowledge::Executing,
            // The reading that shows the end of the command is from after its acknowledgement.
            Some(_) => Knowledge::Current,
            None if told_at.is_some() && live.read_at < told_at => Knowledge::Outdated,
            None => Knowledge::Current,
        }
    }

    fn answer_command(&mut self, request: Request) {
        match request {
            Request::Act { lease, carrier, manual, reply } => answer(reply, self.manual(lease, carrier, manual)),
            Request::Move { lease, job, path, reply } => answer(reply, self.start_move(lease, &job, path)),
            // Only these two are ever given here.
            Request::TakeLease(..)
            | Request::RenewLease(..)
            | Request::ReleaseLease(..)
            | Request::Scan { .. }
            | Request::Reset { .. }
            | Request::Close(_) => {}
        }
    }
}
