//! Why a cloud does not become profiles: each variant a reason with its numbers, each text what happened and what to do.

use crate::geometry::FrameError;
use crate::scan::ScanError;

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
        "profiles cannot be separated by {wanted}: the profile column is {found}; name it when decoding, or use another rule"
    )]
    NoColumn {
        /// The requested value.
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
    /// The cloud is not valid.
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
