//! The handle of the cell: starts a driver for each device and the task that they report to, and sends requests to that task.
//! A stop does not wait behind the other requests: it raises the halt flag itself (see `stop`).

use super::driver::context::{DriverContext, Timing};
use super::driver::manipulator::ManipulatorDriver;
use super::driver::messages::{Acquisition, DriverOrder, Report, StageCommand};
use super::driver::sensor::SensorDriver;
use super::driver::stage::StageDriver;
use super::events::{EventLog, Events};
use super::input::{Manual, Member, Taken};
use super::lease::{Lease, LeaseRequest};
use super::refusal::Refusal;
use super::request::{Job, Reply, Request};
use super::settings::{Devices, ScanOrder, Settings};
use super::snapshot::{Live, Snapshot};
use super::stop::{HaltFlag, Halted, StopEntry, StopReport};
use super::task::{CellTask, Drivers};
use crate::device::clock::now;
use crate::device::{Manipulator, Profile, ProfileSensor, Stage};
use crate::motion::{Carrier, Pair, Path};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;

/// The handle of the cell. It is cheap to clone. When the last one is dropped, the cell stops its devices and ends.
#[derive(Debug, Clone)]
pub struct Cell {
    requests: mpsc::Sender<Request>,
    stops: Arc<StopEntry>,
    snapshots: watch::Receiver<Arc<Snapshot>>,
    log: Arc<EventLog>,
}

impl Cell {
    /// Starts the cell: connects to the devices, and moves nothing. Every new fencing token is greater than `fence_floor`, which
    /// must be the greatest token that was ever used. Must be called within a tokio runtime.
    #[must_use]
    pub fn start(devices: Devices, settings: Settings, fence_floor: u64) -> Self {
        start(devices, settings, fence_floor).0
    }

    /// Whether the task of the cell still accepts requests. If it does not and the cell was not closed, the task has failed: every
    /// device was halted, and the snapshot is out of date.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }

    /// The current snapshot.
    #[must_use]
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.snapshots.borrow().clone()
    }

    /// A channel that changes with every snapshot.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Arc<Snapshot>> {
        self.snapshots.clone()
    }

    /// Acquires the lease, or renews it if the client already has it under the same id.
    ///
    /// # Errors
    /// [`Refusal::LeaseHeld`] if another client holds it.
    pub async fn take_lease(&self, request: LeaseRequest) -> Result<Lease, Refusal> {
        self.ask(|reply| Request::TakeLease(request, reply)).await
    }

    /// Renews the lease.
    ///
    /// # Errors
    /// The refusal if the lease has ended, or another client holds it.
    pub async fn renew_lease(&self, id: &str) -> Result<Lease, Refusal> {
        self.ask(|reply| Request::RenewLease(id.to_owned(), reply)).await
    }

    /// Releases the lease. A motion that was started under it stops.
    ///
    /// # Errors
    /// The refusal if the lease has ended, or another client holds it.
    pub async fn release_lease(&self, id: &str) -> Result<(), Refusal> {
        self.ask(|reply| Request::ReleaseLease(id.to_owned(), reply)).await
    }

    /// Enables, disables or homes a manipulator. Returns when the command has been accepted.
    ///
    /// # Errors
    /// The reason for the refusal; nothing was sent to the devices.
    pub async fn act(&self, lease: &str, carrier: Carrier, manual: Manual) -> Result<Taken, Refusal> {
        self.ask(|reply| Request::Act { lease: lease.to_owned(), carrier, manual, reply }).await
    }

    /// Starts a move along a path, which is checked again against the limits and the positions of the devices. Returns at once. A
    /// request repeated for the same job while it is under way gets the same answer.
    ///
    /// # Errors
    /// The reason for the refusal; nothing was sent to the devices.
    pub async fn start_move(&self, lease: &str, job: &str, path: Path) -> Result<Job, Refusal> {
        let (lease, job) = (lease.to_owned(), job.to_owned());
        self.ask(|reply| Request::Move { lease, job, path, reply }).await
    }

    /// Starts a scan. Returns at once; the profiles arrive over the channel as the sensor sends them. The scan fails if the
    /// receiver is dropped, or is not read for one second.
    ///
    /// # Errors
    /// The reason for the refusal; nothing was sent to the devices.
    pub async fn start_scan(
        &self,
        lease: &str,
        job: &str,
        order: ScanOrder,
    ) -> Result<(Job, mpsc::Receiver<Vec<Profile>>), Refusal> {
        let (lease, job) = (lease.to_owned(), job.to_owned());
        self.ask(|reply| Request::Scan { lease, job, order, reply }).await
    }

    /// Stops every device: an operational stop, category 2. It needs no lease, works in every state, and may be repeated. The halt
    /// flag is raised before this function first waits. It waits at most 30 ms for the devices, and reports what they have
    /// confirmed by then.
    pub async fn stop(&self) -> StopReport {
        self.stops.stop().await
    }

    /// Acknowledges the latched faults and reads every device; when all are at rest without a fault, the cell becomes idle. Returns
    /// when this has begun; the state shows the result.
    ///
    /// # Errors
    /// The reason for the refusal.
    pub async fn reset(&self, lease: &str) -> Result<Taken, Refusal> {
        self.ask(|reply| Request::Reset { lease: lease.to_owned(), reply }).await
    }

    /// Returns the events after number `after`.
    #[must_use]
    pub fn events(&self, after: u64) -> Events {
        self.log.after(after)
    }

    /// A channel with the number of the newest event; it changes with every event.
    #[must_use]
    pub fn newest_event(&self) -> watch::Receiver<u64> {
        self.log.newest()
    }

    /// Stops every device, waits until all are at rest or the time limit is over, and ends the cell.
    pub async fn close(&self) {
        let (reply, closed) = oneshot::channel();
        if self.requests.send(Request::Close(reply)).await.is_ok() {
            // An error means that the task has ended, as intended.
            let _ended = closed.await;
        }
    }

    async fn ask<T>(&self, make: impl FnOnce(Reply<T>) -> Request) -> Result<T, Refusal> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(make(reply)).await.map_err(|_| Refusal::Closing)?;
        // A closed cell drops the reply channels of all waiting requests.
        answer.await.map_err(|_| Refusal::Unanswered)?
    }
}

/// Number of requests that may wait; a client that sends faster has to wait.
const REQUESTS_WAITING: usize = 64;
/// Number of reports that may wait for the task.
const REPORTS_WAITING: usize = 256;
/// Number of commands that may wait for a driver. The task sends the next one only after the outcome of the last.
const ORDERS_WAITING: usize = 8;

/// Starts the drivers and the task of the cell; also returns the handle of that task.
pub(super) fn start(devices: Devices, settings: Settings, fence_floor: u64) -> (Cell, JoinHandle<()>) {
    let flag = Arc::new(HaltFlag::new(fence_floor));
    let (reports, reported) = mpsc::channel(REPORTS_WAITING);
    let mut spawner = Spawner { settings: &settings, flag: &flag, reports, watched: Vec::new() };
    let Devices { manipulators: Pair { m1, m2 }, sensor, stage } = devices;
    let live = Pair { m1: live(m1.name(), &settings), m2: live(m2.name(), &settings) };
    let live_stage = stage.as_ref().map(|stage| live_of(stage.name(), settings.poll));
    let live_sensor = sensor.as_ref().map(|sensor| live_of(sensor.name(), settings.sensor_poll));
    let sensor_deadlines = sensor.as_ref().map(|sensor| sensor.deadlines()).unwrap_or_default();
    let orders = Pair { m1: spawner.manipulator(Carrier::M1, m1), m2: spawner.manipulator(Carrier::M2, m2) };
    let stage = stage.map(|stage| spawner.stage(stage));
    let sensor = sensor.map(|sensor| spawner.sensor(sensor));
    let Spawner { watched, .. } = spawner;

    let log = Arc::new(EventLog::new());
    let drivers = Drivers { manipulators: orders, stage, sensor, sensor_deadlines };
    let (requests, requested) = mpsc::channel(REQUESTS_WAITING);
    let task = CellTask::new(settings, drivers, (live, live_stage, live_sensor), &flag, Arc::clone(&log), fence_floor);
    let (published, snapshots) = watch::channel(Arc::new(task.snapshot(0, now())));
    let running = tokio::spawn(task.run(requested, reported, published));
    (Cell { requests, stops: Arc::new(StopEntry::new(flag, watched)), snapshots, log }, running)
}

fn live<R>(name: &str, settings: &Settings) -> Live<R> {
    live_of(name, settings.poll)
}

fn live_of<R>(name: &str, poll: Duration) -> Live<R> {
    Live::unknown(name.to_owned(), poll * 3)
}

/// Spawns the drivers.
struct Spawner<'a> {
    settings: &'a Settings,
    flag: &'a HaltFlag,
    reports: mpsc::Sender<Report>,
    watched: Vec<(Member, String, watch::Receiver<Halted>)>,
}

impl Spawner<'_> {
    /// Creates the context of a driver, and adds its device to those whose halts a stop reports.
    fn context(&mut self, member: Member, name: &str, timing: Timing) -> DriverContext {
        let (context, halted) = DriverContext::new(member, name.to_owned(), self.reports.clone(), self.flag, timing);
        self.watched.push((member, name.to_owned(), halted));
        context
    }

    fn manipulator(
        &mut self,
        carrier: Carrier,
        device: Box<dyn Manipulator>,
    ) -> mpsc::Sender<DriverOrder<super::driver::messages::ManipulatorCommand>> {
        let member = Member::Manipulator(carrier);
        let context = self.context(member, device.name(), Timing::of(self.settings));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(ManipulatorDriver::task(carrier, device, context, ordered).run());
        orders
    }

    fn stage(&mut self, device: Box<dyn Stage>) -> mpsc::Sender<DriverOrder<StageCommand>> {
        let context = self.context(Member::Stage, device.name(), Timing::of(self.settings));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(StageDriver::task(device, context, ordered).run());
        orders
    }

    fn sensor(&mut self, device: Box<dyn ProfileSensor>) -> mpsc::Sender<DriverOrder<Acquisition>> {
        let context =
            self.context(Member::Sensor, device.name(), Timing::of_sensor(self.settings, &device.deadlines()));
        let (orders, ordered) = mpsc::channel(ORDERS_WAITING);
        tokio::spawn(SensorDriver::task(device, context, ordered).run());
        orders
    }
}
