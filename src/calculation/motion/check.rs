//! Checks whether a path may be executed. Every path is checked when it is planned, and again right before a command is sent to a
//! device: a path from the store, or one that was planned under other limits, is checked like a new one.

use super::arrangement::Arrangement;
use super::axes::{Axis, AxisLimits, Carrier, Pair, Path, Position, Waypoint};
use super::refusal::{MotionRefusal, PathFault};
use super::strain::{Step, check_run_on};

/// Most waypoints of a path.
pub(super) const WAYPOINTS_MAX: usize = 4096;
/// Allowance for rounding of a length, an angle, or a share.
const ROUNDING: f64 = 1e-9;

/// The strain of the part by a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Burden {
    /// Largest change of the distance of the clamps; mm.
    pub(super) strain_mm: f64,
    /// Largest change of c1 - c2; rad.
    pub(super) twist: f64,
}

/// Checks that the cell may execute the path now: it starts at the actual positions of the axes, within the settling tolerance, and
/// keeps limits, step caps, speeds, spans, strain and twist throughout.
///
/// # Errors
/// The first violation.
pub fn check_path(arrangement: &Arrangement, actual: &Pair<Position>, path: &Path) -> Result<(), MotionRefusal> {
    arrangement.check()?;
    burden(arrangement, path)?;
    let Some(first) = path.waypoints.first() else { return Err(malformed(0, PathFault::TooFew)) };
    for (carrier, axis, actual) in each(actual) {
        let planned = *first.targets.get(carrier).get(axis);
        let tolerance = *arrangement.settle_tolerance.get(axis) + ROUNDING;
        if !actual.is_finite() {
            return Err(MotionRefusal::NotFinite { what: "positions" });
        }
        if (actual - planned).abs() > tolerance {
            let (actual, planned) = (axis.outside(actual), axis.outside(planned));
            return Err(MotionRefusal::Stale { carrier, axis, actual, planned });
        }
    }
    Ok(())
}

/// Checks the path by itself, and returns the strain of the part.
pub(super) fn burden(arrangement: &Arrangement, path: &Path) -> Result<Burden, MotionRefusal> {
    let Some((first, rest)) = path.waypoints.split_first().filter(|(_, rest)| !rest.is_empty()) else {
        return Err(malformed(0, PathFault::TooFew));
    };
    if path.waypoints.len() > WAYPOINTS_MAX {
        return Err(MotionRefusal::PathTooLong { max_count: WAYPOINTS_MAX });
    }
    check_first(first)?;
    for (index, (before, after)) in path.waypoints.iter().zip(rest).enumerate() {
        check_times_and_speeds(index + 1, before, after, &path.moves)?;
    }
    let mut moves_any = false;
    for (carrier, axis, start) in each(&first.targets) {
        moves_any |= check_axis(arrangement, path, (carrier, axis, start))?;
    }
    if !moves_any {
        return Err(MotionRefusal::NothingToMove);
    }
    path.waypoints.iter().try_for_each(|waypoint| check_run_on(arrangement, &waypoint.speeds))?;
    check_steps(arrangement, path, first)
}

fn check_first(first: &Waypoint) -> Result<(), MotionRefusal> {
    if !each(&first.targets).all(|(.., target)| target.is_finite()) {
        return Err(MotionRefusal::NotFinite { what: "path" });
    }
    if first.at_s != 0.0 {
        return Err(malformed(0, PathFault::TimesDoNotRise));
    }
    if each(&first.speeds).any(|(.., speed)| speed != 0.0) {
        return Err(malformed(0, PathFault::SpeedsDoNotFit));
    }
    Ok(())
}

fn check_times_and_speeds(
    index: usize,
    before: &Waypoint,
    after: &Waypoint,
    moves: &Pair<bool>,
) -> Result<(), MotionRefusal> {
    if !each(&after.targets).all(|(.., target)| target.is_finite()) {
        return Err(MotionRefusal::NotFinite { what: "path" });
    }
    let time = after.at_s - before.at_s;
    if !(time > 0.0 && time.is_finite()) {
        return Err(malformed(index, PathFault::TimesDoNotRise));
    }
    for (carrier, axis, target) in each(&after.targets) {
        let way = (target - before.targets.get(carrier).get(axis)).abs();
        if way > 0.0 && !moves.get(carrier) {
            return Err(malformed(index, PathFault::MovesWhatStays));
        }
        let speed = *after.speeds.get(carrier).get(axis);
        let fits = speed >= 0.0 && (speed * time - way).abs() <= 1e-6 * way;
        if !fits {
            return Err(malformed(index, PathFault::SpeedsDoNotFit));
        }
    }
    Ok(())
}

/// Checks limits, step cap and speeds of one axis throughout. Returns whether it moves; an axis that stays needs no travel.
fn check_axis(
    arrangement: &Arrangement,
    path: &Path,
    (carrier, axis, start): (Carrier, Axis, f64),
) -> Result<bool, MotionRefusal> {
    let limits = arrangement.supports.get(carrier).limits.get(axis);
    let values = || path.waypoints.iter().map(|waypoint| *waypoint.targets.get(carrier).get(axis));
    if values().all(|value| value == start) {
        return Ok(false);
    }
    values().try_for_each(|value| check_target(carrier, axis, limits, start, value))?;
    for waypoint in &path.waypoints {
        let speed = *waypoint.speeds.get(carrier).get(axis);
        if speed > limits.speed {
            let (speed, max) = (axis.outside(speed), axis.outside(limits.speed));
            return Err(MotionRefusal::TooFast { carrier, axis, speed, max });
        }
    }
    Ok(true)
}

/// Whether an axis that starts at `start` may be sent to `value`.
pub(super) fn check_target(
    carrier: Carrier,
    axis: Axis,
    limits: &AxisLimits,
    start: f64,
    value: f64,
) -> Result<(), MotionRefusal> {
    let AxisLimits { lower, upper, step, .. } = *limits;
    if !(lower..=upper).contains(&value) {
        let (value, lower, upper) = (axis.outside(value), axis.outside(lower), axis.outside(upper));
        return Err(MotionRefusal::OutOfLimits { carrier, axis, value, lower, upper });
    }
    let travel = (value - start).abs();
    if travel > step + ROUNDING {
        let (travel, max) = (axis.outside(travel), axis.outside(step));
        return Err(MotionRefusal::StepTooLarge { carrier, axis, travel, max });
    }
    Ok(())
}

/// Spans, strain and twist, step by step.
fn check_steps(arrangement: &Arrangement, path: &Path, first: &Waypoint) -> Result<Burden, MotionRefusal> {
    let origin = Step::new(arrangement, &first.targets, &first.targets);
    let mut burden = Burden { strain_mm: 0.0, twist: 0.0 };
    for (index, (before, after)) in path.waypoints.iter().zip(path.waypoints.iter().skip(1)).enumerate() {
        let step = Step::new(arrangement, &before.targets, &after.targets);
        check_gap(arrangement, &origin, &step)?;
        let added = check_burden(arrangement, &origin, &step)?;
        burden.strain_mm = burden.strain_mm.max(added.strain_mm);
        burden.twist = burden.twist.max(added.twist);
        check_lead(arrangement, &step, index + 1)?;
    }
    Ok(burden)
}

/// Two manipulators that are already too near to each other may move apart.
pub(super) fn check_gap(arrangement: &Arrangement, origin: &Step, step: &Step) -> Result<(), MotionRefusal> {
    let (gap_mm, min_mm) = (step.gap(arrangement), arrangement.clearance_min_mm);
    if gap_mm >= min_mm.min(origin.gap(arrangement)) - ROUNDING {
        return Ok(());
    }
    Err(MotionRefusal::SpansMeet { gap_mm, min_mm })
}

pub(super) fn check_burden(arrangement: &Arrangement, origin: &Step, step: &Step) -> Result<Burden, MotionRefusal> {
    let strain_mm = step.distance().away_from(origin.distance().least);
    let twist = step.twist().away_from(origin.twist().least);
    if strain_mm > arrangement.strain_max_mm + ROUNDING {
        return Err(MotionRefusal::StrainTooLarge { strain_mm, max_mm: arrangement.strain_max_mm });
    }
    if twist > arrangement.twist_max + ROUNDING {
        let (twist_deg, max_deg) = (twist.to_degrees(), arrangement.twist_max.to_degrees());
        return Err(MotionRefusal::TwistTooLarge { twist_deg, max_deg });
    }
    Ok(Burden { strain_mm, twist })
}

/// Whether the part stays within its limits when axes arrive late.
pub(super) fn check_lead(arrangement: &Arrangement, step: &Step, waypoint: usize) -> Result<(), MotionRefusal> {
    let coarse = |axis: Axis, lead: f64, max: f64| MotionRefusal::PathTooCoarse {
        waypoint,
        lead: axis.outside(lead),
        max: axis.outside(max),
        unit: axis.unit(),
    };
    let (distance, turn) = (step.distance_lead(), step.twist_lead());
    if distance > arrangement.strain_max_mm + ROUNDING {
        return Err(coarse(Axis::X, distance, arrangement.strain_max_mm));
    }
    if turn > arrangement.twist_max + ROUNDING {
        return Err(coarse(Axis::C, turn, arrangement.twist_max));
    }
    Ok(())
}

/// Every axis of both.
pub(super) fn each(positions: &Pair<Position>) -> impl Iterator<Item = (Carrier, Axis, f64)> {
    positions.iter().flat_map(|(carrier, axes)| axes.iter().map(move |(axis, value)| (carrier, axis, *value)))
}

fn malformed(waypoint: usize, fault: PathFault) -> MotionRefusal {
    MotionRefusal::PathMalformed { waypoint, fault }
}
