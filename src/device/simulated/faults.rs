//! The injected faults: planned for an exchange with a device, permanent, or random from a seed. Input: the exchanges, one after
//! the other. Output: the fault of each.

use crate::device::error::ScanFault;
use crate::motion::{Axis, Carrier, Pair};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::time::Duration;

/// Number of injected faults that are kept; the oldest are dropped first.
const STRUCK_MAX: usize = 4096;

/// A device of the simulated cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Device {
    /// One of the two manipulators.
    Manipulator(Carrier),
    /// The profile sensor.
    Sensor,
    /// The linear stage.
    Stage,
}

/// A fault in an exchange with a device. An exchange is a request and its answer; connecting takes two.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// The link goes down, before or after the device has received the request.
    LinkLost {
        /// The device has received the request.
        arrives: bool,
    },
    /// There is no answer.
    Silence {
        /// The device has received the request.
        arrives: bool,
    },
    /// The answer is delayed.
    Late {
        /// The delay.
        by: Duration,
    },
    /// The answer is malformed; the device has received the request.
    Corrupt,
    /// The device refuses, and executes nothing.
    Rejected {
        /// The code of the device.
        code: u32,
    },
    /// The connection is half open: connecting succeeds, but no request is answered.
    HalfOpen,
    /// An axis of the manipulator reaches its limit switch. The exchange itself succeeds.
    LimitHit {
        /// The axis.
        axis: Axis,
    },
    /// The stage stops and stays until [`super::FaultSwitch::free_stage`]. The exchange itself succeeds.
    Stall,
    /// The sensor has lost data, so that the next requested profiles are missing.
    Scan(ScanFault),
}

/// A fault that was injected.
#[derive(Debug, Clone, PartialEq)]
pub struct Struck {
    /// The device of the exchange.
    pub device: Device,
    /// Number of the exchange, from 1.
    pub step: u64,
    /// The fault.
    pub fault: Fault,
}

/// Whether an exchange opens the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    Open,
    Ask,
}

#[derive(Debug, Clone, Default)]
struct Plan {
    steps: u64,
    next: Option<Fault>,
    planned: BTreeMap<u64, Fault>,
    held: Option<Fault>,
}

/// All faults that will be injected.
#[derive(Debug, Clone, Default)]
pub(super) struct Faults {
    manipulators: Pair<Plan>,
    sensor: Plan,
    stage: Plan,
    random: Option<(ChaCha8Rng, f64)>,
    struck: Vec<Struck>,
}

impl Faults {
    fn plan(&mut self, device: Device) -> &mut Plan {
        match device {
            Device::Manipulator(carrier) => self.manipulators.get_mut(carrier),
            Device::Sensor => &mut self.sensor,
            Device::Stage => &mut self.stage,
        }
    }

    pub(super) fn next(&mut self, device: Device, fault: Fault) {
        self.plan(device).next = Some(fault);
    }

    pub(super) fn at(&mut self, device: Device, step: u64, fault: Fault) {
        self.plan(device).planned.insert(step, fault);
    }

    pub(super) fn hold(&mut self, device: Device, fault: Fault) {
        self.plan(device).held = Some(fault);
    }

    pub(super) fn clear(&mut self, device: Device) {
        let plan = self.plan(device);
        *plan = Plan { steps: plan.steps, ..Plan::default() };
    }

    pub(super) fn by_chance(&mut self, seed: u64, ratio: f64) {
        let random = ChaCha8Rng::seed_from_u64(seed);
        self.random = (ratio > 0.0).then(|| (random, ratio.min(1.0)));
    }

    pub(super) fn steps(&mut self, device: Device) -> u64 {
        self.plan(device).steps
    }

    pub(super) fn struck(&self) -> &[Struck] {
        &self.struck
    }

    /// Counts an exchange, and returns its fault, if any.
    pub(super) fn strike(&mut self, device: Device, kind: Step) -> Option<Fault> {
        let plan = self.plan(device);
        plan.steps += 1;
        let step = plan.steps;
        // Connecting does not reveal a half-open connection.
        let waits = kind == Step::Open && plan.next == Some(Fault::HalfOpen);
        let due = if waits { None } else { plan.next.take() };
        let due = due.or_else(|| plan.planned.remove(&step)).or_else(|| plan.held.clone());
        let fault = due.or_else(|| self.draw(device)).filter(|fault| kind == Step::Ask || *fault != Fault::HalfOpen)?;
        if self.struck.len() == STRUCK_MAX {
            self.struck.remove(0);
        }
        self.struck.push(Struck { device, step, fault: fault.clone() });
        Some(fault)
    }

    fn draw(&mut self, device: Device) -> Option<Fault> {
        let (chance, ratio) = self.random.as_mut()?;
        if !chance.random_bool(*ratio) {
            return None;
        }
        let own = match device {
            Device::Manipulator(_) => Fault::LimitHit { axis: Axis::ALL.choose(chance).copied()? },
            Device::Sensor => Fault::Scan(ScanFault::TriggerDrops { count: 1 }),
            Device::Stage => Fault::Stall,
        };
        let late = Duration::from_millis(chance.random_range(1..500));
        let kinds = [
            Fault::LinkLost { arrives: false },
            Fault::LinkLost { arrives: true },
            Fault::Silence { arrives: false },
            Fault::Silence { arrives: true },
            Fault::Late { by: late },
            Fault::Corrupt,
            Fault::Rejected { code: 1 },
            Fault::HalfOpen,
            own,
        ];
        kinds.choose(chance).cloned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const M1: Device = Device::Manipulator(Carrier::M1);

    #[test]
    fn a_planned_fault_occurs_once_at_its_step_and_its_device_only() {
        let mut faults = Faults::default();
        faults.at(M1, 3, Fault::Corrupt);
        let struck: Vec<_> =
            (0..4).map(|_| (faults.strike(M1, Step::Ask), faults.strike(Device::Stage, Step::Ask))).collect();
        assert_eq!(struck, [(None, None), (None, None), (Some(Fault::Corrupt), None), (None, None)]);
        assert_eq!(faults.struck(), [Struck { device: M1, step: 3, fault: Fault::Corrupt }]);
    }

    #[test]
    fn a_half_open_connection_can_be_opened() {
        let mut faults = Faults::default();
        faults.hold(M1, Fault::HalfOpen);
        let seen = [Step::Open, Step::Ask, Step::Open, Step::Ask].map(|step| faults.strike(M1, step));
        assert_eq!(seen, [None, Some(Fault::HalfOpen), None, Some(Fault::HalfOpen)]);
        faults.clear(M1);
        assert_eq!((faults.strike(M1, Step::Ask), faults.steps(M1)), (None, 5));
    }

    #[test]
    fn random_faults_depend_on_the_seed_and_occur_at_the_given_rate() {
        let run = |seed: u64| {
            let mut faults = Faults::default();
            faults.by_chance(seed, 0.1);
            (0..10_000).map(|_| faults.strike(Device::Stage, Step::Ask)).collect::<Vec<_>>()
        };
        assert_eq!(run(5), run(5));
        assert_ne!(run(5), run(6));
        // 1000 ± 30 (binomial), four standard deviations.
        let count = run(5).into_iter().flatten().count();
        assert!((880..1120).contains(&count), "{count}");
    }
}
