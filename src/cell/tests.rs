//! Tests of the complete cell on simulated devices, on paused time, with fixed seeds. `machine` has its own tests.

mod faults;
mod links;
mod machine;
mod moves;
mod scans;
mod stops;

use crate::cell::handle::start;
use crate::cell::{Cell, Devices, Job, LeaseRequest, Manual, Settings, Snapshot, State};
use crate::device::clock::now;
use crate::device::sequence::next;
use crate::device::simulated::{Mounting, Settings as SimulationSettings, World};
use crate::device::{Action, Command, DeviceError, Manipulator, Pending, ProfileSensor, Reading, SensorReading, Stage};
use crate::motion::{Arrangement, Axes, AxisLimits, Carrier, MoveTargets, Pair, Path, Position, Support, plan_move};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};

/// The id of the lease in the tests.
pub(super) const LEASE: &str = "lease-1";

/// The traffic on the line of one manipulator.
#[derive(Debug, Default)]
pub(super) struct Line {
    /// Time of the last valid answer.
    pub(super) good_at: Option<Instant>,
    /// Commands passed to the device, with their times.
    pub(super) sent: Vec<(Instant, Command)>,
}

/// A manipulator whose traffic is recorded.
struct Watched<M> {
    inside: M,
    line: Arc<Mutex<Line>>,
}

impl<M> Watched<M> {
    fn line(&self) -> MutexGuard<'_, Line> {
        self.line.lock().expect("an unpoisoned lock")
    }

    fn mark<T>(&self, answer: Result<T, DeviceError>) -> Result<T, DeviceError> {
        if answer.is_ok() {
            self.line().good_at = Some(now());
        }
        answer
    }
}

impl<M: Manipulator> Manipulator for Watched<M> {
    fn name(&self) -> &str {
        self.inside.name()
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            let answer = self.inside.connect().await;
            self.mark(answer)
        })
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            let answer = self.inside.read().await;
            self.mark(answer)
        })
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        self.line().sent.push((now(), command.clone()));
        let command = command.clone();
        Box::pin(async move {
            let answer = self.inside.send(&command).await;
            self.mark(answer)
        })
    }
}

/// A sensor that is not connected.
pub(super) struct Unplugged;

impl ProfileSensor for Unplugged {
    fn name(&self) -> &str {
        "unplugged"
    }
    fn connect(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        Box::pin(async { Err(DeviceError::LinkLost { device: "unplugged".to_owned(), cause: "no cable".to_owned() }) })
    }
    fn read(&mut self) -> Pending<'_, Result<SensorReading, DeviceError>> {
        self.connect()
    }
    fn start(&mut self, _: u64) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(std::future::pending())
    }
    fn receive(&mut self) -> Pending<'_, Result<Vec<crate::device::Profile>, DeviceError>> {
        Box::pin(std::future::pending())
    }
    fn stop(&mut self) -> Pending<'_, Result<(), DeviceError>> {
        Box::pin(std::future::pending())
    }
}

/// A cell on simulated devices, with their recorded traffic.
pub(super) struct Bench {
    pub(super) world: World,
    pub(super) cell: Cell,
    /// The task of the cell.
    pub(super) task: JoinHandle<()>,
    pub(super) lines: Pair<Arc<Mutex<Line>>>,
    pub(super) arrangement: Arrangement,
}

/// The limits of both manipulators: linear axes have 10 mm/s and 100 mm/s², so that a halt from full speed takes 0.1 s.
fn limits() -> Axes<AxisLimits> {
    let linear = AxisLimits { lower: -40.0, upper: 40.0, speed: 10.0, acceleration: 100.0, jerk: 2000.0, step: 30.0 };
    let turn = AxisLimits { lower: -0.5, upper: 0.5, speed: 0.2, acceleration: 2.0, jerk: 40.0, step: 0.5 };
    Axes { x: linear, y: linear, z: linear, c: turn }
}

pub(super) fn arrangement() -> Arrangement {
    let support = |x: f64| Support { mount_mm: [x, 0.0, 0.0], limits: limits(), half_span_mm: 50.0 };
    Arrangement {
        supports: Pair { m1: support(150.0), m2: support(650.0) },
        strain_max_mm: 0.5,
        twist_max: 0.02,
        run_on_max_mm: 1.0,
        clearance_min_mm: 20.0,
        settle_tolerance: Axes { x: 0.02, y: 0.02, z: 0.02, c: 0.001 },
    }
}

/// Simulated devices without backlash or noise, so that every motion of a clamp appears in the true place of the part.
pub(super) fn simulation() -> SimulationSettings {
    let mut simulation = SimulationSettings::default();
    (simulation.manipulators.backlash_mm, simulation.manipulators.backlash_deg) = (0.0, 0.0);
    simulation.stage.watchdog_ms = 300.0;
    simulation.sensor.points_count = 16;
    simulation
}

pub(super) fn settings() -> Settings {
    Settings::new(arrangement())
}

impl Bench {
    /// Starts a cell on new devices.
    pub(super) fn start(simulation: &SimulationSettings) -> Self {
        Self::start_with(simulation, settings())
    }

    pub(super) fn start_with(simulation: &SimulationSettings, settings: Settings) -> Self {
        Self::start_within(simulation, settings, |limits| limits)
    }

    /// Starts a cell whose manipulators have these limits of their own.
    pub(super) fn start_within(
        simulation: &SimulationSettings,
        settings: Settings,
        own: impl Fn(Axes<AxisLimits>) -> Axes<AxisLimits>,
    ) -> Self {
        let mounting = |support: &Support| Mounting { mount_mm: support.mount_mm, limits: own(support.limits) };
        let mountings = settings.arrangement.supports.map(|_, support| mounting(support));
        Self::on(World::new(simulation, &mountings).expect("valid settings"), settings)
    }

    /// Starts a cell on devices that may have been used before.
    pub(super) fn on(world: World, settings: Settings) -> Self {
        settings.check().expect("valid settings");
        let arrangement = settings.arrangement;
        let lines = Pair::from_fn(|_| Arc::new(Mutex::new(Line::default())));
        let watched = |carrier: Carrier| -> Box<dyn Manipulator> {
            Box::new(Watched { inside: world.manipulator(carrier), line: Arc::clone(lines.get(carrier)) })
        };
        let stage: Box<dyn Stage> = Box::new(world.stage());
        let sensor: Box<dyn ProfileSensor> = Box::new(world.sensor());
        let manipulators = Pair { m1: watched(Carrier::M1), m2: watched(Carrier::M2) };
        let devices = Devices { manipulators, sensor: Some(sensor), stage: Some(stage) };
        let (cell, task) = start(devices, settings, 41);
        Self { world, cell, task, lines, arrangement }
    }

    /// An idle cell, with a lease for one minute and both manipulators enabled.
    pub(super) async fn ready(simulation: &SimulationSettings) -> Self {
        Self::start(simulation).prepared().await
    }

    /// Waits until the cell is idle, takes the lease for one minute, and enables both manipulators.
    pub(super) async fn prepared(self) -> Self {
        self.until(|now| now.state == State::Idle).await;
        self.take_lease(Duration::from_secs(60)).await;
        self.enable().await;
        self
    }

    pub(super) async fn take_lease(&self, time_to_live: Duration) {
        let request = LeaseRequest { id: LEASE.to_owned(), holder: "test".to_owned(), time_to_live };
        self.cell.take_lease(request).await.expect("the lease is free");
    }

    pub(super) async fn enable(&self) {
        for carrier in Carrier::ALL {
            self.cell.act(LEASE, carrier, Manual::Enable).await.expect("allowed");
        }
        self.until(|now| now.commands_allowed).await;
    }

    /// Another client commands a manipulator over its own link.
    pub(super) async fn command_from_elsewhere(&self, carrier: Carrier, action: Action) {
        let mut line = self.world.manipulator(carrier);
        let sequence = next(line.connect().await.expect("a link").acknowledged.sequence);
        let watchdog = Duration::from_millis(400);
        line.send(&Command { sequence, fence: 99, watchdog, action }).await.expect("a link");
    }

    /// Waits for the next reading of m1; for 50 ms after it only commands are sent.
    pub(super) async fn m1_was_read(&self) {
        let before = self.cell.snapshot().manipulators.m1.read_at;
        self.until(|now| now.manipulators.m1.read_at != before).await;
    }

    /// Waits until the condition holds, at most one minute.
    pub(super) async fn until(&self, so: impl Fn(&Snapshot) -> bool) -> Arc<Snapshot> {
        let mut watch = self.cell.watch();
        let found = timeout(Duration::from_secs(60), watch.wait_for(|now| so(now))).await;
        match found {
            Ok(found) => found.expect("the cell is running").clone(),
            Err(_) => panic!("the condition was never met; the cell is {:#?}", self.cell.snapshot()),
        }
    }

    /// The positions of both manipulators in the last readings.
    pub(super) fn positions(&self) -> Pair<Position> {
        let seen = self.cell.snapshot();
        seen.manipulators.map(|_, live| live.reading.as_ref().expect("was read").position())
    }

    /// A path that moves both manipulators to this y together.
    pub(super) fn path_to_y(&self, y: f64) -> Path {
        let targets = Axes { x: None, y: Some(y), z: None, c: None };
        self.path(&Pair { m1: Some(targets), m2: Some(targets) })
    }

    pub(super) fn path(&self, targets: &MoveTargets) -> Path {
        plan_move(&self.arrangement, &self.positions(), targets, 1.0).expect("an allowed path").path
    }

    /// Begins the move of both manipulators to this y.
    pub(super) async fn begin(&self, job: &str, y: f64) -> Job {
        self.cell.start_move(LEASE, job, self.path_to_y(y)).await.expect("allowed")
    }

    /// The true place of the part, and its rotation.
    pub(super) fn truth(&self) -> [f64; 5] {
        let axis = self.world.truth();
        [axis.p, axis.q, axis.y0, axis.z0, self.world.true_roll()]
    }

    /// Checks every 5 ms for this time, and returns the time at which the part last moved.
    pub(super) async fn last_motion(&self, within: Duration) -> Option<Instant> {
        let until = now() + within;
        let (mut before, mut moved_at) = (self.truth(), None);
        while now() < until {
            sleep(Duration::from_millis(5)).await;
            let truth = self.truth();
            if truth != before {
                (before, moved_at) = (truth, Some(now()));
            }
        }
        moved_at
    }

    /// The times at which commands of a kind were sent to a manipulator.
    pub(super) fn sent(&self, carrier: Carrier, of: impl Fn(&Command) -> bool) -> Vec<Instant> {
        let line = self.lines.get(carrier).lock().expect("an unpoisoned lock");
        line.sent.iter().filter(|(_, command)| of(command)).map(|(at, _)| *at).collect()
    }
}
