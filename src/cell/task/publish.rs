//! Shows the cell as it is. Decides nothing.

use super::Task;
use crate::cell::input::Activity;
use crate::cell::obstacles;
use crate::cell::refusal::Refusal;
use crate::cell::snapshot::Snapshot;
use crate::cell::state::State;
use crate::cell::work::Course;
use tokio::time::Instant;

impl Task {
    pub(in crate::cell) fn snapshot(&self, sequence: u64, now: Instant) -> Snapshot {
        let reasons = self.reasons(now);
        Snapshot {
            sequence,
            at: now,
            state: self.machine.state(),
            since: self.machine.since(),
            motions_count: self.machine.motions_count(),
            job: self.course.as_ref().and_then(Course::view),
            lease: self.machine.tenancy().view(now),
            faults: self.machine.faults().to_vec(),
            resetting: self.machine.resetting(),
            manipulators: self.live.clone(),
            stage: self.live_stage.clone(),
            sensor: self.live_sensor.clone(),
            commands_allowed: reasons.is_empty(),
            reasons,
        }
    }

    /// What keeps the holder of the lease from beginning a move.
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
