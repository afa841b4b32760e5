//! Finding references: one at a time, only where the other stands, and not again where they are known.

use super::bench::{Bench, LEASE, made};
use crate::cell::{Failure, Manual, Refusal, State, Taken};
use crate::device::{Action, AxisState, Mode, Reading, Safety};
use crate::motion::{Axes, Carrier};
use std::time::Duration;
use tokio::time::sleep;

fn home() -> Action {
    Action::Home { axes: Axes::from_fn(|_| true) }
}

fn homes(bench: &Bench, carrier: Carrier) -> usize {
    bench.sent(carrier, |command| matches!(command.action, Action::Home { .. })).len()
}

fn homed(reading: &Reading) -> bool {
    reading.axes.iter().all(|(_, axis)| axis.homed)
}

/// Both are enabled, and none has a reference.
async fn without_references() -> Bench {
    let mut unhomed = made();
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
async fn homing_what_is_homed_moves_nothing() {
    let bench = Bench::ready(&made()).await;
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
async fn homing_is_refused_before_anything_moves_where_the_other_may_not_move() {
    let disabled = without_references().await;
    disabled.cell.act(LEASE, Carrier::M2, Manual::Disable).await.expect("allowed");
    let guard_open = without_references().await;
    let open = Safety { emergency_stop_ok: true, guard_closed: false, drives_ready: true, remote_enabled: true };
    guard_open.world.set_safety(Carrier::M2, open);
    let at_its_panel = without_references().await;
    at_its_panel.world.set_mode(Carrier::M2, Mode::Manual);
    for (bench, what) in [(disabled, "disabled"), (guard_open, "guard open"), (at_its_panel, "in manual mode")] {
        // Long enough for a reading of it.
        sleep(Duration::from_millis(200)).await;
        let refused = bench.cell.act(LEASE, Carrier::M1, Manual::Home).await;
        let named = match (&refused, what) {
            (Err(Refusal::NotEnabled { carrier, .. }), "disabled")
            | (Err(Refusal::NotRemote { carrier, .. }), "in manual mode") => *carrier == Carrier::M2,
            // The guard makes the device report a fault, which has stopped the cell already.
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
        assert!(!live.reading.as_ref().is_some_and(homed), "{} was stopped on the way", carrier.name());
    }
}

#[tokio::test(start_paused = true)]
async fn a_reference_that_was_lost_meanwhile_is_found_again() {
    let bench = Bench::ready(&made()).await;
    // A homing that does not come to its end leaves the axes without a reference.
    bench.command_from_elsewhere(Carrier::M1, home()).await;
    bench.command_from_elsewhere(Carrier::M1, Action::Halt).await;
    let lost = |reading: &Reading| !homed(reading) && reading.state == AxisState::Standstill;
    let seen = bench.until(|now| now.manipulators.m1.reading.as_ref().is_some_and(lost)).await;
    assert!(matches!(seen.reasons.first(), Some(Refusal::NotHomed { carrier: Carrier::M1, .. })), "{:?}", seen.reasons);
    assert_eq!(bench.cell.act(LEASE, Carrier::M1, Manual::Home).await, Ok(Taken::Accepted));
    bench.until(|now| now.state == State::Idle && now.commands_allowed).await;
    assert_eq!((homes(&bench, Carrier::M1), homes(&bench, Carrier::M2)), (1, 0));
}
