//! Stops in every state, without a lease and ahead of every queue; and leases: one commander, and what happens when the lease ends.

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
async fn a_stop_in_a_move_is_sent_to_all_within_50_ms_and_ends_the_job_when_all_stand() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let asked_at = now();
    let report = bench.cell.stop().await;
    assert!(now() - asked_at <= Duration::from_millis(50), "the answer took {:?}", now() - asked_at);
    // Latency of the simulated devices is 5 ms, and a call under way may take another 25 ms.
    assert!(report.sent_within < Duration::from_millis(30), "{report:?}");
    assert!(report.devices.len() == 4 && report.devices.iter().all(|device| device.sent), "{report:?}");
    assert_eq!(bench.cell.snapshot().state, State::Stopping);
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    bench.until(|now| now.state == State::Idle).await;
    // From 10 mm/s at 100 mm/s² it takes 0.1 s; latency and one reading come on top.
    assert!(now() - asked_at <= Duration::from_millis(200), "at rest after {:?}", now() - asked_at);
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    let y = bench.positions().m1.y;
    assert!(y > 1.0 && y < 19.0, "mm, on the way: {y}");
}

#[tokio::test(start_paused = true)]
async fn axes_that_still_move_are_named() {
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
async fn a_halt_that_a_device_refuses_is_not_said_to_be_sent_and_is_latched_by_that_name() {
    let bench = Bench::ready(&simulation()).await;
    bench.m1_was_read().await;
    // The halt, a reading, and the halt that the fault raises.
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
async fn a_device_that_refuses_the_halt_in_a_motion_is_left_alone_and_stops_by_its_watchdog() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    bench.m1_was_read().await;
    let (m1, faults) = (Device::Manipulator(Carrier::M1), bench.world.faults());
    faults.at(m1, faults.steps(m1) + 1, Fault::Rejected { code: 6 });
    let report = bench.cell.stop().await;
    assert!(!report.devices.iter().any(|device| device.name == "m1" && device.sent), "{report:?}");
    // 300 ms of watchdog, 100 ms from 10 mm/s at 100 mm/s², one reading.
    sleep(Duration::from_millis(450)).await;
    assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None);
    let y = bench.positions().m1.y;
    assert!(y > 1.0 && y < 15.0, "mm, on the way: {y}");
}

#[tokio::test(start_paused = true)]
async fn a_halt_whose_number_somebody_else_has_used_goes_out_again() {
    // The first takes the number of our halt, the second a newer one.
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
        // The wait for the acknowledgement, 300 ms, and the way to rest.
        sleep(Duration::from_millis(500)).await;
        assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None, "{commands_count}");
        let y = bench.positions().m1.y;
        assert!(y > 1.0 && y < 15.0, "mm, on the way: {y}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_device_that_is_slow_every_time_is_halted_every_time() {
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
async fn stop_is_taken_in_every_state_without_a_lease_and_again() {
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
    // m1's next answer comes 120 ms late: its call is dropped after the grace, and the halt goes out on a new connection.
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
    // Both at once; the stop has its own way in.
    let (started, _) = tokio::join!(bench.cell.start_move(LEASE, "job-1", path), bench.cell.stop());
    if let Ok(job) = started {
        assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::Requested));
    }
    bench.until(|now| now.state == State::Idle).await;
    assert_eq!(bench.last_motion(Duration::from_secs(3)).await, None);
    assert!(bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. })).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_hundred_stops_at_once_do_not_wear_the_cell_down() {
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
async fn closing_stops_first_and_then_lets_go() {
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
async fn requests_that_wait_when_the_cell_ends_are_refused_and_not_left_unanswered() {
    let bench = Bench::ready(&simulation()).await;
    // All of them are in the queue before the task sees the first.
    let (closed, first, second) =
        tokio::join!(bench.cell.close(), bench.cell.act(LEASE, Carrier::M1, Manual::Disable), bench.cell.reset(LEASE),);
    assert_eq!((closed, first, second), ((), Err(Refusal::Closing), Err(Refusal::Closing)));
}

#[tokio::test(start_paused = true)]
async fn the_cell_stops_when_nobody_holds_it_any_more() {
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
        line.lock().expect("unpoisoned").sent.last().is_some_and(|(_, command)| command.action == Action::Halt)
    };
    assert!(halted(Carrier::M1) && halted(Carrier::M2));
    drop(world);
}

fn request(id: &str, holder: &str, seconds: u64) -> LeaseRequest {
    let time_to_live = Duration::from_secs(seconds);
    LeaseRequest { id: id.to_owned(), holder: holder.to_owned(), time_to_live }
}

#[tokio::test(start_paused = true)]
async fn a_lease_that_runs_out_stops_what_it_moved_within_250_ms() {
    let bench = Bench::start(&simulation());
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(2)).await;
    bench.enable().await;
    let job = bench.begin("job-1", 30.0).await;
    let until = bench.cell.snapshot().lease.as_ref().expect("it was just used").until;
    let halt_count = bench.sent(Carrier::M1, |command| command.action == Action::Halt).len();
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::LeaseOver));
    let at_rest_after = now() - until;
    assert!(at_rest_after <= Duration::from_millis(250), "at rest {at_rest_after:?} after the lease");
    for carrier in Carrier::ALL {
        let halts = bench.sent(carrier, |command| command.action == Action::Halt);
        assert!(halts.len() > halt_count && *halts.last().expect("one") - until <= Duration::from_millis(50));
    }
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    let late = bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await;
    assert_eq!(late, Err(Refusal::LeaseOver));
}

#[tokio::test(start_paused = true)]
async fn a_lease_that_is_renewed_carries_a_long_move_to_its_end() {
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
async fn a_lease_that_is_given_back_stops_what_it_moved() {
    let bench = Bench::ready(&simulation()).await;
    let job = bench.begin("job-1", 30.0).await;
    sleep(Duration::from_millis(600)).await;
    bench.cell.release_lease(LEASE).await.expect("it is held");
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
    bench.cell.release_lease(LEASE).await.expect("it is held");
    let next = bench.cell.take_lease(request("lease-2", "other", 5)).await.expect("free");
    // The bench's floor is 41: 42 was the first.
    assert_eq!(next.fence, 43);
    let refused = bench.cell.start_move(LEASE, "job-3", bench.path_to_y(1.0)).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::LeaseHeld { .. })), "{refused:?}");
}

#[tokio::test(start_paused = true)]
async fn every_command_carries_the_fence_of_its_lease() {
    let bench = Bench::ready(&simulation()).await;
    bench.begin("job-1", 1.0).await.ended().await;
    bench.cell.release_lease(LEASE).await.expect("it is held");
    bench.cell.take_lease(request("lease-2", "other", 5)).await.expect("free");
    bench.cell.stop().await;
    bench.until(|now| now.state == State::Idle).await;
    let line = bench.lines.m1.lock().expect("unpoisoned");
    for (_, command) in &line.sent {
        let fence = if command.action == Action::Halt { 43 } else { 42 };
        assert_eq!(command.fence, fence, "{command:?}");
    }
}
