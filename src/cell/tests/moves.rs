//! Moves: what is refused before a byte goes out, and what a good path does.

use super::bench::{Bench, LEASE, made, settings};
use crate::cell::{EventKind, JobEnd, JobState, Manual, Refusal, State, Taken, now};
use crate::device::{Action, Mode};
use crate::motion::{Axes, Axis, AxisLimits, Carrier, MotionRefusal, Pair};
use std::time::Duration;
use tokio::time::sleep;

const fn is_move(action: &Action) -> bool {
    matches!(action, Action::MoveTo { .. })
}

#[tokio::test(start_paused = true)]
async fn a_move_reaches_its_target_with_every_set_point_executed_once() {
    let bench = Bench::ready(&made()).await;
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
            "{} is at {at} mm, 6 within the tolerance of 0.02 were asked for",
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
async fn a_manipulator_that_stays_is_sent_nothing() {
    let bench = Bench::ready(&made()).await;
    // 0.3 mm across at one end: cos strains the part by less than a micrometre.
    let targets = Axes { x: None, y: Some(0.3), z: None, c: None };
    let path = bench.path(&Pair { m1: None, m2: Some(targets) });
    let job = bench.cell.start_move(LEASE, "job-1", path).await.expect("allowed");
    assert_eq!(job.ended().await, JobEnd::Done);
    assert!(bench.sent(Carrier::M1, |command| is_move(&command.action)).is_empty());
    assert!(!bench.sent(Carrier::M2, |command| is_move(&command.action)).is_empty());
}

#[tokio::test(start_paused = true)]
async fn what_is_not_allowed_is_refused_before_a_byte_goes_out() {
    let bench = Bench::ready(&made()).await;
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
    // None of the refused ones has used up its name.
    let job = bench.cell.start_move(LEASE, "a", good).await.expect("allowed");
    assert_eq!(job.ended().await, JobEnd::Done);
}

#[tokio::test(start_paused = true)]
async fn a_path_that_was_planned_before_something_moved_is_stale() {
    let bench = Bench::ready(&made()).await;
    let old = bench.path_to_y(6.0);
    bench.begin("job-1", 3.0).await.ended().await;
    bench.until(|now| now.state == State::Idle).await;
    let refused = bench.cell.start_move(LEASE, "job-2", old).await;
    assert!(matches!(refused, Err(Refusal::Motion(MotionRefusal::Stale { .. }))), "{refused:?}");
}

#[tokio::test(start_paused = true)]
async fn one_job_at_a_time_and_each_only_once() {
    let bench = Bench::ready(&made()).await;
    let path = bench.path_to_y(6.0);
    let job = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("allowed");
    let other = bench.cell.start_move(LEASE, "job-2", path.clone()).await;
    let busy = Refusal::WrongState { state: State::Moving, verb: "move", job: Some("job-1".to_owned()) };
    assert_eq!(other.map(|job| job.id), Err(busy));
    // Who has lost the answer asks again, and gets the same job.
    let again = bench.cell.start_move(LEASE, "job-1", path.clone()).await.expect("the same job");
    assert_eq!(again.ended().await, JobEnd::Done);
    assert_eq!(job.state(), JobState::Ended(JobEnd::Done));
    bench.until(|now| now.state == State::Idle).await;
    let repeated = bench.cell.start_move(LEASE, "job-1", bench.path_to_y(0.0)).await;
    assert_eq!(repeated.map(|job| job.id), Err(Refusal::Repeated { job: "job-1".to_owned() }));
}

#[tokio::test(start_paused = true)]
async fn a_client_that_hangs_up_changes_nothing() {
    let bench = Bench::ready(&made()).await;
    let path = bench.path_to_y(6.0);
    // Dropped as soon as it has been polled once: the request is in the line, nobody waits for the answer.
    {
        let mut asked = Box::pin(bench.cell.start_move(LEASE, "job-1", path));
        let once = std::future::poll_fn(|context| std::task::Poll::Ready(asked.as_mut().poll(context)));
        assert!(once.await.is_pending());
    }
    bench.until(|now| now.state == State::Moving).await;
    bench.until(|now| now.state == State::Idle).await;
    assert!((bench.positions().m1.y - 6.0).abs() <= 0.02, "mm, within the tolerance of the arrangement");
}

#[tokio::test(start_paused = true)]
async fn the_manipulator_must_be_enabled_homed_remote_and_safe() {
    let mut unhomed = made();
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
async fn a_mode_that_is_left_during_a_move_is_latched_even_at_the_one_that_stays() {
    let bench = Bench::ready(&made()).await;
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
async fn the_devices_own_limits_are_kept_before_the_first_set_point() {
    let shorter = |limits: Axes<AxisLimits>| Axes { y: AxisLimits { upper: 5.0, ..limits.y }, ..limits };
    let slower = |limits: Axes<AxisLimits>| Axes { y: AxisLimits { speed: 5.0, ..limits.y }, ..limits };
    let bench = Bench::start_within(&made(), settings(), shorter).made_ready().await;
    let refused = bench.cell.start_move(LEASE, "a", bench.path_to_y(6.0)).await.map(|job| job.id);
    let (carrier, axis, lower, upper) = (Carrier::M1, Axis::Y, -40.0, 5.0);
    let Err(Refusal::Motion(MotionRefusal::OutOfLimits { value, .. })) = refused else { panic!("{refused:?}") };
    assert!(value > 5.0 && value <= 6.0, "the first set-point beyond 5 mm: {value}");
    let beyond = Refusal::Motion(MotionRefusal::OutOfLimits { carrier, axis, value, lower, upper });
    assert_eq!(refused, Err(beyond));
    // Up to there it goes.
    assert_eq!(bench.begin("b", 5.0).await.ended().await, JobEnd::Done);

    let bench = Bench::start_within(&made(), settings(), slower).made_ready().await;
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
async fn a_cell_that_starts_says_nothing_before_the_watchdogs_have_run_out() {
    let bench = Bench::start(&made());
    let started_at = now();
    bench.until(|now| now.state == State::Idle).await;
    // 500 ms of the slowest watchdog and 50 ms of margin.
    assert!(now() - started_at >= Duration::from_millis(550), "spoke after {:?}", now() - started_at);
}

#[tokio::test(start_paused = true)]
async fn events_are_numbered_without_a_gap_and_can_be_waited_for() {
    let bench = Bench::ready(&made()).await;
    let seen = bench.cell.events(0);
    assert_eq!(seen.missed, 0);
    let numbers: Vec<u64> = seen.events.iter().map(|event| event.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>());
    let mut newest = bench.cell.newest_event();
    let last = *newest.borrow_and_update();
    bench.cell.stop().await;
    newest.changed().await.expect("the cell lives");
    let more = bench.cell.events(last);
    assert!(more.events.first().is_some_and(|event| event.number == last + 1 && event.at <= now()));
}
