//! When a scan was taken, in terms that no clock on the wall changes: how often something had moved by then, how long this instance
//! had run, and where the manipulators were. Goes into the record of what is measured from the scan.

use super::Service;
use super::plans::Stale;
use crate::motion::{Axis, Carrier, Pair, Position};
use crate::service::side::CellSide;
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

impl Service {
    /// This moment.
    pub(super) fn acquisition_now(&self) -> Acquisition {
        Acquisition {
            instance_id: self.instance_id.clone(),
            motions_count: self.cell.as_ref().map_or(0, CellSide::motions_count),
            uptime_ms: self.uptime.elapsed_ms(),
            at: self.clock.now(),
            positions: self.cell.as_ref().and_then(CellSide::positions),
        }
    }

    /// Refuses a pose from before a restart, from before the end of the last motion, or from too long ago.
    pub(super) fn check_fresh(&self, side: &CellSide, taken: Option<&Acquisition>) -> Result<(), Stale> {
        // Records of earlier versions do not say; they are from before a restart.
        let Some(taken) = taken.filter(|taken| taken.instance_id == self.instance_id) else {
            return Err(Stale::Restarted);
        };
        if taken.motions_count != side.motions_count() {
            return Err(Stale::MovedSince);
        }
        let age_ms = self.uptime.elapsed_ms().saturating_sub(taken.uptime_ms);
        let max_s = side.config.plan_age_max_s;
        if age_ms > max_s.saturating_mul(1000) {
            return Err(Stale::TooOld { age_s: age_ms / 1000, max_s });
        }
        Ok(())
    }
}

impl Acquisition {
    /// Refuses where a manipulator is elsewhere than at that time, whoever moved it.
    pub(super) fn check_in_place(&self, side: &CellSide, now: &Pair<Position>) -> Result<(), Stale> {
        let Some(then) = &self.positions else { return Ok(()) };
        for carrier in Carrier::ALL {
            for axis in Axis::ALL {
                let (then, now) = (*then.get(carrier).get(axis), *now.get(carrier).get(axis));
                if (then - now).abs() > *side.arrangement.settle_tolerance.get(axis) {
                    let (then, now) = (axis.outside(then), axis.outside(now));
                    return Err(Stale::Displaced { carrier, axis, then, now });
                }
            }
        }
        Ok(())
    }
}
