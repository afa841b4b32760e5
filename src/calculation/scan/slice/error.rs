//! Why a cloud cannot be divided into profiles: each variant is a reason with its numbers, and its message states what happened and
//! what to do.

use crate::geometry::FrameError;
use crate::scan::ScanError;

/// Why a cloud cannot be divided into profiles.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SliceError {
    /// The declared frame is invalid.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A point lies too far from the origin of the frame.
    #[error(
        "in the declared frame point {index} has a coordinate of {value} mm, beyond ±{limit} mm (coordinate_max_mm); check the frame and the unit"
    )]
    CoordinateOutOfRange {
        /// Index among the points, from 0.
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
    /// The requested profile column does not exist in the cloud.
    #[error(
        "profiles cannot be separated by {wanted}: the profile column is {found}; name it when decoding, or use another rule"
    )]
    NoColumn {
        /// The requested value.
        wanted: String,
        /// The column of the cloud.
        found: String,
    },
    /// Rows were requested and the cloud has none.
    #[error("the points are not organised in rows; use column, x_value or x_pitch_mm")]
    NoRows,
    /// The thickness is not a positive number.
    #[error("x_pitch_mm must be a number above 0, e.g. x_pitch_mm=0.5")]
    PitchInvalid,
    /// The thickness gives too many slabs.
    #[error("x_pitch_mm={pitch} makes {slabs} slabs, at most {limit} are allowed; use at least {least}")]
    PitchTooSmall {
        /// The thickness, mm.
        pitch: f64,
        /// The number of slabs.
        slabs: f64,
        /// Largest number of profiles.
        limit: usize,
        /// The least allowed thickness, mm.
        least: f64,
    },
    /// More profiles than allowed.
    #[error("the scan has more than {limit} profiles; use x_pitch_mm with a larger pitch, or raise the limit")]
    TooManyProfiles {
        /// Largest number of profiles.
        limit: usize,
    },
    /// A profile has more points than allowed.
    #[error(
        "the profile at x = {x} mm has {found} points, at most {limit} are allowed; use another rule or raise the limit"
    )]
    ProfileTooLong {
        /// Its plane, mm.
        x: f64,
        /// The number of its points.
        found: usize,
        /// Largest number of points.
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
