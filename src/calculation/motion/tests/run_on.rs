//! Paths are so slow that a manipulator that runs on after something has stuck does not run on too far.

use super::arrangement;
use crate::motion::{Axes, Axis, Carrier, MotionRefusal, Pair, Path, Position, check_path, plan_move};

const ORIGIN: Pair<Position> =
    Pair { m1: Position { x: 0.0, y: 0.0, z: 0.0, c: 0.0 }, m2: Position { x: 0.0, y: 0.0, z: 0.0, c: 0.0 } };

fn path(run_on_max_mm: f64) -> Path {
    let arrangement = crate::motion::Arrangement { run_on_max_mm, ..arrangement() };
    let to = Some(Axes { x: None, y: Some(20.0), z: Some(15.0), c: Some(0.1) });
    plan_move(&arrangement, &ORIGIN, &Pair { m1: to, m2: to }, 1.0).expect("allowed").path
}

/// The greatest way of a clamp in 0.1 s and while it brakes, said once more.
fn run_on_mm(path: &Path) -> f64 {
    let limits = arrangement().supports.m1.limits;
    let of = |speeds: &Position, axis: Axis| {
        let speed = *speeds.get(axis);
        0.1 * speed + speed * speed / (2.0 * limits.get(axis).acceleration)
    };
    let ways = path.waypoints.iter().flat_map(|waypoint| Carrier::ALL.map(|carrier| *waypoint.speeds.get(carrier)));
    ways.map(|speeds| of(&speeds, Axis::X).hypot(of(&speeds, Axis::Y)).hypot(of(&speeds, Axis::Z))).fold(0.0, f64::max)
}

#[test]
fn a_path_is_slowed_down_until_it_keeps_the_run_on_and_no_further() {
    let (fast, slow) = (path(1000.0), path(0.5));
    assert!(run_on_mm(&fast) > 1.0, "{} mm", run_on_mm(&fast));
    // The greatest speed is kept on the whole of the middle, which a set-point's mean over its step comes near to.
    let run_on = run_on_mm(&slow);
    assert!(run_on <= 0.5 + 1e-9 && run_on > 0.2, "{run_on} mm");
    let end = |path: &Path| path.waypoints.last().map(|last| last.targets);
    assert_eq!(end(&fast), end(&slow));
}

#[test]
fn a_path_that_would_run_on_too_far_is_refused_before_it_is_executed() {
    let strict = crate::motion::Arrangement { run_on_max_mm: 0.5, ..arrangement() };
    let refused = check_path(&strict, &ORIGIN, &path(1000.0)).expect_err("too fast");
    assert!(matches!(refused, MotionRefusal::RunsOn { unit: "mm", max, .. } if max == 0.5), "{refused}");
    assert_eq!(check_path(&strict, &ORIGIN, &path(0.5)), Ok(()));
}
