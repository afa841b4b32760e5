//! The laser is a hazard like a motion: a sensor that is found running is stopped, a stop and the end of the cell switch it off,
//! and one that does not stop is latched.

use super::bench::{Bench, LEASE, arrangement, made, settings};
use crate::cell::{Failure, Link, ScanOrder, State, now};
use crate::device::simulated::{Device, Fault, Mounting, World};
use crate::device::{DeviceError, ProfileSensor};
use crate::motion::{Carrier, Support};
use std::time::Duration;
use tokio::time::{Instant, sleep};

const ORDER: ScanOrder = ScanOrder { x_from_mm: 100.0, x_to_mm: 900.0, profiles_count: 350, speed_mm_s: 50.0 };

fn world() -> World {
    let mounting = |support: &Support| Mounting { mount_mm: support.mount_mm, limits: support.limits };
    World::new(&made(), &arrangement().supports.map(|_, support| mounting(support))).expect("settings that are allowed")
}

/// Somebody starts the sensor over a line of their own.
async fn start_from_elsewhere(world: &World) {
    let mut line = world.sensor();
    line.connect().await.expect("a link");
    line.start(1_000).await.expect("started");
    assert!(world.laser_is_on());
}

/// Looks each millisecond; says when the laser was off, within a minute.
async fn off_after(world: &World, since: Instant) -> Duration {
    while world.laser_is_on() {
        assert!(now() - since < Duration::from_secs(60), "the laser is still on");
        sleep(Duration::from_millis(1)).await;
    }
    now() - since
}

/// In the middle of a scan.
async fn scanning() -> Bench {
    let bench = Bench::ready(&made()).await;
    let (_, mut profiles) = bench.cell.start_scan(LEASE, "scan-1", ORDER).await.expect("allowed");
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
async fn a_sensor_found_running_after_a_lost_link_is_stopped_whatever_the_cell_does() {
    for moves in [false, true] {
        let bench = Bench::ready(&made()).await;
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
async fn a_link_that_is_lost_in_a_scan_leaves_the_laser_on_no_longer_than_until_it_is_back() {
    let bench = scanning().await;
    bench.world.faults().hold(Device::Sensor, Fault::LinkLost { arrives: false });
    bench.until(|now| now.state == State::Faulted).await;
    sleep(Duration::from_secs(3)).await;
    assert!(bench.world.laser_is_on(), "nothing arrives there");
    bench.world.faults().clear(Device::Sensor);
    let back_at = bench.until(|now| now.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Up)).await.at;
    let off = off_after(&bench.world, back_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_stop_a_lease_that_is_over_and_the_end_of_the_cell_switch_the_laser_off() {
    let bench = scanning().await;
    let asked_at = now();
    let report = bench.cell.stop().await;
    assert_eq!(report.devices.last().map(|device| (device.name.as_str(), device.sent)), Some(("sensor", true)));
    let off = off_after(&bench.world, asked_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");

    let bench = scanning().await;
    bench.cell.release_lease(LEASE).await.expect("it is held");
    let off = off_after(&bench.world, now()).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");

    let bench = scanning().await;
    bench.cell.close().await;
    assert!(!bench.world.laser_is_on(), "it is off before the cell lets go of the devices");

    let bench = scanning().await;
    // What a panic would do to the cell's task.
    bench.task.abort();
    let off = off_after(&bench.world, now()).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_stop_switches_off_a_laser_that_somebody_else_has_switched_on() {
    let bench = Bench::ready(&made()).await;
    start_from_elsewhere(&bench.world).await;
    let asked_at = now();
    bench.cell.stop().await;
    let off = off_after(&bench.world, asked_at).await;
    assert!(off <= Duration::from_millis(50), "off after {off:?}");
}

#[tokio::test(start_paused = true)]
async fn a_sensor_that_refuses_to_stop_is_latched_by_that_name() {
    let bench = Bench::ready(&made()).await;
    start_from_elsewhere(&bench.world).await;
    // It is not asked again for a second then.
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
