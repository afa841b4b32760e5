//! The execution of commands over time: moves the axes in equal steps, ends completed actions and stops motions that must not
//! continue; and decides which actions are refused, with a [`code`], because of the mode, safety functions, references or limits.

use std::time::Duration;

use crate::device::manipulator::{Action, CommandResult, Mode};
use crate::motion::{Axes, Axis, Position};

use super::{Controller, Motion, code};

/// A step of simulated time, s.
const STEP_S: f64 = 0.001;

impl Controller {
    /// Advances the simulated time to `now`, in equal steps, so that the result does not depend on how often it is called.
    pub(in crate::device::simulated) fn advance(&mut self, now: Duration) {
        let due = (now.as_secs_f64() * self.settings.time_factor / STEP_S + 1e-6) as u64;
        while self.steps < due {
            if self.motion == Motion::Rest {
                self.steps = due;
                return;
            }
            self.steps += 1;
            self.step();
        }
    }

    fn step(&mut self) {
        let deadline_s = (self.heard + self.watchdog).as_secs_f64() * self.settings.time_factor;
        let moves = matches!(self.motion, Motion::Move | Motion::Home { .. });
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

    /// Ends the action when all axes are at rest.
    fn arrive(&mut self) {
        match self.motion {
            Motion::Home { until_step, .. } if self.steps < until_step => return,
            Motion::Home { axes, .. } => self.homed = self.homed.map(|axis, homed| *homed || *axes.get(axis)),
            Motion::Stop { then_off: true } => self.powered = false,
            Motion::Rest | Motion::Move | Motion::Stop { then_off: false } => {}
        }
        self.motion = Motion::Rest;
        if matches!(self.acknowledged.result, CommandResult::Accepted | CommandResult::Running) {
            self.acknowledged.result = CommandResult::Done;
        }
    }

    /// Latches a fault, and stops the motion.
    pub(super) fn fail(&mut self, code: u32) {
        self.fault = Some(code);
        self.abort();
    }

    /// Stops the motion, and reports the command as aborted.
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
        self.motion = Motion::Stop { then_off };
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
                self.motion = Motion::Home { axes, until_step };
            }
            Action::MoveTo { axes, targets, speeds } => {
                for axis in Axis::ALL.into_iter().filter(|axis| *axes.get(*axis)) {
                    self.servos.get_mut(axis).go(*targets.get(axis), *speeds.get(axis));
                }
                self.motion = Motion::Move;
            }
        }
        if matches!(action, Action::Enable | Action::Reset) && self.motion == Motion::Rest {
            self.acknowledged.result = CommandResult::Done;
        }
    }
}

/// Relative and absolute tolerance of a limit, because the protocol may use single precision.
const SLACK: f64 = 1e-6;

impl Controller {
    /// Returns the [`code`] with which an action is refused.
    pub(super) fn refusal_of(&mut self, action: &Action) -> Result<(), u32> {
        if let Some(code) = self.refuse_next.take() {
            return Err(code);
        }
        // A stop has no preconditions.
        let wants_motion = match action {
            Action::Halt | Action::Disable => return Ok(()),
            Action::Reset => false,
            Action::Enable | Action::Home { .. } | Action::MoveTo { .. } => true,
        };
        if self.mode != Mode::Automatic {
            return Err(code::NOT_REMOTE);
        }
        if wants_motion && !self.safety.allows_motion() {
            return Err(code::SAFETY_OPEN);
        }
        if wants_motion && self.fault.is_some() {
            return Err(code::FAULTED);
        }
        match action {
            Action::Home { axes } => self.may_move(axes),
            Action::MoveTo { axes, targets, speeds } => self.may_go(axes, targets, speeds),
            Action::Enable | Action::Disable | Action::Reset | Action::Halt => Ok(()),
        }
    }

    fn may_move(&self, axes: &Axes<bool>) -> Result<(), u32> {
        if !self.powered || matches!(self.motion, Motion::Stop { then_off: true }) {
            return Err(code::NOT_ENABLED);
        }
        if axes.iter().any(|(_, named)| *named) { Ok(()) } else { Err(code::NO_AXIS) }
    }

    /// The limits are checked first, so that a wrong target is reported and recorded even if there are other reasons to refuse.
    fn may_go(&self, axes: &Axes<bool>, targets: &Position, speeds: &Position) -> Result<(), u32> {
        for (axis, limits) in self.settings.limits.iter().filter(|(axis, _)| *axes.get(*axis)) {
            let (target, speed, here) = (*targets.get(axis), *speeds.get(axis), self.servos.get(axis).position());
            let slack = |limit: f64| SLACK * (1.0 + limit.abs());
            if !(limits.lower - slack(limits.lower)..=limits.upper + slack(limits.upper)).contains(&target) {
                return Err(code::OUT_OF_LIMITS);
            }
            let stays = (target - here).abs() <= slack(here);
            let lowest_ok = speed > 0.0 || (stays && speed == 0.0);
            if !(lowest_ok && speed <= limits.speed + SLACK * limits.speed) {
                return Err(code::SPEED);
            }
        }
        self.may_move(axes)?;
        let known = axes.iter().all(|(axis, named)| !named || *self.homed.get(axis));
        if known { Ok(()) } else { Err(code::NOT_HOMED) }
    }
}
