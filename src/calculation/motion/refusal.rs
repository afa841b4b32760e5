//! Why a motion is not planned or not executed, in the terms of an operator. Values are in mm and degrees, so that messages and
//! documents agree. Requests are never adjusted to make them feasible.

use super::arrangement::ArrangementError;
use super::axes::{Axis, Carrier};

/// Why a motion is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionRefusal {
    /// An axis would leave its limits, at the end or before.
    #[error(
        "axis {a} of {m} would go to {value} {u}, outside its limits of {lower} to {upper} {u}",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        value = short(*value), lower = short(*lower), upper = short(*upper)
    )]
    OutOfLimits {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Its target; mm or degrees.
        value: f64,
        /// Its lower limit; mm or degrees.
        lower: f64,
        /// Its upper limit; mm or degrees.
        upper: f64,
    },
    /// An axis is already outside its limits.
    #[error(
        "axis {a} of {m} is at {actual} {u}, outside its limits of {lower} to {upper} {u}; move it back from its panel",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        lower = short(*lower), upper = short(*upper), actual = short(*actual)
    )]
    StandsOutside {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Its position; mm or degrees.
        actual: f64,
        /// Its lower limit; mm or degrees.
        lower: f64,
        /// Its upper limit; mm or degrees.
        upper: f64,
    },
    /// The travel of an axis exceeds the limit of one request.
    #[error(
        "axis {a} of {m} would travel {travel} {u} in one request, at most {max} {u} are allowed; move in shorter steps",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        travel = short(*travel), max = short(*max)
    )]
    StepTooLarge {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// The travel in either direction; mm or degrees.
        travel: f64,
        /// The limit; mm or degrees.
        max: f64,
    },
    /// An axis would exceed its speed limit.
    #[error(
        "axis {a} of {m} would move at {speed} {u}/s, at most {max} {u}/s are allowed",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        max = short(*max), speed = short(*speed)
    )]
    TooFast {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// The speed; mm/s or deg/s.
        speed: f64,
        /// The limit; mm/s or deg/s.
        max: f64,
    },
    /// The run-on of a manipulator after an axis has stuck would exceed its limit.
    #[error(
        "if an axis stuck, {m} would run on by {run_on} {unit}, at most {max} {unit} are allowed; move more slowly",
        m = carrier.name(), run_on = short(*run_on), max = short(*max)
    )]
    RunsOn {
        /// The manipulator.
        carrier: Carrier,
        /// The run-on; mm or degrees.
        run_on: f64,
        /// The limit; mm or degrees.
        max: f64,
        /// mm or deg.
        unit: &'static str,
    },
    /// The share of the greatest speed is out of range.
    #[error("the share of the greatest speed is {share}; it must be from {min} to 1", share = short(*share))]
    ShareOutOfRange {
        /// The requested value.
        share: f64,
        /// The least allowed share.
        min: f64,
    },
    /// The bodies of the manipulators would come too near to each other.
    #[error(
        "the clearance of the two manipulators along x would be {gap_mm} mm, at least {min_mm} mm are required",
        gap_mm = short(*gap_mm), min_mm = short(*min_mm)
    )]
    SpansMeet {
        /// The remaining clearance; below zero if they would overlap.
        gap_mm: f64,
        /// The required clearance.
        min_mm: f64,
    },
    /// The part would be stretched or compressed.
    #[error(
        "the distance of the clamps would change by {strain_mm} mm, at most {max_mm} mm are allowed; move both together",
        strain_mm = short(*strain_mm), max_mm = short(*max_mm)
    )]
    StrainTooLarge {
        /// Largest change along the path.
        strain_mm: f64,
        /// The limit.
        max_mm: f64,
    },
    /// The part would be twisted.
    #[error(
        "the clamps would twist the part by {twist_deg} deg, at most {max_deg} deg are allowed; turn both together",
        twist_deg = short(*twist_deg), max_deg = short(*max_deg)
    )]
    TwistTooLarge {
        /// Largest change of the difference of the two turns along the path.
        twist_deg: f64,
        /// The limit.
        max_deg: f64,
    },
    /// Every axis is at its target, or nothing was requested.
    #[error("nothing would move: every axis is within its tolerance of its target")]
    NothingToMove,
    /// A number is not finite, or too large for the calculation.
    #[error("{what}: a number is not finite or too large")]
    NotFinite {
        /// The input: "positions", "measured pose", "target".
        what: &'static str,
    },
    /// The path would exceed the largest number of waypoints; the travel is too long for the strain limit of the part.
    #[error("the path needs more than {max_count} waypoints; move in shorter steps")]
    PathTooLong {
        /// The largest number of waypoints.
        max_count: usize,
    },
    /// Between two waypoints an axis that arrives late would strain or twist the part too much.
    #[error(
        "before waypoint {waypoint}, an axis ahead of another could strain the part by {lead} {unit}; {max} {unit} are allowed",
        max = short(*max), lead = short(*lead)
    )]
    PathTooCoarse {
        /// The later one of the two; the first is 0.
        waypoint: usize,
        /// The excess; mm or degrees.
        lead: f64,
        /// The limit; mm or degrees.
        max: f64,
        /// mm or deg.
        unit: &'static str,
    },
    /// The path was not planned by this module.
    #[error("the path is malformed at waypoint {waypoint}: {fault}")]
    PathMalformed {
        /// Index of the waypoint; the first is 0.
        waypoint: usize,
        /// The fault.
        fault: PathFault,
    },
    /// The path does not start at the position of the axis: something has moved since it was planned.
    #[error(
        "axis {a} of {m} is at {actual} {u}, but the path starts at {planned} {u}; the path is stale, plan again",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        actual = short(*actual), planned = short(*planned)
    )]
    Stale {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Its position; mm or degrees.
        actual: f64,
        /// The start of the path; mm or degrees.
        planned: f64,
    },
    /// The arrangement is invalid.
    #[error(transparent)]
    Arrangement(#[from] ArrangementError),
}

/// A fault of a waypoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PathFault {
    /// A single waypoint is not a path.
    #[error("a path needs at least two waypoints")]
    TooFew,
    /// The times do not increase, or the path does not start at 0 s.
    #[error("times must start at 0 and increase")]
    TimesDoNotRise,
    /// The axes would not arrive together.
    #[error("the speeds do not match the distances and times")]
    SpeedsDoNotFit,
    /// A manipulator that should not move has a waypoint elsewhere.
    #[error("a manipulator that does not move has a target elsewhere")]
    MovesWhatStays,
}

/// Rounds a number for a message: digits beyond the fourth decimal are artefacts of the calculation.
fn short(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
