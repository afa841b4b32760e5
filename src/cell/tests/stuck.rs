//! A manipulator that sticks in any axis while the other one goes on: the other stops within 300 ms and 1 mm, and the axis is
//! named. And nothing is stopped where nothing sticks.

use super::bench::{Bench, LEASE, arrangement, made};
use crate::cell::{Failure, JobEnd, State, now};
use crate::device::simulated::Settings;
use crate::motion::{Axes, Axis, Carrier, MoveTargets, Pair, Path, Position, plan_move};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::time::{Instant, sleep};

const CASES_COUNT: u64 = 1_000;
const HEALTHY_COUNT: u64 = 200;
const STANDS_WITHIN: Duration = Duration::from_millis(300);
const RUN_ON_MAX_MM: f64 = 1.0;
/// An axis sticks where it is farther than this from every set-point, mm or rad: nearer to one it counts as there.
const ON_ITS_WAY: f64 = 0.05;
/// The shortest way of an axis that sticks, mm or rad. A shorter one is noticed when the part has felt as little.
const WAY_MIN: Axes<f64> = Axes { x: 0.4, y: 0.4, z: 0.4, c: 0.01 };

/// Clamps that are exactly where the encoders are.
fn rigid() -> Settings {
    let mut rigid = made();
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

/// The axes of both that go far enough.
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

/// Waits until an axis is on its way, away from every set-point; false where the job ends before.
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

/// When the other manipulator began to move without the one that sticks, and when and how far away it stood.
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

/// One case; `None` where the axis could not be caught on its way.
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
        assert!(time <= STANDS_WITHIN, "seed {seed}: stood after {time:?}");
        assert!(way_mm <= RUN_ON_MAX_MM, "seed {seed}: ran on by {way_mm} mm");
        (longest, farthest) = (longest.max(time), farthest.max(way_mm));
        cases_count += 1;
        if cases_count == CASES_COUNT {
            break;
        }
    }
    // Otherwise nothing was tested.
    assert!(farthest > 0.3 && longest > Duration::from_millis(50), "{farthest} mm, {longest:?}");
}

#[tokio::test(start_paused = true)]
async fn nothing_is_stopped_where_nothing_sticks() {
    for seed in 0..HEALTHY_COUNT {
        let path = path(&mut ChaCha8Rng::seed_from_u64(1_000_000 + seed));
        let bench = Bench::ready(&made()).await;
        let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
        assert_eq!(job.ended().await, JobEnd::Done, "seed {seed}");
    }
}
