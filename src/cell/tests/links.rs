//! Links that are lost at every step of a move and in every way: every device stops, nothing is sent twice, and nothing moves
//! before a reset. Also many moves with random link failures: a set-point is executed exactly once, or the job reports that its
//! outcome is unknown. `COAXIS_FAULTY_RUNS` sets the number of these runs.

use super::{Bench, LEASE, simulation};
use crate::cell::{Cell, Devices, EventKind, JobEnd, Link, Quality, Refusal, State, StopCause, Taken};
use crate::device::clock::now;
use crate::device::simulated::{Device, Fault};
use crate::device::{Action, Manipulator};
use crate::motion::{Carrier, Pair, Path};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

/// Longest time from the last valid answer until everything is at rest.
const HOLD_WITHIN: Duration = Duration::from_millis(500);
/// Number of random runs, unless `COAXIS_FAULTY_RUNS` sets it: about 17 s of one core.
const RUNS_BY_DEFAULT: u64 = 10_000;

fn faults() -> Vec<Fault> {
    vec![
        Fault::LinkLost { arrives: false },
        Fault::LinkLost { arrives: true },
        Fault::Silence { arrives: false },
        Fault::Silence { arrives: true },
        Fault::Late { by: Duration::from_secs(5) },
        Fault::Corrupt,
        Fault::HalfOpen,
    ]
}

/// Runs a move with a fault at one of its steps, and checks the consequences.
async fn one_fault(step: u64, fault: Fault) {
    let told = format!("{fault:?} at step {step}");
    let bench = Bench::ready(&simulation()).await;
    let device = Device::Manipulator(Carrier::M1);
    let first = bench.world.faults().steps(device);
    bench.world.faults().at(device, first + step, fault);
    let job = bench.begin("job-1", 3.0).await;
    let end = job.ended().await;
    if bench.world.faults().struck().is_empty() {
        assert_eq!(end, JobEnd::Done, "{told}");
        return;
    }
    assert!(matches!(end, JobEnd::Unknown(_)), "{told}: {end:?}");
    let seen = bench.until(|now| now.state == State::Faulted).await;
    assert!(!seen.faults.is_empty() && !seen.commands_allowed, "{told}");
    let good_at = bench.lines.m1.lock().expect("an unpoisoned lock").good_at.expect("it answered once");
    let moved_at = bench.last_motion(Duration::from_secs(3)).await;
    let held = moved_at.map(|at| at - good_at);
    assert!(held.is_none_or(|held| held <= HOLD_WITHIN), "{told}: at rest {held:?} after the last valid answer");
    // The device is connected again, and no request moves anything until a reset.
    let seen = bench.until(|now| now.manipulators.m1.link == Link::Up).await;
    assert_eq!(seen.state, State::Faulted, "{told}");
    let refused = bench.cell.start_move(LEASE, "job-2", bench.path_to_y(-1.0)).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::Faulted { .. })), "{told}: {refused:?}");
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::Accepted), "{told}");
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    assert_eq!(bench.begin("job-3", -1.0).await.ended().await, JobEnd::Done, "{told}");
    for carrier in Carrier::ALL {
        let record = bench.world.record(carrier);
        assert_eq!((record.all_ignored().len(), record.all_out_of_limits().len()), (0, 0), "{told}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_lost_at_any_step_of_a_move_stops_everything_until_a_reset() {
    for step in [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 14, 18, 25] {
        for fault in faults() {
            one_fault(step, fault).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn an_answer_that_is_lost_is_resolved_by_what_the_device_acknowledges() {
    for arrives in [false, true] {
        let bench = Bench::ready(&simulation()).await;
        let faults = bench.world.faults();
        let device = Device::Manipulator(Carrier::M1);
        // The exchange that sends the first set-point, after the reading before it.
        faults.at(device, faults.steps(device) + 2, Fault::LinkLost { arrives });
        let job = bench.begin("job-1", 6.0).await;
        assert!(matches!(job.ended().await, JobEnd::Unknown(_)));
        bench.until(|now| now.manipulators.m1.link == Link::Up).await;
        let sent = bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. }));
        assert_eq!(sent.len(), 1, "the set-point must be sent once, whether it arrived or not");
        let resolved = bench.cell.events(0).events.into_iter().find_map(|event| match event.kind {
            EventKind::Resolved { taken, .. } => Some(taken),
            _ => None,
        });
        assert_eq!(resolved, Some(arrives), "the acknowledgement of the device");
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_lost_at_rest_is_latched_too() {
    let bench = Bench::ready(&simulation()).await;
    bench.world.faults().next(Device::Stage, Fault::LinkLost { arrives: false });
    let seen = bench.until(|now| now.state == State::Faulted).await;
    assert_eq!(seen.faults.iter().map(|fault| fault.device.as_str()).collect::<Vec<_>>(), ["stage"]);
    // While the device is not connected, a reset is refused.
    assert!(matches!(bench.cell.reset(LEASE).await, Err(Refusal::DeviceStale { .. })));
    bench.until(|now| now.stage.as_ref().is_some_and(|stage| stage.link == Link::Up)).await;
    assert_eq!(bench.cell.snapshot().state, State::Faulted);
    bench.cell.reset(LEASE).await.expect("every device answers");
    bench.until(|now| now.state == State::Idle).await;
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::AlreadySo));
}

#[tokio::test(start_paused = true)]
async fn values_report_their_age() {
    let bench = Bench::ready(&simulation()).await;
    let good = bench.cell.snapshot();
    assert_eq!(good.manipulators.m2.quality(now()), Quality::Good);
    bench.world.faults().hold(Device::Manipulator(Carrier::M2), Fault::HalfOpen);
    // A reading is stale after three polling periods of 50 ms; the time-out of an answer is 150 ms.
    let at = good.manipulators.m2.read_at.expect("was read");
    assert_eq!(good.manipulators.m2.quality(at + Duration::from_millis(151)), Quality::Stale);
    let lost = bench.until(|now| now.manipulators.m2.link == Link::Lost).await;
    let live = &lost.manipulators.m2;
    assert_eq!(live.quality(now()), Quality::Lost);
    assert!(live.reading.is_some() && live.age(now()).is_some_and(|age| age >= Duration::from_millis(150)));
}

#[tokio::test(start_paused = true)]
async fn a_device_fault_stops_all_devices_and_needs_a_reset() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let hit = Fault::LimitHit { axis: crate::motion::Axis::Y };
    bench.world.faults().next(Device::Manipulator(Carrier::M2), hit);
    assert!(matches!(job.ended().await, JobEnd::Failed(_)));
    let faulted_at = now();
    let moved_at = bench.last_motion(Duration::from_secs(2)).await;
    assert!(moved_at.is_none_or(|at| at - faulted_at <= Duration::from_millis(150)), "m1 must stop as well");
    // The reset acknowledges the fault of the device, and ends only when a reading shows that it is gone.
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
}

#[tokio::test(start_paused = true)]
async fn a_cell_starts_without_any_device_and_keeps_reconnecting() {
    let mut far = simulation();
    far.seed = 2;
    let bench = Bench::start(&far);
    for carrier in Carrier::ALL {
        bench.world.faults().hold(Device::Manipulator(carrier), Fault::HalfOpen);
    }
    let cell = bench.cell.clone();
    sleep(Duration::from_secs(30)).await;
    assert_eq!((cell.snapshot().state, cell.snapshot().faults.len()), (State::Offline, 0));
    assert!(!cell.snapshot().commands_allowed);
    for carrier in Carrier::ALL {
        bench.world.faults().clear(Device::Manipulator(carrier));
    }
    bench.until(|now| now.state == State::Idle).await;
}

#[tokio::test(start_paused = true)]
async fn a_cell_works_with_manipulators_only() {
    let bench = Bench::ready(&simulation()).await;
    let boxed = |carrier| -> Box<dyn Manipulator> { Box::new(bench.world.manipulator(carrier)) };
    let manipulators = Pair { m1: boxed(Carrier::M1), m2: boxed(Carrier::M2) };
    let sensor: Box<dyn crate::device::ProfileSensor> = Box::new(super::Unplugged);
    let devices = Devices { manipulators, sensor: Some(sensor), stage: None };
    let cell = Cell::start(devices, super::settings(), 0);
    let mut watch = cell.watch();
    let idle = watch.wait_for(|now| now.state == State::Idle).await.expect("the cell is running").clone();
    assert!(idle.stage.is_none() && idle.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Connecting));
}

fn runs_count() -> u64 {
    std::env::var("COAXIS_FAULTY_RUNS").ok().and_then(|text| text.parse().ok()).unwrap_or(RUNS_BY_DEFAULT)
}

fn fault(rng: &mut ChaCha8Rng) -> Fault {
    match rng.random_range(0..8) {
        0 => Fault::LinkLost { arrives: false },
        1 => Fault::LinkLost { arrives: true },
        2 => Fault::Silence { arrives: false },
        3 => Fault::Silence { arrives: true },
        4 => Fault::Late { by: Duration::from_millis(rng.random_range(1..300)) },
        5 => Fault::Late { by: Duration::from_secs(5) },
        6 => Fault::Corrupt,
        _ => Fault::HalfOpen,
    }
}

/// How often each manipulator has executed each set-point of the path.
fn executed(bench: &Bench, carrier: Carrier, path: &Path) -> Vec<usize> {
    let record = bench.world.record(carrier);
    let count = |wanted: &crate::motion::Position| {
        let is_it = |action: &Action| matches!(action, Action::MoveTo { targets, .. } if targets == wanted);
        record.all_executed().filter(|one| is_it(&one.action)).count()
    };
    path.waypoints.iter().skip(1).map(|waypoint| count(waypoint.targets.get(carrier))).collect()
}

/// The end of a run, with the data for judging it.
struct Ended {
    end: JobEnd,
    /// The times of the last valid answers when the job ended.
    good_at: Pair<Instant>,
}

/// Runs a move, randomly with faults or a stop, until its job has ended.
async fn run(bench: &Bench, path: &Path, rng: &mut ChaCha8Rng) -> Ended {
    let faults = bench.world.faults();
    for _ in 0..rng.random_range(0..3) {
        let carrier = Carrier::ALL[rng.random_range(0..2)];
        let device = Device::Manipulator(carrier);
        let within = 12 * path.waypoints.len() as u64;
        faults.at(device, faults.steps(device) + rng.random_range(1..=within), fault(rng));
    }
    let job = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("allowed");
    if rng.random_ratio(1, 5) {
        let early = Duration::from_millis(rng.random_range(0..1_000));
        if timeout(early, job.ended()).await.is_err() {
            let asked_at = now();
            bench.cell.stop().await;
            assert!(now() - asked_at <= Duration::from_millis(50), "the stop took {:?}", now() - asked_at);
        }
    }
    let end = timeout(Duration::from_secs(60), job.ended()).await.expect("every job ends");
    let good_at =
        |carrier: Carrier| bench.lines.get(carrier).lock().expect("an unpoisoned lock").good_at.expect("it was read");
    Ended { end, good_at: Pair::from_fn(good_at) }
}

/// The time from which the stop is measured. A working link transmits the halt that the loss of another link causes; if both have
/// failed, each device has only its own watchdog, and the one that answered later stops later.
fn silent_since(bench: &Bench, good_at: &Pair<Instant>) -> Instant {
    let struck = bench.world.faults().struck();
    let failed = |carrier| struck.iter().any(|one| one.device == Device::Manipulator(carrier));
    match (failed(Carrier::M1), failed(Carrier::M2)) {
        (true, false) => good_at.m1,
        (false, true) => good_at.m2,
        (true, true) | (false, false) => good_at.m1.max(good_at.m2),
    }
}

async fn judge(bench: &Bench, path: &Path, Ended { end, good_at }: &Ended, told: &str) {
    for carrier in Carrier::ALL {
        let counts = executed(bench, carrier, path);
        assert!(counts.iter().all(|count| *count <= 1), "{told}: {} did {counts:?}", carrier.name());
        assert!(*end != JobEnd::Done || counts.iter().all(|count| *count == 1), "{told}: done, and {counts:?}");
        // In order and without gaps: no set-point was skipped.
        assert!(counts.is_sorted_by(|one, next| one >= next), "{told}: {counts:?}");
        let record = bench.world.record(carrier);
        assert_eq!(record.all_ignored().len(), 0, "{told}: a command was sent again");
        assert_eq!(record.all_out_of_limits().len(), 0, "{told}");
    }
    let before = [executed(bench, Carrier::M1, path), executed(bench, Carrier::M2, path)];
    let moved_at = bench.last_motion(Duration::from_millis(1_500)).await;
    let held = moved_at.map(|at| at.saturating_duration_since(silent_since(bench, good_at)));
    assert!(held.is_none_or(|held| held <= HOLD_WITHIN), "{told}: moved {held:?} after the last valid answer");
    let after = [executed(bench, Carrier::M1, path), executed(bench, Carrier::M2, path)];
    assert_eq!(before, after, "{told}: a set-point was executed after the end");
    match end {
        JobEnd::Done => {
            let off = (bench.positions().m1.y - 3.0).abs().max((bench.positions().m2.y - 3.0).abs());
            assert!(off <= 0.02, "{told}: done, but {off} mm from the target");
        }
        JobEnd::Stopped(cause) => assert_eq!(*cause, StopCause::Requested, "{told}"),
        JobEnd::Failed(_) | JobEnd::Unknown(_) => assert_eq!(bench.cell.snapshot().state, State::Faulted, "{told}"),
    }
}

/// After a fault only a reset leads back to idle, and then a move succeeds again.
async fn come_back(bench: &Bench, told: &str) {
    for _ in 0..20 {
        if bench.cell.snapshot().state == State::Idle {
            break;
        }
        // Refused while a device is not connected.
        let _refused = bench.cell.reset(LEASE).await;
        sleep(Duration::from_millis(700)).await;
    }
    // Planned faults that have not occurred yet could still follow.
    bench.world.faults().clear(Device::Manipulator(Carrier::M1));
    bench.world.faults().clear(Device::Manipulator(Carrier::M2));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    let end = bench.begin("job-2", -1.0).await.ended().await;
    assert_eq!(end, JobEnd::Done, "{told}");
}

#[tokio::test(start_paused = true)]
async fn with_random_link_faults_a_set_point_is_executed_once_or_reported_unknown() {
    let mut ends = [0_u64; 4];
    for seed in 0..runs_count() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bench = Bench::ready(&simulation()).await;
        let path = bench.path_to_y(3.0);
        let ended = run(&bench, &path, &mut rng).await;
        let told = format!("seed {seed}, {:?}, faults {:?}", ended.end, bench.world.faults().struck());
        judge(&bench, &path, &ended, &told).await;
        if bench.cell.snapshot().state == State::Faulted && rng.random_ratio(1, 4) {
            come_back(&bench, &told).await;
        }
        let kind = match ended.end {
            JobEnd::Done => 0,
            JobEnd::Stopped(_) => 1,
            JobEnd::Failed(_) => 2,
            JobEnd::Unknown(_) => 3,
        };
        ends[kind] += 1;
        bench.cell.close().await;
    }
    // The random runs have caused every kind of end except the third, which no link can cause.
    assert!(ends[0] > 0 && ends[1] > 0 && ends[3] > 0, "done, stopped, failed, unknown: {ends:?}");
}
