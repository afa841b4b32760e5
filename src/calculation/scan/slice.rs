//! From a cloud to profiles: into the rail frame, cut to a region, separated by a rule, in order of x.
//!
//! ```text
//! Cloud --frame--> Cloud --region--> Cloud --choose--> key of each stripe --group--> Scan
//! ```
//!
//! Without a requested rule, the first that applies is used:
//!
//! | rule | condition |
//! |---|---|
//! | `column` | the file has a profile column, and its labels separate profiles: x differs more from label to label than within one |
//! | `row` | the file is organised in rows, and x varies along every row by at most a tenth of the usual step between rows |
//! | `x_value` | x takes few values, eight points or more for each on average; or the cloud has less than 1000 points |
//! | `x_pitch_mm` | otherwise; slabs of about a hundred points, their thickness the next 1, 2, 2.5 or 5·10ⁿ mm below |

use super::cloud::{self, Cloud};
use super::decode::Limits;
use super::rule::ProfileRule;
use super::{Grouping, Scan};
use crate::geometry::Frame;
mod error;
mod place;
mod profiles;

pub use error::SliceError;
pub use place::{Region, RegionError};

/// The request of a caller.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SliceRequest {
    /// The rule that separates profiles; `None` chooses one.
    pub rule: Option<ProfileRule>,
    /// The rail frame in the cloud's coordinates; `None` if these are the rail frame.
    pub frame: Option<Frame>,
    /// The region that is retained, in the rail frame; `None` retains all.
    pub region: Option<Region>,
}

/// Divides a cloud into profiles. Every point keeps its own x; the points of a profile keep the file's order.
///
/// # Errors
/// [`SliceError`] if the request does not fit the cloud, or the result exceeds `limits`.
pub fn slice(cloud: Cloud, request: &SliceRequest, limits: &Limits) -> Result<Scan, SliceError> {
    let mut cloud = cloud;
    let mut lattice = cloud::steps(&cloud);
    if let Some(frame) = &request.frame {
        cloud = place::move_into(&cloud, frame, limits.coordinate_max_mm)?;
        lattice = frame.steps(lattice);
    }
    if let Some(region) = &request.region {
        cloud = place::cut_to(&cloud, region)?;
    }
    let (key, rule) = profiles::choose_key(&cloud, request.rule.as_ref(), limits)?;
    let grouping = match (&request.rule, profiles::grouping(&cloud)) {
        (None, grouping) => grouping,
        // Slabs of a file that is ordered by profiles contain complete profiles.
        (Some(ProfileRule::XPitch(_)), Grouping::SharedX | Grouping::Slabs | Grouping::Chosen) => Grouping::Slabs,
        (Some(_), _) => Grouping::Given,
    };
    Ok(profiles::group(cloud, key, rule, limits)?.with_grouping(grouping).with_lattice(lattice))
}

#[cfg(test)]
mod tests;
