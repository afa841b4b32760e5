//! What the room as a whole promises. Here: the arrangement that the tests stand on, and random requests to it.

mod carrying;
mod paths;
mod refusals;
mod run_on;

use super::*;
use crate::geometry::AxisLine;
use nalgebra::Vector3;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The same cases on every run.
pub(super) fn fixed() -> ProptestConfig {
    ProptestConfig { rng_seed: RngSeed::Fixed(19), failure_persistence: None, ..ProptestConfig::default() }
}

/// Two manipulators a metre apart, and axes as such manipulators have them.
pub(super) fn arrangement() -> Arrangement {
    let linear =
        |half: f64| AxisLimits { lower: -half, upper: half, speed: 10.0, acceleration: 40.0, jerk: 400.0, step: 60.0 };
    let turn = AxisLimits { lower: -3.0, upper: 3.0, speed: 0.1, acceleration: 0.4, jerk: 4.0, step: 2.0 };
    let limits = Axes { x: linear(100.0), y: linear(80.0), z: linear(80.0), c: turn };
    let support = |x| Support { mount_mm: [x, 12.0, -340.0], limits, half_span_mm: 150.0 };
    Arrangement {
        supports: Pair { m1: support(300.0), m2: support(1300.0) },
        strain_max_mm: 0.2,
        // So far that it slows down nothing; `run_on` has tests of its own.
        run_on_max_mm: 1000.0,
        twist_max: 0.01,
        clearance_min_mm: 400.0,
        settle_tolerance: Axes { x: 0.02, y: 0.02, z: 0.02, c: 2e-4 },
    }
}

pub(super) fn at(x: f64, y: f64, z: f64, c: f64) -> Position {
    Position { x, y, z, c }
}

/// Where a clamp's centre is, said once more.
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

/// Clamps somewhere in the middle of their ways.
pub(super) fn positions() -> impl Strategy<Value = Pair<Position>> {
    let one = || (-20.0..20.0, -20.0..20.0, -20.0..20.0, -0.5..0.5).prop_map(|(x, y, z, c)| at(x, y, z, c));
    (one(), one()).prop_map(|(m1, m2)| Pair { m1, m2 })
}

/// A request for an alignment: where the clamps are, the measured pose (its axis near the clamps' line, not on it), and the
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

/// Planned; the ranges of [`wishes`] are such that it is allowed.
pub(super) fn planned(wish: &Wish, share: f64) -> Plan {
    plan_alignment(&arrangement(), &wish.from, &wish.measured, &wish.target, share).expect("allowed")
}
