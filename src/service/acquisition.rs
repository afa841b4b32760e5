//! When a scan was taken, in terms that no clock on the wall changes: how often something had moved by then, how long this instance
//! had run, and where the manipulators were. Goes into the record of what is measured from the scan.

use crate::motion::{Axis, Carrier, Pair, Position};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// When a scan was taken, or arrived as a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Acquisition {
    /// The instance of the service; the other numbers say nothing to another one.
    pub instance_id: String,
    /// How often something had moved the part by then.
    pub motions_count: u64,
    /// How long the instance had run, ms.
    pub uptime_ms: u64,
    /// The time of the clock, for people.
    pub at: Timestamp,
    /// Where the manipulators were, where that was known; mm, rad.
    pub positions: Option<Pair<Position>>,
}

/// Why a plan, or a pose, no longer holds.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stale {
    /// The pose is too old.
    #[error("the part was scanned {age_s} s ago, and holds for {max_s} s; measure again")]
    TooOld {
        /// Since it was measured.
        age_s: u64,
        /// How long a pose holds.
        max_s: u64,
    },
    /// Something was moved since the measurement.
    #[error("something was moved since the part was measured; measure again")]
    MovedSince,
    /// The service was restarted since, and does not know what was moved meanwhile.
    #[error("the service was restarted since the part was measured; measure again")]
    Restarted,
    /// A manipulator is not where it was when the part was measured.
    #[error(
        "axis {} of {} was at {then:.3} {unit} when the part was measured, and is at {now:.3} {unit}; measure again",
        axis.name(), carrier.name(), unit = axis.unit()
    )]
    Displaced {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it was; mm or degrees.
        then: f64,
        /// Where it is; mm or degrees.
        now: f64,
    },
}
