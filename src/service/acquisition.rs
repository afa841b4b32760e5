//! When a scan was taken, independent of changes to the wall clock: the number of motions before it, the uptime of the instance
//! and the positions of the manipulators. It is stored in the record of every measurement of the scan.

use crate::motion::{Axis, Carrier, Pair, Position};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// When a scan was taken, or arrived as a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Acquisition {
    /// The instance of the service; the other numbers are valid only within it.
    pub instance_id: String,
    /// Number of motions of the part before the scan.
    pub motions_count: u64,
    /// Uptime of the instance, ms.
    pub uptime_ms: u64,
    /// Wall-clock time, for information.
    pub at: Timestamp,
    /// Positions of the manipulators, if they were known; mm, rad.
    pub positions: Option<Pair<Position>>,
}

/// Why a plan or a pose is no longer valid.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stale {
    /// The pose is too old.
    #[error("the part was scanned {age_s} s ago, and its pose is valid for {max_s} s; measure again")]
    TooOld {
        /// Age of the scan.
        age_s: u64,
        /// How long a pose is valid.
        max_s: u64,
    },
    /// Something moved after the measurement.
    #[error("something was moved since the part was measured; measure again")]
    MovedSince,
    /// The service was restarted after the measurement and does not know what moved in between.
    #[error("the service was restarted since the part was measured; measure again")]
    Restarted,
    /// The position of a manipulator has changed since the measurement.
    #[error(
        "axis {} of {} was at {then:.3} {unit} when the part was measured, and is at {now:.3} {unit}; measure again",
        axis.name(), carrier.name(), unit = axis.unit()
    )]
    Displaced {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
        /// Its position at the measurement; mm or degrees.
        then: f64,
        /// Its position now; mm or degrees.
        now: f64,
    },
}
