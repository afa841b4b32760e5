//! The controller of one simulated manipulator, which behaves like a PLC: accepts commands by sequence number, enforces its own
//! limits and watchdog, moves its axes, and reports its state. Input: commands, heartbeats and the caller's clock. Output: a
//! [`Reading`], and a record of the commands for tests. Pure. `execution` decides which commands are permitted and executes them
//! over time.
//!
//! ```text
//! Disabled --Enable--> Standstill --MoveTo--> DiscreteMotion --arrived--> Standstill
//!     ^                  |  ^  \---Home-----> Homing ----------done-----> Standstill
//!     +----Disable-------+  |                   |
//!                           +---at rest--- Stopping <--Halt, Disable
//!                           |                   |  <--watchdog, limit switch, emergency stop
//!                           +----Reset---- ErrorStop
//! ```

mod execution;

use std::collections::VecDeque;
use std::time::Duration;

use crate::device::manipulator::{
    Acknowledged, Action, AxisReading, AxisState, Command, CommandResult, Mode, Reading, Safety,
};
use crate::device::sequence::is_newer;
use crate::motion::{Axes, Axis, AxisLimits, Position};

use super::drives::{Mechanics, Servo};

/// The codes of a simulated controller in [`crate::device::Reading::fault_code`]. Codes below 100 are faults, which a reset
/// acknowledges; codes from 100 on are the reason why the newest command was refused, and last until there is a newer one.
pub mod code {
    /// No heartbeat arrived within the watchdog time while it moved.
    pub const WATCHDOG: u32 = 1;
    /// An axis ran onto its limit switch.
    pub const LIMIT_SWITCH: u32 = 2;
    /// A safety function stopped the motion.
    pub const SAFETY: u32 = 3;
    /// A target is outside of the limits, or not finite.
    pub const OUT_OF_LIMITS: u32 = 101;
    /// A speed is zero, too great or not finite.
    pub const SPEED: u32 = 102;
    /// The drives are not enabled.
    pub const NOT_ENABLED: u32 = 103;
    /// An axis has no reference.
    pub const NOT_HOMED: u32 = 104;
    /// A fault is latched.
    pub const FAULTED: u32 = 105;
    /// It is not in automatic mode.
    pub const NOT_REMOTE: u32 = 106;
    /// The safety functions do not allow motion.
    pub const SAFETY_OPEN: u32 = 107;
    /// No axis was named.
    pub const NO_AXIS: u32 = 108;
}

/// The result of a command on arrival.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandReceipt {
    /// It is executed.
    Executed,
    /// It is refused, with a [`code`].
    Refused(u32),
    /// Ignored, because its sequence number is not newer than the last one.
    Ignored,
}

/// The controller of one manipulator. `now` is the time since a fixed moment by the caller's clock; it never decreases.
#[derive(Debug, Clone)]
pub struct Controller {
    settings: ControllerSettings,
    steps: u64,
    heard: Duration,
    watchdog: Duration,
    powered: bool,
    mode: Mode,
    safety: Safety,
    fault: Option<u32>,
    refusal: Option<u32>,
    refuse_next: Option<u32>,
    acknowledged: Acknowledged,
    motion: Motion,
    servos: Axes<Servo>,
    homed: Axes<bool>,
    limit_hit: Axes<bool>,
    stuck: Axes<bool>,
    mechanics: Mechanics,
    record: Record,
}

impl Controller {
    /// A controller at rest, not enabled, in automatic mode, with all safety functions allowing motion.
    #[must_use]
    pub fn new(settings: ControllerSettings) -> Self {
        let servos = settings.start.map(|axis, start| Servo::at(*start, settings.limits.get(axis).acceleration));
        Self {
            steps: 0,
            heard: Duration::ZERO,
            watchdog: settings.watchdog_max,
            powered: false,
            mode: Mode::Automatic,
            safety: Safety { emergency_stop_ok: true, guard_closed: true, drives_ready: true, remote_enabled: true },
            fault: None,
            refusal: None,
            refuse_next: None,
            acknowledged: Acknowledged { sequence: 0, result: CommandResult::None },
            motion: Motion::Rest,
            servos,
            homed: Axes::from_fn(|_| settings.homed),
            limit_hit: Axes::default(),
            stuck: Axes::default(),
            mechanics: Mechanics::new(settings.start, settings.backlash, settings.coupling_ratio),
            record: Record::default(),
            settings,
        }
    }

    /// Receives a command, which also counts as a heartbeat.
    pub fn take(&mut self, command: &Command, now: Duration) -> CommandReceipt {
        self.beat(now);
        if !is_newer(command.sequence, self.acknowledged.sequence) {
            self.record.ignored(command.sequence);
            return CommandReceipt::Ignored;
        }
        self.refusal = self.refusal_of(&command.action).err();
        if let Some(code) = self.refusal {
            // The motion under way continues, but its result can no longer be read.
            self.acknowledged = Acknowledged { sequence: command.sequence, result: CommandResult::Rejected };
            if matches!(code, code::OUT_OF_LIMITS | code::SPEED) {
                self.record.out_of_limits(command);
            }
            return CommandReceipt::Refused(code);
        }
        self.acknowledged = Acknowledged { sequence: command.sequence, result: CommandResult::Accepted };
        self.watchdog = command.watchdog.min(self.settings.watchdog_max);
        self.record.executed(command, now);
        self.execute(&command.action);
        CommandReceipt::Executed
    }

    /// Receives a heartbeat.
    pub fn beat(&mut self, now: Duration) {
        self.advance(now);
        self.heard = self.heard.max(now);
    }

    /// The true position of the clamp with backlash and cross-coupling, in the manipulator's axes.
    #[must_use]
    pub fn clamp(&mut self, now: Duration) -> Position {
        self.advance(now);
        self.mechanics.clamp()
    }

    /// The commands that it has received.
    #[must_use]
    pub const fn record(&self) -> &Record {
        &self.record
    }

    /// Refuses the next newer command with this code, without executing anything.
    pub const fn refuse_next(&mut self, code: u32) {
        self.refuse_next = Some(code);
    }

    /// Moves an axis onto its limit switch: it stops, and needs a reset.
    pub fn hit_limit(&mut self, axis: Axis, now: Duration) {
        self.advance(now);
        *self.limit_hit.get_mut(axis) = true;
        self.fail(code::LIMIT_SWITCH);
    }

    /// Blocks or releases an axis. The drive does not detect this: it reports a motion and no fault.
    pub fn set_stuck(&mut self, axis: Axis, stuck: bool, now: Duration) {
        self.advance(now);
        *self.stuck.get_mut(axis) = stuck;
    }

    /// Sets the states of the safety functions. A motion that they no longer allow stops.
    pub fn set_safety(&mut self, safety: Safety, now: Duration) {
        self.advance(now);
        self.safety = safety;
        if !safety.allows_motion() && self.powered {
            self.fail(code::SAFETY);
        }
    }

    /// Sets the mode. A motion stops when the mode is no longer automatic.
    pub fn set_mode(&mut self, mode: Mode, now: Duration) {
        self.advance(now);
        self.mode = mode;
        if mode != Mode::Automatic && self.motion != Motion::Rest {
            self.abort();
        }
    }
}

/// Number of entries of each kind that are kept; the oldest are dropped first.
const KEPT_MAX: usize = 4096;

/// A command that was executed.
#[derive(Debug, Clone, PartialEq)]
pub struct Executed {
    /// Its sequence number.
    pub sequence: u16,
    /// The action that was executed.
    pub action: Action,
    /// The time by the caller's clock.
    pub at: Duration,
}

/// The commands that a controller has received.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    executed: VecDeque<Executed>,
    ignored: VecDeque<u16>,
    out_of_limits: VecDeque<Command>,
}

impl Record {
    /// Commands that were executed, in order.
    pub fn all_executed(&self) -> impl ExactSizeIterator<Item = &Executed> {
        self.executed.iter()
    }

    /// Sequence numbers that were repeated or too old and therefore ignored, in order.
    pub fn all_ignored(&self) -> impl ExactSizeIterator<Item = u16> {
        self.ignored.iter().copied()
    }

    /// Commands with a target or a speed outside the limits, which were refused. A client that checks its commands before sending
    /// causes none.
    pub fn all_out_of_limits(&self) -> impl ExactSizeIterator<Item = &Command> {
        self.out_of_limits.iter()
    }

    pub(super) fn executed(&mut self, command: &Command, at: Duration) {
        let entry = Executed { sequence: command.sequence, action: command.action.clone(), at };
        keep(&mut self.executed, entry);
    }

    pub(super) fn ignored(&mut self, sequence: u16) {
        keep(&mut self.ignored, sequence);
    }

    pub(super) fn out_of_limits(&mut self, command: &Command) {
        keep(&mut self.out_of_limits, command.clone());
    }
}

fn keep<T>(kept: &mut VecDeque<T>, entry: T) {
    if kept.len() == KEPT_MAX {
        kept.pop_front();
    }
    kept.push_back(entry);
}

/// The settings of a controller. Lengths in mm, angles in rad.
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerSettings {
    /// Its own limits.
    pub limits: Axes<AxisLimits>,
    /// Initial position of the axes.
    pub start: Position,
    /// Whether the references are initially known.
    pub homed: bool,
    /// Simulated seconds of motion per second of the caller's clock. Watchdog and heartbeat are not accelerated.
    pub time_factor: f64,
    /// Greatest watchdog time that it accepts; a command may request less.
    pub watchdog_max: Duration,
    /// Duration of a homing, simulated s. The axes do not move, as with distance-coded reference marks.
    pub homing_s: f64,
    /// Backlash between an axis' encoder and its clamp.
    pub backlash: Axes<f64>,
    /// Fraction of each linear axis' motion that the clamp shows along each of the other two.
    pub coupling_ratio: f64,
}

impl ControllerSettings {
    /// A stiff manipulator with these limits, initially at zero or at the limit nearest to zero.
    #[must_use]
    pub fn exact(limits: Axes<AxisLimits>) -> Self {
        Self {
            limits,
            start: limits.map(|_, own| 0.0_f64.max(own.lower).min(own.upper)),
            homed: true,
            time_factor: 1.0,
            watchdog_max: Duration::from_millis(500),
            homing_s: 0.5,
            backlash: Axes::default(),
            coupling_ratio: 0.0,
        }
    }
}

/// The heartbeat counter increases once in this time.
const BEAT: Duration = Duration::from_millis(10);

impl Controller {
    /// The reading. It does not count as a heartbeat.
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
        match self.motion {
            Motion::Stop { .. } => AxisState::Stopping,
            _ if self.fault.is_some() => AxisState::ErrorStop,
            _ if !self.powered => AxisState::Disabled,
            Motion::Home { .. } => AxisState::Homing,
            Motion::Move => AxisState::DiscreteMotion,
            Motion::Rest => AxisState::Standstill,
        }
    }

    fn axis_reading(&self, axis: Axis, limits: &AxisLimits) -> AxisReading {
        let servo = self.servos.get(axis);
        let device = self.state();
        let concerned = match self.motion {
            Motion::Home { axes, .. } => *axes.get(axis),
            Motion::Rest | Motion::Move | Motion::Stop { .. } => !servo.rests(),
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

/// The motion under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Motion {
    Rest,
    Move,
    Home { axes: Axes<bool>, until_step: u64 },
    Stop { then_off: bool },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Action, AxisState};
    use crate::motion::AxisLimits;

    const WATCHDOG: Duration = Duration::from_millis(400);

    fn limits() -> Axes<AxisLimits> {
        let linear = AxisLimits { lower: -50.0, upper: 50.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 50.0 };
        let turn = AxisLimits { lower: -0.2, upper: 0.2, speed: 0.1, acceleration: 0.5, jerk: 5.0, step: 0.2 };
        Axes { x: linear, y: linear, z: linear, c: turn }
    }

    fn command(sequence: u16, action: Action) -> Command {
        Command { sequence, fence: 1, watchdog: WATCHDOG, action }
    }

    fn y_to(target: f64) -> Action {
        let axes = Axes { y: true, ..Axes::default() };
        let speeds = Axes { y: 10.0, ..Axes::default() };
        Action::MoveTo { axes, targets: Axes { y: target, ..Axes::default() }, speeds }
    }

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn enabled() -> Controller {
        let mut controller = Controller::new(ControllerSettings::exact(limits()));
        assert_eq!(controller.take(&command(1, Action::Enable), ms(0)), CommandReceipt::Executed);
        controller
    }

    /// Sends a heartbeat every 100 ms from one time to the other.
    fn run(controller: &mut Controller, from_ms: u64, to_ms: u64) {
        for at in (from_ms..=to_ms).step_by(100) {
            controller.beat(ms(at));
        }
    }

    #[test]
    fn a_move_is_accepted_executed_and_ends_exactly_at_its_target() {
        let mut controller = enabled();
        controller.take(&command(2, y_to(5.0)), ms(10));
        assert_eq!(controller.reading(ms(10)).acknowledged.result, CommandResult::Accepted);
        run(&mut controller, 100, 300);
        let under_way = controller.reading(ms(300));
        assert_eq!(under_way.acknowledged, Acknowledged { sequence: 2, result: CommandResult::Running });
        assert_eq!((under_way.state, under_way.axes.y.state), (AxisState::DiscreteMotion, AxisState::DiscreteMotion));
        assert_eq!(under_way.axes.x.state, AxisState::Standstill);
        // 5 mm at 10 mm/s and 50 mm/s²: 0.7 s.
        run(&mut controller, 400, 730);
        let there = controller.reading(ms(730));
        assert_eq!((there.state, there.acknowledged.result), (AxisState::Standstill, CommandResult::Done));
        assert!(there.axes.y.actual == 5.0 && there.axes.y.in_position, "{:?}", there.axes.y);
    }

    #[test]
    fn only_a_newer_sequence_number_is_executed() {
        let mut controller = enabled();
        controller.take(&command(2, y_to(1.0)), ms(10));
        run(&mut controller, 100, 500);
        assert_eq!(controller.take(&command(2, y_to(9.0)), ms(510)), CommandReceipt::Ignored);
        assert_eq!(controller.take(&command(1, y_to(9.0)), ms(520)), CommandReceipt::Ignored);
        run(&mut controller, 600, 2_000);
        assert_eq!(controller.reading(ms(2_000)).axes.y.actual, 1.0);
        assert_eq!(controller.record().all_ignored().collect::<Vec<_>>(), [2, 1]);
        assert_eq!(controller.record().all_executed().map(|entry| entry.sequence).collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn a_controller_without_heartbeat_stops_and_needs_a_reset() {
        let mut controller = enabled();
        controller.take(&command(2, y_to(40.0)), ms(0));
        // The watchdog expires at 400 ms, and braking takes v/a = 0.2 s.
        let stopped = controller.reading(ms(610));
        assert_eq!((stopped.state, stopped.fault_code), (AxisState::ErrorStop, code::WATCHDOG));
        assert_eq!(stopped.acknowledged, Acknowledged { sequence: 2, result: CommandResult::Aborted });
        // v·t − v²/2a on the way up, v²/2a down: 3 mm + 1 mm.
        assert!((stopped.axes.y.actual - 4.0).abs() < 0.05, "{}", stopped.axes.y.actual);
        assert_eq!(controller.take(&command(3, y_to(40.0)), ms(700)), CommandReceipt::Refused(code::FAULTED));
        assert_eq!(controller.take(&command(4, Action::Reset), ms(710)), CommandReceipt::Executed);
        let reset = controller.reading(ms(2_000));
        assert_eq!((reset.state, reset.fault_code), (AxisState::Standstill, 0));
        assert_eq!(reset.axes.y.actual, stopped.axes.y.actual);
    }

    #[test]
    fn a_forbidden_command_is_refused_and_recorded() {
        let mut controller = Controller::new(ControllerSettings::exact(limits()));
        assert_eq!(controller.take(&command(1, y_to(1.0)), ms(0)), CommandReceipt::Refused(code::NOT_ENABLED));
        controller.take(&command(2, Action::Enable), ms(0));
        for (sequence, target) in [(3, 50.01), (4, f64::NAN), (5, f64::INFINITY)] {
            assert_eq!(
                controller.take(&command(sequence, y_to(target)), ms(1)),
                CommandReceipt::Refused(code::OUT_OF_LIMITS)
            );
        }
        let axes = Axes { y: true, ..Axes::default() };
        let too_fast = Action::MoveTo { axes, targets: Axes::default(), speeds: Axes::from_fn(|_| 10.1) };
        assert_eq!(controller.take(&command(6, too_fast), ms(1)), CommandReceipt::Refused(code::SPEED));
        let reading = controller.reading(ms(1_000));
        assert_eq!(reading.acknowledged, Acknowledged { sequence: 6, result: CommandResult::Rejected });
        assert_eq!((reading.fault_code, reading.position()), (code::SPEED, Position::default()));
        assert_eq!(controller.record().all_out_of_limits().len(), 4);
        // Rounding to single precision in the protocol is no violation.
        assert_eq!(controller.take(&command(7, y_to(f64::from(50.000_001_f32))), ms(1_001)), CommandReceipt::Executed);
    }

    #[test]
    fn a_halt_stops_the_motion_and_a_limit_switch_latches_a_fault() {
        let mut controller = enabled();
        controller.take(&command(2, y_to(40.0)), ms(0));
        controller.take(&command(3, Action::Halt), ms(300));
        assert_eq!(controller.reading(ms(310)).state, AxisState::Stopping);
        let held = controller.reading(ms(510));
        assert_eq!((held.state, held.acknowledged.result), (AxisState::Standstill, CommandResult::Done));
        controller.take(&command(4, y_to(40.0)), ms(600));
        controller.hit_limit(Axis::Y, ms(900));
        let hit = controller.reading(ms(1_200));
        assert_eq!((hit.state, hit.fault_code), (AxisState::ErrorStop, code::LIMIT_SWITCH));
        assert!(hit.axes.y.limit_hit && !hit.axes.x.limit_hit);
    }

    #[test]
    fn the_motion_does_not_depend_on_the_number_of_readings() {
        let (mut often, mut once) = (enabled(), enabled());
        for controller in [&mut often, &mut once] {
            controller.take(&command(2, y_to(40.0)), ms(3));
        }
        for at in 4..350 {
            let _ = often.reading(ms(at));
        }
        assert_eq!(often.reading(ms(350)), once.reading(ms(350)));
    }

    #[test]
    fn a_faster_cell_moves_sooner_and_keeps_its_watchdog() {
        let settings = ControllerSettings { time_factor: 10.0, ..ControllerSettings::exact(limits()) };
        let mut controller = Controller::new(settings);
        controller.take(&command(1, Action::Enable), ms(0));
        controller.take(&command(2, y_to(20.0)), ms(0));
        // 2.2 s of motion in 220 ms, less than the watchdog.
        let there = controller.reading(ms(230));
        assert_eq!((there.acknowledged.result, there.axes.y.actual), (CommandResult::Done, 20.0));
    }

    #[test]
    fn switching_to_manual_ends_a_move_before_its_end() {
        let mut controller = enabled();
        controller.take(&command(2, y_to(40.0)), ms(0));
        controller.set_mode(Mode::Manual, ms(200));
        assert_eq!(controller.reading(ms(600)).acknowledged.result, CommandResult::Aborted);
        assert_eq!(controller.take(&command(3, y_to(0.0)), ms(700)), CommandReceipt::Refused(code::NOT_REMOTE));
        assert_eq!(controller.take(&command(4, Action::Halt), ms(700)), CommandReceipt::Executed);
    }
}
