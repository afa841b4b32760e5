//! Properties of every planned path, from its set-points alone or from its course by finite differences.

use super::*;
use crate::motion::course::{Course, Progress};
use crate::motion::strain::slowed;

/// The effect of rounding on a distance of a metre.
const ROUNDING_MM: f64 = 1e-9;

/// A raw move with a small strain: both manipulators move equally, except for an allowed difference.
fn raw_moves() -> impl Strategy<Value = (Pair<Position>, MoveTargets)> {
    let way = (-30.0..30.0, -30.0..30.0, -30.0..30.0, -0.4..0.4);
    let own = (-0.3..0.3, -1.0..1.0, -1.0..1.0, -0.015..0.015);
    // Horizontal at the start, so that a millimetre across costs less than the allowed strain.
    (way, own, 0..16u8).prop_map(|((x, y, z, c), (dx, dy, dz, dc), asked)| {
        let wanted = |axis: Axis, value| (asked == 0 || asked >> (axis as u8) & 1 == 1).then_some(value);
        let pick = |at: Position| at.map(|axis, value| wanted(axis, *value));
        let (m1, m2) = (at(x, y, z, c), at(x + dx, y + dy, z + dz, c + dc));
        (Pair::default(), Pair { m1: Some(pick(m1)), m2: Some(pick(m2)) })
    })
}

fn between(a: &Pair<Position>, b: &Pair<Position>, share: impl Fn(Carrier, Axis) -> f64) -> Pair<Position> {
    a.map(|carrier, axes| axes.map(|axis, from| from + (b.get(carrier).get(axis) - from) * share(carrier, axis)))
}

fn check_set_points(plan: &Plan, share: f64) -> Result<(), TestCaseError> {
    let arrangement = arrangement();
    let start = plan.path.waypoints[0];
    prop_assert_eq!(start.at_s, 0.0);
    for pair in plan.path.waypoints.windows(2) {
        let time = pair[1].at_s - pair[0].at_s;
        prop_assert!(time > 0.0);
        for carrier in Carrier::ALL {
            for axis in Axis::ALL {
                let way = (pair[1].targets.get(carrier).get(axis) - pair[0].targets.get(carrier).get(axis)).abs();
                let speed = *pair[1].speeds.get(carrier).get(axis);
                // All axes arrive at the same moment, and none exceeds its speed.
                prop_assert!((speed * time - way).abs() <= 1e-12 * way);
                prop_assert!(speed <= share * arrangement.supports.get(carrier).limits.get(axis).speed);
            }
        }
    }
    let last = plan.path.waypoints[plan.path.waypoints.len() - 1];
    prop_assert_eq!(last.at_s, plan.duration_s);
    prop_assert_eq!(last.targets, plan.axes.map(|_, axes| axes.map(|_, axis| axis.to)));
    prop_assert_eq!(start.targets, plan.axes.map(|_, axes| axes.map(|_, axis| axis.from)));
    Ok(())
}

/// Largest change of the distance of the clamps at a thousand positions between the set-points, with all axes moving together.
fn strain_by_sampling(plan: &Plan) -> f64 {
    let arrangement = arrangement();
    let waypoints = &plan.path.waypoints;
    let origin = distance(&arrangement, &waypoints[0].targets);
    let each = 1000 / (waypoints.len() - 1) + 2;
    waypoints
        .windows(2)
        .flat_map(|pair| (0..=each).map(|i| between(&pair[0].targets, &pair[1].targets, |_, _| i as f64 / each as f64)))
        .map(|at| (distance(&arrangement, &at) - origin).abs())
        .fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(fixed())]

    #[test]
    fn an_alignment_arrives_together_within_its_speeds_and_passes_the_check(wish in wishes(), share in 0.01..1.0) {
        let plan = planned(&wish, share);
        check_set_points(&plan, share)?;
        prop_assert_eq!(check_path(&arrangement(), &wish.from, &plan.path), Ok(()));
    }

    #[test]
    fn an_alignment_keeps_the_distance_of_the_clamps(wish in wishes()) {
        let plan = planned(&wish, 1.0);
        let origin = distance(&arrangement(), &wish.from);
        for waypoint in &plan.path.waypoints {
            let strain = (distance(&arrangement(), &waypoint.targets) - origin).abs();
            prop_assert!(strain < ROUNDING_MM, "{strain} mm at a set-point");
        }
        let sampled = strain_by_sampling(&plan);
        prop_assert!(sampled <= arrangement().strain_max_mm + ROUNDING_MM);
        prop_assert!(sampled <= plan.strain_mm + ROUNDING_MM, "planned {} mm, sampled {sampled} mm", plan.strain_mm);
    }

    #[test]
    fn an_alignment_tolerates_any_order_of_arrival(
        wish in wishes(),
        shares in proptest::collection::vec((0.0..=1.0f64, any::<[bool; 8]>()), 32),
    ) {
        let (arrangement, plan) = (arrangement(), planned(&wish, 1.0));
        let origin = distance(&arrangement, &wish.from);
        for (pair, (share, late)) in plan.path.waypoints.windows(2).zip(shares.iter().cycle()) {
            let one = |carrier, axis| if late[carrier as usize * 4 + axis as usize] { *share } else { 1.0 - share.round() };
            let strain = (distance(&arrangement, &between(&pair[0].targets, &pair[1].targets, one)) - origin).abs();
            prop_assert!(strain <= arrangement.strain_max_mm + ROUNDING_MM, "{strain} mm");
            // One manipulator has completed its step, the other has not started.
            let dead = Pair { m1: pair[1].targets.m1, m2: pair[0].targets.m2 };
            prop_assert!((distance(&arrangement, &dead) - origin).abs() <= arrangement.strain_max_mm + ROUNDING_MM);
            prop_assert!((dead.m1.c - dead.m2.c - (wish.from.m1.c - wish.from.m2.c)).abs() <= arrangement.twist_max + 1e-9);
        }
    }

    #[test]
    fn a_raw_move_passes_the_check_or_is_refused_with_the_true_reason((from, targets) in raw_moves(), share in 0.01..1.0) {
        let arrangement = arrangement();
        match plan_move(&arrangement, &from, &targets, share) {
            Ok(plan) => {
                check_set_points(&plan, share)?;
                prop_assert_eq!(check_path(&arrangement, &from, &plan.path), Ok(()));
                let sampled = strain_by_sampling(&plan);
                prop_assert!(sampled <= arrangement.strain_max_mm + ROUNDING_MM);
                prop_assert!((sampled - plan.strain_mm).abs() < 1e-3, "plan {} mm, seen {sampled} mm", plan.strain_mm);
                prop_assert!(plan.predicted.is_none());
            }
            Err(refusal) => {
                let to = from.map(|carrier, axes| {
                    axes.map(|axis, at| targets.get(carrier).and_then(|wanted| *wanted.get(axis)).unwrap_or(*at))
                });
                let strain = |share| (distance(&arrangement, &between(&from, &to, |_, _| share)) - 1000.0).abs();
                let strain = (0..=100).map(|i| strain(f64::from(i) / 100.0)).fold(0.0, f64::max);
                let truth = match refusal {
                    MotionRefusal::StrainTooLarge { strain_mm, .. } => strain > 0.2 && (strain_mm - strain).abs() < 1e-3,
                    MotionRefusal::TwistTooLarge { .. } => (to.m1.c - to.m2.c).abs() > 0.01,
                    _ => false,
                };
                prop_assert!(truth, "{refusal}; {strain} mm by sampling");
            }
        }
    }

    #[test]
    fn no_axis_is_beyond_its_speed_acceleration_or_jerk(wish in wishes(), share in 0.05..1.0) {
        let arrangement = arrangement();
        let plan = planned(&wish, share);
        let to = plan.axes.map(|_, axes| axes.map(|_, axis| axis.to));
        let course = Course::rigid(&arrangement, &wish.from, &to);
        let limits = arrangement.supports.map(|_, support| support.limits);
        let progress = Progress::new(&slowed(&arrangement, &course, &course.pace(&limits, share)));
        let (n, duration) = (1000, progress.duration());
        prop_assert!((duration - plan.duration_s).abs() < 1e-9);
        let h = duration / f64::from(n);
        let ways: Vec<_> = (0..=n).map(|i| course.at(progress.at(h * f64::from(i)))).collect();
        for carrier in Carrier::ALL {
            for axis in Axis::ALL {
                let q = |i: usize| *ways[i].get(carrier).get(axis);
                let limits = limits.get(carrier).get(axis);
                // Positions of up to 100 are accurate to about 1e-13 (coordinates of metres enter the calculation).
                let noise = 2e-12;
                for i in 1..ways.len() - 2 {
                    let speed = (q(i + 1) - q(i)) / h;
                    prop_assert!(speed.abs() <= limits.speed * share + noise / h, "{axis:?}: {speed}");
                    let acceleration = (q(i + 1) - 2.0 * q(i) + q(i - 1)) / (h * h);
                    prop_assert!(acceleration.abs() <= limits.acceleration + 4.0 * noise / (h * h), "{acceleration}");
                    let jerk = (q(i + 2) - 3.0 * q(i + 1) + 3.0 * q(i) - q(i - 1)) / (h * h * h);
                    prop_assert!(jerk.abs() <= limits.jerk + 8.0 * noise / (h * h * h), "{axis:?}: {jerk}");
                }
            }
        }
    }

    #[test]
    fn a_stored_path_is_unchanged_and_passes_the_check_again(wish in wishes()) {
        let plan = planned(&wish, 0.5);
        let stored = serde_json::to_string(&plan).expect("finite numbers");
        let read: Plan = serde_json::from_str(&stored).expect("a stored plan");
        prop_assert_eq!(check_path(&arrangement(), &wish.from, &read.path), Ok(()));
        prop_assert_eq!(read, plan);
    }
}

#[test]
fn the_axis_that_needs_longest_sets_the_pace() {
    // 20 mm at 10 mm/s, 40 mm/s², 400 mm/s³: ramps of 0.1 + 0.15 + 0.1 s over 1.75 mm each, so 0.7 s and 1.65 s of cruise.
    let both = Some(Axes { y: Some(20.0), z: Some(5.0), ..Axes::default() });
    let plan = plan_move(&arrangement(), &Pair::default(), &Pair { m1: both, m2: both }, 1.0).expect("allowed");
    assert!((plan.duration_s - 2.35).abs() < 1e-6, "{} s", plan.duration_s);
}

#[test]
fn steps_across_the_part_are_long_and_steps_along_it_short() {
    let move_to = |wanted: Axes<Option<f64>>| {
        let targets = Pair { m1: Some(wanted), m2: Some(wanted) };
        plan_move(&arrangement(), &Pair::default(), &targets, 1.0).expect("allowed").path.waypoints.len() - 1
    };
    // Along: 0.2 mm of lead are 0.2 mm of strain. Across, with a distance of a metre: 20 mm of lead are √(1000² + 20²) - 1000 =
    // 0.19998 mm.
    assert_eq!(move_to(Axes { x: Some(10.0), ..Axes::default() }), 50);
    assert_eq!(move_to(Axes { y: Some(20.0), ..Axes::default() }), 1);
    assert_eq!(move_to(Axes { y: Some(40.1), ..Axes::default() }), 3);
    // A hundredth of a radian of lead in the turns is a hundredth of twist.
    assert_eq!(move_to(Axes { c: Some(0.5), ..Axes::default() }), 50);
}

#[test]
fn a_rigid_course_avoids_the_strain_of_straight_axes() {
    // The part pitches by 6°: the clamps have the same distance at both ends, but not half-way along straight axes.
    let mut arrangement = arrangement();
    arrangement.strain_max_mm = 0.01;
    let start =
        AxisLine { p: 0.0, q: -(3f64.to_radians().tan()), y0: 12.0, z0: -340.0 + 800.0 * 3f64.to_radians().tan() };
    let (sin, cos) = 3f64.to_radians().sin_cos();
    let from = Pair {
        m1: at(500.0 - 500.0 * cos, 0.0, 500.0 * sin, 0.0),
        m2: at(500.0 * cos - 500.0, 0.0, -500.0 * sin, 0.0),
    };
    let target = AxisLine { q: -start.q, z0: -340.0 - 800.0 * 3f64.to_radians().tan(), ..start };
    let measured = PartPose { axis: start, x_ref: 800.0 };
    let plan = plan_alignment(&arrangement, &from, &measured, &PoseTarget::axis(target), 1.0).expect("allowed");
    assert!(plan.strain_mm <= 0.01, "{} mm", plan.strain_mm);
    let targets = plan.axes.map(|_, axes| Some(axes.map(|_, axis| Some(axis.to))));
    let refusal = plan_move(&arrangement, &from, &targets, 1.0).expect_err("straight axes cut the corner");
    // 1000 mm (1 - cos 3°), the two ends being 6° apart.
    let MotionRefusal::StrainTooLarge { strain_mm, .. } = refusal else { panic!("{refusal}") };
    assert!((strain_mm - 1000.0 * (1.0 - cos)).abs() < 1e-9, "{strain_mm} mm");
}

#[test]
fn only_manipulators_with_travel_are_marked_as_moving() {
    let targets = Pair { m1: None, m2: Some(Axes { y: Some(3.0), ..Axes::default() }) };
    let plan = plan_move(&arrangement(), &Pair::default(), &targets, 1.0).expect("3 mm across strain by 0.0045 mm");
    assert_eq!(plan.path.moves, Pair { m1: false, m2: true });
    assert!((plan.strain_mm - (1000f64.hypot(3.0) - 1000.0)).abs() < 1e-9);
    assert!(plan.path.waypoints.iter().all(|waypoint| waypoint.speeds.m1 == Position::default()));
}

#[test]
fn an_axis_slightly_beyond_its_limit_may_return_without_a_set_point_outside() {
    for side in [1.0, -1.0] {
        let mut from = Pair::<Position>::default();
        (from.m1.y, from.m2.y) = (80.015 * side, 80.0 * side);
        let both = Some(Axes { y: Some(40.0 * side), ..Axes::default() });
        let targets = Pair { m1: both, m2: both };
        let plan = plan_move(&arrangement(), &from, &targets, 1.0).expect("within its tolerance of the limit");
        assert!(plan.path.waypoints.iter().all(|waypoint| waypoint.targets.m1.y.abs() <= 80.0));
        assert_eq!(check_path(&arrangement(), &from, &plan.path), Ok(()));
    }
}

#[test]
fn a_turn_at_its_limit_does_not_block_a_part_without_roll() {
    let mut arrangement = arrangement();
    for carrier in Carrier::ALL {
        let c = &mut arrangement.supports.get_mut(carrier).limits.c;
        (c.lower, c.upper) = (0.0, 6.0);
    }
    // The axis leans by 0.001 relative to the clamps' line X and is raised by 0.03: X, the axis, the target and the line after it
    // enclose a parallelogram of 3e-5 on the sphere, which is the required turn. In one direction it is possible; in the other it
    // is below the limit.
    for (p, turn, left_mm) in [(0.001, 3e-5, 0.0), (-0.001, 0.0, 0.8 * 3e-5)] {
        let axis = AxisLine::through([800.0, 12.0, -340.0], p, 0.0);
        let target = AxisLine::through([800.0, 12.0, -340.0], 0.0, 0.03);
        let measured = PartPose { axis, x_ref: 800.0 };
        let plan = plan_alignment(&arrangement, &Pair::default(), &measured, &PoseTarget::axis(target), 1.0)
            .expect("the turn is not needed");
        assert!(plan.axes.iter().all(|(_, axes)| (axes.c.travel - turn).abs() < 1e-7));
        // Without the turn the axis, 0.8 mm beside the clamps' line at the part's ends, is off by 0.8 mm times 3e-5.
        let predicted = plan.predicted.expect("an alignment predicts");
        let off = apart(&predicted.axis, &target);
        assert!((off - left_mm).abs() < 1e-7, "{off} mm");
    }
}

const ORIGIN: Pair<Position> =
    Pair { m1: Position { x: 0.0, y: 0.0, z: 0.0, c: 0.0 }, m2: Position { x: 0.0, y: 0.0, z: 0.0, c: 0.0 } };

fn path(run_on_max_mm: f64) -> Path {
    let arrangement = crate::motion::Arrangement { run_on_max_mm, ..arrangement() };
    let to = Some(Axes { x: None, y: Some(20.0), z: Some(15.0), c: Some(0.1) });
    plan_move(&arrangement, &ORIGIN, &Pair { m1: to, m2: to }, 1.0).expect("allowed").path
}

/// The largest travel of a clamp in 0.1 s and while it brakes, calculated independently.
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
    // The greatest speed applies throughout the middle, which the mean of a set-point over its step approaches.
    let run_on = run_on_mm(&slow);
    assert!(run_on <= 0.5 + 1e-9 && run_on > 0.2, "{run_on} mm");
    let end = |path: &Path| path.waypoints.last().map(|last| last.targets);
    assert_eq!(end(&fast), end(&slow));
}

#[test]
fn a_path_with_too_long_a_run_on_is_refused_before_execution() {
    let strict = crate::motion::Arrangement { run_on_max_mm: 0.5, ..arrangement() };
    let refused = check_path(&strict, &ORIGIN, &path(1000.0)).expect_err("too fast");
    assert!(matches!(refused, MotionRefusal::RunsOn { unit: "mm", max, .. } if max == 0.5), "{refused}");
    assert_eq!(check_path(&strict, &ORIGIN, &path(0.5)), Ok(()));
}
