//! Does what was decided: raises the halt flag, gives orders to the drivers, and looks whether everything is at rest or was
//! read again. Decides nothing.

use super::{Rereading, Rest, Task};
use crate::cell::driver::{Handling, Order, Travel, moves};
use crate::cell::failure::{Failure, Fault};
use crate::cell::input::{Input, Manual, Member};
use crate::cell::now;
use crate::cell::obstacles::fault_of;
use crate::cell::run::Step;
use crate::cell::scanning::ScanStep;
use crate::cell::snapshot::Link;
use crate::cell::state::State;
use crate::cell::work::{Next, Purpose};
use crate::device::{Action, DeviceError};
use crate::motion::{Axes, Carrier, Pair};
use tokio::sync::mpsc;
use tokio::time::Instant;

impl Task {
    /// `raised`: by whoever asked for the stop, before we heard of it.
    pub(super) fn halt(&mut self, raised: bool) {
        self.halts_known = if raised { self.halts.borrow().number } else { self.flag.raise() };
        self.rest = Some(Rest { halt: self.halts_known, until: now() + self.settings.rest });
    }

    pub(super) fn begin(&mut self) {
        self.course = self.prepared.take();
        if let Some(next) = self.course.as_ref().map(|course| course.begin()) {
            self.follow(next, "cell");
        }
    }

    /// Takes the next step of what is under way. `device` is the one that it came from.
    pub(super) fn follow(&mut self, next: Next, device: &str) {
        match next {
            Next::Manipulators(Step::Wait) | Next::Scan(ScanStep::Wait) => {}
            Next::Manipulators(Step::Order(orders)) => {
                for (carrier, handling) in orders {
                    self.order(carrier, handling, Purpose::Work(carrier));
                }
            }
            Next::Scan(ScanStep::Carry(travel)) => self.carry(travel, Some(Purpose::Carry)),
            Next::Scan(ScanStep::Arm) => self.arm(),
            Next::Manipulators(Step::Finished) | Next::Scan(ScanStep::Finished) => self.tell(Input::Finished),
            Next::Manipulators(Step::Fail(failure)) | Next::Scan(ScanStep::Fail(failure)) => {
                self.fail(device, failure);
            }
        }
        if let Some(course) = &self.course {
            course.tell_progress();
        }
    }

    /// What leaves no device in doubt ends the work; anything else is latched.
    pub(super) fn fail(&mut self, device: &str, failure: Failure) {
        if failure.latches() {
            let device = device.to_owned();
            self.tell(Input::Fault(Fault { device, failure, at: now() }));
        } else {
            self.tell(Input::GivenUp(failure));
        }
    }

    pub(super) fn order_manual(&mut self, carrier: Carrier, manual: Manual) {
        let action = match manual {
            Manual::Enable => Action::Enable,
            Manual::Disable => Action::Disable,
            Manual::Home => Action::Home { axes: Axes::from_fn(|_| true) },
        };
        self.order(carrier, Handling::Send(action), Purpose::Manual(carrier, manual));
    }

    pub(super) fn order(&mut self, carrier: Carrier, handling: Handling, purpose: Purpose) {
        let says = handling != Handling::Look;
        let order = self.made(handling);
        if says {
            self.purposes.insert(order.number, purpose);
        }
        let sent = given(self.lines.manipulators.get(carrier), order);
        self.mind(sent, self.live.get(carrier).name.clone());
    }

    fn carry(&mut self, travel: Travel, purpose: Option<Purpose>) {
        let order = self.made(travel);
        if let Some(purpose) = purpose {
            self.purposes.insert(order.number, purpose);
        }
        let sent = self.lines.stage.as_ref().is_none_or(|line| given(line, order));
        self.mind(sent, self.stage_name());
    }

    fn arm(&mut self) {
        let Some(taking) = self.course.as_mut().and_then(|course| course.taking()) else { return };
        let order = self.made(taking);
        self.purposes.insert(order.number, Purpose::Arm);
        let sent = self.lines.sensor.as_ref().is_none_or(|line| given(line, order));
        self.mind(sent, self.sensor_name());
    }

    fn made<E>(&mut self, errand: E) -> Order<E> {
        self.orders_count += 1;
        let fence = self.machine.tenancy().fence();
        Order { number: self.orders_count, halts: self.halts_known, fence, errand }
    }

    /// A driver that takes no orders is hung, or gone; nothing may go on as if it had.
    fn mind(&mut self, sent: bool, device: String) {
        if !sent {
            let cause = "its driver takes no orders".to_owned();
            let failure = Failure::Device(DeviceError::LinkLost { device: device.clone(), cause });
            self.tell(Input::Fault(Fault { device, failure, at: now() }));
        }
    }

    /// Acknowledges the devices' own faults where there are any, and reads all of them.
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
            let handling = if faulted { Handling::Send(Action::Reset) } else { Handling::Look };
            self.order(carrier, handling, Purpose::Reset(carrier));
        }
        if self.live_stage.is_some() {
            self.carry(Travel::Look, None);
        }
    }

    /// A device of which a halt has not been seen to be over.
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

    /// After a halt: looks whether everything is at rest, or late.
    pub(super) fn look_for_rest(&mut self, now: Instant) {
        let Some(Rest { until, .. }) = self.rest else { return };
        match (self.machine.state(), self.restless()) {
            (State::Stopping, None) => self.tell(Input::AtRest),
            (State::Stopping, Some(member)) if now >= until => self.late(member, now),
            (State::Faulted, None) => self.rest = None,
            // What a fault has halted may have refused it and stand all the same; what moves is halted once more.
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
        self.tell(Input::Fault(Fault { device, failure, at: now }));
    }

    /// After a reset: looks whether every device was read, or one is late.
    pub(super) fn look_for_reread(&mut self, now: Instant) {
        let Some(rereading) = self.rereading else { return };
        let Rereading { read, stage_read, until, .. } = rereading;
        if read.m1 && read.m2 && stage_read {
            self.tell(Input::Reread);
        } else if now >= until {
            let member = match read {
                Pair { m1: false, .. } => Member::Manipulator(Carrier::M1),
                Pair { m2: false, .. } => Member::Manipulator(Carrier::M2),
                Pair { .. } => Member::Stage,
            };
            let device = self.name_of(member);
            let failure = self.still_faulted(member);
            self.tell(Input::Fault(Fault { device, failure, at: now }));
        }
    }

    /// What keeps a device from counting as read after a reset.
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

    /// A manipulator was read while a reset is under way.
    pub(super) fn reread_of(&mut self, carrier: Carrier, asked_at: Instant) {
        let outstanding = self.purposes.values().any(|purpose| *purpose == Purpose::Reset(carrier));
        let Some(rereading) = &mut self.rereading else { return };
        let Some(reading) = &self.live.get(carrier).reading else { return };
        if !outstanding && asked_at >= *rereading.since.get(carrier) {
            *rereading.read.get_mut(carrier) = fault_of(reading).is_none() && !moves(reading);
        }
    }

    /// The stage was read while a reset is under way.
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

fn given<E>(line: &mpsc::Sender<Order<E>>, order: Order<E>) -> bool {
    line.try_send(order).is_ok()
}
