//! What an estimation returns: the pose or the reason why there is none, and what became of every profile.
//! Stored as it is; must not know how it is shown.

use super::refusal::Refusal;
use super::section_cut::SectionCut;
use super::settings::{EndFaceRule, Method};
use super::warning::Warning;
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
    /// How the points were cut into sections square to the axis, where the scan gave none along it; axis, position and
    /// uncertainty are in the frame of the cut then, and else in the rail frame.
    #[serde(default)]
    pub cut: Option<SectionCut>,
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
    /// Uncertainty of its x, mm: of the plane's offset along the axis and of the pose together. Two of them hold 95.45 %,
    /// as two standard uncertainties do of a normal distribution; what the spacing leaves open is an even one, whose
    /// standard deviation is a fifth more than that.
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
    /// Degrees of freedom of the standard uncertainties in the order above, combined over the budget by Welch-Satterthwaite
    /// (JCGM 100, G.4); `None` where infinite, and in results that were stored without them. The covariance is already widened
    /// for them.
    #[serde(default)]
    pub effective_freedom: [Option<f64>; 5],
    /// The same for y and z where the axis meets x = 0.
    #[serde(default)]
    pub effective_freedom_at_origin: [Option<f64>; 2],
}

/// One line of the uncertainty budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// What makes the result uncertain, e.g. `repeatability`.
    pub source: String,
    /// Its covariance of (deflection, pitch, y_ref, z_ref, radius); `None` in records from before it was stored.
    #[serde(default)]
    pub covariance: Option<[[f64; 5]; 5]>,
    /// Standard uncertainties of (deflection, pitch, y_ref, z_ref, radius) in radians and millimetres.
    pub standard: [f64; 5],
    /// Standard uncertainties of y and z where the axis meets x = 0, mm; `None` in results that were stored without them.
    #[serde(default)]
    pub standard_at_origin: Option<[f64; 2]>,
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
    /// Root mean square residual of the inliers, mm; 0 where there is none.
    pub rms: f64,
    /// Angle that the inliers span, seen from the centre.
    pub arc: Angle,
    /// Fits made.
    pub iterations_count: u32,
}

/// Why a profile is not valid by itself. Exactly one each, the first that applies in this order. The methods by sections leave
/// such a profile out; `cylinder` takes what lies on the part from it all the same.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// It lies outside every part of the scan that was asked for or found.
    OutsideParts,
    /// Fewer points than `points_min`, or all in fewer than six places.
    TooFewPoints,
    /// No ellipse could be fitted.
    NotConverged,
    /// Too small a share of inliers.
    LowInlierRatio,
    /// The inliers span too small an arc; a straight line does, too.
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
    pub(super) fn advice(self, sigma_mm: Option<f64>, epsilon_mm: f64) -> String {
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

/// How the points of the valid profiles lie about their sections.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// Median of the sections' robust spreads, mm.
    pub sigma: f64,
    /// Share of inliers among all points of the valid profiles.
    pub inlier_ratio: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_was_stored_before_there_were_end_faces_and_degrees_of_freedom_is_read() {
        let text = r#"{"axis": {"p": 0.0, "q": 0.0, "y0": 1.0, "z0": 2.0}, "x_ref": 3.0, "radius": 4.0,
            "radius_source": "fitted", "uncertainty": {"covariance": [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]],
            "budget": [{"source": "repeatability", "standard": [0, 0, 0, 0, 0]}]}}"#;
        let pose: Pose = serde_json::from_str(text).expect("an old row");
        assert_eq!(pose.end_faces, EndFaces::default());
        assert_eq!(pose.uncertainty.effective_freedom, [None; 5]);
        assert_eq!(pose.uncertainty.budget[0].standard_at_origin, None);
    }
}
