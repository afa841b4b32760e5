//! From a cloud to profiles: into the rail frame, cut to a region, told apart by a rule, in order of x.
//!
//! ```text
//! Cloud --frame--> Cloud --region--> Cloud --choose--> key of each stripe --group--> Scan
//! ```
//!
//! Without a rule asked for, the first that fits decides:
//!
//! | rule | where |
//! |---|---|
//! | `column` | the file has a profile column, and its labels separate profiles: x differs more from label to label than within one |
//! | `row` | it is organised in rows, and x varies along every row by at most a tenth of the usual step between rows |
//! | `x_value` | x takes few values, eight points or more for each on average; or the cloud has less than 1000 points |
//! | `x_pitch_mm` | else; slabs of about a hundred points, their thickness the next 1, 2, 2.5 or 5·10ⁿ mm below |

mod choose;
mod group;
mod place;

pub use place::{Region, RegionError};

use super::cloud::Cloud;
use super::decode::Limits;
use super::lattice;
use super::rule::ProfileRule;
use super::{Grouping, Scan, ScanError};
use crate::geometry::{Frame, FrameError};

/// What a caller asks for.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SliceRequest {
    /// How profiles are told apart; `None` chooses.
    pub rule: Option<ProfileRule>,
    /// The rail frame in the cloud's coordinates; `None` where they are one.
    pub frame: Option<Frame>,
    /// What is kept, in the rail frame; `None` keeps all.
    pub region: Option<Region>,
}

/// Why a cloud does not become profiles.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SliceError {
    /// The declared frame is none.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A point lies too far from the origin of the frame.
    #[error(
        "in the declared frame point {index} has a coordinate of {value} mm, beyond ±{limit} mm (coordinate_max_mm); check the frame and the unit"
    )]
    CoordinateOutOfRange {
        /// Its position among the points, from 0.
        index: usize,
        /// The coordinate, mm.
        value: f64,
        /// The limit, mm.
        limit: f64,
    },
    /// No point lies in the region.
    #[error("none of the {points} points lies in the region; check the region, the frame and the unit")]
    RegionEmpty {
        /// Points of the cloud.
        points: usize,
    },
    /// A profile column was asked for that the cloud has not.
    #[error(
        "profiles cannot be told apart by {wanted}: the profile column is {found}; name it when decoding, or use another rule"
    )]
    NoColumn {
        /// What was asked for.
        wanted: String,
        /// What the cloud has.
        found: String,
    },
    /// Rows were asked for and the cloud has none.
    #[error("the points are not organised in rows; use column, x_value or x_pitch_mm")]
    NoRows,
    /// A thickness that is none.
    #[error("x_pitch_mm must be a number above 0, e.g. x_pitch_mm=0.5")]
    PitchInvalid,
    /// A thickness that makes too many slabs.
    #[error("x_pitch_mm={pitch} makes {slabs} slabs, at most {limit} are allowed; use at least {least}")]
    PitchTooSmall {
        /// The thickness, mm.
        pitch: f64,
        /// The slabs it makes.
        slabs: f64,
        /// Most profiles.
        limit: usize,
        /// A thickness that does, mm.
        least: f64,
    },
    /// More profiles than allowed.
    #[error("the scan has more than {limit} profiles; use x_pitch_mm with a larger pitch, or raise the limit")]
    TooManyProfiles {
        /// Most profiles.
        limit: usize,
    },
    /// A profile of more points than allowed.
    #[error(
        "the profile at x = {x} mm has {found} points, at most {limit} are allowed; use another rule or raise the limit"
    )]
    ProfileTooLong {
        /// Its plane, mm.
        x: f64,
        /// Its points.
        found: usize,
        /// Most points.
        limit: usize,
    },
    /// The cloud breaks its promise.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

impl SliceError {
    /// A stable name of the reason, at most 32 characters.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::Frame(_) => "frame_invalid",
            Self::CoordinateOutOfRange { .. } => "coordinate_out_of_range",
            Self::RegionEmpty { .. } => "region_empty",
            Self::NoColumn { .. } => "no_profile_column",
            Self::NoRows => "no_rows",
            Self::PitchInvalid => "pitch_invalid",
            Self::PitchTooSmall { .. } => "pitch_too_small",
            Self::TooManyProfiles { .. } => "too_many_profiles",
            Self::ProfileTooLong { .. } => "profile_too_long",
            Self::Scan(_) => "scan_invalid",
        }
    }
}

/// Cuts a cloud into profiles. Every point keeps its own x; the points of a profile keep the file's order.
///
/// # Errors
/// [`SliceError`] where the request does not fit the cloud, or the result is beyond `limits`.
pub fn slice(cloud: Cloud, request: &SliceRequest, limits: &Limits) -> Result<Scan, SliceError> {
    let mut cloud = cloud;
    let mut lattice = lattice::steps(&cloud);
    if let Some(frame) = &request.frame {
        cloud = place::move_into(&cloud, frame, limits.coordinate_max_mm)?;
        lattice = frame.steps(lattice);
    }
    if let Some(region) = &request.region {
        cloud = place::cut_to(&cloud, region)?;
    }
    let (key, rule) = choose::choose_key(&cloud, request.rule.as_ref(), limits)?;
    let grouping = match (&request.rule, choose::grouping(&cloud)) {
        (None, grouping) => grouping,
        // Slabs of a file that is ordered in profiles hold whole ones.
        (Some(ProfileRule::XPitch(_)), Grouping::SharedX | Grouping::Slabs | Grouping::Chosen) => Grouping::Slabs,
        (Some(_), _) => Grouping::Given,
    };
    Ok(group::group(cloud, key, rule, limits)?.with_grouping(grouping).with_lattice(lattice))
}

#[cfg(test)]
mod tests;
