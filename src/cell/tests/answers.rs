//! Commands are answered by how a device is after its last command, and not by an older reading.

use super::bench::{Bench, LEASE, made, settings};
use crate::cell::{Manual, Refusal, State, Taken, now};
use crate::device::simulated::{Device, Fault};
use crate::device::{Action, AxisState};
use crate::motion::Carrier;
use std::time::Duration;
use tokio::time::sleep;

/// A cell that is idle, with the lease taken and nothing enabled.
async fn idle() -> Bench {
    let bench = Bench::start_with(&made(), settings());
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(60)).await;
    bench
}

fn state(bench: &Bench, carrier: Carrier) -> AxisState {
    bench.cell.snapshot().manipulators.get(carrier).reading.as_ref().expect("was read").state
}

#[tokio::test(start_paused = true)]
async fn a_disable_right_after_an_enable_disables_and_so_does_its_mirror() {
    // At every phase of the polling, which has a period of 50 ms.
    for offset_ms in 0..50 {
        for (first, last, ends) in [
            (Manual::Enable, Manual::Disable, AxisState::Disabled),
            (Manual::Disable, Manual::Enable, AxisState::Standstill),
        ] {
            let bench = idle().await;
            if first == Manual::Disable {
                bench.cell.act(LEASE, Carrier::M1, Manual::Enable).await.expect("allowed");
                sleep(Duration::from_millis(200)).await;
            }
            sleep(Duration::from_millis(offset_ms)).await;
            assert_eq!(bench.cell.act(LEASE, Carrier::M1, first).await, Ok(Taken::Accepted));
            assert_eq!(bench.cell.act(LEASE, Carrier::M1, last).await, Ok(Taken::Accepted), "{first:?} {offset_ms} ms");
            sleep(Duration::from_millis(200)).await;
            assert_eq!(state(&bench, Carrier::M1), ends, "{first:?}, {last:?}, {offset_ms} ms");
            assert_eq!(bench.cell.act(LEASE, Carrier::M1, last).await, Ok(Taken::AlreadySo));
        }
    }
}

#[tokio::test(start_paused = true)]
async fn the_same_command_again_is_already_so_once_it_was_read_and_is_sent_once() {
    let bench = idle().await;
    let enable = || bench.cell.act(LEASE, Carrier::M1, Manual::Enable);
    let answers = tokio::join!(enable(), enable(), enable());
    assert_eq!(answers, (Ok(Taken::Accepted), Ok(Taken::AlreadySo), Ok(Taken::AlreadySo)));
    assert_eq!(bench.sent(Carrier::M1, |command| command.action == Action::Enable).len(), 1);
    assert_eq!(state(&bench, Carrier::M1), AxisState::Standstill);
}

#[tokio::test(start_paused = true)]
async fn a_move_right_after_two_accepted_enables_begins() {
    for offset_ms in 0..50 {
        let bench = idle().await;
        let path = bench.path_to_y(3.0);
        sleep(Duration::from_millis(offset_ms)).await;
        for carrier in Carrier::ALL {
            assert_eq!(bench.cell.act(LEASE, carrier, Manual::Enable).await, Ok(Taken::Accepted));
        }
        let begun = bench.cell.start_move(LEASE, "job-1", path).await.map(|job| job.id);
        assert_eq!(begun, Ok("job-1".to_owned()), "{offset_ms} ms");
    }
}

#[tokio::test(start_paused = true)]
async fn a_move_right_after_a_disable_is_refused_and_sends_nothing() {
    let bench = Bench::ready(&made()).await;
    let path = bench.path_to_y(3.0);
    assert_eq!(bench.cell.act(LEASE, Carrier::M2, Manual::Disable).await, Ok(Taken::Accepted));
    let refused = bench.cell.start_move(LEASE, "job-1", path).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::NotEnabled { carrier: Carrier::M2, .. })), "{refused:?}");
    assert!(bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. })).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_request_that_waits_for_a_reading_does_not_outlive_a_stop() {
    let bench = idle().await;
    let path = bench.path_to_y(3.0);
    for carrier in Carrier::ALL {
        bench.cell.act(LEASE, carrier, Manual::Enable).await.expect("allowed");
    }
    let cell = bench.cell.clone();
    let waiting = tokio::spawn(async move { cell.start_move(LEASE, "job-1", path).await.map(|job| job.id) });
    tokio::task::yield_now().await;
    bench.cell.stop().await;
    let refused = waiting.await.expect("it is answered");
    assert!(matches!(refused, Err(Refusal::WrongState { state: State::Stopping, .. })), "{refused:?}");
    bench.until(|now| now.state == State::Idle).await;
    assert_eq!(bench.last_motion(Duration::from_secs(2)).await, None);
    assert!(bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. })).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_request_waits_no_longer_than_for_an_acknowledgement_and_an_answer() {
    let bench = idle().await;
    bench.m1_was_read().await;
    // The command arrives, and neither its answer nor any other comes.
    bench.world.faults().hold(Device::Manipulator(Carrier::M1), Fault::Silence { arrives: true });
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Enable).await, Ok(Taken::Accepted));
    let asked_at = now();
    let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await;
    assert!(matches!(refused, Err(Refusal::Faulted { .. } | Refusal::DeviceStale { .. })), "{refused:?}");
    assert!(now() - asked_at <= Duration::from_millis(500), "{:?}", now() - asked_at);
}
