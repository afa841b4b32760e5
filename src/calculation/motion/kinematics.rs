//! Kinematics of the part between the two clamps: forward ([`carried`]) and inverse ([`clamps_for`]). Exact, without linearisation.
//!
//! A clamp's centre in the rail frame is mount + (x, y, z). The part is rigid; each clamp acts on it like a constant-velocity
//! joint: the part can tilt in it, and turns by c. So the pose of the part follows from the positions of the axes alone:
//!
//! ```text
//! u         = (P2 - P1) / |P2 - P1|              direction of the line through the clamps' centres
//! A(u, c)   = T(X, u) Rx(c)                      rotation of the part; T(a, b) is the least rotation that maps a to b
//! P -> M' + A(u', c') A(u, c)^T (P - M)          M the middle of the clamps; c the mean of the two turns
//! ```
//!
//! The part's axis need not lie on the clamps' line: its offset and direction relative to that line remain constant.
//!
//! Inverse: the motion moves the part's axis to the target by the least rotation, rolls it about the target and shifts it
//! along it, R = R(b, roll) T(a, b), and carries the clamps' centres with it. That both turns change by
//! φ = angle of T(X, u')^T R T(X, u) about X makes A(u', c + φ) A(u, c)^T = R. φ is the roll, but for a term of second order
//! in the tilts (the area of the triangle X, u, u' on the sphere, as in a Foucault pendulum).

use super::arrangement::{Arrangement, Support};
use super::axes::{Carrier, Pair, Position};
use crate::geometry::AxisLine;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// A part's axis, and the plane across the rail that contains its reference point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartPose {
    /// The axis.
    pub axis: AxisLine,
    /// The plane of the reference point; mm.
    pub x_ref: f64,
}

/// The target pose of a part.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseTarget {
    /// The target axis. The reference point keeps its x, except for the shift.
    pub axis: AxisLine,
    /// Shift along the target axis, towards +X; mm.
    pub axial_shift: f64,
    /// Rotation about the target axis, from +Y towards +Z, in addition to the least rotation between the axes; rad.
    pub roll: f64,
}

impl PoseTarget {
    /// This axis, without shift or roll.
    #[must_use]
    pub const fn axis(axis: AxisLine) -> Self {
        Self { axis, axial_shift: 0.0, roll: 0.0 }
    }
}

/// The part's axis, initially `axis_before`, after the axes have moved from `before` to `after`.
///
/// If the distance of the clamps changes, the part follows their middle; if the turns differ, it follows their mean. The slopes are
/// not finite for a line that no longer crosses the planes across the rail because the clamps are above one another or in the same
/// position.
#[must_use]
pub fn carried(
    arrangement: &Arrangement,
    before: &Pair<Position>,
    after: &Pair<Position>,
    axis_before: &AxisLine,
) -> AxisLine {
    let (here, there) = (ClampLine::new(arrangement, before), ClampLine::new(arrangement, after));
    let turn = there.attitude(mean_turn(after)) * here.attitude(mean_turn(before)).transpose();
    let [y, z] = axis_before.at(here.middle.x);
    let point = there.middle + turn * (Vector3::new(here.middle.x, y, z) - here.middle);
    let direction = turn * Vector3::from(axis_before.direction());
    AxisLine::through(point.into(), direction.y / direction.x, direction.z / direction.x)
}

/// The targets of the axes that move the part from `measured` to `target`, and the position of its reference point there.
pub(super) fn clamps_for(
    arrangement: &Arrangement,
    from: &Pair<Position>,
    measured: &PartPose,
    target: &PoseTarget,
) -> (Pair<Position>, PartPose) {
    let (a, b) = (Vector3::from(measured.axis.direction()), Vector3::from(target.axis.direction()));
    let rotation = turn_about(&b, target.roll) * least_rotation(&a, &b);
    let here = on(&measured.axis, measured.x_ref);
    let there = on(&target.axis, measured.x_ref) + b * target.axial_shift;
    let mut to = Pair::from_fn(|carrier| {
        let support = arrangement.supports.get(carrier);
        let centre = there + rotation * (clamp_centre(support, from.get(carrier)) - here);
        at_centre(support, &centre, from.get(carrier).c)
    });
    let (before, after) = (ClampLine::new(arrangement, from), ClampLine::new(arrangement, &to));
    let left = after.attitude(0.0).transpose() * rotation * before.attitude(0.0) * Vector3::y();
    // The same rotation, counted so that it is nearest to the requested roll, full turns included.
    let turned = target.roll + nearest_turn(left.z.atan2(left.y) - target.roll);
    for carrier in Carrier::ALL {
        to.get_mut(carrier).c += turned;
    }
    (to, PartPose { axis: target.axis, x_ref: there.x })
}

/// Position of the clamp's centre in the rail frame.
pub(super) fn clamp_centre(support: &Support, position: &Position) -> Vector3<f64> {
    Vector3::from(support.mount_mm) + Vector3::new(position.x, position.y, position.z)
}

/// Positions of the axes for a position of the clamp's centre.
pub(super) fn at_centre(support: &Support, centre: &Vector3<f64>, c: f64) -> Position {
    let way = centre - Vector3::from(support.mount_mm);
    Position { x: way.x, y: way.y, z: way.z, c }
}

/// The line through the centres of the two clamps.
#[derive(Debug, Clone, Copy)]
pub(super) struct ClampLine {
    pub(super) middle: Vector3<f64>,
    /// Unit vector from m1 to m2; not finite if the two coincide.
    pub(super) direction: Vector3<f64>,
    pub(super) distance: f64,
}

impl ClampLine {
    pub(super) fn new(arrangement: &Arrangement, at: &Pair<Position>) -> Self {
        let centres = arrangement.supports.map(|carrier, support| clamp_centre(support, at.get(carrier)));
        let between = centres.m2 - centres.m1;
        let distance = between.norm();
        Self { middle: centres.m1 + between * 0.5, direction: between / distance, distance }
    }

    /// Rotation of the part between the clamps.
    fn attitude(&self, c: f64) -> Matrix3<f64> {
        least_rotation(&Vector3::x(), &self.direction) * turn_about(&Vector3::x(), c)
    }
}

fn mean_turn(at: &Pair<Position>) -> f64 {
    0.5 * (at.m1.c + at.m2.c)
}

fn on(axis: &AxisLine, x: f64) -> Vector3<f64> {
    let [y, z] = axis.at(x);
    Vector3::new(x, y, z)
}

/// The least rotation that maps the unit vector `a` to the unit vector `b`: I + [v] + [v]²/(1 + a·b) with v = a × b. Not finite for
/// opposite vectors, for which it is not unique.
fn least_rotation(a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let v = a.cross(b).cross_matrix();
    Matrix3::identity() + v + v * v / (1.0 + a.dot(b))
}

/// The rotation by `angle` about a unit vector (Rodrigues).
fn turn_about(unit: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let k = unit.cross_matrix();
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity() + k * sin + k * k * (1.0 - cos)
}

/// The same angle between -π and π.
fn nearest_turn(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}
