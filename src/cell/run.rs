//! The motions of the manipulators: a path, waypoint by waypoint, and the homing of one manipulator. Pure: readings, outcomes and
//! the time are the inputs, commands are the output.
//!
//! ```text
//! read both --ready, and at the previous waypoint--> send each its set-point --both acknowledged-->
//!    wait until both are there by their actual positions and at rest --> read both ... --> finished
//!       |-- an axis does not follow the others (see `following`) --> fail
//! ```
//!
//! Nothing is sent for a waypoint before both manipulators were read for it. A homing is sent once; it is finished when the device
//! reports the end of the command, every axis has its reference and the device is at rest.

use std::time::Duration;

use tokio::time::Instant;

use crate::device::{Action, AxisState, CommandResult, DeviceError, Reading};
use crate::motion::{Arrangement, Axes, Axis, Carrier, MotionRefusal, Pair, Path, Position, Waypoint};

use super::driver::messages::{ManipulatorCommand, Outcome};
use super::failure::Failure;
use super::following::{Following, Lag};
use super::obstacles;
use super::refusal::Refusal;
use super::settings::Settings;

/// The next step of a motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    /// There is nothing to do yet.
    Wait,
    /// Send these commands, all at once.
    Send(Vec<(Carrier, ManipulatorCommand)>),
    /// The motion is finished, and every device is at rest at its target.
    Finished,
    /// The motion cannot go on.
    Fail(Failure),
}

/// A path that is being executed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Run {
    path: Path,
    names: Pair<String>,
    arrangement: Arrangement,
    look: Duration,
    arrival: Duration,
    /// Index of the waypoint that the manipulators move to; the first waypoint is the start of the path.
    next: usize,
    phase: Phase,
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    /// Waits for readings that were requested after this time.
    Look { since: Instant, readings: Box<Pair<Option<Reading>>> },
    /// Set-points were sent.
    Go { sent_at: Instant, legs: Pair<Leg>, following: Box<Following> },
}

/// The progress of one manipulator between two waypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Leg {
    /// It stays at its position.
    Stays,
    /// The device has not acknowledged the set-point yet.
    Sent,
    /// It moves.
    Goes { sequence: u16, since: Instant },
    /// It has reached the waypoint, and is at rest.
    There,
}

impl Run {
    /// Creates the run of a path that was checked before.
    pub(super) fn new(path: Path, names: Pair<String>, settings: &Settings, now: Instant) -> Self {
        Self {
            path,
            names,
            arrangement: settings.arrangement,
            look: settings.acknowledge,
            arrival: settings.arrival,
            next: 1,
            phase: looking(now),
        }
    }

    /// The first step.
    pub(super) fn begin(&self) -> Step {
        Step::Send(Carrier::ALL.map(|carrier| (carrier, ManipulatorCommand::Read)).to_vec())
    }

    /// The fraction of the waypoints that were reached, 0 to 1.
    pub(super) fn progress(&self) -> f64 {
        (self.next - 1) as f64 / (self.path.waypoints.len().max(2) - 1) as f64
    }

    /// The latest time at which [`Self::time`] must be called.
    pub(super) fn deadline(&self) -> Instant {
        match &self.phase {
            Phase::Look { since, .. } => *since + self.look,
            Phase::Go { sent_at, .. } => *sent_at + self.patience(),
        }
    }

    /// Takes a reading of a manipulator.
    pub(super) fn read(&mut self, now: Instant, carrier: Carrier, asked_at: Instant, reading: &Reading) -> Step {
        match &mut self.phase {
            Phase::Look { since, readings } => {
                if asked_at >= *since {
                    *readings.get_mut(carrier) = Some(reading.clone());
                }
                match readings.as_ref() {
                    Pair { m1: Some(m1), m2: Some(m2) } => {
                        let readings = Pair { m1: m1.clone(), m2: m2.clone() };
                        self.send(now, &readings)
                    }
                    Pair { .. } => Step::Wait,
                }
            }
            Phase::Go { .. } => self.supervise(now, carrier, asked_at, reading),
        }
    }

    /// Takes the outcome of the set-point of a manipulator.
    pub(super) fn take_outcome(&mut self, now: Instant, carrier: Carrier, outcome: Outcome) -> Step {
        let Phase::Go { legs, .. } = &mut self.phase else { return Step::Wait };
        match outcome {
            Outcome::Taken { sequence } => {
                *legs.get_mut(carrier) = Leg::Goes { sequence, since: now };
                Step::Wait
            }
            Outcome::Refused(error) => Step::Fail(Failure::Device(error)),
            // The halt is reported to the task as well.
            Outcome::Overtaken | Outcome::Cut => Step::Wait,
            Outcome::Unknown(failure) => Step::Fail(failure),
        }
    }

    /// Checks the deadline.
    pub(super) fn time(&self, now: Instant, last: &Pair<Option<Position>>) -> Step {
        if now < self.deadline() {
            return Step::Wait;
        }
        match &self.phase {
            Phase::Look { readings, .. } => {
                let carrier = if readings.m1.is_none() { Carrier::M1 } else { Carrier::M2 };
                Step::Fail(Failure::NotReadBack { carrier, within: self.look })
            }
            Phase::Go { legs, .. } => {
                let late = if matches!(legs.m1, Leg::Sent | Leg::Goes { .. }) { Carrier::M1 } else { Carrier::M2 };
                Step::Fail(self.not_arrived(late, last.get(late).as_ref()))
            }
        }
    }

    /// Sends the set-points if both manipulators are ready and at the previous waypoint.
    fn send(&mut self, now: Instant, readings: &Pair<Reading>) -> Step {
        let (Some(from), Some(to)) = (self.waypoint(self.next - 1), self.waypoint(self.next)) else {
            return Step::Finished;
        };
        for (carrier, reading) in readings.iter() {
            if let Err(refusal) = self.ready(carrier, reading, from.targets.get(carrier)) {
                return Step::Fail(Failure::NotReady(Box::new(refusal)));
            }
        }
        let orders: Vec<_> = Carrier::ALL.into_iter().filter_map(|carrier| self.order(carrier, &to)).collect();
        let legs =
            Pair::from_fn(|carrier| if orders.iter().any(|(one, _)| *one == carrier) { Leg::Sent } else { Leg::Stays });
        let places = readings.map(|_, reading| reading.position());
        let following = Box::new(Following::new(&self.arrangement, &places, &to, &self.path.moves));
        self.phase = Phase::Go { sent_at: now, legs, following };
        if orders.is_empty() { self.go_on(now) } else { Step::Send(orders) }
    }

    fn ready(&self, carrier: Carrier, reading: &Reading, planned: &Position) -> Result<(), Refusal> {
        if let Some(refusal) = obstacles::of_reading(self.names.get(carrier), carrier, reading).into_iter().next() {
            return Err(refusal);
        }
        match obstacles::away(&reading.position(), planned, &self.arrangement.settle_tolerance) {
            None => Ok(()),
            Some((axis, actual, planned)) => {
                Err(Refusal::Motion(MotionRefusal::Stale { carrier, axis, actual, planned }))
            }
        }
    }

    /// The command that moves a manipulator to a waypoint; `None` if it stays.
    fn order(&self, carrier: Carrier, to: &Waypoint) -> Option<(Carrier, ManipulatorCommand)> {
        let (targets, speeds) = (*to.targets.get(carrier), *to.speeds.get(carrier));
        let axes = speeds.map(|_, speed| *speed > 0.0);
        let goes = *self.path.moves.get(carrier) && axes.iter().any(|(_, goes)| *goes);
        goes.then_some((carrier, ManipulatorCommand::Send(Action::MoveTo { axes, targets, speeds })))
    }

    /// Takes a reading of a manipulator between two waypoints.
    fn supervise(&mut self, now: Instant, carrier: Carrier, asked_at: Instant, reading: &Reading) -> Step {
        let Some(to) = self.waypoint(self.next) else { return Step::Finished };
        if let Some(refusal) = obstacles::of_motion(carrier, reading) {
            return Step::Fail(Failure::Interrupted(Box::new(refusal)));
        }
        let tolerance = &self.arrangement.settle_tolerance;
        let Phase::Go { sent_at, legs, following } = &mut self.phase else { return Step::Wait };
        let leg = legs.get_mut(carrier);
        if matches!(leg, Leg::Stays | Leg::There)
            && let Some(refusal) =
                obstacles::of_staying(self.names.get(carrier), carrier, reading, to.targets.get(carrier), tolerance)
        {
            return Step::Fail(Failure::Interrupted(Box::new(refusal)));
        }
        if let Leg::Goes { sequence, since } = *leg
            && asked_at >= since
        {
            if let Some(failure) = given_up(carrier, sequence, reading) {
                return Step::Fail(failure);
            }
            let stands = !reading.moves() && reading.axes.iter().all(|(_, axis)| axis.state == AxisState::Standstill);
            if stands && obstacles::away(&reading.position(), to.targets.get(carrier), tolerance).is_none() {
                *leg = Leg::There;
            }
        }
        if asked_at >= *sent_at
            && let Some(Lag { axis, actual, expected }) = following.read(carrier, asked_at, reading)
        {
            let (actual, expected) = (axis.outside(actual), axis.outside(expected));
            return Step::Fail(Failure::NotFollowing { carrier, axis, actual, expected });
        }
        let all_there = legs.iter().all(|(_, leg)| matches!(leg, Leg::Stays | Leg::There));
        if all_there { self.go_on(now) } else { Step::Wait }
    }

    /// Continues after a waypoint was reached.
    fn go_on(&mut self, now: Instant) -> Step {
        self.next += 1;
        if self.waypoint(self.next).is_none() {
            return Step::Finished;
        }
        self.phase = looking(now);
        self.begin()
    }

    fn waypoint(&self, index: usize) -> Option<Waypoint> {
        self.path.waypoints.get(index).copied()
    }

    /// The longest time allowed until the next waypoint.
    fn patience(&self) -> Duration {
        let way_s = match (self.waypoint(self.next - 1), self.waypoint(self.next)) {
            (Some(from), Some(to)) => to.at_s - from.at_s,
            (_, None) | (None, _) => 0.0,
        };
        self.arrival + Duration::try_from_secs_f64(way_s).unwrap_or(Duration::ZERO)
    }

    fn not_arrived(&self, carrier: Carrier, last: Option<&Position>) -> Failure {
        let target = self.waypoint(self.next).map(|to| *to.targets.get(carrier)).unwrap_or_default();
        let worst = last.and_then(|position| obstacles::away(position, &target, &self.arrangement.settle_tolerance));
        let (axis, actual, target) = worst.unwrap_or((Axis::X, last.map_or(f64::NAN, |at| at.x), target.x));
        Failure::NotArrived { carrier, axis, actual, target, within: self.patience() }
    }
}

fn looking(since: Instant) -> Phase {
    Phase::Look { since, readings: Box::new(Pair { m1: None, m2: None }) }
}

/// The failure of a device that no longer executes the command of coaxis.
fn given_up(carrier: Carrier, sequence: u16, reading: &Reading) -> Option<Failure> {
    let found = reading.acknowledged.sequence;
    if found != sequence {
        return Some(Failure::Overridden { carrier, sequence, found });
    }
    match reading.acknowledged.result {
        CommandResult::Aborted => Some(Failure::Aborted { carrier, sequence }),
        CommandResult::Rejected => {
            let device = carrier.name().to_owned();
            Some(Failure::Device(DeviceError::Rejected { device, code: reading.fault_code }))
        }
        CommandResult::None | CommandResult::Accepted | CommandResult::Running | CommandResult::Done => None,
    }
}

/// A homing that is being executed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Homing {
    carrier: Carrier,
    begun_at: Instant,
    within: Duration,
    sequence: Option<u16>,
    names: Pair<String>,
    tolerance: Axes<f64>,
    /// Position of the other manipulator, which must not move.
    place: Option<Position>,
}

impl Homing {
    pub(super) const fn new(carrier: Carrier, names: Pair<String>, settings: &Settings, now: Instant) -> Self {
        let tolerance = settings.arrangement.settle_tolerance;
        Self { carrier, begun_at: now, within: settings.homing, sequence: None, names, tolerance, place: None }
    }

    /// The first step, which sends the only command.
    pub(super) fn begin(&self) -> Step {
        let axes = Axes::from_fn(|_| true);
        Step::Send(vec![(self.carrier, ManipulatorCommand::Send(Action::Home { axes }))])
    }

    /// The latest time at which [`Self::time`] must be called.
    pub(super) fn deadline(&self) -> Instant {
        self.begun_at + self.within
    }

    /// Takes the outcome of the command.
    pub(super) fn take_outcome(&mut self, carrier: Carrier, outcome: Outcome) -> Step {
        match outcome {
            _ if carrier != self.carrier => Step::Wait,
            Outcome::Taken { sequence } => {
                self.sequence = Some(sequence);
                Step::Wait
            }
            Outcome::Refused(error) => Step::Fail(Failure::Device(error)),
            // The halt is reported to the task as well.
            Outcome::Overtaken | Outcome::Cut => Step::Wait,
            Outcome::Unknown(failure) => Step::Fail(failure),
        }
    }

    /// Takes a reading of a manipulator. The other manipulator has to stay at its position.
    pub(super) fn read(&mut self, carrier: Carrier, reading: &Reading) -> Step {
        let mut refusal = obstacles::of_motion(carrier, reading);
        if carrier != self.carrier {
            let place = *self.place.get_or_insert_with(|| reading.position());
            let name = self.names.get(carrier);
            refusal = refusal.or_else(|| obstacles::of_staying(name, carrier, reading, &place, &self.tolerance));
        }
        if let Some(refusal) = refusal {
            return Step::Fail(Failure::Interrupted(Box::new(refusal)));
        }
        self.own(carrier, reading)
    }

    /// Evaluates the reading of the manipulator that is being homed.
    fn own(&self, carrier: Carrier, reading: &Reading) -> Step {
        let Some(sequence) = self.sequence.filter(|_| carrier == self.carrier) else { return Step::Wait };
        let acknowledged = reading.acknowledged;
        if acknowledged.sequence != sequence {
            return Step::Fail(Failure::Overridden { carrier, sequence, found: acknowledged.sequence });
        }
        if acknowledged.result == CommandResult::Aborted {
            return Step::Fail(Failure::Aborted { carrier, sequence });
        }
        if acknowledged.result == CommandResult::Rejected {
            let device = self.names.get(carrier).clone();
            return Step::Fail(Failure::Device(DeviceError::Rejected { device, code: reading.fault_code }));
        }
        let known = reading.axes.iter().all(|(_, axis)| axis.homed);
        if acknowledged.result == CommandResult::Done && known && !reading.moves() {
            return Step::Finished;
        }
        Step::Wait
    }

    /// Checks the deadline.
    pub(super) fn time(&self, now: Instant) -> Step {
        if now < self.deadline() {
            return Step::Wait;
        }
        Step::Fail(Failure::NotHomed { carrier: self.carrier, within: self.within })
    }
}
