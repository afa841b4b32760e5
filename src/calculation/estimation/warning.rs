//! Warnings to the user of a pose.

use super::settings::End;
use serde::{Deserialize, Serialize};

/// A warning to the user of a pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case", tag = "code")]
pub enum Warning {
    /// A free ellipse on a short arc is biased towards the sensor, and more profiles do not help.
    #[error(
        "the sections span {arc_deg:.0}°: below 120° a freely fitted ellipse is biased along the viewing direction, by about \
         the line fit_bias of the budget; the method cylinder is not biased"
    )]
    ShortArc {
        /// Median arc of the valid sections.
        arc_deg: f64,
    },
    /// The fitted radius differs from the nominal one.
    #[error("the fitted radius is {radius_mm:.3} mm, but the nominal radius is {nominal_radius_mm} mm")]
    RadiusDiffers {
        /// Fitted.
        radius_mm: f64,
        /// From the recipe.
        nominal_radius_mm: f64,
    },
    /// Many profiles have no points on the cylinder.
    #[error(
        "{elsewhere_count} of {profiles_count} profiles do not show this cylinder: if the scan shows several parts, or a part \
         of several diameters, declare which profiles belong together (parts), or restrict the region"
    )]
    OnSomeProfiles {
        /// Profiles without a point on it.
        elsewhere_count: usize,
        /// Profiles in the scan.
        profiles_count: usize,
    },
    /// A number in the file marks points that were not measured.
    #[error(
        "{count} of {points_count} points have {value} and are treated as missing data; if that is a measured value, declare the values \
         that mark missing points (missing_values, an empty list for none)"
    )]
    MissingValues {
        /// The value that the points have in common, in the unit of the file.
        value: String,
        /// Points that have it.
        count: u64,
        /// Points of the file.
        points_count: u64,
    },
    /// Profiles that are a copy of an earlier one.
    #[error(
        "{repeated_count} of {profiles_count} profiles repeat an earlier profile bit for bit and are left out: a sensor never \
         measures the same noise twice, so check whether the export writes profiles twice or the sensor delivers old data"
    )]
    RepeatedProfiles {
        /// Profiles that were left out.
        repeated_count: u64,
        /// Profiles of the file.
        profiles_count: u64,
    },
    /// The axis does not lie along the rail.
    #[error(
        "the axis lies {angle_deg:.1}° from X, farther than the {tilt_max_deg}° of an axis along the rail (tilt_max_deg): deflection, \
         pitch, y_c0 and z_c0 are then of little use, so use the axis; if it should lie along X, check the frame and the order of the \
         columns"
    )]
    AxisNotAlongRail {
        /// Between the axis and X.
        angle_deg: f64,
        /// Largest angle of an axis along the rail.
        tilt_max_deg: f64,
    },
    /// The arc opens towards the sensor.
    #[error(
        "the arc opens towards the sensor (+Z): the scan shows the inside of a pipe, or an axis of the coordinates is mirrored; if \
         the outside of the part was scanned, check the sign of z"
    )]
    ConcaveTowardsSensor,
    /// The radius changes along the part.
    #[error(
        "the part is tapered by {taper_deg:.4}°: its radius changes by {radius_change_mm:+.3} mm over the scan. A cylinder fit takes \
         part of that for tilt, by about the line form of the budget"
    )]
    Tapered {
        /// Half of the cone's angle, positive if the radius grows along x.
        taper_deg: f64,
        /// Change from the first profile to the last.
        radius_change_mm: f64,
    },
    /// The axis is not a straight line.
    #[error(
        "the part, or the travel of the stage, is bent: the axis is {sagitta_mm:.3} mm off a straight line between middle and \
         ends; the pose is that of the straight line that fits best"
    )]
    Bent {
        /// Deviation of the middle of the scan from the straight line through its ends.
        sagitta_mm: f64,
    },
    /// The method neither re-weights nor rejects.
    #[error("section_line_plain does not reject clamps and holes; use it for comparison only")]
    NotRobust,
    /// No standard uncertainty from calibration is stated.
    #[error(
        "the stated uncertainty covers only what the scan itself shows (repeatability): the straightness of the stage, the \
         linearity and the mounting of the sensor and the temperature are not included. State them as type_b in the recipe or the \
         configuration"
    )]
    CalibrationNotStated,
    /// A requested end face was not observed in the scan.
    #[error(
        "the {} end face was not found: the scan must extend beyond that end of the part, by two profiles or more that show the \
         background or are kept although they are empty, part of the edge must be free of clamps, no two profiles in a row may be \
         lost, and the axis must be accurate enough to determine where the surface ends; a cloud without profiles has no end \
         faces unless profile_by and frame are declared",
        .end.name()
    )]
    EndFaceNotSeen {
        /// The end.
        end: End,
    },
}

impl Warning {
    /// The stable name of the warning.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::ShortArc { .. } => "short_arc",
            Self::RadiusDiffers { .. } => "radius_differs",
            Self::OnSomeProfiles { .. } => "on_some_profiles",
            Self::MissingValues { .. } => "missing_values",
            Self::RepeatedProfiles { .. } => "repeated_profiles",
            Self::AxisNotAlongRail { .. } => "axis_not_along_rail",
            Self::ConcaveTowardsSensor => "concave_towards_sensor",
            Self::Tapered { .. } => "tapered",
            Self::Bent { .. } => "bent",
            Self::NotRobust => "not_robust",
            Self::CalibrationNotStated => "calibration_not_stated",
            Self::EndFaceNotSeen { .. } => "end_face_not_seen",
        }
    }
}
