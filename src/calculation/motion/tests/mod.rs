//! Tests of the module: the arrangement and the random requests that they use, and the kinematics compared with the rigid motion
//! calculated in another way: quaternions, distances, areas on the sphere.

mod paths;
mod refusals;

use super::*;
use crate::geometry::AxisLine;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The same cases on every run.
pub(super) fn fixed() -> ProptestConfig {
    ProptestConfig { rng_seed: RngSeed::Fixed(19), failure_persistence: None, ..ProptestConfig::default() }
}

/// Two manipulators a metre apart, with typical axes.
pub(super) fn arrangement() -> Arrangement {
    let linear =
        |half: f64| AxisLimits { lower: -half, upper: half, speed: 10.0, acceleration: 40.0, jerk: 400.0, step: 60.0 };
    let turn = AxisLimits { lower: -3.0, upper: 3.0, speed: 0.1, acceleration: 0.4, jerk: 4.0, step: 2.0 };
    let limits = Axes { x: linear(100.0), y: linear(80.0), z: linear(80.0), c: turn };
    let support = |x| Support { mount_mm: [x, 12.0, -340.0], limits, half_span_mm: 150.0 };
    Arrangement {
        supports: Pair { m1: support(300.0), m2: support(1300.0) },
        strain_max_mm: 0.2,
        // So large that it slows nothing down; `run_on` has separate tests.
        run_on_max_mm: 1000.0,
        twist_max: 0.01,
        clearance_min_mm: 400.0,
        settle_tolerance: Axes { x: 0.02, y: 0.02, z: 0.02, c: 2e-4 },
    }
}

pub(super) fn at(x: f64, y: f64, z: f64, c: f64) -> Position {
    Position { x, y, z, c }
}

/// The centre of a clamp, calculated independently.
pub(super) fn centre(arrangement: &Arrangement, carrier: Carrier, position: &Position) -> Vector3<f64> {
    let [x, y, z] = arrangement.supports.get(carrier).mount_mm;
    Vector3::new(x + position.x, y + position.y, z + position.z)
}

/// |P2 - P1|.
pub(super) fn distance(arrangement: &Arrangement, at: &Pair<Position>) -> f64 {
    (centre(arrangement, Carrier::M2, &at.m2) - centre(arrangement, Carrier::M1, &at.m1)).norm()
}

/// The line through the clamps' centres as an axis.
pub(super) fn clamps_axis(arrangement: &Arrangement, at: &Pair<Position>) -> AxisLine {
    let from = centre(arrangement, Carrier::M1, &at.m1);
    let way = centre(arrangement, Carrier::M2, &at.m2) - from;
    AxisLine::through(from.into(), way.y / way.x, way.z / way.x)
}

/// Largest distance between two lines in the planes at the ends of a part, mm.
pub(super) fn apart(a: &AxisLine, b: &AxisLine) -> f64 {
    [0.0, 1600.0]
        .map(|x| {
            let ([ay, az], [by, bz]) = (a.at(x), b.at(x));
            (ay - by).hypot(az - bz)
        })
        .into_iter()
        .fold(0.0, f64::max)
}

/// Clamps somewhere in the middle of their travel.
pub(super) fn positions() -> impl Strategy<Value = Pair<Position>> {
    let one = || (-20.0..20.0, -20.0..20.0, -20.0..20.0, -0.5..0.5).prop_map(|(x, y, z, c)| at(x, y, z, c));
    (one(), one()).prop_map(|(m1, m2)| Pair { m1, m2 })
}

/// A request for an alignment: the positions of the clamps, the measured pose (its axis near the clamps' line, not on it), and the
/// target.
#[derive(Debug, Clone)]
pub(super) struct Wish {
    pub(super) from: Pair<Position>,
    pub(super) measured: PartPose,
    pub(super) target: PoseTarget,
}

pub(super) fn wishes() -> impl Strategy<Value = Wish> {
    let line = (-0.01..0.01, -0.01..0.01, -3.0..3.0, -3.0..3.0);
    let target = (-0.03..0.03, -0.03..0.03, -15.0..15.0, -15.0..15.0, -10.0..10.0, -0.8..0.8);
    (positions(), line, target, 0.0..1600.0).prop_map(|(from, (dp, dq, dy, dz), (p, q, y, z, shift, roll), x_ref)| {
        let clamps = clamps_axis(&arrangement(), &from);
        let [cy, cz] = clamps.at(800.0);
        let axis = AxisLine::through([800.0, cy + dy, cz + dz], clamps.p + dp, clamps.q + dq);
        let wanted = AxisLine::through([800.0, 12.0 + y, -340.0 + z], p, q);
        let target = PoseTarget { axis: wanted, axial_shift: shift, roll };
        Wish { from, measured: PartPose { axis, x_ref }, target }
    })
}

/// The plan; the ranges of [`wishes`] ensure that it is allowed.
pub(super) fn planned(wish: &Wish, share: f64) -> Plan {
    plan_alignment(&arrangement(), &wish.from, &wish.measured, &wish.target, share).expect("allowed")
}

/// Rounding of coordinates of a few metres through a dozen operations.
const EXACT_MM: f64 = 1e-9;

fn ends(plan: &Plan) -> (Pair<Position>, Pair<Position>) {
    (plan.axes.map(|_, axes| axes.map(|_, axis| axis.from)), plan.axes.map(|_, axes| axes.map(|_, axis| axis.to)))
}

fn point(axis: &AxisLine, x: f64) -> Vector3<f64> {
    let [y, z] = axis.at(x);
    Vector3::new(x, y, z)
}

proptest! {
    #![proptest_config(fixed())]

    #[test]
    fn the_targets_put_the_parts_axis_on_the_target_axis(wish in wishes()) {
        let plan = planned(&wish, 1.0);
        let (from, to) = ends(&plan);
        let carried = carried(&arrangement(), &from, &to, &wish.measured.axis);
        prop_assert!(apart(&carried, &wish.target.axis) < EXACT_MM, "{} mm", apart(&carried, &wish.target.axis));
        let predicted = plan.predicted.expect("an alignment predicts");
        prop_assert!(apart(&predicted.axis, &wish.target.axis) < EXACT_MM);
    }

    #[test]
    fn the_clamps_move_with_the_part_as_one_rigid_body(wish in wishes()) {
        let arrangement = arrangement();
        let (_, to) = ends(&planned(&wish, 1.0));
        let (a, b) = (Vector3::from(wish.measured.axis.direction()), Vector3::from(wish.target.axis.direction()));
        let roll = UnitQuaternion::from_axis_angle(&Unit::new_normalize(b), wish.target.roll);
        let turn = roll * UnitQuaternion::rotation_between(&a, &b).expect("not opposite");
        let x_ref = wish.measured.x_ref;
        let (here, there) = (point(&wish.measured.axis, x_ref), point(&wish.target.axis, x_ref) + b * wish.target.axial_shift);
        for carrier in Carrier::ALL {
            let truth = there + turn * (centre(&arrangement, carrier, wish.from.get(carrier)) - here);
            let ours = centre(&arrangement, carrier, to.get(carrier));
            prop_assert!((ours - truth).norm() < EXACT_MM, "{} mm", (ours - truth).norm());
        }
        // Both turn by the same angle, so the part is not twisted.
        prop_assert!(((to.m1.c - wish.from.m1.c) - (to.m2.c - wish.from.m2.c)).abs() < 1e-12);
    }

    #[test]
    fn the_pose_of_the_part_does_not_depend_on_the_path(a in positions(), b in positions(), c in positions(), wish in wishes()) {
        let arrangement = arrangement();
        let axis = wish.measured.axis;
        let at_once = carried(&arrangement, &a, &c, &axis);
        let by_the_way = carried(&arrangement, &b, &c, &carried(&arrangement, &a, &b, &axis));
        prop_assert!(apart(&at_once, &by_the_way) < EXACT_MM);
        let returned = carried(&arrangement, &c, &a, &at_once);
        prop_assert!(apart(&returned, &axis) < EXACT_MM);
    }

    #[test]
    fn a_part_on_the_clamps_line_remains_on_it(a in positions(), b in positions()) {
        let arrangement = arrangement();
        let carried = carried(&arrangement, &a, &b, &clamps_axis(&arrangement, &a));
        prop_assert!(apart(&carried, &clamps_axis(&arrangement, &b)) < EXACT_MM);
    }

    #[test]
    fn the_turn_is_the_roll_and_the_area_enclosed_by_the_axis(from in positions(), wish in wishes()) {
        let arrangement = arrangement();
        let axis = clamps_axis(&arrangement, &from);
        let measured = PartPose { axis, x_ref: 800.0 };
        let target = PoseTarget { axial_shift: 0.0, ..wish.target };
        let plan = plan_alignment(&arrangement, &from, &measured, &target, 1.0).expect("allowed");
        // Signed area of the spherical triangle X, u, u' (Eriksson 1990): tan(E/2) = det / (1 + sum of cosines).
        let (x, u, v) = (Vector3::x(), Vector3::from(axis.direction()), Vector3::from(target.axis.direction()));
        let area = 2.0 * (x.dot(&u.cross(&v))).atan2(1.0 + x.dot(&u) + u.dot(&v) + v.dot(&x));
        let turned = plan.axes.m1.c.travel;
        prop_assert!((turned - target.roll - area).abs() < 1e-12, "{turned} rad, {} + {area}", target.roll);
    }

    #[test]
    fn a_cell_mounted_elsewhere_plans_the_same_axes(wish in wishes(), by in [-900.0..900.0, -900.0..900.0, -900.0..900.0]) {
        let mut moved = arrangement();
        for carrier in Carrier::ALL {
            for (mount, by) in moved.supports.get_mut(carrier).mount_mm.iter_mut().zip(by) {
                *mount += by;
            }
        }
        let shifted = |axis: &AxisLine| {
            let [y, z] = axis.at(0.0);
            AxisLine::through([by[0], y + by[1], z + by[2]], axis.p, axis.q)
        };
        let measured = PartPose { axis: shifted(&wish.measured.axis), x_ref: wish.measured.x_ref + by[0] };
        let target = PoseTarget { axis: shifted(&wish.target.axis), ..wish.target };
        let there = plan_alignment(&moved, &wish.from, &measured, &target, 1.0).expect("allowed");
        same_travels(&ends(&planned(&wish, 1.0)).1, &ends(&there).1)?;
    }

    #[test]
    fn a_cell_mirrored_across_plans_mirrored_axes(wish in wishes()) {
        let mut mirrored = arrangement();
        for carrier in Carrier::ALL {
            mirrored.supports.get_mut(carrier).mount_mm[1] *= -1.0;
        }
        let flip = |axis: &AxisLine| AxisLine { p: -axis.p, y0: -axis.y0, ..*axis };
        let flipped = |at: &Position| Position { y: -at.y, c: -at.c, ..*at };
        let from = wish.from.map(|_, at| flipped(at));
        let measured = PartPose { axis: flip(&wish.measured.axis), ..wish.measured };
        let target = PoseTarget { axis: flip(&wish.target.axis), roll: -wish.target.roll, ..wish.target };
        let there = plan_alignment(&mirrored, &from, &measured, &target, 1.0).expect("allowed");
        let truth = ends(&planned(&wish, 1.0)).1.map(|_, at| flipped(at));
        same_travels(&truth, &ends(&there).1)?;
    }

    #[test]
    fn a_cell_viewed_from_the_other_end_plans_with_the_manipulators_exchanged(wish in wishes()) {
        let ours = arrangement();
        let mirror = |support: &Support| {
            let [x, y, z] = support.mount_mm;
            Support { mount_mm: [-x, y, z], ..*support }
        };
        let supports = Pair { m1: mirror(&ours.supports.m2), m2: mirror(&ours.supports.m1) };
        let seen = Arrangement { supports, ..ours };
        let flipped = |at: &Position| Position { x: -at.x, ..*at };
        let exchanged = |at: &Pair<Position>| Pair { m1: flipped(&at.m2), m2: flipped(&at.m1) };
        let flip = |axis: &AxisLine| AxisLine { p: -axis.p, q: -axis.q, ..*axis };
        let measured = PartPose { axis: flip(&wish.measured.axis), x_ref: -wish.measured.x_ref };
        let PoseTarget { axis, axial_shift, roll } = wish.target;
        let target = PoseTarget { axis: flip(&axis), axial_shift: -axial_shift, roll };
        let there = plan_alignment(&seen, &exchanged(&wish.from), &measured, &target, 1.0).expect("allowed");
        same_travels(&exchanged(&ends(&planned(&wish, 1.0)).1), &ends(&there).1)?;
    }
}

fn same_travels(truth: &Pair<Position>, ours: &Pair<Position>) -> Result<(), TestCaseError> {
    for (carrier, axes) in truth.iter() {
        for (axis, value) in axes.iter() {
            let other = ours.get(carrier).get(axis);
            prop_assert!((value - other).abs() < EXACT_MM, "{carrier:?} {axis:?}: {value}, {other}");
        }
    }
    Ok(())
}

#[test]
fn a_part_straight_along_the_rail_rolls_by_both_turns_and_shifts_by_both_x() {
    let from = Pair { m1: at(0.0, 0.0, 0.0, 0.1), m2: at(0.0, 0.0, 0.0, 0.1) };
    let axis = AxisLine { p: 0.0, q: 0.0, y0: 12.0, z0: -340.0 };
    let target = PoseTarget { axis, axial_shift: 4.0, roll: 0.25 };
    let plan = plan_alignment(&arrangement(), &from, &PartPose { axis, x_ref: 700.0 }, &target, 1.0).expect("allowed");
    for (_, axes) in plan.axes.iter() {
        assert!((axes.x.travel - 4.0).abs() < 1e-12 && (axes.c.travel - 0.25).abs() < 1e-12);
        assert_eq!((axes.y.travel, axes.z.travel), (0.0, 0.0));
        assert!((axes.x.margin - 96.0).abs() < 1e-12);
    }
    let predicted = plan.predicted.expect("an alignment predicts");
    assert!((predicted.x_ref - 704.0).abs() < 1e-12);
}

#[test]
fn a_quarter_turn_of_the_clamps_moves_a_part_beside_their_line_by_a_quarter_turn() {
    let arrangement = arrangement();
    let before = Pair::default();
    let after = Pair { m1: at(0.0, 0.0, 0.0, 1.5), m2: at(0.0, 0.0, 0.0, 1.5) };
    // The axis lies 2 mm towards +Y of the clamps' line and leans towards +Y: a rotation from +Y to +Z applies to both.
    let part = AxisLine { p: 0.01, q: 0.0, y0: 14.0, z0: -340.0 };
    let (sin, cos) = 1.5f64.sin_cos();
    let truth = AxisLine { p: 0.01 * cos, q: 0.01 * sin, y0: 12.0 + 2.0 * cos, z0: -340.0 + 2.0 * sin };
    assert!(apart(&carried(&arrangement, &before, &after, &part), &truth) < EXACT_MM);
}

#[test]
fn a_roll_beyond_half_a_turn_is_not_replaced_by_the_shorter_rotation() {
    let mut arrangement = arrangement();
    for carrier in Carrier::ALL {
        arrangement.supports.get_mut(carrier).limits.c.upper = 10.0;
        arrangement.supports.get_mut(carrier).limits.c.step = 10.0;
    }
    let axis = AxisLine { p: 0.0, q: 0.0, y0: 12.0, z0: -340.0 };
    let target = PoseTarget { roll: 5.0, ..PoseTarget::axis(axis) };
    let measured = PartPose { axis, x_ref: 0.0 };
    let plan = plan_alignment(&arrangement, &Pair::default(), &measured, &target, 1.0).expect("allowed");
    assert!((plan.axes.m2.c.travel - 5.0).abs() < 1e-12);
}
