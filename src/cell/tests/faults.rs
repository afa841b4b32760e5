//! Tests which faults are latched, and that nothing continues to move after them. Also an axis that is stuck while the others move:
//! they stop within 300 ms and 1 mm, and the fault names the axis; and no motion is stopped if no axis is stuck.

use super::{Bench, LEASE, arrangement, simulation};
use crate::cell::input::{Effect, Input, Verdict};
use crate::cell::lease::TimeToLiveBounds;
use crate::cell::machine::Machine;
use crate::cell::{EventKind, Failure, Fault, JobEnd, Link, Manual, Refusal, ScanOrder, State, Taken};
use crate::device::clock::now;
use crate::device::simulated::{Device, Fault as SimulatedFault, STAGE_WATCHDOG, Settings};
use crate::device::{Action, Safety};
use crate::motion::{Axes, Axis, Carrier, MoveTargets, Pair, Path, Position, plan_move};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::time::{Instant, sleep};

/// A reading every 20 ms, some ms each for an answer and the halt, and 0.1 s of braking from 10 mm/s at 100 mm/s².
const ALL_STAND_WITHIN: Duration = Duration::from_millis(200);
const GUARD_OPEN: Safety =
    Safety { emergency_stop_ok: true, guard_closed: false, drives_ready: true, remote_enabled: true };

fn interrupted(refusal: Refusal) -> Failure {
    Failure::Interrupted(Box::new(refusal))
}

/// Checks that both manipulators were sent a halt, and are at rest soon after `since`.
async fn both_were_halted(bench: &Bench, since: Instant) {
    let moved_at = bench.last_motion(Duration::from_secs(2)).await;
    let stood = moved_at.map(|at| at - since);
    assert!(stood.is_none_or(|stood| stood <= ALL_STAND_WITHIN), "at rest after {stood:?}");
    for carrier in Carrier::ALL {
        assert!(!bench.sent(carrier, |command| command.action == Action::Halt).is_empty(), "{}", carrier.name());
        assert_eq!(bench.world.record(carrier).all_ignored().len(), 0, "{} has ignored a command", carrier.name());
    }
}

#[tokio::test(start_paused = true)]
async fn a_safety_function_that_opens_during_a_move_halts_both_and_is_reported() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    bench.world.set_safety(Carrier::M2, GUARD_OPEN);
    let opened_at = now();
    let open = interrupted(Refusal::SafetyOpen { carrier: Carrier::M2 });
    assert_eq!(job.ended().await, JobEnd::Failed(open.clone()));
    let seen = bench.cell.snapshot();
    assert_eq!((seen.state, seen.faults.first().map(|fault| &fault.failure)), (State::Faulted, Some(&open)));
    assert!(open.to_string().contains("safety functions of m2"), "{open}");
    both_were_halted(&bench, opened_at).await;
    // The fault remains latched until a reset when the guard is closed.
    let closed = Safety { guard_closed: true, ..GUARD_OPEN };
    bench.world.set_safety(Carrier::M2, closed);
    sleep(Duration::from_secs(1)).await;
    assert_eq!(bench.cell.snapshot().state, State::Faulted);
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
}

#[tokio::test(start_paused = true)]
async fn a_manipulator_that_moves_although_it_should_stay_stops_both() {
    let bench = Bench::ready(&simulation()).await;
    // 15 mm across at one end lengthen 500 mm by 0.22 mm; 0.5 mm are allowed.
    let y_to = |y| Axes { x: None, y: Some(y), z: None, c: None };
    let path = bench.path(&Pair { m1: None, m2: Some(y_to(15.0)) });
    let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
    bench.until(|now| now.manipulators.m2.reading.as_ref().is_some_and(|seen| seen.state.moves())).await;
    let axes = Axes { y: true, ..Axes::default() };
    let (targets, speeds) = (Axes { y: 2.0, ..Axes::default() }, Axes { y: 5.0, ..Axes::default() });
    bench.command_from_elsewhere(Carrier::M1, Action::MoveTo { axes, targets, speeds }).await;
    let drifts_since = now();
    let moves = interrupted(Refusal::Moves { device: "m1".to_owned() });
    assert_eq!(job.ended().await, JobEnd::Failed(moves));
    assert_eq!(bench.cell.snapshot().state, State::Faulted);
    both_were_halted(&bench, drifts_since).await;
    let y = bench.positions().m1.y;
    assert!(y > 0.0 && y < 1.5, "y of m1 is {y} mm; the other client sent it to 2 mm");
}

#[tokio::test(start_paused = true)]
async fn a_command_interrupted_by_the_halt_of_a_fault_is_not_a_second_fault() {
    let bench = Bench::ready(&simulation()).await;
    bench.m1_was_read().await;
    // The answer of m1 to the command is delayed; meanwhile the link of the stage breaks.
    bench
        .world
        .faults()
        .next(Device::Manipulator(Carrier::M1), SimulatedFault::Late { by: Duration::from_millis(120) });
    bench.world.faults().next(Device::Stage, SimulatedFault::LinkLost { arrives: false });
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Faulted).await;
    sleep(Duration::from_secs(1)).await;
    let seen = bench.cell.snapshot();
    assert_eq!(seen.faults.iter().map(|fault| fault.device.as_str()).collect::<Vec<_>>(), ["stage"]);
    let refused = |kind: &EventKind| matches!(kind, EventKind::ManualRefused { verb: "disable", .. });
    assert!(
        bench.cell.events(0).events.iter().any(|event| refused(&event.kind)),
        "the refusal must be reported as an event"
    );
}

#[tokio::test(start_paused = true)]
async fn at_most_32_faults_are_latched_and_later_ones_do_not_halt_again() {
    let bounds = TimeToLiveBounds { least: Duration::from_secs(1), most: Duration::from_secs(10) };
    let mut machine = Machine::new(now(), bounds, 0);
    for code in 1..=40 {
        let failure = Failure::DeviceFault { device: "m1".to_owned(), code };
        let verdict = machine.put(now(), Input::Fault(Fault { device: "m1".to_owned(), failure, at: now() }));
        match verdict {
            Verdict::Accepted(acts) => assert!(code <= 32 && acts.contains(&Effect::Halt), "{code}: {acts:?}"),
            other => assert!(code > 32 && other == Verdict::AlreadySo, "{code}: {other:?}"),
        }
    }
    assert_eq!(machine.faults().len(), 32);
    let first = Failure::DeviceFault { device: "m1".to_owned(), code: 1 };
    assert_eq!(machine.faults().first().map(|fault| &fault.failure), Some(&first), "the first fault must be kept");
}

#[tokio::test(start_paused = true)]
async fn a_task_that_ends_during_a_motion_halts_every_device() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    assert!(bench.cell.is_alive());
    // The task is dropped where it waits, as after a panic.
    bench.task.abort();
    let ended_at = now();
    both_were_halted(&bench, ended_at).await;
    assert!(!bench.cell.is_alive());
    assert_eq!(job.ended().await, JobEnd::Unknown(Failure::CellGone));
    let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await;
    assert_eq!(refused, Err(Refusal::Closing));
}

#[tokio::test(start_paused = true)]
async fn a_driver_without_a_link_sends_nothing_but_a_halt_after_the_task_has_ended() {
    let m1 = Device::Manipulator(Carrier::M1);
    // During its silence, while it tries to connect, and between these.
    for ended_after_ms in [210, 400, 600, 800, 900, 1_000, 1_200] {
        let bench = Bench::ready(&simulation()).await;
        bench.begin("job-1", 20.0).await;
        sleep(Duration::from_millis(700)).await;
        bench.world.faults().hold(m1, SimulatedFault::Silence { arrives: false });
        let silent_since = now();
        sleep(Duration::from_millis(ended_after_ms)).await;
        bench.task.abort();
        let ended_at = now();
        bench.world.faults().clear(m1);
        let moved_at = bench.last_motion(Duration::from_secs(2)).await;
        let held = moved_at.map(|at| at - silent_since);
        assert!(held.is_none_or(|held| held <= Duration::from_millis(500)), "{ended_after_ms} ms: {held:?}");
        let said = bench.sent(Carrier::M1, |command| command.action != Action::Halt);
        assert!(said.iter().all(|at| *at <= ended_at), "{ended_after_ms} ms: {said:?}");
        // The driver has ended, and sends no requests to its device.
        let steps = bench.world.faults().steps(m1);
        sleep(Duration::from_secs(10)).await;
        assert_eq!(bench.world.faults().steps(m1), steps, "{ended_after_ms} ms");
    }
}

/// The times at which requests were sent to a device, checked every millisecond for this time.
async fn words(bench: &Bench, device: Device, within: Duration) -> Vec<Instant> {
    let until = now() + within;
    let (mut steps, mut words) = (bench.world.faults().steps(device), Vec::new());
    while now() < until {
        sleep(Duration::from_millis(1)).await;
        let seen = bench.world.faults().steps(device);
        if seen != steps {
            steps = seen;
            words.push(now());
        }
    }
    words
}

#[tokio::test(start_paused = true)]
async fn nothing_is_sent_after_a_loss_for_the_longest_watchdog_time() {
    let mut slow = simulation();
    slow.stage.watchdog_ms = 400.0;
    for device in [Device::Stage, Device::Manipulator(Carrier::M1)] {
        let bench = Bench::ready(&slow).await;
        let order = ScanOrder { x_from_mm: 100.0, x_to_mm: 900.0, profiles_count: 350, speed_mm_s: 50.0 };
        let mut profiles = None;
        if device == Device::Stage {
            profiles = Some(bench.cell.start_scan(LEASE, "job-1", order).await.expect("allowed"));
            bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.05)).await;
        } else {
            bench.begin("job-1", 20.0).await;
            sleep(Duration::from_millis(700)).await;
        }
        // No request arrives from here on, so that the device receives no heartbeat.
        bench.world.faults().hold(device, SimulatedFault::Silence { arrives: false });
        let words = words(&bench, device, Duration::from_millis(1_200)).await;
        // The wait for an answer is at most 200 ms, so that a longer pause is the silence.
        let silence = words.windows(2).map(|two| two[1] - two[0]).find(|pause| *pause > Duration::from_millis(210));
        // 500 ms of the longest watchdog and 50 ms of margin, less one millisecond for the interval of the check.
        assert!(silence.is_some_and(|pause| pause >= Duration::from_millis(549)), "{device:?}: {silence:?}");
        bench.world.faults().clear(device);
        drop(profiles);
        if device == Device::Stage {
            let seen = bench.until(|now| now.stage.as_ref().is_some_and(|stage| stage.link == Link::Up)).await;
            let stage = seen.stage.as_ref().and_then(|stage| stage.reading).expect("was read");
            assert_eq!(
                (stage.moves, stage.fault_code),
                (false, STAGE_WATCHDOG),
                "the watchdog must have stopped the stage"
            );
        }
    }
}

const CASES_COUNT: u64 = 1_000;
const HEALTHY_COUNT: u64 = 200;
const STANDS_WITHIN: Duration = Duration::from_millis(300);
const RUN_ON_MAX_MM: f64 = 1.0;
/// An axis sticks only farther than this from every set-point, mm or rad, because closer to one it counts as arrived.
const ON_ITS_WAY: f64 = 0.05;
/// The shortest travel of an axis that sticks, mm or rad. A shorter travel strains the part so little that it is detected later.
const WAY_MIN: Axes<f64> = Axes { x: 0.4, y: 0.4, z: 0.4, c: 0.01 };

/// Clamps whose positions equal those of the encoders.
fn rigid() -> Settings {
    let mut rigid = simulation();
    rigid.manipulators.coupling_ratio = 0.0;
    rigid
}

/// Targets for some axes of both manipulators, about the same for both, at a random speed.
fn path(rng: &mut ChaCha8Rng) -> Path {
    let arrangement = arrangement();
    let from = Pair { m1: Position::default(), m2: Position::default() };
    loop {
        let mut common = |reach: f64| rng.random_bool(0.6).then(|| rng.random_range(-reach..reach));
        let (x, y, z, c) = (common(6.0), common(15.0), common(15.0), common(0.3));
        let mut beside = |value: Option<f64>| value.map(|value| value + rng.random_range(-3.0..3.0));
        let targets: MoveTargets =
            Pair { m1: Some(Axes { x, y, z, c }), m2: Some(Axes { x, y: beside(y), z: beside(z), c }) };
        if let Ok(plan) = plan_move(&arrangement, &from, &targets, rng.random_range(0.2..=1.0)) {
            return plan.path;
        }
    }
}

/// The axes of both manipulators that travel far enough.
fn movers(path: &Path) -> Vec<(Carrier, Axis)> {
    let (Some(first), Some(last)) = (path.waypoints.first(), path.waypoints.last()) else { return Vec::new() };
    let way = |carrier, axis: &Axis| last.targets.get(carrier).get(*axis) - first.targets.get(carrier).get(*axis);
    let far = |carrier| {
        Axis::ALL
            .into_iter()
            .filter(move |axis| way(carrier, axis).abs() > *WAY_MIN.get(*axis))
            .map(move |axis| (carrier, axis))
    };
    Carrier::ALL.into_iter().flat_map(far).collect()
}

fn distance(a: &Position, b: &Position) -> f64 {
    ((a.x - b.x).powi(2) + (a.y - b.y).powi(2) + (a.z - b.z).powi(2)).sqrt()
}

/// Waits until an axis is moving, away from every set-point; false if the job ends before.
async fn is_on_its_way(bench: &Bench, path: &Path, (carrier, axis): (Carrier, Axis)) -> bool {
    let mut before = *bench.world.clamp(carrier).get(axis);
    while bench.cell.snapshot().state == State::Moving {
        sleep(Duration::from_millis(1)).await;
        let at = *bench.world.clamp(carrier).get(axis);
        let away = |target: &f64| (at - target).abs() > ON_ITS_WAY * if axis == Axis::C { 0.05 } else { 1.0 };
        if at.to_bits() != before.to_bits() && path.waypoints.iter().all(|one| away(one.targets.get(carrier).get(axis)))
        {
            return true;
        }
        before = at;
    }
    false
}

/// How long and how far the other manipulator moved without the stuck one.
async fn ran_on(bench: &Bench, other: Carrier, stuck_at: Instant) -> (Duration, f64) {
    let from = bench.world.clamp(other);
    let (mut before, mut first, mut last) = (from, None, stuck_at);
    while now() - stuck_at < Duration::from_secs(2) {
        sleep(Duration::from_millis(1)).await;
        let at = bench.world.clamp(other);
        if at != before {
            (before, last) = (at, now());
            first.get_or_insert(now());
        }
    }
    (last - first.unwrap_or(last), distance(&from, &before))
}

/// Runs one case; `None` if the axis did not move far enough to be blocked.
async fn stick(seed: u64) -> Option<(Duration, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let path = path(&mut rng);
    let (carrier, axis) = *movers(&path).choose(&mut rng)?;
    let other = if carrier == Carrier::M1 { Carrier::M2 } else { Carrier::M1 };
    let bench = Bench::ready(&rigid()).await;
    let before_the_start = rng.random_ratio(1, 5);
    if before_the_start {
        bench.world.set_stuck(carrier, axis, true);
    }
    let duration_s = path.waypoints.last().map_or(0.0, |last| last.at_s);
    let job = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("allowed");
    if !before_the_start {
        sleep(Duration::from_secs_f64(rng.random_range(0.0..0.9) * duration_s)).await;
        if !is_on_its_way(&bench, &path, (carrier, axis)).await {
            return None;
        }
        bench.world.set_stuck(carrier, axis, true);
    }
    let ran_on = ran_on(&bench, other, now()).await;
    let end = job.ended().await;
    let named = matches!(&end, JobEnd::Failed(Failure::NotFollowing { carrier: c, axis: a, .. }) if (*c, *a) == (carrier, axis));
    assert!(named, "seed {seed}, {} {}: {end:?}", carrier.name(), axis.name());
    assert_eq!(bench.cell.snapshot().state, State::Faulted, "seed {seed}");
    Some(ran_on)
}

#[tokio::test(start_paused = true)]
async fn with_one_manipulator_stuck_in_any_axis_the_other_stops_within_300_ms_and_1_mm() {
    let (mut cases_count, mut longest, mut farthest) = (0, Duration::ZERO, 0.0_f64);
    for seed in 0.. {
        let Some((time, way_mm)) = stick(seed).await else { continue };
        assert!(time <= STANDS_WITHIN, "seed {seed}: at rest after {time:?}");
        assert!(way_mm <= RUN_ON_MAX_MM, "seed {seed}: moved on by {way_mm} mm");
        (longest, farthest) = (longest.max(time), farthest.max(way_mm));
        cases_count += 1;
        if cases_count == CASES_COUNT {
            break;
        }
    }
    // Otherwise the test would prove nothing.
    assert!(farthest > 0.3 && longest > Duration::from_millis(50), "{farthest} mm, {longest:?}");
}

#[tokio::test(start_paused = true)]
async fn no_motion_is_stopped_if_no_axis_is_stuck() {
    for seed in 0..HEALTHY_COUNT {
        let path = path(&mut ChaCha8Rng::seed_from_u64(1_000_000 + seed));
        let bench = Bench::ready(&simulation()).await;
        let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
        assert_eq!(job.ended().await, JobEnd::Done, "seed {seed}");
    }
}
