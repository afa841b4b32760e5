//! What an estimation returns: the pose or the reason why there is none, and what became of every profile.
//! Stored as it is; must not know how it is shown.

use super::{End, EndFaceRule, Method};
use crate::geometry::{Angle, AxisLine, SectionEllipse};
use serde::{Deserialize, Serialize};

/// The result of one estimation; a refusal is a result too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// How it was found.
    pub method: Method,
    /// The pose, or why there is none.
    pub outcome: Outcome,
    /// One entry a profile, in station order.
    pub profiles: Vec<Profile>,
    /// How well the geometry of the scan determines a pose.
    pub conditioning: Conditioning,
    /// How the points of the valid profiles lie about their sections, of all fitted ones where a pose rests on profiles of
    /// which none is valid; `None` where none serves.
    pub residuals: Option<Residuals>,
}

/// Accepted with a pose, or refused with a reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The pose is good to use.
    Accepted(Box<Pose>),
    /// No pose, and why.
    Refused(Refusal),
}

/// The pose of the part's axis in the rail frame. Roll cannot be seen by the scan and is absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The axis.
    pub axis: AxisLine,
    /// Mean x of the profiles used, mm: where the position is known best and nearly independent of the angles.
    pub x_ref: f64,
    /// Radius of the part, mm.
    pub radius: f64,
    /// Where the radius came from.
    pub radius_source: RadiusSource,
    /// How well the pose is known.
    pub uncertainty: Uncertainty,
    /// Where the axis meets the part's end planes, as far as that was asked for and seen.
    #[serde(default)]
    pub end_faces: EndFaces,
}

/// The end faces of a part.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EndFaces {
    /// What was asked for.
    pub asked: EndFaceRule,
    /// At the smaller x; `None` where it was not asked for or not seen.
    pub near: Option<EndFace>,
    /// At the larger x; `None` where it was not asked for or not seen.
    pub far: Option<EndFace>,
}

impl EndFaces {
    /// The one that was asked for; the near one where both were.
    #[must_use]
    pub fn asked_one(&self) -> Option<EndFace> {
        match self.asked {
            EndFaceRule::None => None,
            EndFaceRule::Near | EndFaceRule::Both => self.near,
            EndFaceRule::Far => self.far,
        }
    }

    /// The far one where both were asked for.
    #[must_use]
    pub fn other_one(&self) -> Option<EndFace> {
        self.far.filter(|_| self.asked == EndFaceRule::Both)
    }
}

/// Where the axis meets an end plane, which is square to it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EndFace {
    /// The point, mm.
    pub centre: [f64; 3],
    /// Standard uncertainty of its x, mm: of the plane's offset along the axis and of the pose together.
    pub x_standard: f64,
}

/// Where a radius came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RadiusSource {
    /// From the data alone.
    Fitted,
    /// As given.
    Nominal,
    /// From the data and what was known before.
    Prior,
}

/// Covariance of (deflection, pitch, y_ref, z_ref, radius) in radians and millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// The combined covariance matrix, rows and columns in the order above.
    pub covariance: [[f64; 5]; 5],
    /// What it is made of.
    pub budget: Vec<Component>,
}

/// One line of the uncertainty budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// What makes the result uncertain, e.g. `repeatability`.
    pub source: String,
    /// Standard uncertainties of (deflection, pitch, y_ref, z_ref, radius) in radians and millimetres.
    pub standard: [f64; 5],
}

/// What became of one profile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Its plane, mm.
    pub x: f64,
    /// Its number of points.
    pub points_count: usize,
    /// Why it was rejected; `None` where it is valid.
    pub rejected: Option<Reason>,
    /// Its fitted section; `None` where no ellipse could be had.
    pub section: Option<Section>,
    /// Distance of its centre from the axis, mm; `None` without a section or an axis.
    pub offset: Option<f64>,
}

/// The fitted section of a profile and how its points lie about it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// The ellipse.
    pub ellipse: SectionEllipse,
    /// Robust spread of the residuals, 1.4826 times their median absolute value, mm.
    pub sigma: f64,
    /// Share of the points nearer than ε.
    pub inlier_ratio: f64,
    /// Root mean square residual of the inner points, mm; 0 where there is none.
    pub rms: f64,
    /// Angle that the inner points span, seen from the centre.
    pub arc: Angle,
    /// Fits made.
    pub iterations_count: u32,
}

/// Why a profile takes no part in the pose. Exactly one each, the first that applies in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// It lies outside every part of the scan that was asked for or found.
    OutsideParts,
    /// Fewer points than `points_min`, or all in fewer than six places.
    TooFewPoints,
    /// No ellipse could be fitted.
    NotConverged,
    /// Too small a share of inner points.
    LowInlierRatio,
    /// The inner points span too small an arc; a straight line does, too.
    ArcTooShort,
    /// Its centre lies too far from the axis that the other profiles agree on.
    OffAxis,
}

impl Reason {
    /// All reasons, in the order in which they are looked for.
    pub const ALL: [Self; 6] = [
        Self::OutsideParts,
        Self::TooFewPoints,
        Self::NotConverged,
        Self::LowInlierRatio,
        Self::ArcTooShort,
        Self::OffAxis,
    ];

    /// The name used in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OutsideParts => "outside_parts",
            Self::TooFewPoints => "too_few_points",
            Self::NotConverged => "not_converged",
            Self::LowInlierRatio => "low_inlier_ratio",
            Self::ArcTooShort => "arc_too_short",
            Self::OffAxis => "off_axis",
        }
    }

    /// What to do where most profiles are rejected for this.
    fn advice(self, sigma_mm: Option<f64>, epsilon_mm: f64) -> String {
        match (self, sigma_mm) {
            (Self::OutsideParts, _) => "widen the windows of the parts".to_owned(),
            (Self::TooFewPoints, _) => {
                "lower points_min, or declare which points make a profile (profile_by)".to_owned()
            }
            (Self::NotConverged, _) => {
                "no section of a cylinder fits them; check unit, frame, region and which column is the height"
                    .to_owned()
            }
            (Self::LowInlierRatio, Some(sigma_mm)) => format!(
                "their points scatter by {sigma_mm:.3} mm about their sections where epsilon_mm is {epsilon_mm}; if that is the \
                 sensor's noise raise epsilon_mm, if it is interference use the method cylinder"
            ),
            (Self::LowInlierRatio, None) => "see the profiles".to_owned(),
            (Self::ArcTooShort, _) => {
                "show more of the section to the sensor, lower arc_min_deg, or use the method cylinder".to_owned()
            }
            (Self::OffAxis, _) => {
                "their centres lie on no common line; check the order of the profiles and x".to_owned()
            }
        }
    }
}

/// Why a scan has no pose, with the numbers that decided it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case", tag = "code")]
pub enum Refusal {
    /// Not enough profiles in the scan to define an axis.
    #[error(
        "the scan has {profiles_count} profile(s), an axis needs at least {profiles_min}; scan more of the part, or \
         declare how points belong to profiles (profile_by)"
    )]
    TooFewProfiles {
        /// Profiles in the scan.
        profiles_count: usize,
        /// Least number.
        profiles_min: u32,
    },
    /// Every point lies in the same place of its plane.
    #[error("all {points_count} points have the same y and z; check the export and its columns")]
    PointsIdentical {
        /// Points in the scan.
        points_count: usize,
    },
    /// Every profile is a straight line.
    #[error(
        "the points of every profile lie on a straight line, so there is no curvature to find an axis from; check which \
         column is the height, and that the part is in view"
    )]
    PointsCollinear {
        /// Profiles in the scan.
        profiles_count: usize,
    },
    /// Too few profiles passed.
    #[error(
        "only {valid_count} of {profiles_count} profiles are valid, {profiles_min} are needed; most were rejected as {}: {}",
        .most_common.name(), .most_common.advice(*.sigma_mm, *.epsilon_mm)
    )]
    TooFewValidProfiles {
        /// Profiles that passed.
        valid_count: usize,
        /// Profiles in the scan.
        profiles_count: usize,
        /// Least number.
        profiles_min: u32,
        /// What most of the others failed on.
        most_common: Reason,
        /// Median spread of the points about their sections, mm; `None` without a section.
        sigma_mm: Option<f64>,
        /// What counts as an inner point, mm.
        epsilon_mm: f64,
    },
    /// The valid profiles lie too close together to give a direction.
    #[error(
        "the valid profiles span {axial_length_mm:.3} mm along x, at least {axial_length_min_mm} mm are needed; scan a \
         longer piece of the part"
    )]
    AxialLengthTooShort {
        /// Span of the valid profiles.
        axial_length_mm: f64,
        /// Least span.
        axial_length_min_mm: f64,
    },
    /// The sections are not those of one cylinder.
    #[error(
        "the radii of the valid sections scatter by {radius_spread_mm:.3} mm about {radius_mm:.3} mm: they are not sections \
         of one cylinder; check the frame and the region, and that the rail is X"
    )]
    SectionsDisagree {
        /// Median radius.
        radius_mm: f64,
        /// Robust spread of the radii.
        radius_spread_mm: f64,
    },
    /// The sections are ellipses that their axis does not explain.
    #[error(
        "the sections are {axis_ratio:.3} times as long as wide where their axis explains {expected_ratio:.3}: the part is not \
         round, or its arc too short for its noise; scan a wider arc, or use the method cylinder"
    )]
    SectionsNotRound {
        /// Median of the longer over the shorter axis.
        axis_ratio: f64,
        /// The same of a cylinder about the fitted axis.
        expected_ratio: f64,
    },
    /// No cylinder that enough of the points lie on.
    #[error(
        "no cylinder{} was found that enough of the points lie on; check the unit, the frame and the region{}",
        .nominal_radius_mm.map_or_else(String::new, |radius| format!(" of about {radius} mm radius")),
        .nominal_radius_mm.map_or("", |_| ", and the nominal radius")
    )]
    NoCylinder {
        /// From the recipe.
        nominal_radius_mm: Option<f64>,
    },
    /// Two surfaces that could both be the part.
    #[error(
        "the scan could be a part of {radius_a_mm:.3} mm radius (on {:.0} % of the profiles) or one of {radius_b_mm:.3} mm \
         (on {:.0} %); say which by nominal_radius_mm", 100.0 * .coverage_a, 100.0 * .coverage_b
    )]
    TwoCylinders {
        /// Radius of the one.
        radius_a_mm: f64,
        /// Share of the profiles that show it.
        coverage_a: f64,
        /// Radius of the other.
        radius_b_mm: f64,
        /// Share of the profiles that show it.
        coverage_b: f64,
    },
    /// Layers close to the surface hide which of them it is.
    #[error(
        "{:.0} % of what lies within {reach_mm:.3} mm of the surface belongs to layers on it, so that nobody can tell the part \
         from them; take tape, clamp or dirt off, choose a region without it, or give nominal_radius_mm", 100.0 * .layer_ratio
    )]
    LayersUndecided {
        /// Share of the surface seen that lies in layers.
        layer_ratio: f64,
        /// How far from the surface was looked for layers.
        reach_mm: f64,
    },
    /// The data leave the pose open.
    #[error(
        "the data leave the pose open: standard uncertainties of {angle_deg:.4}° and {position_mm:.3} mm where {angle_max_deg}° \
         and {position_max_mm} mm are allowed; scan a longer or wider piece, or give the radius (radius: fixed or prior)"
    )]
    PoseUndetermined {
        /// The larger standard uncertainty of the two angles.
        angle_deg: f64,
        /// What is allowed.
        angle_max_deg: f64,
        /// The larger standard uncertainty of y_ref and z_ref.
        position_mm: f64,
        /// What is allowed.
        position_max_mm: f64,
    },
    /// Another number of parts than there must be.
    #[error(
        "{parts_count} part(s) were found by gaps of at least {gap_min_mm} mm where {} must be; a profile shows a part where a \
         fifth of its points lie on one arc of 15° or more. Change gap_min_mm, cut off with region what is no part, or declare windows",
        range_in_words(*.parts_min_count, *.parts_max_count)
    )]
    PartsCountDiffers {
        /// Parts found.
        parts_count: usize,
        /// Least number.
        parts_min_count: usize,
        /// Largest number.
        parts_max_count: usize,
        /// What divides two parts.
        gap_min_mm: f64,
    },
    /// A part's window holds nothing.
    #[error(
        "no profile lies between x = {x_min_mm} mm and {x_max_mm} mm; check the window of the part, the unit and the frame, and \
         that the scan reaches there"
    )]
    WindowEmpty {
        /// Least x of the window.
        x_min_mm: f64,
        /// Largest x of the window.
        x_max_mm: f64,
    },
}

fn range_in_words(least: usize, most: usize) -> String {
    if least == most { least.to_string() } else { format!("{least} to {most}") }
}

impl Refusal {
    /// The stable name of the reason.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::TooFewProfiles { .. } => "too_few_profiles",
            Self::PointsIdentical { .. } => "points_identical",
            Self::PointsCollinear { .. } => "points_collinear",
            Self::TooFewValidProfiles { .. } => "too_few_valid_profiles",
            Self::AxialLengthTooShort { .. } => "axial_length_too_short",
            Self::SectionsDisagree { .. } => "sections_disagree",
            Self::SectionsNotRound { .. } => "sections_not_round",
            Self::NoCylinder { .. } => "no_cylinder",
            Self::TwoCylinders { .. } => "two_cylinders",
            Self::LayersUndecided { .. } => "layers_undecided",
            Self::PoseUndetermined { .. } => "pose_undetermined",
            Self::PartsCountDiffers { .. } => "parts_count_differs",
            Self::WindowEmpty { .. } => "window_empty",
        }
    }
}

/// How well the geometry of the scan determines a pose, over the valid profiles (over all where none is valid).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditioning {
    /// Median arc of the sections; `None` where there is no section.
    pub arc: Option<Angle>,
    /// Span along x, mm.
    pub axial_length: f64,
    /// What makes the pose less certain than its numbers say.
    pub warnings: Vec<Warning>,
}

/// Something that a user of the pose should know.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case", tag = "code")]
pub enum Warning {
    /// A free ellipse on a short arc is biased towards the sensor, and more profiles do not help.
    #[error(
        "the sections span {arc_deg:.0}°: below 120° a freely fitted ellipse is pulled along the viewing direction, by about \
         what the line fit_bias of the budget says; the method cylinder is not"
    )]
    ShortArc {
        /// Median arc of the valid sections.
        arc_deg: f64,
    },
    /// The fitted radius is not the one that the drawing gives.
    #[error("the fitted radius is {radius_mm:.3} mm where {nominal_radius_mm} mm were expected")]
    RadiusDiffers {
        /// Fitted.
        radius_mm: f64,
        /// From the recipe.
        nominal_radius_mm: f64,
    },
    /// Many profiles show nothing of the cylinder that was found.
    #[error(
        "{elsewhere_count} of {profiles_count} profiles show nothing of this cylinder: if the scan shows several parts, or a part \
         of several diameters, say which profiles belong together (parts), or cut the region"
    )]
    OnSomeProfiles {
        /// Profiles without a point on it.
        elsewhere_count: usize,
        /// Profiles in the scan.
        profiles_count: usize,
    },
    /// The radius changes along the part.
    #[error(
        "the part is tapered by {taper_deg:.4}°: its radius changes by {radius_change_mm:+.3} mm over the scan. A cylinder fit takes \
         part of that for tilt, by about what the line form of the budget says"
    )]
    Tapered {
        /// Half of the cone's angle, positive where the radius grows along x.
        taper_deg: f64,
        /// From the first profile to the last.
        radius_change_mm: f64,
    },
    /// The axis is no straight line.
    #[error(
        "the part, or the travel of the stage, is bent: the axis is {sagitta_mm:.3} mm off a straight line between middle and \
         ends; the pose is that of the straight line that fits best"
    )]
    Bent {
        /// From the middle of the scan to its ends, against a straight line.
        sagitta_mm: f64,
    },
    /// The method neither re-weights nor rejects.
    #[error("section_line_plain follows every clamp and hole; it is for comparison only")]
    NotRobust,
    /// An end face was asked for that the scan does not show.
    #[error(
        "the {} end face is not seen: the scan must go on beyond that end of the part, by two profiles or more that show the \
         background or are kept though they are empty, and part of the edge must be free of clamps", .end.name()
    )]
    EndFaceNotSeen {
        /// Which.
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
            Self::Tapered { .. } => "tapered",
            Self::Bent { .. } => "bent",
            Self::NotRobust => "not_robust",
            Self::EndFaceNotSeen { .. } => "end_face_not_seen",
        }
    }
}

/// How the points of the valid profiles lie about their sections.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// Median of the sections' robust spreads, mm.
    pub sigma: f64,
    /// Share of inner points among all points of the valid profiles.
    pub inlier_ratio: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_was_kept_before_there_were_end_faces_is_read() {
        let text = r#"{"axis": {"p": 0.0, "q": 0.0, "y0": 1.0, "z0": 2.0}, "x_ref": 3.0, "radius": 4.0,
            "radius_source": "fitted", "uncertainty": {"covariance": [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]], "budget": []}}"#;
        let pose: Pose = serde_json::from_str(text).expect("an old row");
        assert_eq!(pose.end_faces, EndFaces::default());
    }
}
