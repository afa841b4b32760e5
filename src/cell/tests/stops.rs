//! Stops in every state, without a lease and ahead of every queue; and leases: only one client commands, and the end of the lease.

use super::{Bench, LEASE, simulation};
use crate::cell::{Failure, JobEnd, LeaseRequest, Manual, Refusal, State, StopCause};
use crate::device::clock::now;
use crate::device::simulated::{Device, Fault};
use crate::device::{Action, DeviceError};
use crate::motion::{Axes, Axis, Carrier};
use std::time::Duration;
use tokio::time::sleep;

fn halts(bench: &Bench, carrier: Carrier) -> Vec<tokio::time::Instant> {
    bench.sent(carrier, |command| command.action == Action::Halt)
}

#[tokio::test(start_paused = true)]
async fn a_stop_in_a_move_is_sent_to_all_within_50_ms_and_ends_the_job_at_rest() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let asked_at = now();
    let report = bench.cell.stop().await;
    assert!(now() - asked_at <= Duration::from_millis(50), "the answer took {:?}", now() - asked_at);
    // The latency of the simulated devices is 5 ms, and a call under way may take another 25 ms.
    assert!(report.sent_within < Duration::from_millis(30), "{report:?}");
    assert!(report.devices.len() == 4 && report.devices.iter().all(|device| device.sent), "{report:?}");
    assert_eq!(bench.cell.snapshot().state, State::Stopping);
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    bench.until(|now| now.state == State::Idle).await;
    // Braking from 10 mm/s at 100 mm/s² takes 0.1 s; latency and one reading are added.
    assert!(now() - asked_at <= Duration::from_millis(200), "at rest after {:?}", now() - asked_at);
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    let y = bench.positions().m1.y;
    assert!(y > 1.0 && y < 19.0, "y = {y} mm, not between start and target");
}

#[tokio::test(start_paused = true)]
async fn a_stop_reports_the_axes_that_still_move() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let report = bench.cell.stop().await;
    assert!(report.unconfirmed.contains(&(Carrier::M1, Axis::Y)), "{report:?}");
    bench.until(|now| now.state == State::Idle).await;
    let report = bench.cell.stop().await;
    assert!(report.unconfirmed.is_empty() && report.devices.iter().all(|device| device.confirmed), "{report:?}");
}

#[tokio::test(start_paused = true)]
async fn a_refused_halt_is_not_reported_as_sent_and_is_latched_as_a_fault() {
    let bench = Bench::ready(&simulation()).await;
    bench.m1_was_read().await;
    // The halt, a reading, and the halt that the fault causes.
    let (m1, faults) = (Device::Manipulator(Carrier::M1), bench.world.faults());
    for ahead in [1, 3] {
        faults.at(m1, faults.steps(m1) + ahead, Fault::Rejected { code: 5 });
    }
    let report = bench.cell.stop().await;
    let told: Vec<_> =
        report.devices.iter().map(|device| (device.name.as_str(), device.sent, device.confirmed)).collect();
    assert_eq!(told, [("m1", false, false), ("m2", true, true), ("stage", true, true), ("sensor", true, true)]);
    assert_eq!(report.unconfirmed, Axis::ALL.map(|axis| (Carrier::M1, axis)));
    let seen = bench.until(|now| now.state == State::Faulted).await;
    let refused = Failure::HaltRefused(DeviceError::Rejected { device: "m1".to_owned(), code: 5 });
    assert_eq!(seen.faults.iter().map(|fault| &fault.failure).collect::<Vec<_>>(), [&refused]);
}

#[tokio::test(start_paused = true)]
async fn a_device_that_refuses_the_halt_in_a_motion_is_not_read_and_stops_by_its_watchdog() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    bench.m1_was_read().await;
    let (m1, faults) = (Device::Manipulator(Carrier::M1), bench.world.faults());
    faults.at(m1, faults.steps(m1) + 1, Fault::Rejected { code: 6 });
    let report = bench.cell.stop().await;
    assert!(!report.devices.iter().any(|device| device.name == "m1" && device.sent), "{report:?}");
    // 300 ms of watchdog, 100 ms of braking from 10 mm/s at 100 mm/s², one reading.
    sleep(Duration::from_millis(450)).await;
    assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None);
    let y = bench.positions().m1.y;
    assert!(y > 1.0 && y < 15.0, "y = {y} mm, not between start and target");
}

#[tokio::test(start_paused = true)]
async fn a_halt_whose_number_another_client_has_used_is_sent_again() {
    // The first command has the number of our halt, the second a newer one.
    for commands_count in [1, 2] {
        let bench = Bench::ready(&simulation()).await;
        bench.begin("job-1", 20.0).await;
        sleep(Duration::from_millis(700)).await;
        bench.m1_was_read().await;
        let axes = Axes { y: true, ..Axes::default() };
        let (targets, speeds) = (Axes { y: 18.0, ..Axes::default() }, Axes { y: 5.0, ..Axes::default() });
        for _ in 0..commands_count {
            bench.command_from_elsewhere(Carrier::M1, Action::MoveTo { axes, targets, speeds }).await;
        }
        bench.cell.stop().await;
        // 300 ms of waiting for the acknowledgement, and the braking time.
        sleep(Duration::from_millis(500)).await;
        assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None, "{commands_count}");
        let y = bench.positions().m1.y;
        assert!(y > 1.0 && y < 15.0, "y = {y} mm, not between start and target");
    }
}

#[tokio::test(start_paused = true)]
async fn a_device_that_is_always_slow_is_halted_every_time() {
    let bench = Bench::ready(&simulation()).await;
    for round in 1..=3 {
        bench.world.faults().next(Device::Manipulator(Carrier::M1), Fault::Late { by: Duration::from_millis(120) });
        sleep(Duration::from_millis(60)).await;
        let before = halts(&bench, Carrier::M1).len();
        bench.cell.stop().await;
        sleep(Duration::from_millis(100)).await;
        assert!(halts(&bench, Carrier::M1).len() > before, "round {round}");
        bench.until(|now| now.state == State::Idle).await;
    }
    assert_eq!(bench.cell.snapshot().faults, []);
}

#[tokio::test(start_paused = true)]
async fn stop_is_accepted_in_every_state_without_a_lease_and_repeatedly() {
    let bench = Bench::start(&simulation());
    assert_eq!(bench.cell.snapshot().state, State::Offline);
    bench.cell.stop().await;
    bench.until(|now| now.state == State::Idle).await;
    bench.until(|_| halts(&bench, Carrier::M1).len() == 1).await;
    for round in 2..5 {
        bench.cell.stop().await;
        bench.until(|now| now.state == State::Idle).await;
        assert_eq!(halts(&bench, Carrier::M2).len(), round);
    }
    bench.world.faults().hold(Device::Manipulator(Carrier::M1), Fault::HalfOpen);
    bench.until(|now| now.state == State::Faulted).await;
    let before = halts(&bench, Carrier::M2).len();
    let report = bench.cell.stop().await;
    assert_eq!(halts(&bench, Carrier::M2).len(), before + 1);
    let confirmed: Vec<_> = report.devices.iter().map(|device| device.confirmed).collect();
    assert_eq!(confirmed, [false, true, true, true], "m1 does not answer: {report:?}");
    assert_eq!(report.unconfirmed.len(), 4, "all axes of m1: {report:?}");
}

#[tokio::test(start_paused = true)]
async fn a_stop_does_not_wait_behind_a_device_that_is_slow_to_answer() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(500)).await;
    // The next answer of m1 is 120 ms late: its call is dropped after the grace time, and the halt is sent on a new connection.
    bench.world.faults().next(Device::Manipulator(Carrier::M1), Fault::Late { by: Duration::from_millis(120) });
    sleep(Duration::from_millis(30)).await;
    let asked_at = now();
    bench.cell.stop().await;
    assert!(now() - asked_at <= Duration::from_millis(50), "the answer took {:?}", now() - asked_at);
    sleep(Duration::from_millis(200)).await;
    let sent = |carrier| *halts(&bench, carrier).last().expect("a halt") - asked_at;
    assert!(sent(Carrier::M2) <= Duration::from_millis(20), "m2 after {:?}", sent(Carrier::M2));
    assert!(sent(Carrier::M1) <= Duration::from_millis(60), "m1 after {:?}", sent(Carrier::M1));
    bench.until(|now| now.state == State::Idle).await;
}

#[tokio::test(start_paused = true)]
async fn a_stop_overtakes_requests_and_orders_that_came_before_it() {
    let bench = Bench::ready(&simulation()).await;
    let path = bench.path_to_y(20.0);
    // Both at once; the stop does not pass through the queue.
    let (started, _) = tokio::join!(bench.cell.start_move(LEASE, "job-1", path), bench.cell.stop());
    if let Ok(job) = started {
        assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    }
    bench.until(|now| now.state == State::Idle).await;
    assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None);
    assert!(bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. })).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_hundred_simultaneous_stops_are_all_answered() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 20.0).await;
    for _ in 0..100 {
        let report = bench.cell.stop().await;
        assert!(report.devices.iter().all(|device| device.sent), "{report:?}");
    }
    bench.until(|now| now.state == State::Idle).await;
    bench.begin("job-2", 0.5).await.ended().await;
}

#[tokio::test(start_paused = true)]
async fn closing_stops_the_devices_before_it_releases_them() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    bench.cell.close().await;
    assert_eq!(job.state(), crate::cell::JobState::Ended(JobEnd::Stopped(StopCause::Closing)));
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    let request = LeaseRequest { id: "l".to_owned(), holder: "late".to_owned(), time_to_live: Duration::from_secs(5) };
    assert_eq!(bench.cell.take_lease(request).await, Err(Refusal::Closing));
    bench.cell.close().await;
}

#[tokio::test(start_paused = true)]
async fn requests_waiting_at_the_end_of_the_cell_are_refused() {
    let bench = Bench::ready(&simulation()).await;
    // All of them are in the queue before the task takes the first.
    let (closed, first, second) =
        tokio::join!(bench.cell.close(), bench.cell.act(LEASE, Carrier::M1, Manual::Disable), bench.cell.reset(LEASE),);
    assert_eq!((closed, first, second), ((), Err(Refusal::Closing), Err(Refusal::Closing)));
}

#[tokio::test(start_paused = true)]
async fn the_cell_stops_when_its_last_handle_is_dropped() {
    let Bench { world, cell, task, lines, arrangement } = Bench::ready(&simulation()).await;
    let bench = Bench { world, cell: cell.clone(), task, lines, arrangement };
    bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let Bench { world, cell: last, lines, .. } = bench;
    let watch = cell.watch();
    drop((cell, last));
    let mut watch = watch;
    while watch.changed().await.is_ok() {}
    assert_eq!(watch.borrow().state, State::Idle);
    let halted = |carrier| {
        let line: &std::sync::Mutex<super::Line> = lines.get(carrier);
        line.lock().expect("an unpoisoned lock").sent.last().is_some_and(|(_, command)| command.action == Action::Halt)
    };
    assert!(halted(Carrier::M1) && halted(Carrier::M2));
    drop(world);
}

fn request(id: &str, holder: &str, seconds: u64) -> LeaseRequest {
    let time_to_live = Duration::from_secs(seconds);
    LeaseRequest { id: id.to_owned(), holder: holder.to_owned(), time_to_live }
}

#[tokio::test(start_paused = true)]
async fn an_expired_lease_stops_its_motion_within_250_ms() {
    let bench = Bench::start(&simulation());
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(2)).await;
    bench.enable().await;
    let job = bench.begin("job-1", 30.0).await;
    let until = bench.cell.snapshot().lease.as_ref().expect("a valid lease").until;
    let halt_count = bench.sent(Carrier::M1, |command| command.action == Action::Halt).len();
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::LeaseOver));
    let at_rest_after = now() - until;
    assert!(at_rest_after <= Duration::from_millis(250), "at rest {at_rest_after:?} after the lease");
    for carrier in Carrier::ALL {
        let halts = bench.sent(carrier, |command| command.action == Action::Halt);
        assert!(halts.len() > halt_count && *halts.last().expect("a halt") - until <= Duration::from_millis(50));
    }
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    let late = bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await;
    assert_eq!(late, Err(Refusal::LeaseOver));
}

#[tokio::test(start_paused = true)]
async fn a_renewed_lease_allows_a_long_move_to_finish() {
    let bench = Bench::start(&simulation());
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(1)).await;
    bench.enable().await;
    let job = bench.begin("job-1", 30.0).await;
    let cell = bench.cell.clone();
    let renewing = tokio::spawn(async move {
        while cell.renew_lease(LEASE).await.is_ok() {
            sleep(Duration::from_millis(500)).await;
        }
    });
    assert_eq!(job.ended().await, JobEnd::Done);
    renewing.abort();
}

#[tokio::test(start_paused = true)]
async fn releasing_a_lease_stops_its_motion() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 30.0).await;
    sleep(Duration::from_millis(600)).await;
    bench.cell.release_lease(LEASE).await.expect("the lease is valid");
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::LeaseReleased));
    assert_eq!(bench.cell.release_lease(LEASE).await, Err(Refusal::LeaseOver));
}

#[tokio::test(start_paused = true)]
async fn two_clients_cannot_both_command() {
    let bench = Bench::ready(&simulation()).await;
    let refused = bench.cell.take_lease(request("lease-2", "other", 5)).await;
    assert!(matches!(&refused, Err(Refusal::LeaseHeld { holder, .. }) if holder == "test"), "{refused:?}");
    let refused = bench.cell.start_move("lease-2", "job-2", bench.path_to_y(1.0)).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::LeaseHeld { .. })), "{refused:?}");
    assert!(matches!(bench.cell.reset("lease-2").await, Err(Refusal::LeaseHeld { .. })));
    bench.cell.release_lease(LEASE).await.expect("the lease is valid");
    let next = bench.cell.take_lease(request("lease-2", "other", 5)).await.expect("free");
    // The bench starts with the token 41, so that the first lease had 42.
    assert_eq!(next.fence, 43);
    let refused = bench.cell.start_move(LEASE, "job-3", bench.path_to_y(1.0)).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::LeaseHeld { .. })), "{refused:?}");
}

#[tokio::test(start_paused = true)]
async fn every_command_carries_the_fencing_token_of_its_lease() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 1.0).await.ended().await;
    bench.cell.release_lease(LEASE).await.expect("the lease is valid");
    bench.cell.take_lease(request("lease-2", "other", 5)).await.expect("free");
    bench.cell.stop().await;
    bench.until(|now| now.state == State::Idle).await;
    let line = bench.lines.m1.lock().expect("an unpoisoned lock");
    for (_, command) in &line.sent {
        let fence = if command.action == Action::Halt { 43 } else { 42 };
        assert_eq!(command.fence, fence, "{command:?}");
    }
}
