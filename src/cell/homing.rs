//! One manipulator finds its references: sent once, over when the device says it is done, every reference is known and it
//! stands. Pure.

use super::driver::{Handling, Outcome, moves};
use super::failure::Failure;
use super::obstacles;
use super::run::Step;
use super::settings::Settings;
use crate::device::{Action, CommandResult, DeviceError, Reading};
use crate::motion::{Axes, Carrier, Pair, Position};
use std::time::Duration;
use tokio::time::Instant;

/// A homing under way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Homing {
    carrier: Carrier,
    begun_at: Instant,
    within: Duration,
    sequence: Option<u16>,
    names: Pair<String>,
    tolerance: Axes<f64>,
    /// Where the other one stands.
    place: Option<Position>,
}

impl Homing {
    pub(super) const fn new(carrier: Carrier, names: Pair<String>, settings: &Settings, now: Instant) -> Self {
        let tolerance = settings.arrangement.settle_tolerance;
        Self { carrier, begun_at: now, within: settings.homing, sequence: None, names, tolerance, place: None }
    }

    /// The one order.
    pub(super) fn begin(&self) -> Step {
        let axes = Axes::from_fn(|_| true);
        Step::Order(vec![(self.carrier, Handling::Send(Action::Home { axes }))])
    }

    /// When the time is to be told at the latest.
    pub(super) fn deadline(&self) -> Instant {
        self.begun_at + self.within
    }

    /// What became of the order.
    pub(super) fn told(&mut self, carrier: Carrier, outcome: Outcome) -> Step {
        match outcome {
            _ if carrier != self.carrier => Step::Wait,
            Outcome::Taken { sequence } => {
                self.sequence = Some(sequence);
                Step::Wait
            }
            Outcome::Refused(error) => Step::Fail(Failure::Device(error)),
            // A halt is on its way to us as well.
            Outcome::Overtaken | Outcome::Cut => Step::Wait,
            Outcome::Unknown(failure) => Step::Fail(failure),
        }
    }

    /// A manipulator was read. The other one has to stay where it is.
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

    /// The one that finds its references was read, or the other.
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
        if acknowledged.result == CommandResult::Done && known && !moves(reading) {
            return Step::Finished;
        }
        Step::Wait
    }

    /// Time has passed.
    pub(super) fn time(&self, now: Instant) -> Step {
        if now < self.deadline() {
            return Step::Wait;
        }
        Step::Fail(Failure::NotHomed { carrier: self.carrier, within: self.within })
    }
}
