//! From a request to a path, or to the reason for a refusal: [`plan_alignment`] for a part, [`plan_move`] for axes. Planning moves
//! nothing.
//!
//! The course is divided into set-points with times and speeds. The cell sends a set-point to both manipulators, waits until both
//! have reached it, and sends the next. So set-points cost time, and between them only the devices keep the axes synchronised. The
//! course is divided into the fewest even steps for which no order of arrival within a step strains or twists the part beyond its
//! limits, see [`super::strain`]: if one manipulator stops while the other finishes its step, the part stays within its limits.
//! Steps across the part are long (mm to cm), steps along it about as long as the allowed strain.

use super::arrangement::Arrangement;
use super::axes::{Axes, Axis, Carrier, Pair, Path, Position, Waypoint};
use super::check::{WAYPOINTS_MAX, burden, check_burden, check_gap, check_lead, check_target, each};
use super::course::{Course, Progress};
use super::kinematics::{ClampLine, PartPose, PoseTarget, carried, clamps_for};
use super::refusal::MotionRefusal;
use super::strain::{Step, slowed};
use serde::{Deserialize, Serialize};

/// Least share of the greatest speeds.
const SHARE_MIN: f64 = 1e-3;

/// The travel of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisTravel {
    /// Start; mm, or rad.
    pub from: f64,
    /// End; mm, or rad.
    pub to: f64,
    /// `to` - `from`; mm, or rad.
    pub travel: f64,
    /// Distance from its nearest limit at the end; mm, or rad. Below zero for an axis that stays outside its limits.
    pub margin: f64,
}

/// A planned path and its effect on the part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Each axis.
    pub axes: Pair<Axes<AxisTravel>>,
    /// Duration of the path, s, without the settling at every set-point.
    pub duration_s: f64,
    /// The set-points.
    pub path: Path,
    /// Largest change of the distance of the clamps along the path; mm.
    pub strain_mm: f64,
    /// Largest change of c1 - c2 along the path; rad.
    pub twist: f64,
    /// The part's axis and its reference point at the end. None for a move of axes, which has no part.
    pub predicted: Option<PartPose>,
}

/// Targets of a move of axes: absolute, mm or rad. An axis with None stays at its position.
pub type MoveTargets = Pair<Option<Axes<Option<f64>>>>;

/// Plans the motion that moves the part from `measured` to `target`, with the clamps at `from`.
///
/// `share` is the share of the axes' greatest speeds, from 0.001 to 1.
///
/// # Errors
/// Why the part cannot be moved there.
pub fn plan_alignment(
    arrangement: &Arrangement,
    from: &Pair<Position>,
    measured: &PartPose,
    target: &PoseTarget,
    share: f64,
) -> Result<Plan, MotionRefusal> {
    check_request(arrangement, from, share)?;
    let PartPose { axis, x_ref } = *measured;
    check_finite("measured pose", &[axis.p, axis.q, axis.y0, axis.z0, x_ref])?;
    let PoseTarget { axis, axial_shift, roll } = *target;
    check_finite("target", &[axis.p, axis.q, axis.y0, axis.z0, axial_shift, roll])?;
    check_clamps(arrangement, from)?;
    let (mut to, pose) = clamps_for(arrangement, from, measured, target);
    check_finite("target", &values(&to))?;
    spare_turns(arrangement, from, &mut to);
    let course = Course::rigid(arrangement, from, &to);
    let axis = carried(arrangement, from, &to, &measured.axis);
    plan(arrangement, &course, share, Some(PartPose { axis, ..pose }))
}

/// Plans a straight, synchronous move of axes to absolute targets. The part is assumed to be clamped by both manipulators.
///
/// `share` is the share of the axes' greatest speeds, from 0.001 to 1.
///
/// # Errors
/// Why the axes cannot be moved there.
pub fn plan_move(
    arrangement: &Arrangement,
    from: &Pair<Position>,
    targets: &MoveTargets,
    share: f64,
) -> Result<Plan, MotionRefusal> {
    check_request(arrangement, from, share)?;
    let to = from.map(|carrier, axes| {
        let wanted = targets.get(carrier).unwrap_or_default();
        axes.map(|axis, actual| wanted.get(axis).unwrap_or(*actual))
    });
    check_finite("target", &values(&to))?;
    let course = Course::straight(from, &to);
    check_ends(arrangement, &course)?;
    // Exact for straight courses, and more helpful than the refusal of a path that is too long.
    let (origin, whole) = (Step::new(arrangement, from, from), Step::new(arrangement, from, &to));
    check_burden(arrangement, &origin, &whole)?;
    plan(arrangement, &course, share, None)
}

/// Leaves the turns at their positions if a limit blocks them and they would move less than their tolerance: a part without a
/// requested roll must not be refused for a second-order term at the end of the travel of a turn. The prediction states the
/// remainder.
fn spare_turns(arrangement: &Arrangement, from: &Pair<Position>, to: &mut Pair<Position>) {
    let outside = |(carrier, at): (Carrier, &Position)| {
        let limits = arrangement.supports.get(carrier).limits.c;
        !(limits.lower..=limits.upper).contains(&at.c)
    };
    let small = (to.m1.c - from.m1.c).abs() <= arrangement.settle_tolerance.c;
    if small && to.iter().any(outside) {
        (to.m1.c, to.m2.c) = (from.m1.c, from.m2.c);
    }
}

fn plan(
    arrangement: &Arrangement,
    course: &Course,
    share: f64,
    predicted: Option<PartPose>,
) -> Result<Plan, MotionRefusal> {
    check_ends(arrangement, course)?;
    let path = cut(arrangement, course, share)?;
    let burden = burden(arrangement, &path)?;
    let (from, to) = (course.at(0.0), course.at(1.0));
    let axes = to.map(|carrier, axes| {
        axes.map(|axis, &to| {
            let (from, limits) = (*from.get(carrier).get(axis), arrangement.supports.get(carrier).limits.get(axis));
            AxisTravel { from, to, travel: to - from, margin: (to - limits.lower).min(limits.upper - to) }
        })
    });
    let duration_s = path.waypoints.last().map_or(0.0, |waypoint| waypoint.at_s);
    Ok(Plan { axes, duration_s, path, strain_mm: burden.strain_mm, twist: burden.twist, predicted })
}

fn check_request(arrangement: &Arrangement, from: &Pair<Position>, share: f64) -> Result<(), MotionRefusal> {
    arrangement.check()?;
    if !(SHARE_MIN..=1.0).contains(&share) {
        return Err(MotionRefusal::ShareOutOfRange { share, min: SHARE_MIN });
    }
    check_finite("positions", &values(from))
}

/// A part lies along the rail only if the clamps do.
fn check_clamps(arrangement: &Arrangement, from: &Pair<Position>) -> Result<(), MotionRefusal> {
    if ClampLine::new(arrangement, from).direction.x > 0.0 {
        return Ok(());
    }
    let (gap_mm, min_mm) = (Step::new(arrangement, from, from).gap(arrangement), arrangement.clearance_min_mm);
    Err(MotionRefusal::SpansMeet { gap_mm, min_mm })
}

/// Checks before the course is divided: whether it has a length, and whether its ends are allowed.
fn check_ends(arrangement: &Arrangement, course: &Course) -> Result<(), MotionRefusal> {
    let (from, to) = (course.at(0.0), course.at(1.0));
    let settled = |axis, way: f64| way.abs() <= *arrangement.settle_tolerance.get(axis);
    if each(&from).all(|(carrier, axis, start)| settled(axis, to.get(carrier).get(axis) - start)) {
        return Err(MotionRefusal::NothingToMove);
    }
    for (carrier, axis, start) in each(&from) {
        check_start(arrangement, course, (carrier, axis, start))?;
        if course.moves(carrier, axis) {
            let limits = arrangement.supports.get(carrier).limits.get(axis);
            check_target(carrier, axis, limits, start, *to.get(carrier).get(axis))?;
        }
    }
    let (origin, end) = (Step::new(arrangement, &from, &from), Step::new(arrangement, &to, &to));
    check_gap(arrangement, &origin, &end)
}

fn values(positions: &Pair<Position>) -> Vec<f64> {
    each(positions).map(|(.., value)| value).collect()
}

/// Numbers beyond 1e9 mm or rad are invalid, and their squares would lose significant digits.
fn check_finite(what: &'static str, numbers: &[f64]) -> Result<(), MotionRefusal> {
    if numbers.iter().all(|number| number.abs() < 1e9) { Ok(()) } else { Err(MotionRefusal::NotFinite { what }) }
}

/// The path along a course, at a share of the greatest speeds.
pub(super) fn cut(arrangement: &Arrangement, course: &Course, share: f64) -> Result<Path, MotionRefusal> {
    let steps_count = steps_count(arrangement, course)?;
    let limits = arrangement.supports.map(|_, support| support.limits);
    let progress = Progress::new(&slowed(arrangement, course, &course.pace(&limits, share)));
    let mut waypoints = Vec::with_capacity(steps_count + 1);
    let mut before = Waypoint { at_s: 0.0, targets: set_point(arrangement, course, 0.0), speeds: Pair::default() };
    waypoints.push(before);
    for index in 1..=steps_count {
        let s = share_of(index, steps_count);
        let (at_s, targets) = (progress.time_at(s), set_point(arrangement, course, s));
        let time = at_s - before.at_s;
        let speeds = targets.map(|carrier, axes| {
            axes.map(|axis, target| (target - before.targets.get(carrier).get(axis)).abs() / time)
        });
        before = Waypoint { at_s, targets, speeds };
        waypoints.push(before);
    }
    let moves = Pair::from_fn(|carrier| Axis::ALL.into_iter().any(|axis| course.moves(carrier, axis)));
    Ok(Path { waypoints, moves })
}

/// The fewest even steps that are fine enough, found by doubling and then by bisection.
fn steps_count(arrangement: &Arrangement, course: &Course) -> Result<usize, MotionRefusal> {
    let steps_max = WAYPOINTS_MAX - 1;
    let mut fine = 1;
    while !is_fine(arrangement, course, fine) {
        if fine == steps_max {
            return Err(MotionRefusal::PathTooLong { max_count: WAYPOINTS_MAX });
        }
        fine = (2 * fine).min(steps_max);
    }
    let mut coarse = fine / 2;
    while fine - coarse > 1 {
        let middle = usize::midpoint(coarse, fine);
        if is_fine(arrangement, course, middle) { fine = middle } else { coarse = middle }
    }
    Ok(fine)
}

fn is_fine(arrangement: &Arrangement, course: &Course, steps_count: usize) -> bool {
    let mut before = set_point(arrangement, course, 0.0);
    (1..=steps_count).all(|index| {
        let after = set_point(arrangement, course, share_of(index, steps_count));
        let step = Step::new(arrangement, &before, &after);
        before = after;
        check_lead(arrangement, &step, index).is_ok()
    })
}

/// Exactly 1 at the end.
fn share_of(index: usize, count: usize) -> f64 {
    index as f64 / count as f64
}

/// Positions of the axes at s. An axis beyond a limit by at most its tolerance starts from the limit.
fn set_point(arrangement: &Arrangement, course: &Course, s: f64) -> Pair<Position> {
    let (mut at, start) = (course.at(s), course.at(0.0));
    for (carrier, axis, from) in each(&start) {
        let limits = arrangement.supports.get(carrier).limits.get(axis);
        let value = at.get_mut(carrier).get_mut(axis);
        if (limits.lower..=limits.upper).contains(&from) || !course.moves(carrier, axis) {
            continue;
        }
        if (from..limits.lower).contains(value) {
            *value = limits.lower;
        } else if *value > limits.upper && *value <= from {
            *value = limits.upper;
        }
    }
    at
}

/// Refuses an axis that is to move and lies beyond a limit by more than its tolerance.
pub(super) fn check_start(
    arrangement: &Arrangement,
    course: &Course,
    (carrier, axis, actual): (Carrier, Axis, f64),
) -> Result<(), MotionRefusal> {
    let limits = arrangement.supports.get(carrier).limits.get(axis);
    let slack = *arrangement.settle_tolerance.get(axis);
    if !course.moves(carrier, axis) || (limits.lower - slack..=limits.upper + slack).contains(&actual) {
        return Ok(());
    }
    let (actual, lower, upper) = (axis.outside(actual), axis.outside(limits.lower), axis.outside(limits.upper));
    Err(MotionRefusal::StandsOutside { carrier, axis, actual, lower, upper })
}
