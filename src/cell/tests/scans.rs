//! Scans: all profiles in order, or the scan fails with a named reason and the stage stops. Also the laser, which is a hazard like
//! a motion: a sensor that is found running is stopped, a stop and the end of the cell switch it off, and a sensor that does not
//! stop is a fault.

use super::{Bench, LEASE, arrangement, settings, simulation};
use crate::cell::driver::messages::Outcome;
use crate::cell::scanning::{ScanStep, Scanning};
use crate::cell::{Failure, JobEnd, Link, Refusal, ScanOrder, State, StopCause};
use crate::device::clock::now;
use crate::device::simulated::{Device, Fault, Mounting, World};
use crate::device::{DeviceError, Profile, ProfileSensor, ScanFault, SensorDeadlines, StageReading};
use crate::motion::{Carrier, Support};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep};

/// 50 profiles, one every 2 mm, as the simulated sensor triggers.
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
    assert_eq!(at.to_bits(), later.to_bits(), "the stage must be at rest, mm");
}

fn stage_stands(stage: &crate::cell::Live<crate::device::StageReading>) -> bool {
    stage.reading.is_some_and(|reading| !reading.moves)
}

#[tokio::test(start_paused = true)]
async fn a_scan_returns_every_profile_once_and_in_order() {
    let bench = Bench::ready(&simulation()).await;
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
async fn a_scan_beyond_the_range_or_speed_of_the_stage_is_refused() {
    let bench = Bench::ready(&simulation()).await;
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
    let bench = Bench::ready(&simulation()).await;
    let axes = Axes { y: true, ..Axes::default() };
    let (targets, speeds) = (Axes { y: 10.0, ..Axes::default() }, Axes { y: 5.0, ..Axes::default() });
    bench.command_from_elsewhere(Carrier::M2, Action::MoveTo { axes, targets, speeds }).await;
    bench.until(|now| now.manipulators.m2.reading.as_ref().is_some_and(|seen| seen.state.moves())).await;
    let refused = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.map(|(job, _)| job.id);
    assert_eq!(refused, Err(Refusal::Moves { device: "m2".to_owned() }));
}

/// A scan in its state machine: armed at `at`, with the stage moving since then.
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
    scanning.stage_outcome(at, Outcome::Taken { sequence: 0 });
    assert_eq!(scanning.read(at, at, &from), ScanStep::Arm);
    assert!(matches!(scanning.sensor_outcome(at, Outcome::Taken { sequence: 0 }), ScanStep::Carry(_)));
    scanning.stage_outcome(at, Outcome::Taken { sequence: 0 });
    let arrived = StageReading { actual_mm: ORDER.x_to_mm, ..from };
    assert_eq!(scanning.read(at + Duration::from_secs(3), at + Duration::from_secs(3), &arrived), ScanStep::Wait);
    scanning
}

#[tokio::test(start_paused = true)]
async fn the_stall_limit_does_not_override_a_sensors_own_time_for_the_first_profile() {
    let at = now();
    let patient = SensorDeadlines { first_profile: Duration::from_secs(30), ..SensorDeadlines::default() };
    let mut scanning = travelling(patient, at);
    // The surface arrives 20 s after the start, long after the stage has arrived.
    assert_eq!(scanning.time(at + Duration::from_secs(20), None), ScanStep::Wait);
    scanning.received(at + Duration::from_secs(20), 50);
    assert_eq!(scanning.ended(Ok(())), ScanStep::Finished);
    let silent = travelling(patient, at);
    assert!(matches!(silent.time(at + Duration::from_secs(31), None), ScanStep::Fail(_)));
    // A sensor without a time limit of its own has the stall limit of 1 s plus two periods of 40 ms.
    let impatient = travelling(SensorDeadlines::default(), at);
    assert!(matches!(impatient.time(at + Duration::from_millis(1_100), None), ScanStep::Fail(_)));
    // Between profiles the stall limit applies.
    let mut stalled = travelling(patient, at);
    stalled.received(at + Duration::from_secs(4), 10);
    assert!(matches!(stalled.time(at + Duration::from_millis(5_100), None), ScanStep::Fail(_)));
}

#[tokio::test(start_paused = true)]
async fn a_gap_fails_the_scan_with_its_reason_and_halts_the_stage() {
    let bench = Bench::ready(&simulation()).await;
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
    assert!(collecting.await.expect("the task ends").len() < 50);
    // The states of all devices are known, so that another scan may follow.
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-2", ORDER).await.expect("allowed");
    assert_eq!(collect(profiles).await.len(), 50);
    assert_eq!(job.ended().await, JobEnd::Done);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_without_answer_fails_the_scan_and_halts_the_stage() {
    let bench = Bench::ready(&simulation()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.world.faults().hold(Device::Sensor, Fault::HalfOpen);
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Unknown(_) | JobEnd::Failed(_)), "{end:?}");
    bench.world.faults().clear(Device::Sensor);
    bench.until(|now| matches!(now.state, State::Faulted | State::Idle)).await;
    assert!(collecting.await.expect("the task ends").len() < 50);
}

#[tokio::test(start_paused = true)]
async fn a_stage_that_stalls_fails_the_scan() {
    let bench = Bench::ready(&simulation()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.world.faults().next(Device::Stage, Fault::Stall);
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Failed(_)), "{end:?}");
    assert!(collecting.await.expect("the task ends").len() < 50);
}

#[tokio::test(start_paused = true)]
async fn a_scan_with_more_profiles_than_its_travel_allows_is_incomplete() {
    let bench = Bench::ready(&simulation()).await;
    let order = ScanOrder { profiles_count: 500, ..ORDER };
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", order).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    let end = job.ended().await;
    assert!(matches!(end, JobEnd::Failed(Failure::Device(DeviceError::ScanFault { .. }))), "{end:?}");
    let count = collecting.await.expect("the task ends").len();
    assert!((40..60).contains(&count), "{count} profiles on 102 mm with a pitch of 2 mm");
}

#[tokio::test(start_paused = true)]
async fn a_scan_fails_if_its_profiles_are_not_received() {
    let bench = Bench::ready(&simulation()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    drop(profiles);
    assert_eq!(job.ended().await, JobEnd::Failed(Failure::ProfilesNotTaken));
    stands(&bench).await;
}

#[tokio::test(start_paused = true)]
async fn a_stop_in_a_scan_halts_the_stage() {
    let bench = Bench::ready(&simulation()).await;
    let (job, profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
    let collecting = tokio::spawn(collect(profiles));
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.2)).await;
    bench.cell.stop().await;
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    stands(&bench).await;
    assert!(collecting.await.expect("the task ends").len() < 50);
}

const LASER_ORDER: ScanOrder = ScanOrder { x_from_mm: 100.0, x_to_mm: 900.0, profiles_count: 350, speed_mm_s: 50.0 };

fn world() -> World {
    let mounting = |support: &Support| Mounting { mount_mm: support.mount_mm, limits: support.limits };
    World::new(&simulation(), &arrangement().supports.map(|_, support| mounting(support))).expect("valid settings")
}

/// Another client starts the sensor over its own link.
async fn start_from_elsewhere(world: &World) {
    let mut line = world.sensor();
    line.connect().await.expect("a link");
    line.start(1_000).await.expect("started");
    assert!(world.laser_is_on());
}

/// Checks every millisecond, for up to a minute, and returns the time until the laser was off.
async fn off_after(world: &World, since: Instant) -> Duration {
    while world.laser_is_on() {
        assert!(now() - since < Duration::from_secs(60), "the laser is still on");
        sleep(Duration::from_millis(1)).await;
    }
    now() - since
}

/// A cell in the middle of a scan.
async fn scanning() -> Bench {
    let bench = Bench::ready(&simulation()).await;
    let (_, mut profiles) = bench.cell.start_scan(LEASE, "scan-1", LASER_ORDER).await.expect("allowed");
    tokio::spawn(async move { while profiles.recv().await.is_some() {} });
    bench.until(|now| now.job.as_ref().is_some_and(|job| job.progress > 0.05)).await;
    assert!(bench.world.laser_is_on());
    bench
}

#[tokio::test(start_paused = true)]
async fn a_sensor_found_running_at_the_start_is_stopped_within_a_second_and_the_cell_waits_for_it() {
    let world = world();
    start_from_elsewhere(&world).await;
    let (bench, started_at) = (Bench::on(world.clone(), settings()), now());
    let off = off_after(&world, started_at).await;
    assert!(off <= Duration::from_millis(100), "off after {off:?}");
    let idle = bench.until(|now| now.state == State::Idle).await;
    assert!(idle.sensor.as_ref().and_then(|sensor| sensor.reading.as_ref()).is_some_and(|one| !one.running));
    assert_eq!(idle.faults, []);
}

#[tokio::test(start_paused = true)]
async fn a_sensor_found_running_after_a_lost_link_is_stopped_in_every_state() {
    for moves in [false, true] {
        let bench = Bench::ready(&simulation()).await;
        bench.world.faults().hold(Device::Sensor, Fault::HalfOpen);
        bench.until(|now| now.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Lost)).await;
        bench.world.faults().clear(Device::Sensor);
        start_from_elsewhere(&bench.world).await;
        if moves {
            bench.begin("job-1", 20.0).await;
        }
        bench.until(|now| now.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Up)).await;
        let off = off_after(&bench.world, now()).await;
        assert!(off <= Duration::from_millis(50), "off after {off:?}");
        if moves {
            assert_eq!(bench.cell.snapshot().state, State::Moving, "a laser is no reason to halt a move");
        } else {
            bench.until(|now| now.state == State::Idle).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn the_laser_is_switched_off_when_a_link_lost_in_a_scan_is_restored() {
    let bench = scanning().await;
    bench.world.faults().hold(Device::Sensor, Fault::LinkLost { arrives: false });
    bench.until(|now| now.state == State::Faulted).await;
    sleep(Duration::from_secs(3)).await;
    assert!(bench.world.laser_is_on(), "no request arrives");
    bench.world.faults().clear(Device::Sensor);
    let back_at = bench.until(|now| now.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Up)).await.at;
    let off = off_after(&bench.world, back_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_stop_the_end_of_the_lease_and_the_end_of_the_cell_switch_the_laser_off() {
    let bench = scanning().await;
    let asked_at = now();
    let report = bench.cell.stop().await;
    assert_eq!(report.devices.last().map(|device| (device.name.as_str(), device.sent)), Some(("sensor", true)));
    let off = off_after(&bench.world, asked_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");

    let bench = scanning().await;
    bench.cell.release_lease(LEASE).await.expect("the lease is valid");
    let off = off_after(&bench.world, now()).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");

    let bench = scanning().await;
    bench.cell.close().await;
    assert!(!bench.world.laser_is_on(), "the laser must be off before the cell releases the devices");

    let bench = scanning().await;
    // The task of the cell is dropped, as after a panic.
    bench.task.abort();
    let off = off_after(&bench.world, now()).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_stop_switches_off_a_laser_that_another_client_has_switched_on() {
    let bench = Bench::ready(&simulation()).await;
    start_from_elsewhere(&bench.world).await;
    let asked_at = now();
    bench.cell.stop().await;
    let off = off_after(&bench.world, asked_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_refuses_to_stop_is_latched_as_that_fault() {
    let bench = Bench::ready(&simulation()).await;
    start_from_elsewhere(&bench.world).await;
    // After the fault the sensor is not read for a second.
    let read_at = bench.cell.snapshot().sensor.as_ref().and_then(|sensor| sensor.read_at);
    bench.until(|now| now.sensor.as_ref().is_some_and(|sensor| sensor.read_at != read_at)).await;
    bench.world.faults().next(Device::Sensor, Fault::Rejected { code: 1000 });
    bench.cell.stop().await;
    let seen = bench.until(|now| now.state == State::Faulted).await;
    let refused = Failure::HaltRefused(DeviceError::Rejected { device: "sensor".to_owned(), code: 1000 });
    let named = seen.faults.iter().any(|fault| fault.failure == refused);
    assert!(named, "{:?}", seen.faults);
    assert!(Carrier::ALL.iter().all(|carrier| seen.manipulators.get(*carrier).link == Link::Up));
}
