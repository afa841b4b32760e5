//! What a made controller refuses to do, and why: its own mode, safety, references and limits. In: an action. Out: a [`code`]
//! where it is refused.

use super::course::Task;
use super::{Controller, code};
use crate::device::manipulator::{Action, Mode};
use crate::motion::{Axes, Position};

/// Targets and speeds may pass a limit by this share of one and of the limit: a wire may carry single precision.
const SLACK: f64 = 1e-6;

impl Controller {
    /// Refuses with a [`code`].
    pub(super) fn refusal_of(&mut self, action: &Action) -> Result<(), u32> {
        if let Some(code) = self.refuse_next.take() {
            return Err(code);
        }
        // Whoever wants it to stop is not asked for more.
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
        if !self.powered || matches!(self.task, Task::Stop { then_off: true }) {
            return Err(code::NOT_ENABLED);
        }
        if axes.iter().any(|(_, named)| *named) { Ok(()) } else { Err(code::NO_AXIS) }
    }

    /// The limits come first: a target that is wrong is told, and recorded, whatever else is wrong.
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
