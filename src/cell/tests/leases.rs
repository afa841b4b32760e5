//! Leases: one commander, and what happens when it is gone.

use super::bench::{Bench, LEASE, made};
use crate::cell::{JobEnd, LeaseRequest, Manual, Refusal, State, StopCause, now};
use crate::device::Action;
use crate::motion::Carrier;
use std::time::Duration;
use tokio::time::sleep;

fn request(id: &str, holder: &str, seconds: u64) -> LeaseRequest {
    let time_to_live = Duration::from_secs(seconds);
    LeaseRequest { id: id.to_owned(), holder: holder.to_owned(), time_to_live }
}

#[tokio::test(start_paused = true)]
async fn a_lease_that_runs_out_stops_what_it_moved_within_250_ms() {
    let bench = Bench::start(&made());
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
    let bench = Bench::start(&made());
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
    let bench = Bench::ready(&made()).await;
    let job = bench.begin("job-1", 30.0).await;
    sleep(Duration::from_millis(600)).await;
    bench.cell.release_lease(LEASE).await.expect("it is held");
    assert_eq!(job.ended().await, JobEnd::Stopped(StopCause::LeaseReleased));
    assert_eq!(bench.cell.release_lease(LEASE).await, Err(Refusal::LeaseOver));
}

#[tokio::test(start_paused = true)]
async fn two_clients_cannot_both_command() {
    let bench = Bench::ready(&made()).await;
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
    let bench = Bench::ready(&made()).await;
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
