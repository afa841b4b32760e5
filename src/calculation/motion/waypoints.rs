//! Cuts a course into set-points with times and speeds.
//!
//! The cell sends a set-point to both manipulators, waits until both are there, and sends the next. So set-points cost time,
//! and between them nobody but the devices sees to it that the axes go together. The course is cut into the fewest even steps
//! such that within a step no order of arrival strains or twists the part beyond its limits, see [`super::strain`]: if one
//! manipulator stops dead while the other finishes its step, the part bears it. Steps across the part come out long (mm to
//! cm), steps along it about as long as the strain allowed.

use super::arrangement::Arrangement;
use super::axes::{Axis, Carrier, Pair, Path, Position, Waypoint};
use super::check::{WAYPOINTS_MAX, check_lead, each};
use super::course::Course;
use super::progress::Progress;
use super::refusal::MotionRefusal;
use super::run_on::slowed;
use super::strain::Step;

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

/// The fewest even steps that are fine enough: doubled until they are, then halved between.
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

/// Where the axes are at s. One that stands beyond a limit by what an axis may be off its place starts from the limit.
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

/// Refuses an axis that is to move and stands beyond a limit by more than it may be off its place.
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
