//! Takes what the drivers say: keeps the readings, latches what is wrong, and gives what is under way its next step.

use super::Task;
use crate::cell::driver::{News, Outcome, Report, Seen, moves};
use crate::cell::events::EventKind;
use crate::cell::failure::{Failure, Fault};
use crate::cell::input::{Input, Member};
use crate::cell::now;
use crate::cell::obstacles::fault_of;
use crate::cell::refusal::Refusal;
use crate::cell::snapshot::{Link, Live};
use crate::cell::state::State;
use crate::cell::work::{Next, Purpose};
use crate::device::{DeviceError, Reading};
use crate::motion::Carrier;
use tokio::time::Instant;

impl Task {
    pub(super) fn take_report(&mut self, Report { member, news }: Report) {
        match news {
            News::Up { asked_at, seen } => self.up(member, asked_at, seen),
            News::Read { asked_at, seen } => self.read(member, asked_at, seen),
            News::Lost { error, was_up } => self.lost(member, error, was_up),
            News::Told { order, outcome } => self.told(member, order, outcome),
            News::Rested { halt } => {
                self.rested.insert(member, halt);
            }
            News::WillNotHalt { error } => self.fault(member, Failure::HaltRefused(error)),
            News::Resolved { sequence, taken } => {
                let device = self.name_of(member);
                self.note(EventKind::Resolved { device, sequence, taken });
            }
            News::Profiles { received_count } => self.scanned(|scanning, now| scanning.received(now, received_count)),
            News::ScanEnded { result } => self.scanned(|scanning, _| scanning.ended(result)),
        }
    }

    fn up(&mut self, member: Member, asked_at: Instant, seen: Seen) {
        match member {
            Member::Manipulator(carrier) => self.live.get_mut(carrier).link = Link::Up,
            Member::Stage => set_link(self.live_stage.as_mut(), Link::Up),
            Member::Sensor => set_link(self.live_sensor.as_mut(), Link::Up),
        }
        let device = self.name_of(member);
        self.note(EventKind::LinkUp { device });
        self.read(member, asked_at, seen);
        // A sensor that comes back is no reason to halt what somebody moves at its panel, unless its laser is on.
        let moves = if member == Member::Sensor { self.moves(member) } else { self.anything_moves() };
        self.tell(Input::Up { member, moves });
    }

    fn anything_moves(&self) -> bool {
        let manipulators = Carrier::ALL.into_iter().map(Member::Manipulator);
        manipulators.chain([Member::Stage, Member::Sensor]).any(|member| self.moves(member))
    }

    /// By what was read last. Of the sensor: its laser is on.
    pub(super) fn moves(&self, member: Member) -> bool {
        match member {
            Member::Manipulator(carrier) => self.live.get(carrier).reading.as_ref().is_some_and(moves),
            Member::Stage => {
                self.live_stage.as_ref().and_then(|stage| stage.reading).is_some_and(|reading| reading.moves)
            }
            Member::Sensor => {
                self.live_sensor.as_ref().and_then(|sensor| sensor.reading.as_ref()).is_some_and(|one| one.running)
            }
        }
    }

    fn read(&mut self, member: Member, asked_at: Instant, seen: Seen) {
        match (member, seen) {
            (Member::Manipulator(carrier), Seen::Manipulator(reading)) => {
                self.read_manipulator(carrier, asked_at, &reading);
            }
            (_, Seen::Stage(reading)) => {
                keep(self.live_stage.as_mut(), asked_at, reading);
                self.reread_of_stage(asked_at);
                if reading.fault_code != 0 && !self.machine.resetting() {
                    self.device_fault(Member::Stage, reading.fault_code);
                }
                self.scanned(|scanning, now| scanning.read(now, asked_at, &reading));
            }
            (_, Seen::Sensor(reading)) => keep(self.live_sensor.as_mut(), asked_at, reading),
            // A driver says what its own device is; nothing else comes.
            (_, Seen::Manipulator(_)) => {}
        }
    }

    fn read_manipulator(&mut self, carrier: Carrier, asked_at: Instant, reading: &Reading) {
        keep(Some(self.live.get_mut(carrier)), asked_at, reading.clone());
        self.reread_of(carrier, asked_at);
        let member = Member::Manipulator(carrier);
        if let Some(code) = fault_of(reading)
            && !self.machine.resetting()
        {
            // Most devices report a fault of their own then, too; the guard is what an operator has to see to first.
            if self.works() && !reading.safety.allows_motion() {
                self.fault(member, Failure::Interrupted(Box::new(Refusal::SafetyOpen { carrier })));
            }
            self.device_fault(member, code);
        }
        if self.works()
            && let Some(next) = self.course.as_mut().map(|course| course.read(now(), carrier, asked_at, reading))
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
        self.tell(Input::Fault(Fault { device, failure, at: now() }));
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
        self.tell(Input::Lost(member, Fault { device, failure: Failure::Device(error), at: now() }));
    }

    fn told(&mut self, member: Member, order: u64, outcome: Outcome) {
        let Some(purpose) = self.purposes.remove(&order) else { return };
        self.remember_outcome(purpose, &outcome);
        match purpose {
            Purpose::Manual(_, manual) => self.manual_told(member, manual.name(), outcome),
            Purpose::Reset(carrier) => self.reset_told(carrier, outcome),
            Purpose::Work(_) | Purpose::Carry | Purpose::Arm => {
                if self.works()
                    && let Some(next) = self.course.as_mut().map(|course| course.told(now(), purpose, outcome))
                {
                    let device = self.name_of(member);
                    self.follow(next, &device);
                }
            }
        }
    }

    fn manual_told(&mut self, member: Member, verb: &'static str, outcome: Outcome) {
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
            // No fault of its own: whatever has raised the halt is told already.
            Outcome::Cut => {
                let cause = "a halt came before its acknowledgement; whether it was done is not known".to_owned();
                self.note(EventKind::ManualRefused { device, verb, cause });
            }
            Outcome::Unknown(failure) => self.fault(member, failure),
        }
    }

    /// Readings from before the device had acknowledged do not count.
    fn reset_told(&mut self, carrier: Carrier, outcome: Outcome) {
        match outcome {
            Outcome::Taken { .. } => {
                if let Some(rereading) = &mut self.rereading {
                    *rereading.since.get_mut(carrier) = now();
                }
            }
            Outcome::Refused(error) => self.fault(Member::Manipulator(carrier), Failure::Device(error)),
            Outcome::Unknown(failure) => self.fault(Member::Manipulator(carrier), failure),
            // Whatever has raised the halt is told already; what is read says whether the device's fault is gone.
            Outcome::Overtaken | Outcome::Cut => {}
        }
    }

    /// Gives the scan under way its next step, where there is one.
    fn scanned(
        &mut self,
        step: impl FnOnce(&mut crate::cell::scanning::Scanning, Instant) -> crate::cell::scanning::ScanStep,
    ) {
        if self.machine.state() != State::Scanning {
            return;
        }
        if let Some(next) = self.course.as_mut().and_then(|course| course.scan()).map(|scan| step(scan, now())) {
            let device = self.stage_name();
            self.follow(Next::Scan(next), &device);
        }
    }

    /// What is under way may be late.
    pub(super) fn take_work_time(&mut self, now: Instant) {
        if !self.works() {
            return;
        }
        let positions = self.live.map(|_, one| one.reading.as_ref().map(Reading::position));
        let stage = self.live_stage.as_ref().and_then(|stage| stage.reading);
        if let Some(next) = self.course.as_ref().map(|course| course.time(now, &positions, stage.as_ref())) {
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
