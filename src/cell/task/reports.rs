//! Handles the reports of the drivers: keeps the readings, latches faults, and executes the next step of the active work.

use super::CellTask;
use crate::cell::driver::messages::{DeviceReading, DriverEvent, Outcome, Report};
use crate::cell::events::EventKind;
use crate::cell::failure::{Failure, Fault};
use crate::cell::input::{Input, Member};
use crate::cell::obstacles::fault_of;
use crate::cell::refusal::Refusal;
use crate::cell::snapshot::{Link, Live};
use crate::cell::state::State;
use crate::cell::work::{Next, Purpose};
use crate::device::clock::now;
use crate::device::{DeviceError, Reading};
use crate::motion::Carrier;
use tokio::time::Instant;

impl CellTask {
    pub(super) fn take_report(&mut self, Report { member, event }: Report) {
        match event {
            DriverEvent::Up { asked_at, seen } => self.up(member, asked_at, seen),
            DriverEvent::Read { asked_at, seen } => self.read(member, asked_at, seen),
            DriverEvent::Lost { error, was_up } => self.lost(member, error, was_up),
            DriverEvent::Outcome { order, outcome } => self.take_outcome(member, order, outcome),
            DriverEvent::AtRest { halt } => {
                self.rested.insert(member, halt);
            }
            DriverEvent::HaltRefused { error } => self.fault(member, Failure::HaltRefused(error)),
            DriverEvent::Resolved { sequence, taken } => {
                let device = self.name_of(member);
                self.note(EventKind::Resolved { device, sequence, taken });
            }
            DriverEvent::Profiles { received_count } => {
                self.step_scan(|scanning, now| scanning.received(now, received_count));
            }
            DriverEvent::ScanEnded { result } => self.step_scan(|scanning, _| scanning.ended(result)),
        }
    }

    fn up(&mut self, member: Member, asked_at: Instant, seen: DeviceReading) {
        match member {
            Member::Manipulator(carrier) => self.live.get_mut(carrier).link = Link::Up,
            Member::Stage => set_link(self.live_stage.as_mut(), Link::Up),
            Member::Sensor => set_link(self.live_sensor.as_mut(), Link::Up),
        }
        let device = self.name_of(member);
        self.note(EventKind::LinkUp { device });
        self.read(member, asked_at, seen);
        // A sensor that reconnects is no reason to halt a device that an operator moves at its panel, unless its laser is on.
        let moves = if member == Member::Sensor { self.moves(member) } else { self.anything_moves() };
        self.put_event(Input::Up { member, moves });
    }

    fn anything_moves(&self) -> bool {
        let manipulators = Carrier::ALL.into_iter().map(Member::Manipulator);
        manipulators.chain([Member::Stage, Member::Sensor]).any(|member| self.moves(member))
    }

    /// Whether a device moves by its last reading; for the sensor, whether its laser is on.
    pub(super) fn moves(&self, member: Member) -> bool {
        match member {
            Member::Manipulator(carrier) => self.live.get(carrier).reading.as_ref().is_some_and(Reading::moves),
            Member::Stage => {
                self.live_stage.as_ref().and_then(|stage| stage.reading).is_some_and(|reading| reading.moves)
            }
            Member::Sensor => {
                self.live_sensor.as_ref().and_then(|sensor| sensor.reading.as_ref()).is_some_and(|one| one.running)
            }
        }
    }

    fn read(&mut self, member: Member, asked_at: Instant, seen: DeviceReading) {
        match (member, seen) {
            (Member::Manipulator(carrier), DeviceReading::Manipulator(reading)) => {
                self.read_manipulator(carrier, asked_at, &reading);
            }
            (_, DeviceReading::Stage(reading)) => {
                keep(self.live_stage.as_mut(), asked_at, reading);
                self.reread_of_stage(asked_at);
                if reading.fault_code != 0 && !self.machine.resetting() {
                    self.device_fault(Member::Stage, reading.fault_code);
                }
                self.step_scan(|scanning, now| scanning.read(now, asked_at, &reading));
            }
            (_, DeviceReading::Sensor(reading)) => keep(self.live_sensor.as_mut(), asked_at, reading),
            // A driver reports readings of its own device only.
            (_, DeviceReading::Manipulator(_)) => {}
        }
    }

    fn read_manipulator(&mut self, carrier: Carrier, asked_at: Instant, reading: &Reading) {
        keep(Some(self.live.get_mut(carrier)), asked_at, reading.clone());
        self.reread_of(carrier, asked_at);
        let member = Member::Manipulator(carrier);
        if let Some(code) = fault_of(reading)
            && !self.machine.resetting()
        {
            // Most devices then also report a fault of their own, but the operator has to see to the guard first.
            if self.works() && !reading.safety.allows_motion() {
                self.fault(member, Failure::Interrupted(Box::new(Refusal::SafetyOpen { carrier })));
            }
            self.device_fault(member, code);
        }
        if self.works()
            && let Some(next) = self.active.as_mut().map(|active| active.read(now(), carrier, asked_at, reading))
        {
            let device = self.name_of(member);
            self.follow(next, &device);
        }
    }

    fn device_fault(&mut self, member: Member, code: u32) {
        let device = self.name_of(member);
        self.fault(member, Failure::DeviceFault { device, code });
    }

    fn fault(&mut self, member: Member, failure: Failure) {
        let device = self.name_of(member);
        self.put_event(Input::Fault(Fault { device, failure, at: now() }));
    }

    fn lost(&mut self, member: Member, error: DeviceError, was_up: bool) {
        let device = self.name_of(member);
        self.note(EventKind::LinkLost { device: device.clone(), cause: error.to_string() });
        if !was_up {
            return;
        }
        match member {
            Member::Manipulator(carrier) => self.live.get_mut(carrier).link = Link::Lost,
            Member::Stage => set_link(self.live_stage.as_mut(), Link::Lost),
            Member::Sensor => set_link(self.live_sensor.as_mut(), Link::Lost),
        }
        self.put_event(Input::Lost(member, Fault { device, failure: Failure::Device(error), at: now() }));
    }

    fn take_outcome(&mut self, member: Member, order: u64, outcome: Outcome) {
        let Some(purpose) = self.purposes.remove(&order) else { return };
        self.remember_outcome(purpose, &outcome);
        match purpose {
            Purpose::Manual(_, manual) => self.manual_outcome(member, manual.name(), outcome),
            Purpose::Reset(carrier) => self.reset_outcome(carrier, outcome),
            Purpose::Work(_) | Purpose::Carry | Purpose::Arm => {
                if self.works()
                    && let Some(next) = self.active.as_mut().map(|active| active.take_outcome(now(), purpose, outcome))
                {
                    let device = self.name_of(member);
                    self.follow(next, &device);
                }
            }
        }
    }

    fn manual_outcome(&mut self, member: Member, verb: &'static str, outcome: Outcome) {
        let device = self.name_of(member);
        match outcome {
            Outcome::Taken { .. } => self.note(EventKind::ManualDone { device, verb }),
            Outcome::Refused(error) => {
                self.note(EventKind::ManualRefused { device, verb, cause: error.to_string() });
            }
            Outcome::Overtaken => {
                let cause = "a halt came first".to_owned();
                self.note(EventKind::ManualRefused { device, verb, cause });
            }
            // Not a fault, because the cause of the halt is already reported.
            Outcome::Cut => {
                let cause = "a halt came before its acknowledgement; whether it was executed is not known".to_owned();
                self.note(EventKind::ManualRefused { device, verb, cause });
            }
            Outcome::Unknown(failure) => self.fault(member, failure),
        }
    }

    /// Takes the outcome of a reset. Readings from before the acknowledgement of the device do not count.
    fn reset_outcome(&mut self, carrier: Carrier, outcome: Outcome) {
        match outcome {
            Outcome::Taken { .. } => {
                if let Some(rereading) = &mut self.rereading {
                    *rereading.since.get_mut(carrier) = now();
                }
            }
            Outcome::Refused(error) => self.fault(Member::Manipulator(carrier), Failure::Device(error)),
            Outcome::Unknown(failure) => self.fault(Member::Manipulator(carrier), failure),
            // The cause of the halt is already reported; the next reading shows whether the fault of the device is gone.
            Outcome::Overtaken | Outcome::Cut => {}
        }
    }

    /// Executes the next step of the scan under way, if there is one.
    fn step_scan(
        &mut self,
        step: impl FnOnce(&mut crate::cell::scanning::Scanning, Instant) -> crate::cell::scanning::ScanStep,
    ) {
        if self.machine.state() != State::Scanning {
            return;
        }
        if let Some(next) = self.active.as_mut().and_then(|active| active.scan()).map(|scan| step(scan, now())) {
            let device = self.stage_name();
            self.follow(Next::Scan(next), &device);
        }
    }

    /// Checks the deadline of the active work.
    pub(super) fn take_work_time(&mut self, now: Instant) {
        if !self.works() {
            return;
        }
        let positions = self.live.map(|_, one| one.reading.as_ref().map(Reading::position));
        let stage = self.live_stage.as_ref().and_then(|stage| stage.reading);
        if let Some(next) = self.active.as_ref().map(|active| active.time(now, &positions, stage.as_ref())) {
            self.follow(next, "cell");
        }
    }
}

fn keep<R>(live: Option<&mut Live<R>>, asked_at: Instant, reading: R) {
    if let Some(live) = live {
        (live.reading, live.read_at) = (Some(reading), Some(asked_at));
    }
}

fn set_link<R>(live: Option<&mut Live<R>>, link: Link) {
    if let Some(live) = live {
        live.link = link;
    }
}
