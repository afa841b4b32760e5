//! The mechanics of the simulated devices: a driven axis that moves to a target with limited speed and acceleration, or brakes; the
//! backlash and the cross-coupling between the encoders of a manipulator and its clamp; and the linear stage, which moves within
//! its limits and is stopped by its watchdog. Pure.

use std::time::Duration;

use crate::device::sensor::StageReading;
use crate::motion::{Axes, Position};

use super::settings::StageSettings;

/// An axis closer to its target than this has arrived, mm or rad.
const AT_TARGET: f64 = 1e-9;

/// A driven axis, moving or at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Servo {
    position: f64,
    velocity: f64,
    target: f64,
    speed: f64,
    acceleration: f64,
    braking: bool,
}

impl Servo {
    /// At rest at `position`.
    pub(super) const fn at(position: f64, acceleration: f64) -> Self {
        Self { position, velocity: 0.0, target: position, speed: 0.0, acceleration, braking: false }
    }

    /// Its position.
    pub(super) const fn position(&self) -> f64 {
        self.position
    }

    /// Whether it is at rest at its target.
    pub(super) fn rests(&self) -> bool {
        self.velocity == 0.0 && !self.braking && self.position == self.target
    }

    /// Sends it to `target` with at most `speed`.
    pub(super) const fn go(&mut self, target: f64, speed: f64) {
        (self.target, self.speed, self.braking) = (target, speed, false);
    }

    /// Brakes with the greatest deceleration until it is at rest.
    pub(super) const fn brake(&mut self) {
        self.braking = true;
    }

    /// Blocks it: it stops at once, and tries to continue unless it brakes.
    pub(super) fn stick(&mut self) {
        self.velocity = 0.0;
        if self.braking {
            (self.target, self.braking) = (self.position, false);
        }
    }

    /// Advances it by `dt` seconds.
    pub(super) fn step(&mut self, dt: f64) {
        let left = self.target - self.position;
        let wanted = if self.braking { 0.0 } else { self.approach(left.abs(), dt).copysign(left) };
        let change = self.acceleration * dt;
        self.velocity += (wanted - self.velocity).clamp(-change, change);
        self.position += self.velocity * dt;
        if self.braking && self.velocity == 0.0 {
            (self.target, self.braking) = (self.position, false);
        }
        if !self.braking && (self.target - self.position).abs() < AT_TARGET && self.velocity.abs() <= change {
            (self.position, self.velocity) = (self.target, 0.0);
        }
    }

    /// The greatest speed from which it still stops within `left`. In steps of a·dt the braking distance is v²/2a + v·dt/2.
    fn approach(&self, left: f64, dt: f64) -> f64 {
        let step = self.acceleration * dt;
        let braking = step * ((0.25 + 2.0 * left / (step * dt)).sqrt() - 0.5);
        self.speed.min(braking).min(left / dt)
    }
}

/// The clamp of one manipulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mechanics {
    backlash: Axes<f64>,
    coupling_ratio: f64,
    /// Position of each axis' load: within half the backlash of its encoder.
    loads: Position,
}

impl Mechanics {
    /// Initially every axis is in the middle of its backlash.
    pub(super) const fn new(start: Position, backlash: Axes<f64>, coupling_ratio: f64) -> Self {
        Self { backlash, coupling_ratio, loads: start }
    }

    /// Follows the encoders; a load moves with its encoder once the backlash is used up.
    pub(super) fn follow(&mut self, encoders: &Position) {
        self.loads = self.loads.map(|axis, load| {
            let (encoder, half) = (*encoders.get(axis), 0.5 * self.backlash.get(axis).abs());
            load.max(encoder - half).min(encoder + half)
        });
    }

    /// Position of the clamp. The linear axes are not exactly perpendicular, so that each shows a fraction of the other two.
    pub(super) fn clamp(&self) -> Position {
        let Axes { x, y, z, c } = self.loads;
        let share = self.coupling_ratio;
        Axes { x: x + share * (y + z), y: y + share * (x + z), z: z + share * (x + y), c }
    }
}

/// A step of simulated time, s.
const STEP_S: f64 = 0.001;
/// No heartbeat arrived within the watchdog time.
pub const STAGE_WATCHDOG: u32 = 1;
/// It does not move although it is commanded to.
pub const STAGE_STALLED: u32 = 2;
/// A target or a speed is outside the limits; nothing was executed.
pub const STAGE_OUT_OF_LIMITS: u32 = 101;
/// Relative tolerance of the limits.
const SLACK: f64 = 1e-6;

/// The stage.
#[derive(Debug, Clone)]
pub(super) struct Carriage {
    settings: StageSettings,
    time_factor: f64,
    steps: u64,
    heard: Duration,
    servo: Servo,
    stalled: bool,
    fault_code: u32,
    out_of_limits_count: u64,
}

impl Carriage {
    pub(super) fn new(settings: StageSettings, time_factor: f64) -> Self {
        let servo = Servo::at(settings.start_mm, settings.acceleration_mm_s2);
        Self {
            settings,
            time_factor,
            steps: 0,
            heard: Duration::ZERO,
            servo,
            stalled: false,
            fault_code: 0,
            out_of_limits_count: 0,
        }
    }

    /// Moves it to a target. A new command acknowledges a fault.
    ///
    /// # Errors
    /// The stage's code if it refuses.
    pub(super) fn go(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), u32> {
        let StageSettings { lower_mm, upper_mm, speed_mm_s: greatest, .. } = self.settings;
        let within = (lower_mm - SLACK..=upper_mm + SLACK).contains(&target_mm);
        if !(within && speed_mm_s > 0.0 && speed_mm_s <= greatest * (1.0 + SLACK)) {
            self.out_of_limits_count += 1;
            return Err(STAGE_OUT_OF_LIMITS);
        }
        self.fault_code = 0;
        self.servo.go(target_mm, speed_mm_s);
        Ok(())
    }

    pub(super) const fn halt(&mut self) {
        self.servo.brake();
    }

    pub(super) fn beat(&mut self, now: Duration) {
        self.heard = self.heard.max(now);
    }

    /// Blocks it, or releases it. After the release it stays at rest and does not continue its motion.
    pub(super) const fn stall(&mut self, stalled: bool) {
        self.stalled = stalled;
        if !stalled {
            self.servo.brake();
        }
    }

    pub(super) fn reading(&self) -> StageReading {
        StageReading {
            actual_mm: self.servo.position(),
            lower_mm: self.settings.lower_mm,
            upper_mm: self.settings.upper_mm,
            speed_mm_s: self.settings.speed_mm_s,
            moves: !self.servo.rests() && !self.stalled,
            in_position: self.servo.rests() && !self.stalled,
            fault_code: if self.stalled { STAGE_STALLED } else { self.fault_code },
        }
    }

    pub(super) const fn position(&self) -> f64 {
        self.servo.position()
    }

    /// The number of refused targets and speeds outside the limits.
    pub(super) const fn out_of_limits_count(&self) -> u64 {
        self.out_of_limits_count
    }

    /// Advances by one step towards `now`, and returns its time; `None` if it is up to date, or at rest.
    pub(super) fn step_towards(&mut self, now: Duration) -> Option<Duration> {
        let due = (now.as_secs_f64() * self.time_factor / STEP_S + 1e-6) as u64;
        if self.servo.rests() || self.stalled {
            self.steps = self.steps.max(due);
        }
        if self.steps >= due {
            return None;
        }
        self.steps += 1;
        let at = Duration::from_secs_f64(self.steps as f64 * STEP_S / self.time_factor);
        let watchdog = Duration::from_secs_f64(self.settings.watchdog_ms / 1000.0);
        if self.fault_code == 0 && at > self.heard + watchdog {
            self.fault_code = STAGE_WATCHDOG;
            self.servo.brake();
        }
        self.servo.step(STEP_S);
        Some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.001;

    #[test]
    fn an_axis_arrives_exactly_in_the_time_of_a_trapezoidal_profile() {
        // 30 mm at 10 mm/s and 50 mm/s²: s/v + v/a = 3.2 s.
        for target in [30.0, -30.0] {
            let mut servo = Servo::at(0.0, 50.0);
            servo.go(target, 10.0);
            let (mut steps, mut farthest) = (0, 0.0_f64);
            while !servo.rests() {
                servo.step(DT);
                farthest = farthest.max(servo.position().abs());
                steps += 1;
                assert!(steps < 10_000);
            }
            assert!(servo.position() == target && farthest <= 30.0 + 1e-9, "{farthest}");
            assert!((f64::from(steps) * DT - 3.2).abs() < 0.01, "{steps}");
        }
    }

    #[test]
    fn an_axis_keeps_its_speed_limit_and_its_braking_distance() {
        let mut servo = Servo::at(0.0, 50.0);
        servo.go(100.0, 10.0);
        for _ in 0..1_000 {
            let before = servo.position();
            servo.step(DT);
            assert!(servo.position() - before <= 10.0 * DT + 1e-12);
        }
        let from = servo.position();
        servo.brake();
        while !servo.rests() {
            servo.step(DT);
        }
        // v²/2a = 1 mm.
        assert!((servo.position() - from - 1.0).abs() < 0.02, "{}", servo.position() - from);
    }
}

#[cfg(test)]
mod mechanics_tests {
    use super::*;

    #[test]
    fn only_a_reversal_of_direction_loses_the_backlash() {
        let backlash = Axes::from_fn(|_| 0.05);
        let mut clamp = Mechanics::new(Axes::default(), backlash, 0.0);
        let mut at = |y: f64| {
            clamp.follow(&Axes { y, ..Axes::default() });
            clamp.clamp().y
        };
        let seen = [at(1.0), at(2.0), at(1.98), at(1.95), at(1.0)];
        let due = [0.975, 1.975, 1.975, 1.975, 1.025];
        for (seen, due) in seen.into_iter().zip(due) {
            assert!((seen - due).abs() < 1e-12, "{seen} instead of {due}");
        }
    }

    #[test]
    fn a_linear_axis_couples_into_the_two_others_but_not_into_the_rotation() {
        let mut clamp = Mechanics::new(Axes::default(), Axes::default(), 0.02);
        clamp.follow(&Axes { z: 10.0, ..Axes::default() });
        assert_eq!(clamp.clamp(), Axes { x: 0.2, y: 0.2, z: 10.0, c: 0.0 });
    }
}
