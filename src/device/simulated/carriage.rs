//! The linear stage as its drive would be one: goes where it is sent within its limits, stops when nobody is heard. In:
//! targets, heartbeats and the caller's clock. Out: where it is. Pure; must not know what it carries.

use super::servo::Servo;
use super::settings::StageSettings;
use crate::device::stage::StageReading;
use std::time::Duration;

/// A step of simulated time, s.
const STEP_S: f64 = 0.001;
/// Nobody was heard for the watchdog's time.
pub const STAGE_WATCHDOG: u32 = 1;
/// It does not move although it should.
pub const STAGE_STALLED: u32 = 2;
/// A target or a speed is out of its limits; nothing was done.
pub const STAGE_OUT_OF_LIMITS: u32 = 101;
/// A share of one by which a limit may be passed.
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

    /// Sends it somewhere. A new command acknowledges a fault.
    ///
    /// # Errors
    /// The stage's code, where it refuses.
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

    /// It stays where it is, whatever it is told, until it is freed.
    /// Freed, it comes to rest; it does not go on.
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

    /// Targets and speeds that it should never have been sent.
    pub(super) const fn out_of_limits_count(&self) -> u64 {
        self.out_of_limits_count
    }

    /// Makes one step towards `now`, and says at which time; `None` where it is there, or rests.
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
