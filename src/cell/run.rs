//! Executes a path, waypoint by waypoint. Pure: readings, outcomes and the time go in, orders come out.
//!
//! ```text
//!  look at both --fit, and where the last waypoint left them--> send each its set-point --both acknowledged-->
//!  wait until both are there by their actual positions and stand --> look at both ... --> finished
//!       |-- an axis does not follow the others (see `following`) --> fail
//! ```
//!
//! Nothing is sent for a waypoint before both manipulators were read for it.

use super::driver::{Handling, Outcome, moves};
use super::failure::Failure;
use super::following::{Following, Lag};
use super::obstacles;
use super::refusal::Refusal;
use super::settings::Settings;
use crate::device::{Action, AxisState, CommandResult, DeviceError, Reading};
use crate::motion::{Arrangement, Axis, Carrier, MotionRefusal, Pair, Path, Position, Waypoint};
use std::time::Duration;
use tokio::time::Instant;

/// What is to be done next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Step {
    /// Nothing yet.
    Wait,
    /// These orders, all at once.
    Order(Vec<(Carrier, Handling)>),
    /// The path is done, and everything stands where it should.
    Finished,
    /// It cannot go on.
    Fail(Failure),
}

/// A path under way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Run {
    path: Path,
    names: Pair<String>,
    arrangement: Arrangement,
    look: Duration,
    arrival: Duration,
    /// The waypoint that is gone to; the first is where the path starts.
    next: usize,
    phase: Phase,
}

#[derive(Debug, Clone, PartialEq)]
enum Phase {
    /// Readings that were asked for since are waited for.
    Look { since: Instant, readings: Box<Pair<Option<Reading>>> },
    /// Set-points are out.
    Go { sent_at: Instant, legs: Pair<Leg>, following: Box<Following> },
}

/// One manipulator's way to a waypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Leg {
    /// It has nothing to do.
    Stays,
    /// The device has not acknowledged yet.
    Sent,
    /// It is on its way.
    Goes { sequence: u16, since: Instant },
    /// It is there, and stands.
    There,
}

impl Run {
    /// A path that was checked.
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

    /// The first orders.
    pub(super) fn begin(&self) -> Step {
        Step::Order(Carrier::ALL.map(|carrier| (carrier, Handling::Look)).to_vec())
    }

    /// The part of the waypoints that was reached, 0 to 1.
    pub(super) fn progress(&self) -> f64 {
        (self.next - 1) as f64 / (self.path.waypoints.len().max(2) - 1) as f64
    }

    /// When the time is to be told at the latest.
    pub(super) fn deadline(&self) -> Instant {
        match &self.phase {
            Phase::Look { since, .. } => *since + self.look,
            Phase::Go { sent_at, .. } => *sent_at + self.patience(),
        }
    }

    /// A manipulator was read.
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
            Phase::Go { .. } => self.watch(now, carrier, asked_at, reading),
        }
    }

    /// What became of the set-point of a manipulator.
    pub(super) fn told(&mut self, now: Instant, carrier: Carrier, outcome: Outcome) -> Step {
        let Phase::Go { legs, .. } = &mut self.phase else { return Step::Wait };
        match outcome {
            Outcome::Taken { sequence } => {
                *legs.get_mut(carrier) = Leg::Goes { sequence, since: now };
                Step::Wait
            }
            Outcome::Refused(error) => Step::Fail(Failure::Device(error)),
            // A halt is on its way to us as well.
            Outcome::Overtaken | Outcome::Cut => Step::Wait,
            Outcome::Unknown(failure) => Step::Fail(failure),
        }
    }

    /// Time has passed.
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

    /// Both were read: sends the set-points, where both are fit and stand where the waypoint before has left them.
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
        if orders.is_empty() { self.go_on(now) } else { Step::Order(orders) }
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

    /// The command that takes a manipulator to a waypoint; none where it stays.
    fn order(&self, carrier: Carrier, to: &Waypoint) -> Option<(Carrier, Handling)> {
        let (targets, speeds) = (*to.targets.get(carrier), *to.speeds.get(carrier));
        let axes = speeds.map(|_, speed| *speed > 0.0);
        let goes = *self.path.moves.get(carrier) && axes.iter().any(|(_, goes)| *goes);
        goes.then_some((carrier, Handling::Send(Action::MoveTo { axes, targets, speeds })))
    }

    /// A manipulator was read while set-points are out.
    fn watch(&mut self, now: Instant, carrier: Carrier, asked_at: Instant, reading: &Reading) -> Step {
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
            let stands = !moves(reading) && reading.axes.iter().all(|(_, axis)| axis.state == AxisState::Standstill);
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

    /// A waypoint is reached.
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

    /// How long the way to the next waypoint may take.
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

/// Whether the device does not do our command any more.
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
