//! The simulated cell meets the contract of every adaptor, fails on command, and its sensor sees the part at the position to which
//! the manipulators carry it. The truth is the synthetic part; time is paused.

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::print_stdout,
    reason = "a test may fail, and prints its results"
)]

use crate::made::count;
use coaxis::config::{Cell, Config, Layers};
use coaxis::device::contract::motion::{check_manipulator_motion, check_sensor_scan, check_stage_motion};
use coaxis::device::contract::{Report, check_manipulator, check_sensor, check_stage};
use coaxis::device::sequence::is_newer;
use coaxis::device::simulated::{Device, Fault, FaultSwitch, Mounting, Settings, SimulatedManipulator, World};
use coaxis::device::{
    Action, AxisState, Command, DeviceError, Manipulator, Pending, Profile, ProfileSensor, Reading, ScanFault, Stage,
};
use coaxis::estimation::{Outcome, Pose, Progress, estimate};
use coaxis::geometry::AxisLine;
use coaxis::motion::{Axes, Axis, AxisLimits, Carrier, Pair, Position};
use coaxis::scan::{Columns, Scan, Station};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::time::{sleep, timeout};

const M1: Device = Device::Manipulator(Carrier::M1);
/// Scans of the cell with the default settings in continuous integration.
const SCANS: u64 = 6;

fn mountings() -> Pair<Mounting> {
    let linear = AxisLimits { lower: -40.0, upper: 40.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 40.0 };
    let turn = AxisLimits { lower: -0.5, upper: 0.5, speed: 0.2, acceleration: 1.0, jerk: 10.0, step: 0.5 };
    let at = |x: f64| Mounting { mount_mm: [x, 0.0, 0.0], limits: Axes { x: linear, y: linear, z: linear, c: turn } };
    Pair { m1: at(150.0), m2: at(650.0) }
}

fn world(settings: &Settings) -> World {
    World::new(settings, &mountings()).expect("settings that are allowed")
}

fn assert_passed(report: &Report) {
    assert!(report.passed(), "{report:#?}");
}

fn command(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(400), action }
}

fn go(targets: Position) -> Action {
    let speeds = Axes { c: 0.2, ..Axes::from_fn(|_| 10.0) };
    Action::MoveTo { axes: Axes::from_fn(|_| true), targets, speeds }
}

#[tokio::test(start_paused = true)]
async fn every_simulated_device_meets_the_contract() {
    let world = world(&Settings::default());
    let (mut sensor, mut stage) = (world.sensor(), world.stage());
    for carrier in Carrier::ALL {
        let mut manipulator = world.manipulator(carrier);
        assert_passed(&check_manipulator(&mut manipulator).await);
        assert_passed(&check_manipulator_motion(&mut manipulator, 1).await);
    }
    assert_passed(&check_stage(&mut stage).await);
    assert_passed(&check_sensor(&mut sensor).await);
    assert_passed(&check_stage_motion(&mut stage, 1).await);
    assert_passed(&check_sensor_scan(&mut sensor, &mut stage, 50, 120.0, 3).await);
}

/// How an adaptor breaks the contract.
#[derive(Clone, Copy, PartialEq)]
enum Wrong {
    Resends,
    IgnoresFences,
    ForgetsNoLink,
}

struct WrongAdaptor {
    inner: SimulatedManipulator,
    world: World,
    wrong: Wrong,
    last: Option<Command>,
}

impl Manipulator for WrongAdaptor {
    fn name(&self) -> &str {
        "wrong"
    }

    fn connect(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            let reading = self.inner.connect().await?;
            if let (Wrong::Resends, Some(last)) = (self.wrong, self.last.clone()) {
                self.inner.send(&Command { sequence: last.sequence + 1, ..last }).await?;
                return self.inner.connect().await;
            }
            Ok(reading)
        })
    }

    fn read(&mut self) -> Pending<'_, Result<Reading, DeviceError>> {
        Box::pin(async move {
            let answer = self.inner.read().await;
            match answer {
                Err(DeviceError::LinkLost { .. }) if self.wrong == Wrong::ForgetsNoLink => self.inner.connect().await,
                answer => answer,
            }
        })
    }

    fn send(&mut self, command: &Command) -> Pending<'_, Result<(), DeviceError>> {
        self.last = Some(command.clone());
        if self.wrong == Wrong::IgnoresFences {
            self.inner = self.world.manipulator(Carrier::M1);
        }
        let command = command.clone();
        Box::pin(async move {
            if self.wrong == Wrong::IgnoresFences {
                self.inner.connect().await?;
            }
            self.inner.send(&command).await
        })
    }
}

#[tokio::test(start_paused = true)]
async fn the_contract_finds_an_adaptor_that_breaks_it() {
    for (wrong, due) in [
        (Wrong::Resends, "a new connection sends no command, and it can be halted over it"),
        (Wrong::IgnoresFences, "an older fence is refused before anything is sent"),
        (Wrong::ForgetsNoLink, "a request dropped half-way costs the connection"),
    ] {
        let world = world(&Settings::default());
        let inner = world.manipulator(Carrier::M1);
        let mut adaptor = WrongAdaptor { inner, world, wrong, last: None };
        let report = check_manipulator_motion(&mut adaptor, 1).await;
        let failed: Vec<_> = report.checks.iter().filter(|check| !check.passed).map(|check| check.name).collect();
        assert!(failed.contains(&due), "{due}: {failed:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn each_fault_is_reported_by_name() {
    let world = world(&Settings::default());
    let (faults, mut m1) = (world.faults(), world.manipulator(Carrier::M1));
    let mut sequence = 0;
    // The fault, the name of the error, and whether the device has executed the command nevertheless.
    let cases: [(Fault, &str, bool); 7] = [
        (Fault::LinkLost { arrives: false }, "LinkLost", false),
        (Fault::LinkLost { arrives: true }, "LinkLost", true),
        (Fault::Silence { arrives: false }, "Silent", false),
        (Fault::Silence { arrives: true }, "Silent", true),
        (Fault::Late { by: Duration::from_millis(400) }, "Silent", true),
        (Fault::Corrupt, "Implausible", true),
        (Fault::Rejected { code: 77 }, "Rejected", false),
    ];
    for (fault, name, executed) in cases {
        m1.connect().await.expect("a link");
        sequence += 1;
        faults.next(M1, fault.clone());
        let error = m1.send(&command(sequence, Action::Enable)).await.expect_err("a fault");
        assert!(format!("{error:?}").starts_with(name), "{fault:?}: {error:?}");
        let again = m1.read().await;
        assert_eq!(again.is_err(), name != "Rejected", "{fault:?}: only a refusal leaves the link up");
        let seen = m1.connect().await.expect("a link").acknowledged.sequence;
        assert_eq!(seen == sequence, executed, "{fault:?}: the device saw {seen}");
    }
    faults.next(M1, Fault::Late { by: Duration::from_millis(100) });
    assert!(m1.read().await.is_ok(), "late, but in time");
    dead_peer(&faults, &mut m1).await;
}

async fn dead_peer(faults: &FaultSwitch, m1: &mut dyn Manipulator) {
    faults.hold(M1, Fault::HalfOpen);
    assert!(matches!(m1.read().await, Err(DeviceError::Silent { .. })));
    assert!(matches!(m1.connect().await, Err(DeviceError::Silent { .. })), "connected, and then nothing");
    faults.clear(M1);
    assert!(m1.connect().await.is_ok());
}

#[tokio::test(start_paused = true)]
async fn a_limit_switch_a_stall_and_lost_profiles_are_reported_by_name() {
    let world = world(&Settings::default());
    let (faults, mut m1) = (world.faults(), world.manipulator(Carrier::M1));
    m1.connect().await.expect("a link");
    faults.next(M1, Fault::LimitHit { axis: Axis::Z });
    let hit = m1.read().await.expect("a reading");
    assert!(hit.axes.z.limit_hit && hit.fault_code != 0, "{hit:?}");

    let (mut sensor, mut stage) = (world.sensor(), world.stage());
    stage.connect().await.expect("a link");
    stage.move_to(1, 100.0, 50.0).await.expect("a command");
    sleep(Duration::from_millis(300)).await;
    faults.next(Device::Stage, Fault::Stall);
    let stalled = stage.read().await.expect("a reading");
    sleep(Duration::from_millis(300)).await;
    let later = stage.read().await.expect("a reading");
    assert!(later.fault_code != 0 && !later.in_position && later.actual_mm == stalled.actual_mm, "{later:?}");
    faults.free_stage();
    sleep(Duration::from_millis(300)).await;
    assert!(stage.read().await.expect("a reading").actual_mm < 30.0, "freed, it must not go on");

    sensor.connect().await.expect("a link");
    faults.next(Device::Sensor, Fault::Scan(ScanFault::TriggerDrops { count: 3 }));
    sensor.start(5).await.expect_err("the fault strikes the next exchange");
}

#[tokio::test(start_paused = true)]
async fn a_stage_without_communication_stops_and_reports_it() {
    let world = world(&Settings::default());
    let mut stage = world.stage();
    stage.connect().await.expect("a link");
    stage.move_to(1, 1000.0, 100.0).await.expect("a command");
    sleep(Duration::from_secs(2)).await;
    let stopped = stage.read().await.expect("a reading");
    // At most 100 mm/s for 0.5 s, then braking from there: v²/2a = 10 mm.
    assert!(stopped.actual_mm < 61.0 && !stopped.moves && stopped.fault_code != 0, "{stopped:?}");
}

/// A minimal driver: it never sends a command twice and reads every state that it does not know.
struct Driver {
    m1: SimulatedManipulator,
    sequence: u16,
}

impl Driver {
    async fn reading(&mut self) -> Reading {
        for _ in 0..200 {
            match self.m1.read().await {
                Ok(reading) => return reading,
                Err(DeviceError::Rejected { .. }) => {}
                Err(_) => drop(self.m1.connect().await),
            }
        }
        panic!("no reading in 200 attempts");
    }

    /// Whether the device has accepted the command.
    async fn command(&mut self, action: Action) -> bool {
        self.sequence += 1;
        let sent = self.m1.send(&command(self.sequence, action)).await;
        self.reading().await.acknowledged.sequence == self.sequence || {
            assert!(sent.is_err(), "sent, but not received");
            false
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_command_is_executed_at_most_once_under_random_faults() {
    let mut struck_count = 0;
    for seed in 0..200 {
        let world = world(&Settings { seed, ..Settings::default() });
        let mut driver = Driver { m1: world.manipulator(Carrier::M1), sequence: 0 };
        drop(driver.m1.connect().await);
        world.faults().by_chance(seed, 0.1);
        let mut taken = BTreeSet::new();
        for round in 0..8 {
            let target = f64::from(round % 3) - 1.0;
            for action in [Action::Reset, Action::Enable, go(Axes { y: target, ..Axes::default() })] {
                if driver.command(action).await {
                    taken.insert(driver.sequence);
                }
            }
            sleep(Duration::from_millis(200)).await;
        }
        let record = world.record(Carrier::M1);
        let executed: Vec<_> = record.all_executed().map(|entry| entry.sequence).collect();
        assert!(executed.windows(2).all(|pair| is_newer(pair[1], pair[0])), "seed {seed}: {executed:?}");
        assert!(executed.iter().all(|sequence| taken.contains(sequence)), "seed {seed}: executed and not known");
        assert_eq!((record.all_ignored().len(), record.all_out_of_limits().len()), (0, 0), "seed {seed}");
        struck_count += world.faults().struck().len();
    }
    // About one exchange in ten of some 50 in each run.
    assert!(struck_count > 1_000, "{struck_count}");
}

#[tokio::test(start_paused = true)]
async fn a_request_that_is_dropped_before_its_end_closes_the_connection() {
    let world = world(&Settings::default());
    let mut m1 = world.manipulator(Carrier::M1);
    m1.connect().await.expect("a link");
    assert!(timeout(Duration::from_millis(3), m1.read()).await.is_err(), "half of the latency is over");
    assert!(matches!(m1.read().await, Err(DeviceError::LinkLost { .. })));
    assert!(m1.connect().await.is_ok() && m1.read().await.is_ok());
}

/// Enables both manipulators, sends them to their targets and waits until they have reached them.
async fn carry(world: &World, targets: &Pair<Position>) {
    let mut devices = Pair::from_fn(|carrier| world.manipulator(carrier));
    for carrier in Carrier::ALL {
        let device = devices.get_mut(carrier);
        let seen = device.connect().await.expect("a link").acknowledged.sequence;
        device.send(&command(seen + 1, Action::Enable)).await.expect("a command");
        device.send(&command(seen + 2, go(*targets.get(carrier)))).await.expect("a command");
    }
    for _ in 0..500 {
        let mut at_rest = true;
        for carrier in Carrier::ALL {
            let reading = devices.get_mut(carrier).read().await.expect("a reading");
            at_rest &= reading.state == AxisState::Standstill && reading.position() == *targets.get(carrier);
        }
        if at_rest {
            return;
        }
        sleep(Duration::from_millis(50)).await;
    }
    panic!("not there in 25 s");
}

/// Takes `profiles_count` profiles from `from_mm` on.
async fn take_scan(world: &World, from_mm: f64, profiles_count: u64) -> Vec<Profile> {
    let (mut sensor, mut stage) = (world.sensor(), world.stage());
    let pitch_mm = world.settings().sensor.profile_pitch_mm;
    stage.connect().await.expect("a link");
    sensor.connect().await.expect("a link");
    stage.move_to(1, from_mm, 200.0).await.expect("a command");
    while !stage.read().await.expect("a reading").in_position {
        sleep(Duration::from_millis(50)).await;
    }
    sensor.start(profiles_count).await.expect("a scan");
    let to_mm = from_mm + pitch_mm * (profiles_count - 1) as f64;
    stage.move_to(1, to_mm, 200.0).await.expect("a command");
    let mut profiles = Vec::new();
    while (profiles.len() as u64) < profiles_count {
        stage.read().await.expect("a reading");
        profiles.extend(sensor.receive().await.expect("profiles"));
    }
    sensor.stop().await.expect("an end");
    profiles
}

fn scan_of(profiles: &[Profile]) -> Scan {
    let (mut y, mut z, mut stations) = (Vec::new(), Vec::new(), Vec::new());
    for profile in profiles.iter().filter(|profile| !profile.y.is_empty()) {
        let start = y.len();
        y.extend_from_slice(&profile.y);
        z.extend_from_slice(&profile.z);
        stations.push(Station { x: profile.travel_mm, start, end: y.len() });
    }
    Scan::new(stations, Columns::F32 { y, z }, "made".to_owned()).expect("a scan")
}

/// Measures as the service does for a scan by the sensor of a cell without calibration data.
fn measured(world: &World, profiles: &[Profile]) -> Pose {
    let cell = Cell { simulated: world.settings().clone(), ..Cell::default() };
    let stated = Config::default().estimation;
    let settings = coaxis::estimation::Settings { type_b: cell.type_b_of_scans(stated.type_b), ..stated };
    match estimate(&scan_of(profiles), &settings, &Progress::default()).outcome {
        Outcome::Accepted(pose) => *pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

/// Error of the pose in its own standard uncertainties: deflection, pitch, y, z.
fn off(pose: &Pose, truth: &AxisLine) -> [f64; 4] {
    let ([y, z], [true_y, true_z]) = (pose.axis.at(pose.x_ref), truth.at(pose.x_ref));
    let deflection = pose.axis.deflection().radians() - truth.deflection().radians();
    let pitch = pose.axis.pitch().radians() - truth.pitch().radians();
    let covariance = pose.uncertainty.covariance;
    let standard = |i: usize| covariance[i][i].sqrt();
    [deflection / standard(0), pitch / standard(1), (y - true_y) / standard(2), (z - true_z) / standard(3)]
}

#[tokio::test(start_paused = true)]
async fn the_sensor_sees_the_part_at_the_true_position_of_the_manipulators() {
    let world = world(&Settings::default());
    let start = world.truth();
    let sees = async |name: &str| {
        let profiles = take_scan(&world, 20.0, 380).await;
        let (pose, truth) = (measured(&world, &profiles), world.truth());
        let off = off(&pose, &truth);
        assert!(off.iter().all(|off| off.abs() < 3.0), "{name}: {off:?}, {pose:?}");
        // 5 µm of the rail and 0.05 mm of noise over 240 000 points: the stated uncertainty must not be large.
        assert!(pose.uncertainty.covariance[3][3].sqrt() < 0.02, "{name}");
        pose.axis
    };
    let seen = sees("at the start").await;
    carry(&world, &Pair { m1: lift(6.0, -3.0, 0.0), m2: lift(2.0, -9.0, 0.0) }).await;
    let lifted = sees("lifted").await;
    // The line of the clamps rotates by -4 mm and -6 mm on 500 mm, and the coupling adds 2 % of the other axis' travel.
    // The backlash is on one side only. An angle of 0.012 changes a tilt of 0.02 by its square and less: 1e-4.
    let (turned_y, turned_z) = (-(4.0 + 0.02 * 6.0) / 500.0, -(6.0 + 0.02 * 4.0) / 500.0);
    let truth = world.truth();
    for (from, to) in [(start, truth), (seen, lifted)] {
        assert!((to.p - from.p - turned_y).abs() < 1e-4, "{}", to.p - from.p);
        assert!((to.q - from.q - turned_z).abs() < 1e-4, "{}", to.q - from.q);
    }
    carry(&world, &Pair { m1: lift(6.0, -3.0, 0.1), m2: lift(2.0, -9.0, 0.1) }).await;
    sees("turned").await;
    assert!((world.true_roll() - 0.1).abs() < 1e-4, "{}", world.true_roll());
}

/// `COAXIS_SCANS=200 cargo test --test all as_shipped -- --nocapture` prints the shares of docs/estimation.md.
#[tokio::test(start_paused = true)]
async fn the_uncertainty_of_the_cell_as_shipped_contains_the_errors() {
    let shipped = Layers::default().text("docker/coaxis.toml", include_str!("../docker/coaxis.toml"));
    let shipped = shipped.and_then(Layers::build).expect("it can be used");
    let built_in = Config::default();
    assert_eq!(shipped.estimation, built_in.estimation);
    assert_eq!((&shipped.cell.simulated, &shipped.cell.scan), (&built_in.cell.simulated, &built_in.cell.scan));
    assert_eq!(shipped.cell.sensor.adaptor, built_in.cell.sensor.adaptor);
    let scans_count = count("COAXIS_SCANS", SCANS);
    let (mut within, mut worst) = ([0_u64; 5], 0.0_f64);
    for seed in 1..=scans_count {
        let cell = Cell { simulated: Settings { seed, ..shipped.cell.simulated.clone() }, ..shipped.cell.clone() };
        let world = World::new(&cell.simulated, &cell.mountings()).expect("settings that are allowed");
        let profiles = take_scan(&world, cell.scan.x_from_mm, cell.scan.profiles_count).await;
        let pose = measured(&world, &profiles);
        assert!(pose.uncertainty.includes_calibration());
        let [deflection, pitch, y, z] = off(&pose, &world.truth());
        let radius = pose.radius - cell.simulated.part.radius_mm;
        let radius = radius / pose.uncertainty.covariance[4][4].sqrt();
        for (within, off) in within.iter_mut().zip([deflection, pitch, y, z, radius]) {
            *within += u64::from(off.abs() <= 2.0);
            worst = worst.max(off.abs());
        }
    }
    let share = within.iter().sum::<u64>() as f64 / (5 * scans_count) as f64;
    println!("{within:?} of {scans_count} within U, {:.1} % of all, at worst {worst:.1} u", 100.0 * share);
    // A share of 5n numbers has the standard deviation √(0.954·0.046/5n); three of these are allowed for few scans.
    let granted = 3.0 * (0.954 * 0.046 / (5 * scans_count) as f64).sqrt();
    assert!((0.93_f64.min(0.954 - granted)..=0.98_f64.max(0.954 + granted)).contains(&share), "{share}");
    assert!(worst <= 5.0, "off by {worst} u");
}

const fn lift(y: f64, z: f64, c: f64) -> Position {
    Axes { x: 1.0, y, z, c }
}

#[tokio::test(start_paused = true)]
async fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let mut taken = Vec::new();
    for seed in [5, 5, 6] {
        let world = world(&Settings { seed, ..Settings::default() });
        carry(&world, &Pair { m1: Axes { y: 3.0, ..Axes::default() }, m2: Axes::default() }).await;
        taken.push(take_scan(&world, 100.0, 40).await);
    }
    assert!(taken[0] == taken[1] && taken[1] != taken[2]);
}

#[tokio::test(start_paused = true)]
async fn a_fast_cell_sees_the_same_as_a_slow_one() {
    let mut taken = Vec::new();
    for time_factor in [1.0, 50.0] {
        let world = world(&Settings { time_factor, ..Settings::default() });
        taken.push(take_scan(&world, 100.0, 40).await);
    }
    assert_eq!(taken[0], taken[1]);
}

#[tokio::test(start_paused = true)]
async fn no_points_are_seen_beyond_the_part_and_outside_of_the_field() {
    let mut settings = Settings::default();
    settings.sensor.drop_out_ratio = 0.0;
    settings.sensor.field_half_width_mm = 100.0;
    let world = world(&settings);
    let profiles = take_scan(&world, 780.0, 20).await;
    for profile in &profiles {
        assert_eq!(profile.y.len() as u64 + profile.missing_count, 640);
        assert!(profile.y.iter().all(|y| y.abs() <= 100.0));
    }
    // The end plane is perpendicular to an axis that is tilted by 1.2°: its top is up to 5 mm before 800 mm.
    assert!(profiles[0].y.len() > 200 && profiles[19].y.is_empty(), "{} points", profiles[0].y.len());
}
