//! Scans: the profiles come whole and in order, or the scan fails by name and the stage stands.

use super::bench::{Bench, LEASE, made, settings};
use crate::cell::driver::Outcome;
use crate::cell::scanning::{ScanStep, Scanning};
use crate::cell::{Failure, JobEnd, Refusal, ScanOrder, State, StopCause, now};
use crate::device::simulated::{Device, Fault};
use crate::device::{DeviceError, Profile, ScanFault, SensorDeadlines, StageReading};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep};

/// 50 profiles, one each 2 mm, as the made sensor triggers.
const ORDER: ScanOrder = ScanOrder { x_from_mm: 100.0, x_to_mm: 202.0, profiles_count: 50, speed_mm_s: 50.0 };

async fn collect(mut profiles: mpsc::Receiver<Vec<Profile>>) -> Vec<Profile> {
    let mut all = Vec::new();
    while let Some(some) = profiles.recv().await {
        all.extend(some);
    }
    all
}

async fn stands(bench: &Bench) {
    bench.until(|now| now.state == State::Idle && now.stage.as_ref().is_some_and(stage_stands)).await;
    let at = bench.cell.snapshot().stage.as_ref().and_then(|stage| stage.reading).expect("was read").actual_mm;
    sleep(Duration::from_secs(2)).await;
    let later = bench.cell.snapshot().stage.as_ref().and_then(|stage| stage.reading).expect("was read").actual_mm;
    assert_eq!(at.to_bits(), later.to_bits(), "the stage stands, mm");
}

fn stage_stands(stage: &crate::cell::Live<crate::device::StageReading>) -> bool {
    stage.reading.is_some_and(|reading| !reading.moves)
}

#[tokio::test(start_paused = true)]
async fn a_scan_gives_every_profile_once_and_in_order() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    assert_eq!(bench.cell.snapshot().state, State::Scanning);
    let all = collect(profiles).await;
    assert_eq!(job.ended().await, JobEnd::Done);
    let indices: Vec<u64> = all.iter().map(|profile| profile.index).collect();
    assert_eq!(indices, (0..50).collect::<Vec<_>>());
    assert!(all.is_sorted_by(|one, next| one.travel_mm < next.travel_mm));
    stands(&bench).await;
    assert_eq!(bench.world.stage_out_of_limits_count(), 0);
}

#[tokio::test(start_paused = true)]
async fn what_the_stage_cannot_do_is_refused() {
    let bench = Bench::ready(&made()).await;
    for wrong in [
        ScanOrder { x_to_mm: 1001.0, ..ORDER },
        ScanOrder { x_from_mm: f64::NAN, ..ORDER },
        ScanOrder { speed_mm_s: 201.0, ..ORDER },
        ScanOrder { speed_mm_s: 0.0, ..ORDER },
        ScanOrder { profiles_count: 0, ..ORDER },
        ScanOrder { profiles_count: u64::MAX, ..ORDER },
        ScanOrder { x_to_mm: ORDER.x_from_mm, ..ORDER },
    ] {
        let refused = bench.cell.start_scan(LEASE, "scan-1", wrong).await.map(|(job, _)| job.id);
        assert!(matches!(refused, Err(Refusal::ScanOutOfRange { .. })), "{wrong:?}: {refused:?}");
    }
    assert_eq!(bench.cell.snapshot().state, State::Idle);
}

#[tokio::test(start_paused = true)]
async fn a_scan_is_refused_while_a_manipulator_moves() {
    use crate::device::Action;
    use crate::motion::{Axes, Carrier};
    let bench = Bench::ready(&made()).await;
    let axes = Axes { y: true, ..Axes::default() };
    let (targets, speeds) = (Axes { y: 10.0, ..Axes::default() }, Axes { y: 5.0, ..Axes::default() });
    bench.command_from_elsewhere(Carrier::M2, Action::MoveTo { axes, targets, speeds }).await;
    bench.until(|now| now.manipulators.m2.reading.as_ref().is_some_and(|seen| seen.state.moves())).await;
    let refused = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.map(|(job, _)| job.id);
    assert_eq!(refused, Err(Refusal::Moves { device: "m2".to_owned() }));
}

/// A scan as the state machine of scans sees it: armed at `at`, and the stage on its way since.
fn travelling(own: SensorDeadlines, at: Instant) -> Scanning {
    let from = StageReading {
        actual_mm: ORDER.x_from_mm,
        lower_mm: 0.0,
        upper_mm: 1000.0,
        speed_mm_s: 100.0,
        moves: false,
        in_position: true,
        fault_code: 0,
    };
    let names = ("stage".to_owned(), "sensor".to_owned());
    let mut scanning = Scanning::new(ORDER, names, from, (&settings(), &own), at);
    scanning.stage_told(at, Outcome::Taken { sequence: 0 });
    assert_eq!(scanning.read(at, at, &from), ScanStep::Arm);
    assert!(matches!(scanning.sensor_told(at, Outcome::Taken { sequence: 0 }), ScanStep::Carry(_)));
    scanning.stage_told(at, Outcome::Taken { sequence: 0 });
    let arrived = StageReading { actual_mm: ORDER.x_to_mm, ..from };
    assert_eq!(scanning.read(at + Duration::from_secs(3), at + Duration::from_secs(3), &arrived), ScanStep::Wait);
    scanning
}

#[tokio::test(start_paused = true)]
async fn the_stall_limit_does_not_override_a_sensors_own_time_for_the_first_profile() {
    let at = now();
    let patient = SensorDeadlines { first_profile: Duration::from_secs(30), ..SensorDeadlines::default() };
    let mut scanning = travelling(patient, at);
    // The whole surface comes 20 s after the start, and the stage has long arrived.
    assert_eq!(scanning.time(at + Duration::from_secs(20), None), ScanStep::Wait);
    scanning.received(at + Duration::from_secs(20), 50);
    assert_eq!(scanning.ended(Ok(())), ScanStep::Finished);
    let silent = travelling(patient, at);
    assert!(matches!(silent.time(at + Duration::from_secs(31), None), ScanStep::Fail(_)));
    // A sensor without a time of its own has the stall limit of 1 s and two periods of 40 ms.
    let impatient = travelling(SensorDeadlines::default(), at);
    assert!(matches!(impatient.time(at + Duration::from_millis(1_100), None), ScanStep::Fail(_)));
    // Between profiles it is the stall limit.
    let mut stalled = travelling(patient, at);
    stalled.received(at + Duration::from_secs(4), 10);
    assert!(matches!(stalled.time(at + Duration::from_millis(5_100), None), ScanStep::Fail(_)));
}

#[tokio::test(start_paused = true)]
async fn a_gap_fails_the_scan_by_name_and_halts_the_stage() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.world.faults().next(Device::Sensor, Fault::Scan(ScanFault::FrameGap { expected: 20, found: 23 }));
    let end = job.ended().await;
    let named = matches!(
        &end,
        JobEnd::Failed(Failure::Device(DeviceError::ScanFault { fault: ScanFault::FrameGap { .. }, .. }))
    );
    assert!(named, "{end:?}");
    stands(&bench).await;
    assert!(collecting.await.expect("it ends").len() < 50);
    // No device is in doubt: another scan may follow.
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-2", ORDER).await.expect("allowed");
    assert_eq!(collect(profiles).await.len(), 50);
    assert_eq!(job.ended().await, JobEnd::Done);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_falls_silent_fails_the_scan_and_halts_the_stage() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.world.faults().hold(Device::Sensor, Fault::HalfOpen);
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Unknown(_) | JobEnd::Failed(_)), "{end:?}");
    bench.world.faults().clear(Device::Sensor);
    bench.until(|now| matches!(now.state, State::Faulted | State::Idle)).await;
    assert!(collecting.await.expect("it ends").len() < 50);
}

#[tokio::test(start_paused = true)]
async fn a_stage_that_stalls_fails_the_scan() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.world.faults().next(Device::Stage, Fault::Stall);
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Failed(_)), "{end:?}");
    assert!(collecting.await.expect("it ends").len() < 50);
}

#[tokio::test(start_paused = true)]
async fn a_scan_that_asks_for_more_than_the_way_gives_is_incomplete() {
    let bench = Bench::ready(&made()).await;
    let order = ScanOrder { profiles_count: 500, ..ORDER };
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", order).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Failed(Failure::Device(DeviceError::ScanFault { .. }))), "{end:?}");
    let count = collecting.await.expect("it ends").len();
    assert!((40..60).contains(&count), "{count} on 102 mm at 2 mm");
}

#[tokio::test(start_paused = true)]
async fn profiles_that_nobody_takes_fail_the_scan() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    drop(profiles);
    assert_eq!(job.ended().await, JobEnd::Failed(Failure::ProfilesNotTaken));
    stands(&bench).await;
}

#[tokio::test(start_paused = true)]
async fn a_stop_in_a_scan_halts_the_stage() {
    let bench = Bench::ready(&made()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.cell.stop().await;
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    stands(&bench).await;
    assert!(collecting.await.expect("it ends").len() < 50);
}
