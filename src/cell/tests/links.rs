//! Links that are lost, at every step of a move and in every way: everything holds, nothing is sent twice, and nothing moves
//! before a reset.

use super::bench::{Bench, LEASE, made};
use crate::cell::{Cell, Devices, EventKind, JobEnd, Link, Quality, Refusal, State, Taken, now};
use crate::device::simulated::{Device, Fault};
use crate::device::{Action, Manipulator};
use crate::motion::{Carrier, Pair};
use std::time::Duration;
use tokio::time::sleep;

/// From the last good answer until everything has come to rest.
const HOLD_WITHIN: Duration = Duration::from_millis(500);

fn faults() -> Vec<Fault> {
    vec![
        Fault::LinkLost { arrives: false },
        Fault::LinkLost { arrives: true },
        Fault::Silence { arrives: false },
        Fault::Silence { arrives: true },
        Fault::Late { by: Duration::from_secs(5) },
        Fault::Corrupt,
        Fault::HalfOpen,
    ]
}

/// A move with a fault at a step of it; what follows must hold.
async fn one_fault(step: u64, fault: Fault) {
    let told = format!("{fault:?} at step {step}");
    let bench = Bench::ready(&made()).await;
    let device = Device::Manipulator(Carrier::M1);
    let first = bench.world.faults().steps(device);
    bench.world.faults().at(device, first + step, fault);
    let job = bench.begin("job-1", 3.0).await;
    let end = job.ended().await;
    if bench.world.faults().struck().is_empty() {
        assert_eq!(end, JobEnd::Done, "{told}");
        return;
    }
    assert!(matches!(end, JobEnd::Unknown(_)), "{told}: {end:?}");
    let seen = bench.until(|now| now.state == State::Faulted).await;
    assert!(!seen.faults.is_empty() && !seen.commands_allowed, "{told}");
    let good_at = bench.lines.m1.lock().expect("unpoisoned").good_at.expect("it answered once");
    let moved_at = bench.last_motion(Duration::from_secs(3)).await;
    let held = moved_at.map(|at| at - good_at);
    assert!(held.is_none_or(|held| held <= HOLD_WITHIN), "{told}: held {held:?} after the last good answer");
    // It is back by then, and nothing moves until a reset, whoever asks.
    let seen = bench.until(|now| now.manipulators.m1.link == Link::Up).await;
    assert_eq!(seen.state, State::Faulted, "{told}");
    let refused = bench.cell.start_move(LEASE, "job-2", bench.path_to_y(-1.0)).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::Faulted { .. })), "{told}: {refused:?}");
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::Accepted), "{told}");
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    assert_eq!(bench.begin("job-3", -1.0).await.ended().await, JobEnd::Done, "{told}");
    for carrier in Carrier::ALL {
        let record = bench.world.record(carrier);
        assert_eq!((record.all_ignored().len(), record.all_out_of_limits().len()), (0, 0), "{told}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_lost_at_any_step_of_a_move_holds_everything_until_a_reset() {
    for step in [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 14, 18, 25] {
        for fault in faults() {
            one_fault(step, fault).await;
        }
    }
}

#[tokio::test(start_paused = true)]
async fn an_answer_that_is_lost_is_resolved_by_what_the_device_acknowledges() {
    for arrives in [false, true] {
        let bench = Bench::ready(&made()).await;
        let faults = bench.world.faults();
        let device = Device::Manipulator(Carrier::M1);
        // The exchange with the first set-point: a reading before it, and then it.
        faults.at(device, faults.steps(device) + 2, Fault::LinkLost { arrives });
        let job = bench.begin("job-1", 6.0).await;
        assert!(matches!(job.ended().await, JobEnd::Unknown(_)));
        bench.until(|now| now.manipulators.m1.link == Link::Up).await;
        let sent = bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. }));
        assert_eq!(sent.len(), 1, "sent once, whether it arrived or not");
        let resolved = bench.cell.events(0).events.into_iter().find_map(|event| match event.kind {
            EventKind::Resolved { taken, .. } => Some(taken),
            _ => None,
        });
        assert_eq!(resolved, Some(arrives), "what the device says about it");
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_lost_at_rest_is_latched_too() {
    let bench = Bench::ready(&made()).await;
    bench.world.faults().next(Device::Stage, Fault::LinkLost { arrives: false });
    let seen = bench.until(|now| now.state == State::Faulted).await;
    assert_eq!(seen.faults.iter().map(|fault| fault.device.as_str()).collect::<Vec<_>>(), ["stage"]);
    // While it is away nothing can be reset.
    assert!(matches!(bench.cell.reset(LEASE).await, Err(Refusal::DeviceStale { .. })));
    bench.until(|now| now.stage.as_ref().is_some_and(|stage| stage.link == Link::Up)).await;
    assert_eq!(bench.cell.snapshot().state, State::Faulted);
    bench.cell.reset(LEASE).await.expect("everything answers");
    bench.until(|now| now.state == State::Idle).await;
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::AlreadySo));
}

#[tokio::test(start_paused = true)]
async fn values_say_how_old_they_are() {
    let bench = Bench::ready(&made()).await;
    let good = bench.cell.snapshot();
    assert_eq!(good.manipulators.m2.quality(now()), Quality::Good);
    bench.world.faults().hold(Device::Manipulator(Carrier::M2), Fault::HalfOpen);
    // Three polls of 50 ms make it stale; the answer is waited for 150 ms.
    let at = good.manipulators.m2.read_at.expect("was read");
    assert_eq!(good.manipulators.m2.quality(at + Duration::from_millis(151)), Quality::Stale);
    let lost = bench.until(|now| now.manipulators.m2.link == Link::Lost).await;
    let live = &lost.manipulators.m2;
    assert_eq!(live.quality(now()), Quality::Lost);
    assert!(live.reading.is_some() && live.age(now()).is_some_and(|age| age >= Duration::from_millis(150)));
}

#[tokio::test(start_paused = true)]
async fn a_device_that_reports_a_fault_stops_all_and_needs_a_reset() {
    let bench = Bench::ready(&made()).await;
    let job = bench.begin("job-1", 20.0).await;
    sleep(Duration::from_millis(700)).await;
    let hit = Fault::LimitHit { axis: crate::motion::Axis::Y };
    bench.world.faults().next(Device::Manipulator(Carrier::M2), hit);
    assert!(matches!(job.ended().await, JobEnd::Failed(_)));
    let faulted_at = now();
    let moved_at = bench.last_motion(Duration::from_secs(2)).await;
    assert!(moved_at.is_none_or(|at| at - faulted_at <= Duration::from_millis(150)), "m1 stops as well");
    // The reset acknowledges the device's own fault, and is only over when the device says so.
    assert_eq!(bench.cell.reset(LEASE).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
}

#[tokio::test(start_paused = true)]
async fn it_starts_without_any_device_and_keeps_trying() {
    let mut far = made();
    far.seed = 2;
    let bench = Bench::start(&far);
    for carrier in Carrier::ALL {
        bench.world.faults().hold(Device::Manipulator(carrier), Fault::HalfOpen);
    }
    let cell = bench.cell.clone();
    sleep(Duration::from_secs(30)).await;
    assert_eq!((cell.snapshot().state, cell.snapshot().faults.len()), (State::Offline, 0));
    assert!(!cell.snapshot().commands_allowed);
    for carrier in Carrier::ALL {
        bench.world.faults().clear(Device::Manipulator(carrier));
    }
    bench.until(|now| now.state == State::Idle).await;
}

#[tokio::test(start_paused = true)]
async fn a_cell_with_two_manipulators_only_is_a_cell() {
    let bench = Bench::ready(&made()).await;
    let boxed = |carrier| -> Box<dyn Manipulator> { Box::new(bench.world.manipulator(carrier)) };
    let manipulators = Pair { m1: boxed(Carrier::M1), m2: boxed(Carrier::M2) };
    let sensor: Box<dyn crate::device::ProfileSensor> = Box::new(super::bench::Unplugged);
    let devices = Devices { manipulators, sensor: Some(sensor), stage: None };
    let cell = Cell::start(devices, super::bench::settings(), 0);
    let mut watch = cell.watch();
    let idle = watch.wait_for(|now| now.state == State::Idle).await.expect("the cell lives").clone();
    assert!(idle.stage.is_none() && idle.sensor.as_ref().is_some_and(|sensor| sensor.link == Link::Connecting));
}
