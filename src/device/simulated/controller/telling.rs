//! How a made controller is, as it says it: the whole device, and each axis.

use super::Controller;
use super::course::Task;
use crate::device::manipulator::{AxisReading, AxisState, Reading};
use crate::motion::{Axis, AxisLimits};
use std::time::Duration;

/// The heartbeat counts once in this time.
const BEAT: Duration = Duration::from_millis(10);

impl Controller {
    /// How it is. Does not count as a heartbeat.
    #[must_use]
    pub fn reading(&mut self, now: Duration) -> Reading {
        self.advance(now);
        Reading {
            state: self.state(),
            mode: self.mode,
            safety: self.safety,
            acknowledged: self.acknowledged,
            fault_code: self.fault.or(self.refusal).unwrap_or(0),
            heartbeat: (now.as_millis() / BEAT.as_millis() % 0x1_0000) as u16,
            axes: self.settings.limits.map(|axis, limits| self.axis_reading(axis, limits)),
        }
    }

    fn state(&self) -> AxisState {
        match self.task {
            Task::Stop { .. } => AxisState::Stopping,
            _ if self.fault.is_some() => AxisState::ErrorStop,
            _ if !self.powered => AxisState::Disabled,
            Task::Home { .. } => AxisState::Homing,
            Task::Move => AxisState::DiscreteMotion,
            Task::Rest => AxisState::Standstill,
        }
    }

    fn axis_reading(&self, axis: Axis, limits: &AxisLimits) -> AxisReading {
        let servo = self.servos.get(axis);
        let device = self.state();
        let concerned = match self.task {
            Task::Home { axes, .. } => *axes.get(axis),
            Task::Rest | Task::Move | Task::Stop { .. } => !servo.rests(),
        };
        AxisReading {
            actual: servo.position(),
            commanded: servo.position(),
            lower: limits.lower,
            upper: limits.upper,
            speed: limits.speed,
            state: if device.moves() && !concerned { AxisState::Standstill } else { device },
            homed: *self.homed.get(axis),
            in_position: servo.rests(),
            fault: *self.limit_hit.get(axis),
            limit_hit: *self.limit_hit.get(axis),
        }
    }
}
