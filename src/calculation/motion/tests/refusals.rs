//! Each reason for a refusal, and that invalid input is always refused.

use super::*;

const Y: Axes<Option<f64>> = Axes { x: None, y: Some(10.0), z: None, c: None };

fn both(wanted: Axes<Option<f64>>) -> MoveTargets {
    Pair { m1: Some(wanted), m2: Some(wanted) }
}

fn refused(from: &Pair<Position>, targets: &MoveTargets) -> MotionRefusal {
    plan_move(&arrangement(), from, targets, 1.0).expect_err("must be refused")
}

/// A valid path for the tests to modify.
fn path() -> Path {
    plan_move(&arrangement(), &Pair::default(), &both(Axes { y: Some(30.0), ..Y }), 1.0).expect("allowed").path
}

fn checked(path: &Path) -> MotionRefusal {
    check_path(&arrangement(), &Pair::default(), path).expect_err("must be refused")
}

#[test]
fn a_target_outside_the_limits_is_refused_with_its_limits() {
    let refusal = refused(&Pair::default(), &both(Axes { c: Some(-3.5), ..Axes::default() }));
    let (value, lower, upper) = ((-3.5f64).to_degrees(), (-3f64).to_degrees(), 3f64.to_degrees());
    let truth = MotionRefusal::OutOfLimits { carrier: Carrier::M1, axis: Axis::C, value, lower, upper };
    assert_eq!(refusal, truth);
}

#[test]
fn an_alignment_out_of_reach_is_refused() {
    let axis = AxisLine { p: 0.0, q: 0.0, y0: 12.0, z0: -340.0 };
    let target = PoseTarget::axis(AxisLine { z0: -240.0, ..axis });
    let refusal = plan_alignment(&arrangement(), &Pair::default(), &PartPose { axis, x_ref: 0.0 }, &target, 1.0);
    let truth =
        MotionRefusal::OutOfLimits { carrier: Carrier::M1, axis: Axis::Z, value: 100.0, lower: -80.0, upper: 80.0 };
    assert_eq!(refusal, Err(truth));
}

#[test]
fn an_axis_outside_its_limits_is_not_moved() {
    let mut from = Pair::<Position>::default();
    (from.m1.y, from.m2.y) = (81.0, 81.0);
    let refusal = refused(&from, &both(Axes { y: Some(60.0), ..Y }));
    let truth =
        MotionRefusal::StandsOutside { carrier: Carrier::M1, axis: Axis::Y, actual: 81.0, lower: -80.0, upper: 80.0 };
    assert_eq!(refusal, truth);
    // Another axis may move at the same time.
    let other = both(Axes { z: Some(5.0), ..Axes::default() });
    assert!(plan_move(&arrangement(), &from, &other, 1.0).is_ok());
}

#[test]
fn a_travel_longer_than_the_step_is_refused() {
    let refusal = refused(&Pair::default(), &both(Axes { y: Some(70.0), ..Y }));
    assert_eq!(refusal, MotionRefusal::StepTooLarge { carrier: Carrier::M1, axis: Axis::Y, travel: 70.0, max: 60.0 });
}

#[test]
fn one_manipulator_may_move_only_within_the_strain_limit() {
    let one = |wanted| Pair { m1: Some(wanted), m2: None };
    let along = |x| one(Axes { x: Some(x), ..Axes::default() });
    assert!(plan_move(&arrangement(), &Pair::default(), &along(0.19), 1.0).is_ok());
    let MotionRefusal::StrainTooLarge { strain_mm, max_mm } = refused(&Pair::default(), &along(-0.3)) else {
        panic!("strain")
    };
    assert!((strain_mm - 0.3).abs() < 1e-9 && max_mm == 0.2);
    let MotionRefusal::TwistTooLarge { twist_deg, .. } =
        refused(&Pair::default(), &one(Axes { c: Some(0.02), ..Axes::default() }))
    else {
        panic!("twist")
    };
    assert!((twist_deg - 0.02f64.to_degrees()).abs() < 1e-9);
}

#[test]
fn the_strain_along_the_path_counts_even_if_both_ends_are_allowed() {
    // m2 moves from 30 mm on one side to 30 mm on the other; in the middle the clamps are nearer by 0.45 mm.
    let from = Pair { m1: Position::default(), m2: at(0.0, -29.0, 0.0, 0.0) };
    let targets = Pair { m1: None, m2: Some(Axes { y: Some(29.0), ..Axes::default() }) };
    let MotionRefusal::StrainTooLarge { strain_mm, .. } = refused(&from, &targets) else { panic!("strain") };
    assert!((strain_mm - (1000f64.hypot(29.0) - 1000.0)).abs() < 1e-9, "{strain_mm} mm");
}

#[test]
fn manipulators_must_not_collide_but_may_move_apart() {
    let mut tight = arrangement();
    (tight.strain_max_mm, tight.clearance_min_mm) = (200.0, 650.0);
    let one = |x| Pair { m1: Some(Axes { x: Some(x), ..Axes::default() }), m2: None };
    // 1000 mm between the clamps less two half spans of 150 mm.
    let refusal = plan_move(&tight, &Pair::default(), &one(55.0), 1.0);
    assert_eq!(refusal.map(|_| ()), Err(MotionRefusal::SpansMeet { gap_mm: 645.0, min_mm: 650.0 }));
    let near = Pair { m1: at(60.0, 0.0, 0.0, 0.0), m2: Position::default() };
    assert!(plan_move(&tight, &near, &one(30.0), 1.0).is_ok(), "they part");
    assert!(matches!(plan_move(&tight, &near, &one(61.0), 1.0), Err(MotionRefusal::SpansMeet { .. })));
}

#[test]
fn spans_are_checked_along_the_whole_path() {
    let mut path = path();
    let last = path.waypoints.len() - 1;
    let mut arrangement = arrangement();
    (arrangement.strain_max_mm, arrangement.clearance_min_mm) = (500.0, 650.0);
    let way = |path: &mut Path, x: f64| {
        path.waypoints[1].targets.m1.x = x;
        for index in [1, 2] {
            let time = path.waypoints[index].at_s - path.waypoints[index - 1].at_s;
            path.waypoints[index].speeds.m1.x = x / time;
        }
    };
    assert!(last >= 2, "the path must have a middle");
    way(&mut path, 3.0);
    assert_eq!(check_path(&arrangement, &Pair::default(), &path), Ok(()));
    arrangement.clearance_min_mm = 698.0;
    let refusal = check_path(&arrangement, &Pair::default(), &path);
    assert_eq!(refusal, Err(MotionRefusal::SpansMeet { gap_mm: 697.0, min_mm: 698.0 }));
}

#[test]
fn clamps_in_the_same_position_carry_no_part_along_the_rail() {
    let mut arrangement = arrangement();
    arrangement.supports.m2.mount_mm = arrangement.supports.m1.mount_mm;
    let axis = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };
    let refusal =
        plan_alignment(&arrangement, &Pair::default(), &PartPose { axis, x_ref: 0.0 }, &PoseTarget::axis(axis), 1.0);
    assert_eq!(refusal.map(|_| ()), Err(MotionRefusal::SpansMeet { gap_mm: -300.0, min_mm: 400.0 }));
}

#[test]
fn an_axis_within_its_tolerance_is_not_moved() {
    assert_eq!(refused(&Pair::default(), &Pair::default()), MotionRefusal::NothingToMove);
    let hair = both(Axes { y: Some(0.019), ..Y });
    assert_eq!(refused(&Pair::default(), &hair), MotionRefusal::NothingToMove);
    let mut still = path();
    still.waypoints.truncate(2);
    still.waypoints[1].targets = still.waypoints[0].targets;
    still.waypoints[1].speeds = Pair::default();
    assert_eq!(checked(&still), MotionRefusal::NothingToMove);
}

#[test]
fn a_share_of_the_speed_outside_its_range_is_refused() {
    for share in [0.0, -1.0, 1.01, f64::NAN, f64::INFINITY, 1e-300] {
        let refusal = plan_move(&arrangement(), &Pair::default(), &both(Y), share);
        assert!(matches!(refusal, Err(MotionRefusal::ShareOutOfRange { .. })), "{share}");
    }
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let bad = f64::NAN;
    let mut from = Pair::<Position>::default();
    from.m2.z = bad;
    assert_eq!(refused(&from, &both(Y)), MotionRefusal::NotFinite { what: "positions" });
    let target = both(Axes { y: Some(bad), ..Y });
    assert_eq!(refused(&Pair::default(), &target), MotionRefusal::NotFinite { what: "target" });
    let axis = AxisLine { p: bad, q: 0.0, y0: 0.0, z0: 0.0 };
    let measured = PartPose { axis, x_ref: 0.0 };
    let refusal = plan_alignment(&arrangement(), &Pair::default(), &measured, &PoseTarget::axis(axis), 1.0);
    assert_eq!(refusal, Err(MotionRefusal::NotFinite { what: "measured pose" }));
    assert_eq!(check_path(&arrangement(), &from, &path()), Err(MotionRefusal::NotFinite { what: "positions" }));
    let mut path = path();
    path.waypoints[1].targets.m1.x = f64::INFINITY;
    assert_eq!(checked(&path), MotionRefusal::NotFinite { what: "path" });
}

#[test]
fn a_travel_too_long_for_the_strain_limit_is_refused() {
    let mut delicate = arrangement();
    delicate.strain_max_mm = 0.001;
    let refusal = plan_move(&delicate, &Pair::default(), &both(Axes { x: Some(10.0), ..Axes::default() }), 1.0);
    assert_eq!(refusal, Err(MotionRefusal::PathTooLong { max_count: 4096 }));
    let mut long = path();
    let last = long.waypoints[long.waypoints.len() - 1];
    long.waypoints.resize(4097, last);
    assert_eq!(checked(&long), MotionRefusal::PathTooLong { max_count: 4096 });
}

#[test]
fn a_path_is_stale_when_an_axis_has_moved_and_only_then() {
    let mut actual = Pair::<Position>::default();
    actual.m2.c = 1.9e-4;
    assert_eq!(check_path(&arrangement(), &actual, &path()), Ok(()));
    actual.m2.c = -3e-4;
    let truth =
        MotionRefusal::Stale { carrier: Carrier::M2, axis: Axis::C, actual: (-3e-4f64).to_degrees(), planned: 0.0 };
    assert_eq!(check_path(&arrangement(), &actual, &path()), Err(truth));
}

#[test]
fn the_check_does_not_rely_on_an_earlier_one() {
    let spoilt = |change: &dyn Fn(&mut Arrangement)| {
        let mut arrangement = arrangement();
        change(&mut arrangement);
        check_path(&arrangement, &Pair::default(), &path()).expect_err("must be refused")
    };
    let refusal = spoilt(&|a| a.supports.m2.limits.y.upper = 29.0);
    assert!(matches!(refusal, MotionRefusal::OutOfLimits { carrier: Carrier::M2, axis: Axis::Y, .. }), "{refusal}");
    let refusal = spoilt(&|a| a.supports.m2.limits.y.step = 29.0);
    assert!(matches!(refusal, MotionRefusal::StepTooLarge { carrier: Carrier::M2, .. }), "{refusal}");
    let refusal = spoilt(&|a| a.supports.m1.limits.y.speed = 1.0);
    assert!(
        matches!(refusal, MotionRefusal::TooFast { carrier: Carrier::M1, axis: Axis::Y, max: 1.0, .. }),
        "{refusal}"
    );
    let refusal = spoilt(&|a| a.strain_max_mm = 0.05);
    assert!(matches!(refusal, MotionRefusal::PathTooCoarse { waypoint: 1, unit: "mm", max: 0.05, .. }), "{refusal}");
    let refusal = spoilt(&|a| a.strain_max_mm = f64::NAN);
    assert!(matches!(refusal, MotionRefusal::Arrangement(_)), "{refusal}");
}

#[test]
fn a_path_from_another_source_is_malformed() {
    let fault = |change: &dyn Fn(&mut Path)| {
        let mut path = path();
        change(&mut path);
        match checked(&path) {
            MotionRefusal::PathMalformed { waypoint, fault } => (waypoint, fault),
            other => panic!("{other}"),
        }
    };
    assert_eq!(fault(&|path| path.waypoints.clear()), (0, PathFault::TooFew));
    assert_eq!(fault(&|path| path.waypoints.truncate(1)), (0, PathFault::TooFew));
    assert_eq!(fault(&|path| path.waypoints[0].at_s = 0.1), (0, PathFault::TimesDoNotRise));
    assert_eq!(fault(&|path| path.waypoints[1].at_s = 0.0), (1, PathFault::TimesDoNotRise));
    assert_eq!(fault(&|path| path.waypoints[1].at_s = f64::NAN), (1, PathFault::TimesDoNotRise));
    assert_eq!(fault(&|path| path.waypoints[1].speeds.m1.y *= 1.1), (1, PathFault::SpeedsDoNotFit));
    assert_eq!(fault(&|path| path.waypoints[1].speeds.m1.x = 1.0), (1, PathFault::SpeedsDoNotFit));
    assert_eq!(fault(&|path| path.waypoints[1].speeds.m1.x = f64::NAN), (1, PathFault::SpeedsDoNotFit));
    assert_eq!(fault(&|path| path.waypoints[0].speeds.m2.z = 1.0), (0, PathFault::SpeedsDoNotFit));
    assert_eq!(fault(&|path| path.moves.m2 = false), (1, PathFault::MovesWhatStays));
}

#[test]
fn an_invalid_arrangement_is_refused_with_its_field() {
    let field = |change: &dyn Fn(&mut Arrangement)| {
        let mut arrangement = arrangement();
        change(&mut arrangement);
        match arrangement.check().expect_err("must be refused") {
            ArrangementError::OutOfRange { field, .. } | ArrangementError::LimitsReversed { field, .. } => field,
        }
    };
    assert_eq!(arrangement().check(), Ok(()));
    assert_eq!(field(&|a| a.strain_max_mm = 0.0), "strain_max");
    assert_eq!(field(&|a| a.twist_max = -1.0), "twist_max");
    assert_eq!(field(&|a| a.clearance_min_mm = f64::INFINITY), "clearance_min");
    assert_eq!(field(&|a| a.settle_tolerance.z = 0.0), "settle_tolerance.z");
    assert_eq!(field(&|a| a.supports.m2.mount_mm[1] = f64::NAN), "supports.m2.mount.y");
    assert_eq!(field(&|a| a.supports.m1.half_span_mm = -1.0), "supports.m1.half_span");
    assert_eq!(field(&|a| a.supports.m1.limits.c.speed = 0.0), "supports.m1.limits.c.speed");
    assert_eq!(field(&|a| a.supports.m1.limits.x.acceleration = 0.0), "supports.m1.limits.x.acceleration");
    assert_eq!(field(&|a| a.supports.m1.limits.x.jerk = f64::NAN), "supports.m1.limits.x.jerk");
    assert_eq!(field(&|a| a.supports.m2.limits.y.step = 0.0), "supports.m2.limits.y.step");
    assert_eq!(field(&|a| a.supports.m2.limits.y.lower = 80.0), "supports.m2.limits.y");
}

/// Arbitrary numbers, often enough plausible ones.
fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::MAX),
        Just(-f64::MAX),
        Just(f64::MIN_POSITIVE),
        Just(0.0),
        -2.0..2.0,
        -100.0..100.0
    ]
}

fn any_positions() -> impl Strategy<Value = Pair<Position>> {
    let one = || (numbers(), numbers(), numbers(), numbers()).prop_map(|(x, y, z, c)| at(x, y, z, c));
    (one(), one()).prop_map(|(m1, m2)| Pair { m1, m2 })
}

fn any_arrangements() -> impl Strategy<Value = Arrangement> {
    (proptest::collection::vec(numbers(), 12), 0..4u8).prop_map(|(n, spoilt)| {
        let mut a = arrangement();
        if spoilt > 0 {
            (a.strain_max_mm, a.twist_max, a.clearance_min_mm) = (n[0], n[1], n[2]);
        }
        if spoilt > 1 {
            (a.supports.m1.mount_mm[0], a.supports.m2.half_span_mm, a.settle_tolerance.y) = (n[3], n[4], n[5]);
        }
        if spoilt > 2 {
            a.supports.m1.limits.x =
                AxisLimits { lower: n[6], upper: n[7], speed: n[8], acceleration: n[9], jerk: n[10], step: n[11] };
        }
        a
    })
}

proptest! {
    #![proptest_config(fixed())]

    #[test]
    fn invalid_requests_are_refused_and_planned_paths_pass(
        arrangement in any_arrangements(),
        from in prop_oneof![any_positions(), positions()],
        to in prop_oneof![any_positions(), positions()],
        n in proptest::collection::vec(numbers(), 11),
        share in prop_oneof![numbers(), 0.0..1.0],
    ) {
        let line = |i: usize| AxisLine { p: n[i], q: n[i + 1], y0: n[i + 2], z0: n[i + 3] };
        let measured = PartPose { axis: line(0), x_ref: n[4] };
        let target = PoseTarget { axis: line(5), axial_shift: n[9], roll: n[10] };
        let plans = [
            plan_alignment(&arrangement, &from, &measured, &target, share),
            plan_move(&arrangement, &from, &to.map(|_, axes| Some(axes.map(|_, value| Some(*value)))), share),
        ];
        for plan in plans {
            match plan {
                Ok(plan) => prop_assert_eq!(check_path(&arrangement, &from, &plan.path), Ok(())),
                // Formatting the refusal must not panic either.
                Err(refusal) => prop_assert!(!refusal.to_string().is_empty()),
            }
        }
        let _ = carried(&arrangement, &from, &to, &measured.axis);
    }

    #[test]
    fn a_path_of_invalid_numbers_is_refused(
        places in proptest::collection::vec((numbers(), any_positions(), any_positions()), 0..4),
        actual in any_positions(),
    ) {
        let waypoints = places.into_iter().map(|(at_s, targets, speeds)| Waypoint { at_s, targets, speeds }).collect();
        let path = Path { waypoints, moves: Pair { m1: true, m2: true } };
        prop_assert!(check_path(&arrangement(), &actual, &path).is_err());
    }
}
