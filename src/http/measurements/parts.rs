//! One part of a measurement of several, as clients see it.

use super::document::{
    ConditioningDocument, PoseDocument, ReasonDocument, ResidualsDocument, TallyDocument, VerdictName,
};
use super::uncertainty::UncertaintyDocument;
use crate::estimation::{Outcome, Pose};
use crate::service::{Finding, MeasuredPart};
use serde::Serialize;
use utoipa::ToSchema;

/// What came out for one part: accepted with a pose, or refused with a reason, as if it had been scanned alone.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Part)]
pub struct PartDocument {
    /// Name of its window; `part_1`, `part_2`, … in order of x where it was found by gaps.
    #[schema(pattern = "^[A-Za-z][A-Za-z0-9_-]{0,31}$", example = "moving")]
    pub name: String,
    /// Where its window begins; its first profile where it was found by gaps.
    pub x_min_mm: f64,
    /// Where its window ends; its last profile where it was found by gaps.
    pub x_max_mm: f64,
    /// Whether there is a pose.
    pub verdict: VerdictName,
    /// The pose of its axis; null where the verdict is `refused`.
    pub pose: Option<PoseDocument>,
    /// How well the pose is known; null where the verdict is `refused`.
    pub uncertainty: Option<UncertaintyDocument>,
    /// How well its geometry determines a pose.
    pub conditioning: ConditioningDocument,
    /// What became of its profiles.
    pub profiles: TallyDocument,
    /// How the points of its valid profiles lie about their sections; null where no profile is valid.
    pub residuals: Option<ResidualsDocument>,
    /// Why there is no pose; null where the verdict is `accepted`.
    pub refusal: Option<ReasonDocument>,
}

/// The pose of a finding, where it has one.
pub(super) fn pose(finding: &Finding) -> Option<&Pose> {
    match &finding.outcome {
        Outcome::Accepted(pose) => Some(pose),
        Outcome::Refused(_) => None,
    }
}

impl From<&MeasuredPart> for PartDocument {
    fn from(part: &MeasuredPart) -> Self {
        let finding = &part.finding;
        Self {
            name: part.name.clone(),
            x_min_mm: part.x_min,
            x_max_mm: part.x_max,
            verdict: if finding.refusal().is_none() { VerdictName::Accepted } else { VerdictName::Refused },
            pose: pose(finding).map(PoseDocument::from),
            uncertainty: pose(finding).map(UncertaintyDocument::from),
            conditioning: (&finding.conditioning).into(),
            profiles: (&part.tally).into(),
            residuals: finding.residuals.map(ResidualsDocument::from),
            refusal: finding.refusal().map(ReasonDocument::from),
        }
    }
}
