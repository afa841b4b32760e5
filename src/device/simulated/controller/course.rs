//! What a made controller does over time: runs its axes in even steps, ends what is done, stops what must not go on.

use super::{Controller, code};
use crate::device::manipulator::{Action, CommandResult};
use crate::motion::{Axes, Axis};
use std::time::Duration;

/// A step of simulated time, s.
const STEP_S: f64 = 0.001;

/// What is under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Task {
    Rest,
    Move,
    Home { axes: Axes<bool>, until_step: u64 },
    Stop { then_off: bool },
}

impl Controller {
    /// Lets simulated time run on to `now`. In even steps, so that it does not matter how often anyone looks.
    pub(in super::super) fn advance(&mut self, now: Duration) {
        let due = (now.as_secs_f64() * self.settings.time_factor / STEP_S + 1e-6) as u64;
        while self.steps < due {
            if self.task == Task::Rest {
                self.steps = due;
                return;
            }
            self.steps += 1;
            self.step();
        }
    }

    fn step(&mut self) {
        let deadline_s = (self.heard + self.watchdog).as_secs_f64() * self.settings.time_factor;
        let moves = matches!(self.task, Task::Move | Task::Home { .. });
        if moves && self.steps as f64 * STEP_S > deadline_s {
            self.fail(code::WATCHDOG);
        }
        if self.acknowledged.result == CommandResult::Accepted {
            self.acknowledged.result = CommandResult::Running;
        }
        for axis in Axis::ALL {
            let servo = self.servos.get_mut(axis);
            if *self.stuck.get(axis) { servo.stick() } else { servo.step(STEP_S) }
        }
        self.mechanics.follow(&self.servos.map(|_, servo| servo.position()));
        if self.servos.iter().all(|(_, servo)| servo.rests()) {
            self.arrive();
        }
    }

    /// All axes stand: ends what was to be done.
    fn arrive(&mut self) {
        match self.task {
            Task::Home { until_step, .. } if self.steps < until_step => return,
            Task::Home { axes, .. } => self.homed = self.homed.map(|axis, homed| *homed || *axes.get(axis)),
            Task::Stop { then_off: true } => self.powered = false,
            Task::Rest | Task::Move | Task::Stop { then_off: false } => {}
        }
        self.task = Task::Rest;
        if matches!(self.acknowledged.result, CommandResult::Accepted | CommandResult::Running) {
            self.acknowledged.result = CommandResult::Done;
        }
    }

    /// Latches a fault; stops what moves.
    pub(super) fn fail(&mut self, code: u32) {
        self.fault = Some(code);
        self.abort();
    }

    /// Stops what moves, and says that what was asked has not come to its end.
    pub(super) fn abort(&mut self) {
        if matches!(self.acknowledged.result, CommandResult::Accepted | CommandResult::Running) {
            self.acknowledged.result = CommandResult::Aborted;
        }
        self.stop(false);
    }

    fn stop(&mut self, then_off: bool) {
        for axis in Axis::ALL {
            self.servos.get_mut(axis).brake();
        }
        self.task = Task::Stop { then_off };
    }

    pub(super) fn execute(&mut self, action: &Action) {
        match *action {
            Action::Enable => self.powered = true,
            Action::Disable => self.stop(true),
            Action::Reset => (self.fault, self.limit_hit) = (None, Axes::default()),
            Action::Halt => self.stop(false),
            Action::Home { axes } => {
                let until_step = self.steps + (self.settings.homing_s / STEP_S) as u64;
                self.homed = self.homed.map(|axis, homed| *homed && !*axes.get(axis));
                self.task = Task::Home { axes, until_step };
            }
            Action::MoveTo { axes, targets, speeds } => {
                for axis in Axis::ALL.into_iter().filter(|axis| *axes.get(*axis)) {
                    self.servos.get_mut(axis).go(*targets.get(axis), *speeds.get(axis));
                }
                self.task = Task::Move;
            }
        }
        if matches!(action, Action::Enable | Action::Reset) && self.task == Task::Rest {
            self.acknowledged.result = CommandResult::Done;
        }
    }
}
