//! Many moves on made devices whose links fail by chance: whatever happens, a set-point is executed exactly once or the job
//! says that it does not know, everything holds, and nothing moves before a reset. `COAXIS_FAULTY_RUNS` sets how many.

use super::bench::{Bench, LEASE, made};
use crate::cell::{JobEnd, State, StopCause, now};
use crate::device::Action;
use crate::device::simulated::{Device, Fault};
use crate::motion::{Carrier, Pair, Path};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

/// What fits some seconds of one core without optimisation.
const RUNS_BY_DEFAULT: u64 = 1_500;
/// From the last good answer of the device in doubt until everything has come to rest.
const HOLD_WITHIN: Duration = Duration::from_millis(500);

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

/// How often each manipulator has executed each way of the path.
fn executed(bench: &Bench, carrier: Carrier, path: &Path) -> Vec<usize> {
    let record = bench.world.record(carrier);
    let count = |wanted: &crate::motion::Position| {
        let is_it = |action: &Action| matches!(action, Action::MoveTo { targets, .. } if targets == wanted);
        record.all_executed().filter(|one| is_it(&one.action)).count()
    };
    path.waypoints.iter().skip(1).map(|waypoint| count(waypoint.targets.get(carrier))).collect()
}

/// What a run has to be judged by.
struct Ended {
    end: JobEnd,
    /// The last good answers, when the job ended.
    good_at: Pair<Instant>,
}

/// A move, perhaps with faults, perhaps with a stop; until its job has ended.
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
    let good_at = |carrier: Carrier| bench.lines.get(carrier).lock().expect("unpoisoned").good_at.expect("it was read");
    Ended { end, good_at: Pair::from_fn(good_at) }
}

/// From when on the holding is timed. A link that is well carries the halt that another's loss brings about; where both have
/// failed, each device has only its own watchdog, and the one that answered later holds later.
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
        // In order and without a gap: nothing was left out on the way.
        assert!(counts.is_sorted_by(|one, next| one >= next), "{told}: {counts:?}");
        let record = bench.world.record(carrier);
        assert_eq!(record.all_ignored().len(), 0, "{told}: something was sent again");
        assert_eq!(record.all_out_of_limits().len(), 0, "{told}");
    }
    let before = [executed(bench, Carrier::M1, path), executed(bench, Carrier::M2, path)];
    let moved_at = bench.last_motion(Duration::from_millis(1_500)).await;
    let held = moved_at.map(|at| at.saturating_duration_since(silent_since(bench, good_at)));
    assert!(held.is_none_or(|held| held <= HOLD_WITHIN), "{told}: moved {held:?} after the last good answer");
    let after = [executed(bench, Carrier::M1, path), executed(bench, Carrier::M2, path)];
    assert_eq!(before, after, "{told}: a set-point was executed after the end");
    match end {
        JobEnd::Done => {
            let off = (bench.positions().m1.y - 3.0).abs().max((bench.positions().m2.y - 3.0).abs());
            assert!(off <= 0.02, "{told}: done, and {off} mm off");
        }
        JobEnd::Stopped(cause) => assert_eq!(*cause, StopCause::Requested, "{told}"),
        JobEnd::Failed(_) | JobEnd::Unknown(_) => assert_eq!(bench.cell.snapshot().state, State::Faulted, "{told}"),
    }
}

/// After a fault only a reset leads back, and then a move is done again.
async fn come_back(bench: &Bench, told: &str) {
    for _ in 0..20 {
        if bench.cell.snapshot().state == State::Idle {
            break;
        }
        // Refused while a device is away.
        let _refused = bench.cell.reset(LEASE).await;
        sleep(Duration::from_millis(700)).await;
    }
    // Faults that have not struck yet may still be ahead.
    bench.world.faults().clear(Device::Manipulator(Carrier::M1));
    bench.world.faults().clear(Device::Manipulator(Carrier::M2));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    let end = bench.begin("job-2", -1.0).await.ended().await;
    assert_eq!(end, JobEnd::Done, "{told}");
}

#[tokio::test(start_paused = true)]
async fn whatever_links_do_a_set_point_is_executed_once_or_unknown_and_everything_holds() {
    let mut ends = [0_u64; 4];
    for seed in 0..runs_count() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let bench = Bench::ready(&made()).await;
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
    // The chance has brought about each of them but the third, which no link can.
    assert!(ends[0] > 0 && ends[1] > 0 && ends[3] > 0, "done, stopped, failed, unknown: {ends:?}");
}
