//! Executes what the machine has decided: raises the halt flag, sends commands to the drivers, and determines whether every device
//! is at rest, or was read again after a reset. It decides nothing itself.

use super::{CellTask, Rereading, Rest};
use crate::cell::driver::messages::{DriverOrder, ManipulatorCommand, StageCommand};
use crate::cell::failure::{Failure, Fault};
use crate::cell::input::{Input, Manual, Member};
use crate::cell::obstacles::fault_of;
use crate::cell::run::Step;
use crate::cell::scanning::ScanStep;
use crate::cell::snapshot::Link;
use crate::cell::state::State;
use crate::cell::work::{Next, Purpose};
use crate::device::clock::now;
use crate::device::{Action, DeviceError};
use crate::motion::{Axes, Carrier, Pair};
use tokio::sync::mpsc;
use tokio::time::Instant;

impl CellTask {
    /// Halts every device. `raised` is true if the request for the stop has already raised the halt flag.
    pub(super) fn halt(&mut self, raised: bool) {
        self.halts_known = if raised { self.halts.borrow().number } else { self.flag.raise() };
        self.rest = Some(Rest { halt: self.halts_known, until: now() + self.settings.rest });
    }

    pub(super) fn begin(&mut self) {
        self.active = self.prepared.take();
        if let Some(next) = self.active.as_ref().map(|active| active.begin()) {
            self.follow(next, "cell");
        }
    }

    /// Executes the next step of the active work. `device` is the device whose report led to it.
    pub(super) fn follow(&mut self, next: Next, device: &str) {
        match next {
            Next::Manipulators(Step::Wait) | Next::Scan(ScanStep::Wait) => {}
            Next::Manipulators(Step::Send(commands)) => {
                for (carrier, command) in commands {
                    self.order(carrier, command, Purpose::Work(carrier));
                }
            }
            Next::Scan(ScanStep::Carry(travel)) => self.carry(travel, Some(Purpose::Carry)),
            Next::Scan(ScanStep::Arm) => self.arm(),
            Next::Manipulators(Step::Finished) | Next::Scan(ScanStep::Finished) => self.put_event(Input::Finished),
            Next::Manipulators(Step::Fail(failure)) | Next::Scan(ScanStep::Fail(failure)) => {
                self.fail(device, failure);
            }
        }
        if let Some(active) = &self.active {
            active.report_progress();
        }
    }

    /// Latches the failure as a fault if it needs a reset; otherwise only the work ends.
    pub(super) fn fail(&mut self, device: &str, failure: Failure) {
        if failure.latches() {
            let device = device.to_owned();
            self.put_event(Input::Fault(Fault { device, failure, at: now() }));
        } else {
            self.put_event(Input::GivenUp(failure));
        }
    }

    pub(super) fn order_manual(&mut self, carrier: Carrier, manual: Manual) {
        let action = match manual {
            Manual::Enable => Action::Enable,
            Manual::Disable => Action::Disable,
            Manual::Home => Action::Home { axes: Axes::from_fn(|_| true) },
        };
        self.order(carrier, ManipulatorCommand::Send(action), Purpose::Manual(carrier, manual));
    }

    pub(super) fn order(&mut self, carrier: Carrier, command: ManipulatorCommand, purpose: Purpose) {
        let has_outcome = command != ManipulatorCommand::Read;
        let order = self.order_of(command);
        if has_outcome {
            self.purposes.insert(order.number, purpose);
        }
        let sent = send(self.drivers.manipulators.get(carrier), order);
        self.check_sent(sent, self.live.get(carrier).name.clone());
    }

    fn carry(&mut self, travel: StageCommand, purpose: Option<Purpose>) {
        let order = self.order_of(travel);
        if let Some(purpose) = purpose {
            self.purposes.insert(order.number, purpose);
        }
        let sent = self.drivers.stage.as_ref().is_none_or(|line| send(line, order));
        self.check_sent(sent, self.stage_name());
    }

    fn arm(&mut self) {
        let Some(taking) = self.active.as_mut().and_then(|active| active.taking()) else { return };
        let order = self.order_of(taking);
        self.purposes.insert(order.number, Purpose::Arm);
        let sent = self.drivers.sensor.as_ref().is_none_or(|line| send(line, order));
        self.check_sent(sent, self.sensor_name());
    }

    fn order_of<E>(&mut self, command: E) -> DriverOrder<E> {
        self.orders_count += 1;
        let fence = self.machine.leases().fence();
        DriverOrder { number: self.orders_count, halts: self.halts_known, fence, command }
    }

    /// A driver that accepts no commands is blocked or has ended, which is a fault.
    fn check_sent(&mut self, sent: bool, device: String) {
        if !sent {
            let cause = "its driver takes no commands".to_owned();
            let failure = Failure::Device(DeviceError::LinkLost { device: device.clone(), cause });
            self.put_event(Input::Fault(Fault { device, failure, at: now() }));
        }
    }

    /// Acknowledges the faults of the devices themselves, and reads every device.
    pub(super) fn reread(&mut self) {
        let now = now();
        self.rereading = Some(Rereading {
            since: Pair { m1: now, m2: now },
            read: Pair::default(),
            stage_since: now,
            stage_read: self.live_stage.is_none(),
            until: now + self.settings.rest,
        });
        for carrier in Carrier::ALL {
            let faulted = self.live.get(carrier).reading.as_ref().and_then(fault_of).is_some();
            let command = if faulted { ManipulatorCommand::Send(Action::Reset) } else { ManipulatorCommand::Read };
            self.order(carrier, command, Purpose::Reset(carrier));
        }
        if self.live_stage.is_some() {
            self.carry(StageCommand::Read, None);
        }
    }

    /// A device that was not read at rest after the newest halt, if there is one.
    pub(super) fn restless(&self) -> Option<Member> {
        self.restless_that(|_| true)
    }

    fn restless_that(&self, also: impl Fn(Member) -> bool) -> Option<Member> {
        let halt = self.rest?.halt;
        let up = |link: Link| link == Link::Up;
        let manipulators = Carrier::ALL.into_iter().filter(|carrier| up(self.live.get(*carrier).link));
        let stage = self.live_stage.as_ref().filter(|stage| up(stage.link)).map(|_| Member::Stage);
        let sensor = self.live_sensor.as_ref().filter(|sensor| up(sensor.link)).map(|_| Member::Sensor);
        let mut all = manipulators.map(Member::Manipulator).chain(stage).chain(sensor);
        all.find(|member| self.rested.get(member).is_none_or(|rested| *rested < halt) && also(*member))
    }

    /// After a halt: determines whether every device is at rest, or one is late.
    pub(super) fn look_for_rest(&mut self, now: Instant) {
        let Some(Rest { until, .. }) = self.rest else { return };
        match (self.machine.state(), self.restless()) {
            (State::Stopping, None) => self.put_event(Input::AtRest),
            (State::Stopping, Some(member)) if now >= until => self.late(member, now),
            (State::Faulted, None) => self.rest = None,
            // A device may refuse the halt after a fault and be at rest nevertheless; one that still moves is halted again.
            (State::Faulted, Some(_)) if now >= until => {
                let moving = self.restless_that(|member| self.moves(member));
                self.rest = None;
                if let Some(member) = moving {
                    self.late(member, now);
                }
            }
            (State::Offline | State::Idle | State::Scanning | State::Moving | State::Stopping | State::Faulted, _) => {}
        }
    }

    fn late(&mut self, member: Member, now: Instant) {
        let device = self.name_of(member);
        let failure = Failure::NotAtRest { device: device.clone(), within: self.settings.rest };
        self.put_event(Input::Fault(Fault { device, failure, at: now }));
    }

    /// After a reset: determines whether every device was read, or one is late.
    pub(super) fn look_for_reread(&mut self, now: Instant) {
        let Some(rereading) = self.rereading else { return };
        let Rereading { read, stage_read, until, .. } = rereading;
        if read.m1 && read.m2 && stage_read {
            self.put_event(Input::Reread);
        } else if now >= until {
            let member = match read {
                Pair { m1: false, .. } => Member::Manipulator(Carrier::M1),
                Pair { m2: false, .. } => Member::Manipulator(Carrier::M2),
                Pair { .. } => Member::Stage,
            };
            let device = self.name_of(member);
            let failure = self.still_faulted(member);
            self.put_event(Input::Fault(Fault { device, failure, at: now }));
        }
    }

    /// Why the reset cannot accept the reading of a device.
    fn still_faulted(&self, member: Member) -> Failure {
        let (device, within) = (self.name_of(member), self.settings.rest);
        let code = match member {
            Member::Manipulator(carrier) => self.live.get(carrier).reading.as_ref().and_then(fault_of),
            Member::Stage => {
                let reading = self.live_stage.as_ref().and_then(|stage| stage.reading);
                reading.map(|reading| reading.fault_code).filter(|code| *code != 0)
            }
            Member::Sensor => None,
        };
        match code {
            Some(code) => Failure::DeviceFault { device, code },
            None => Failure::NotAtRest { device, within },
        }
    }

    /// Takes the reading of a manipulator during a reset.
    pub(super) fn reread_of(&mut self, carrier: Carrier, asked_at: Instant) {
        let outstanding = self.purposes.values().any(|purpose| *purpose == Purpose::Reset(carrier));
        let Some(rereading) = &mut self.rereading else { return };
        let Some(reading) = &self.live.get(carrier).reading else { return };
        if !outstanding && asked_at >= *rereading.since.get(carrier) {
            *rereading.read.get_mut(carrier) = fault_of(reading).is_none() && !reading.moves();
        }
    }

    /// Takes the reading of the stage during a reset.
    pub(super) fn reread_of_stage(&mut self, asked_at: Instant) {
        let Some(rereading) = &mut self.rereading else { return };
        let Some(reading) = self.live_stage.as_ref().and_then(|stage| stage.reading) else { return };
        if asked_at >= rereading.stage_since {
            rereading.stage_read = reading.fault_code == 0 && !reading.moves;
        }
    }

    pub(super) fn name_of(&self, member: Member) -> String {
        match member {
            Member::Manipulator(carrier) => self.live.get(carrier).name.clone(),
            Member::Stage => self.stage_name(),
            Member::Sensor => self.sensor_name(),
        }
    }

    pub(super) fn stage_name(&self) -> String {
        self.live_stage.as_ref().map_or_else(|| "stage".to_owned(), |live| live.name.clone())
    }

    pub(super) fn sensor_name(&self) -> String {
        self.live_sensor.as_ref().map_or_else(|| "sensor".to_owned(), |live| live.name.clone())
    }
}

fn send<E>(line: &mpsc::Sender<DriverOrder<E>>, order: DriverOrder<E>) -> bool {
    line.try_send(order).is_ok()
}
