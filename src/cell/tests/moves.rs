//! Commands of the lease holder: moves (which are refused before anything is sent, and how a valid path is executed), homing (one
//! manipulator at a time, only if the other one is at rest), and that commands are judged by the state after the last command.

use super::{Bench, LEASE, settings, simulation};
use crate::cell::{EventKind, Failure, JobEnd, JobState, Manual, Refusal, State, Taken};
use crate::device::clock::now;
use crate::device::simulated::{Device, Fault};
use crate::device::{Action, AxisState, Mode, Reading, Safety};
use crate::motion::{Axes, Axis, AxisLimits, Carrier, MotionRefusal, Pair};
use std::time::Duration;
use tokio::time::sleep;

const fn is_move(action: &Action) -> bool {
    matches!(action, Action::MoveTo { .. })
}

#[tokio::test(start_paused = true)]
async fn a_move_reaches_its_target_with_every_set_point_executed_once() {
    let bench = Bench::ready(&simulation()).await;
    let path = bench.path_to_y(6.0);
    let legs_count = path.waypoints.len() - 1;
    let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
    assert_eq!(bench.cell.snapshot().state, State::Moving);
    assert_eq!(job.ended().await, JobEnd::Done);
    bench.until(|now| now.state == State::Idle).await;
    for carrier in Carrier::ALL {
        let at = bench.positions().get(carrier).y;
        assert!(
            (at - 6.0).abs() <= 0.02,
            "{} is at {at} mm instead of 6 mm within the tolerance of 0.02 mm",
            carrier.name()
        );
        let record = bench.world.record(carrier);
        let moves = record.all_executed().filter(|one| is_move(&one.action)).count();
        assert_eq!((moves, record.all_ignored().len(), record.all_out_of_limits().len()), (legs_count, 0, 0));
    }
    let kinds: Vec<_> = bench.cell.events(0).events.into_iter().map(|event| event.kind).collect();
    assert!(kinds.contains(&EventKind::JobEnded { job: "job-1".to_owned(), end: JobEnd::Done }));
}

#[tokio::test(start_paused = true)]
async fn nothing_is_sent_to_a_manipulator_that_stays() {
    let bench = Bench::ready(&simulation()).await;
    // 0.3 mm across at one end: the cosine error strains the part by less than a micrometre.
    let targets = Axes { x: None, y: Some(0.3), z: None, c: None };
    let path = bench.path(&Pair { m1: None, m2: Some(targets) });
    let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
    assert_eq!(job.ended().await, JobEnd::Done);
    assert!(bench.sent(Carrier::M1, |command| is_move(&command.action)).is_empty());
    assert!(!bench.sent(Carrier::M2, |command| is_move(&command.action)).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_forbidden_move_is_refused_before_a_byte_is_sent() {
    let bench = Bench::ready(&simulation()).await;
    let good = bench.path_to_y(6.0);
    let last = good.waypoints.len() - 1;
    let mut beyond = good.clone();
    beyond.waypoints[last].targets.m1.y = 41.0;
    let mut fast = good.clone();
    fast.waypoints[1].speeds.m2.y = 11.0;
    let mut hurried = good.clone();
    for waypoint in &mut hurried.waypoints {
        waypoint.at_s /= 10.0;
        for speed in [&mut waypoint.speeds.m1.y, &mut waypoint.speeds.m2.y] {
            *speed *= 10.0;
        }
    }
    let mut nan = good.clone();
    nan.waypoints[last].targets.m2.z = f64::NAN;
    let mut elsewhere = good.clone();
    for waypoint in &mut elsewhere.waypoints {
        waypoint.targets.m1.x += 1.0;
    }
    let mut apart = good.clone();
    apart.waypoints[last].targets.m2.x += 10.0;
    for (job, path) in [("a", beyond), ("b", fast), ("c", hurried), ("d", nan), ("e", elsewhere), ("f", apart)] {
        let refused = bench.cell.start_move(LEASE, job, path).await;
        assert!(matches!(refused, Err(Refusal::Motion(_))), "{job}: {refused:?}");
    }
    sleep(Duration::from_secs(1)).await;
    for carrier in Carrier::ALL {
        assert!(bench.sent(carrier, |command| is_move(&command.action)).is_empty());
    }
    // The refused requests have not used up their job ids.
    let job = bench.cell.start_move(LEASE, "a", good).await.expect("allowed");
    assert_eq!(job.ended().await, JobEnd::Done);
}

#[tokio::test(start_paused = true)]
async fn a_path_planned_before_another_motion_is_stale() {
    let bench = Bench::ready(&simulation()).await;
    let old = bench.path_to_y(6.0);
    bench.begin("job-1", 3.0).await.ended().await;
    bench.until(|now| now.state == State::Idle).await;
    let refused = bench.cell.start_move(LEASE, "job-2", old).await;
    assert!(matches!(refused, Err(Refusal::Motion(MotionRefusal::Stale { .. }))), "{refused:?}");
}

#[tokio::test(start_paused = true)]
async fn one_job_at_a_time_and_each_only_once() {
    let bench = Bench::ready(&simulation()).await;
    let path = bench.path_to_y(6.0);
    let job = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("allowed");
    let other = bench.cell.start_move(LEASE, "job-2", path.clone()).await;
    let busy = Refusal::WrongState { state: State::Moving, verb: "move", job: Some("job-1".to_owned()) };
    assert_eq!(other.map(|job| job.id), Err(busy));
    // A client that has lost the answer repeats its request, and gets the same job.
    let again = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("the same job");
    assert_eq!(again.ended().await, JobEnd::Done);
    assert_eq!(job.state(), JobState::Ended(JobEnd::Done));
    bench.until(|now| now.state == State::Idle).await;
    let repeated = bench.cell.start_move(LEASE, "job-1", bench.path_to_y(0.0)).await;
    assert_eq!(repeated.map(|job| job.id), Err(Refusal::Repeated { job: "job-1".to_owned() }));
}

#[tokio::test(start_paused = true)]
async fn a_client_that_disconnects_changes_nothing() {
    let bench = Bench::ready(&simulation()).await;
    let path = bench.path_to_y(6.0);
    // Dropped after being polled once: the request is in the queue, and its answer is not awaited.
    {
        let mut asked = Box::pin(bench.cell.start_move(LEASE, "job-1", path));
        let once = std::future::poll_fn(|context| std::task::Poll::Ready(asked.as_mut().poll(context)));
        assert!(once.await.is_pending());
    }
    bench.until(|now| now.state == State::Moving).await;
    bench.until(|now| now.state == State::Idle).await;
    assert!((bench.positions().m1.y - 6.0).abs() <= 0.02, "not within the tolerance of the arrangement, mm");
}

#[tokio::test(start_paused = true)]
async fn the_manipulator_must_be_enabled_homed_remote_and_safe() {
    let mut unhomed = simulation();
    unhomed.manipulators.homed = false;
    let bench = Bench::start(&unhomed);
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(60)).await;
    let path = || bench.path_to_y(6.0);
    let refused = bench.cell.start_move(LEASE, "a", path()).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::NotEnabled { carrier: Carrier::M1, .. })), "{refused:?}");
    for carrier in Carrier::ALL {
        bench.cell.act(LEASE, carrier, Manual::Enable).await.expect("allowed");
    }
    let unhomed = |now: &crate::cell::Snapshot| {
        now.reasons.iter().all(|reason| matches!(reason, Refusal::NotHomed { .. })) && !now.reasons.is_empty()
    };
    bench.until(unhomed).await;
    let refused = bench.cell.start_move(LEASE, "a", path()).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::NotHomed { carrier: Carrier::M1, .. })), "{refused:?}");
    for carrier in Carrier::ALL {
        assert_eq!(bench.cell.act(LEASE, carrier, Manual::Home).await, Ok(Taken::Accepted));
        assert_eq!(bench.cell.snapshot().state, State::Moving);
        bench.until(|now| now.state == State::Idle).await;
    }
    bench.until(|now| now.commands_allowed).await;
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Enable).await, Ok(Taken::AlreadySo));
    bench.world.set_mode(Carrier::M2, Mode::Manual);
    bench.until(|now| !now.commands_allowed).await;
    let refused = bench.cell.start_move(LEASE, "a", path()).await.map(|job| job.id);
    assert_eq!(refused, Err(Refusal::NotRemote { carrier: Carrier::M2, mode: Mode::Manual }));
}

#[tokio::test(start_paused = true)]
async fn a_mode_change_during_a_move_is_latched_even_at_the_manipulator_that_stays() {
    let bench = Bench::ready(&simulation()).await;
    let targets = Axes { x: None, y: Some(0.3), z: None, c: None };
    let path = bench.path(&Pair { m1: None, m2: Some(targets) });
    let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
    bench.until(|now| now.manipulators.m2.reading.as_ref().is_some_and(|seen| seen.state.moves())).await;
    bench.world.set_mode(Carrier::M1, Mode::Manual);
    let refusal = Refusal::NotRemote { carrier: Carrier::M1, mode: Mode::Manual };
    assert_eq!(job.ended().await, JobEnd::Failed(crate::cell::Failure::Interrupted(Box::new(refusal))));
    assert_eq!(bench.cell.snapshot().state, State::Faulted);
}

#[tokio::test(start_paused = true)]
async fn the_devices_own_limits_are_checked_before_the_first_set_point() {
    let shorter = |limits: Axes<AxisLimits>| Axes { y: AxisLimits { upper: 5.0, ..limits.y }, ..limits };
    let slower = |limits: Axes<AxisLimits>| Axes { y: AxisLimits { speed: 5.0, ..limits.y }, ..limits };
    let bench = Bench::start_within(&simulation(), settings(), shorter).prepared().await;
    let refused = bench.cell.start_move(LEASE, "a", bench.path_to_y(6.0)).await.map(|job| job.id);
    let (carrier, axis, lower, upper) = (Carrier::M1, Axis::Y, -40.0, 5.0);
    let Err(Refusal::Motion(MotionRefusal::OutOfLimits { value, .. })) = refused else { panic!("{refused:?}") };
    assert!(value > 5.0 && value <= 6.0, "the first set-point beyond 5 mm: {value}");
    let beyond = Refusal::Motion(MotionRefusal::OutOfLimits { carrier, axis, value, lower, upper });
    assert_eq!(refused, Err(beyond));
    // The limit itself can be reached.
    assert_eq!(bench.begin("b", 5.0).await.ended().await, JobEnd::Done);

    let bench = Bench::start_within(&simulation(), settings(), slower).prepared().await;
    let refused = bench.cell.start_move(LEASE, "a", bench.path_to_y(20.0)).await.map(|job| job.id);
    assert!(
        matches!(refused, Err(Refusal::Motion(MotionRefusal::TooFast { axis: Axis::Y, max: 5.0, .. }))),
        "{refused:?}"
    );
    for carrier in Carrier::ALL {
        assert!(bench.sent(carrier, |command| is_move(&command.action)).is_empty());
    }
}

#[tokio::test(start_paused = true)]
async fn a_starting_cell_sends_nothing_before_the_watchdogs_have_expired() {
    let bench = Bench::start(&simulation());
    let started_at = now();
    bench.until(|now| now.state == State::Idle).await;
    // 500 ms of the slowest watchdog and 50 ms of margin.
    assert!(now() - started_at >= Duration::from_millis(550), "first request after {:?}", now() - started_at);
}

#[tokio::test(start_paused = true)]
async fn events_are_numbered_without_a_gap_and_can_be_waited_for() {
    let bench = Bench::ready(&simulation()).await;
    let seen = bench.cell.events(0);
    assert_eq!(seen.missed, 0);
    let numbers: Vec<u64> = seen.events.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>());
    let mut newest = bench.cell.newest_event();
    let last = *newest.borrow_and_update();
    bench.cell.stop().await;
    newest.changed().await.expect("the cell is running");
    let more = bench.cell.events(last);
    assert!(more.events.first().is_some_and(|event| event.number == last + 1 && event.at <= now()));
}

/// An idle cell, with the lease taken and nothing enabled.
async fn idle() -> Bench {
    let bench = Bench::start_with(&simulation(), settings());
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(60)).await;
    bench
}

fn state(bench: &Bench, carrier: Carrier) -> AxisState {
    bench.cell.snapshot().manipulators.get(carrier).reading.as_ref().expect("was read").state
}

#[tokio::test(start_paused = true)]
async fn a_disable_right_after_an_enable_disables_and_vice_versa() {
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
async fn a_repeated_command_is_already_executed_after_a_reading_and_sent_once() {
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
    let bench = Bench::ready(&simulation()).await;
    let path = bench.path_to_y(3.0);
    assert_eq!(bench.cell.act(LEASE, Carrier::M2, Manual::Disable).await, Ok(Taken::Accepted));
    let refused = bench.cell.start_move(LEASE, "job-1", path).await.map(|job| job.id);
    assert!(matches!(refused, Err(Refusal::NotEnabled { carrier: Carrier::M2, .. })), "{refused:?}");
    assert!(bench.sent(Carrier::M1, |command| matches!(command.action, Action::MoveTo { .. })).is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_stop_answers_a_request_that_waits_for_a_reading() {
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
    // The command arrives, but there is no answer to it or to later requests.
    bench.world.faults().hold(Device::Manipulator(Carrier::M1), Fault::Silence { arrives: true });
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Enable).await, Ok(Taken::Accepted));
    let asked_at = now();
    let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Disable).await;
    assert!(matches!(refused, Err(Refusal::Faulted { .. } | Refusal::DeviceStale { .. })), "{refused:?}");
    assert!(now() - asked_at <= Duration::from_millis(500), "{:?}", now() - asked_at);
}

fn home() -> Action {
    Action::Home { axes: Axes::from_fn(|_| true) }
}

fn homes(bench: &Bench, carrier: Carrier) -> usize {
    bench.sent(carrier, |command| matches!(command.action, Action::Home { .. })).len()
}

fn homed(reading: &Reading) -> bool {
    reading.axes.iter().all(|(_, axis)| axis.homed)
}

/// A cell with both manipulators enabled and without references.
async fn without_references() -> Bench {
    let mut unhomed = simulation();
    unhomed.manipulators.homed = false;
    let bench = Bench::start(&unhomed);
    bench.until(|now| now.state == State::Idle).await;
    bench.take_lease(Duration::from_secs(60)).await;
    for carrier in Carrier::ALL {
        bench.cell.act(LEASE, carrier, Manual::Enable).await.expect("allowed");
    }
    let enabled = |reading: &Option<Reading>| reading.as_ref().is_some_and(|one| one.state == AxisState::Standstill);
    bench.until(|now| now.manipulators.iter().all(|(_, live)| enabled(&live.reading))).await;
    bench
}

#[tokio::test(start_paused = true)]
async fn homing_a_homed_manipulator_moves_nothing() {
    let bench = Bench::ready(&simulation()).await;
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Home).await, Ok(Taken::AlreadySo));
    sleep(Duration::from_secs(1)).await;
    assert_eq!(homes(&bench, Carrier::M1), 0);
}

#[tokio::test(start_paused = true)]
async fn homing_is_refused_while_the_other_moves() {
    let bench = without_references().await;
    bench.command_from_elsewhere(Carrier::M2, home()).await;
    bench.until(|now| now.manipulators.m2.reading.as_ref().is_some_and(|one| one.state.moves())).await;
    let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Home).await;
    assert_eq!(refused, Err(Refusal::Moves { device: "m2".to_owned() }));
    assert_eq!(homes(&bench, Carrier::M1), 0);
}

#[tokio::test(start_paused = true)]
async fn homing_is_refused_in_advance_if_the_other_manipulator_is_not_ready() {
    let disabled = without_references().await;
    disabled.cell.act(LEASE, Carrier::M2, Manual::Disable).await.expect("allowed");
    let guard_open = without_references().await;
    let open = Safety { emergency_stop_ok: true, guard_closed: false, drives_ready: true, remote_enabled: true };
    guard_open.world.set_safety(Carrier::M2, open);
    let at_its_panel = without_references().await;
    at_its_panel.world.set_mode(Carrier::M2, Mode::Manual);
    for (bench, what) in [(disabled, "disabled"), (guard_open, "guard open"), (at_its_panel, "in manual mode")] {
        // Long enough for a reading of the manipulator.
        sleep(Duration::from_millis(200)).await;
        let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Home).await;
        let named = match (&refused, what) {
            (Err(Refusal::NotEnabled { carrier, .. }), "disabled")
            | (Err(Refusal::NotRemote { carrier, .. }), "in manual mode") => *carrier == Carrier::M2,
            // The guard makes the device report a fault, which has already stopped the cell.
            (Err(Refusal::Faulted { .. }), "guard open") => true,
            _ => false,
        };
        assert!(named, "m2 is {what}: {refused:?}");
        assert_eq!(homes(&bench, Carrier::M1), 0, "m2 is {what}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_manipulator_that_moves_while_the_other_is_homed_stops_both() {
    let bench = without_references().await;
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Home).await, Ok(Taken::Accepted));
    sleep(Duration::from_millis(200)).await;
    bench.command_from_elsewhere(Carrier::M2, home()).await;
    let seen = bench.until(|now| now.state == State::Faulted).await;
    let moves = Failure::Interrupted(Box::new(Refusal::Moves { device: "m2".to_owned() }));
    assert_eq!(seen.faults.first().map(|fault| &fault.failure), Some(&moves));
    let rests = |reading: &Option<Reading>| reading.as_ref().is_some_and(|one| !one.state.moves());
    let seen = bench.until(|now| now.manipulators.iter().all(|(_, live)| rests(&live.reading))).await;
    for (carrier, live) in seen.manipulators.iter() {
        assert_eq!(bench.sent(carrier, |command| command.action == Action::Halt).len(), 1);
        assert!(!live.reading.as_ref().is_some_and(homed), "{} must be stopped before it is homed", carrier.name());
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_reference_is_found_again_by_homing() {
    let bench = Bench::ready(&simulation()).await;
    // A homing that is interrupted leaves the axes without references.
    bench.command_from_elsewhere(Carrier::M1, home()).await;
    bench.command_from_elsewhere(Carrier::M1, Action::Halt).await;
    let lost = |reading: &Reading| !homed(reading) && reading.state == AxisState::Standstill;
    let seen = bench.until(|now| now.manipulators.m1.reading.as_ref().is_some_and(lost)).await;
    assert!(matches!(seen.reasons.first(), Some(Refusal::NotHomed { carrier: Carrier::M1, .. })), "{:?}", seen.reasons);
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Home).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    assert_eq!((homes(&bench, Carrier::M1), homes(&bench, Carrier::M2)), (1, 0));
}
