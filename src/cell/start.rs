//! Starts the cell: a driver for each device, then the task that they report to.

use super::driver::{
    HaltFlag, ManipulatorDriver, Order, Post, Report, SensorDriver, StageDriver, Taking, Timing, Travel,
};
use super::events::EventLog;
use super::input::Member;
use super::settings::{Devices, Settings};
use super::snapshot::Live;
use super::stop::StopDoor;
use super::task::{Lines, Task};
use super::{Cell, now};
use crate::device::{Manipulator, ProfileSensor, Stage};
use crate::motion::{Carrier, Pair};
use std::sync::Arc;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

/// Requests that may wait; a client that sends faster is slowed.
const REQUESTS_WAITING: usize = 64;
/// Reports that may wait; the task takes them as they come.
const REPORTS_WAITING: usize = 256;
/// Orders that may wait at a driver; the task gives the next one after the word on the last.
const ORDERS_WAITING: usize = 8;

/// Starts everything; the handle is that of the cell's task.
pub(super) fn start(devices: Devices, settings: Settings, fence_floor: u64) -> (Cell, JoinHandle<()>) {
    let flag = Arc::new(HaltFlag::new(fence_floor));
    let (reports, reported) = mpsc::channel(REPORTS_WAITING);
    let mut hire = Hire { settings: &settings, flag: &flag, reports, watched: Vec::new() };
    let Devices { manipulators: Pair { m1, m2 }, sensor, stage } = devices;
    let live = Pair { m1: live(m1.name(), &settings), m2: live(m2.name(), &settings) };
    let live_stage = stage.as_ref().map(|stage| live_of(stage.name(), settings.poll));
    let live_sensor = sensor.as_ref().map(|sensor| live_of(sensor.name(), settings.sensor_poll));
    let sensor_deadlines = sensor.as_ref().map(|sensor| sensor.deadlines()).unwrap_or_default();
    let orders = Pair { m1: hire.manipulator(Carrier::M1, m1), m2: hire.manipulator(Carrier::M2, m2) };
    let stage = stage.map(|stage| hire.stage(stage));
    let sensor = sensor.map(|sensor| hire.sensor(sensor));
    let Hire { watched, .. } = hire;

    let log = Arc::new(EventLog::new());
    let lines = Lines { manipulators: orders, stage, sensor, sensor_deadlines };
    let (requests, requested) = mpsc::channel(REQUESTS_WAITING);
    let task = Task::new(settings, lines, (live, live_stage, live_sensor), &flag, Arc::clone(&log), fence_floor);
    let (published, snapshots) = watch::channel(Arc::new(task.snapshot(0, now())));
    let running = tokio::spawn(task.run(requested, reported, published));
    (Cell { requests, stops: Arc::new(StopDoor::new(flag, watched)), snapshots, log }, running)
}

fn live<R>(name: &str, settings: &Settings) -> Live<R> {
    live_of(name, settings.poll)
}

fn live_of<R>(name: &str, poll: std::time::Duration) -> Live<R> {
    Live::unknown(name.to_owned(), poll * 3)
}

/// Starts drivers.
struct Hire<'a> {
    settings: &'a Settings,
    flag: &'a HaltFlag,
    reports: mpsc::Sender<Report>,
    watched: Vec<(Member, String, watch::Receiver<super::driver::Halted>)>,
}

impl Hire<'_> {
    /// A driver's ends of the lines; a stop reports on every device.
    fn post(&mut self, member: Member, name: &str, timing: Timing) -> Post {
        let (post, halted) = Post::new(member, name.to_owned(), self.reports.clone(), self.flag, timing);
        self.watched.push((member, name.to_owned(), halted));
        post
    }

    fn manipulator(
        &mut self,
        carrier: Carrier,
        device: Box<dyn Manipulator>,
    ) -> mpsc::Sender<Order<super::driver::Handling>> {
        let member = Member::Manipulator(carrier);
        let post = self.post(member, device.name(), Timing::of(self.settings));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(ManipulatorDriver::new(carrier, device, post, ordered).run());
        orders
    }

    fn stage(&mut self, device: Box<dyn Stage>) -> mpsc::Sender<Order<Travel>> {
        let post = self.post(Member::Stage, device.name(), Timing::of(self.settings));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(StageDriver::new(device, post, ordered).run());
        orders
    }

    fn sensor(&mut self, device: Box<dyn ProfileSensor>) -> mpsc::Sender<Order<Taking>> {
        let post = self.post(Member::Sensor, device.name(), Timing::of_sensor(self.settings, &device.deadlines()));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(SensorDriver::new(device, post, ordered).run());
        orders
    }
}
