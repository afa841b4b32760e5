//! Why a motion is not planned or not executed, in the words of an operator. Values are in mm and degrees,
//! so that messages and documents agree. Nothing was changed to make it fit.

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
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it would go; mm or degrees.
        value: f64,
        /// Its lower limit; mm or degrees.
        lower: f64,
        /// Its upper limit; mm or degrees.
        upper: f64,
    },
    /// An axis is outside its limits already.
    #[error(
        "axis {a} of {m} stands at {actual} {u}, outside its limits of {lower} to {upper} {u}; bring it back at its panel",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        lower = short(*lower), upper = short(*upper), actual = short(*actual)
    )]
    StandsOutside {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it is; mm or degrees.
        actual: f64,
        /// Its lower limit; mm or degrees.
        lower: f64,
        /// Its upper limit; mm or degrees.
        upper: f64,
    },
    /// An axis would go further than one request may ask for.
    #[error(
        "axis {a} of {m} would go {travel} {u} at once, and {max} {u} are allowed; go in shorter steps",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        travel = short(*travel), max = short(*max)
    )]
    StepTooLarge {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// How far, whichever way; mm or degrees.
        travel: f64,
        /// How far it may; mm or degrees.
        max: f64,
    },
    /// An axis would be faster than it may.
    #[error(
        "axis {a} of {m} would move at {speed} {u}/s, and {max} {u}/s are allowed",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        max = short(*max), speed = short(*speed)
    )]
    TooFast {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// How fast; mm/s or deg/s.
        speed: f64,
        /// How fast it may; mm/s or deg/s.
        max: f64,
    },
    /// A manipulator would go on too far after an axis had stuck.
    #[error(
        "after an axis had stuck, {m} would run on by {run_on} {unit}, and {max} {unit} are allowed; move more slowly",
        m = carrier.name(), run_on = short(*run_on), max = short(*max)
    )]
    RunsOn {
        /// Which.
        carrier: Carrier,
        /// How far; mm or degrees.
        run_on: f64,
        /// How far it may; mm or degrees.
        max: f64,
        /// mm or deg.
        unit: &'static str,
    },
    /// The share of the greatest speed is no share.
    #[error("the share of the greatest speed is {share}; it must be from {min} to 1", share = short(*share))]
    ShareOutOfRange {
        /// The requested value.
        share: f64,
        /// The least that may be.
        min: f64,
    },
    /// The bodies of the manipulators would come too near to each other.
    #[error(
        "{gap_mm} mm would be left along x between the two manipulators, and at least {min_mm} mm must be",
        gap_mm = short(*gap_mm), min_mm = short(*min_mm)
    )]
    SpansMeet {
        /// The clearance that would be left; below zero where they would overlap.
        gap_mm: f64,
        /// The required clearance.
        min_mm: f64,
    },
    /// The part would be stretched or pressed.
    #[error(
        "the distance of the clamps would change by {strain_mm} mm, and {max_mm} mm are allowed; move both together",
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
        "the clamps would twist the part by {twist_deg} deg, and {max_deg} deg are allowed; turn both together",
        twist_deg = short(*twist_deg), max_deg = short(*max_deg)
    )]
    TwistTooLarge {
        /// Largest change of the difference of the two turns along the path.
        twist_deg: f64,
        /// The limit.
        max_deg: f64,
    },
    /// Every axis is where it should be, or nothing was requested.
    #[error("nothing would move: every axis is within its tolerance of where it should be")]
    NothingToMove,
    /// A number is none, or too large to calculate with.
    #[error("{what}: there is a number that is not finite or too large")]
    NotFinite {
        /// Where: "positions", "measured pose", "target".
        what: &'static str,
    },
    /// The path would have more waypoints than are kept; the travel is too long for the strain limit of the part.
    #[error("the path would take more than {max_count} waypoints; go in shorter steps")]
    PathTooLong {
        /// How many are allowed.
        max_count: usize,
    },
    /// Between two waypoints an axis that comes late would strain or twist the part too much.
    #[error(
        "before waypoint {waypoint}, an axis ahead of another could strain the part by {lead} {unit}; {max} {unit} are allowed",
        max = short(*max), lead = short(*lead)
    )]
    PathTooCoarse {
        /// The later one of the two; the first is 0.
        waypoint: usize,
        /// By how much; mm or degrees.
        lead: f64,
        /// The limit; mm or degrees.
        max: f64,
        /// mm or deg.
        unit: &'static str,
    },
    /// The path is not one that was planned here.
    #[error("the path is malformed at waypoint {waypoint}: {fault}")]
    PathMalformed {
        /// The first is 0.
        waypoint: usize,
        /// The fault.
        fault: PathFault,
    },
    /// The path does not start where the axis is: something has moved since it was planned.
    #[error(
        "axis {a} of {m} is at {actual} {u}, and the path starts at {planned} {u}; it is stale, plan again",
        a = axis.name(), m = carrier.name(), u = axis.unit(),
        actual = short(*actual), planned = short(*planned)
    )]
    Stale {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it is; mm or degrees.
        actual: f64,
        /// Where the path starts; mm or degrees.
        planned: f64,
    },
    /// The arrangement itself makes no sense.
    #[error(transparent)]
    Arrangement(#[from] ArrangementError),
}

/// A fault of a waypoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PathFault {
    /// A single waypoint is no path.
    #[error("a path needs at least two waypoints")]
    TooFew,
    /// Time stands still, or the path does not start at 0 s.
    #[error("times must start at 0 and rise")]
    TimesDoNotRise,
    /// The axes would not arrive together.
    #[error("the speeds do not fit ways and times")]
    SpeedsDoNotFit,
    /// A manipulator that should stay has a waypoint elsewhere.
    #[error("a manipulator that stays has a way to go")]
    MovesWhatStays,
}

/// A number as a person reads it: what lies behind the fourth digit behind the point is an artefact of calculating.
fn short(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
