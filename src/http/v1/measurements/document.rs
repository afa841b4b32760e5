//! The measurement document, the same over HTTP and from the offline command, for a complete scan and for one of several parts.
//! Angles are in degrees, units are in the names; unknown values are null.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::estimation::{Conditioning, EndFace, Outcome, Pose, RadiusSource, Reason, Refusal, Residuals, Warning};
use crate::geometry::Axis;
use crate::http::v1::recipes::RecipeDocument;
use crate::service::{MeasuredPart, Measurement, PoseResult, ProfileCounts, Verdict};

use super::uncertainty::UncertaintyDocument;

/// A measurement that ran: accepted with a pose, or refused with a reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Measurement)]
pub struct MeasurementDocument {
    /// `m-` and a UUID that grows with time.
    #[schema(pattern = "^m-[0-9a-f-]{36}$", example = "m-0199f0c8-0000-7000-8000-000000000000")]
    pub id: String,
    /// Always `done` here; see `SensorMeasurement` for one that still scans.
    pub state: State,
    /// Whether there is a pose, of every part where there are several.
    pub verdict: VerdictName,
    /// How the pose was found.
    #[schema(example = "section_line")]
    pub method: &'static str,
    /// When it was made, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    pub created_at: Timestamp,
    /// Reading and calculation; what was read while it came in is not counted.
    pub duration_ms: u64,
    /// The pose of the part's axis; null where the verdict is `refused`, or there is not exactly one part.
    pub pose: Option<PoseDocument>,
    /// How well the pose is known; null where the verdict is `refused`, or there is not exactly one part.
    pub uncertainty: Option<UncertaintyDocument>,
    /// How well the geometry of the scan determines a pose; null where there is not exactly one part.
    pub conditioning: Option<ConditioningDocument>,
    /// Counts of all profiles of the scan by their verdict.
    pub profiles: TallyDocument,
    /// How the points of the valid profiles lie about their sections; where a pose rests on profiles of which none is valid by
    /// itself, of all of them. Null where no profile serves, or there is not exactly one part.
    pub residuals: Option<ResidualsDocument>,
    /// How many parts there are; null where the recipe does not ask for parts.
    pub parts_count: Option<u64>,
    /// The parts in order of x; null where the recipe does not ask for parts.
    pub parts: Option<Vec<PartDocument>>,
    /// Where the result comes from.
    pub provenance: ProvenanceDocument,
    /// Why there is no pose; null where the verdict is `accepted`. Of several parts it is the first one's that was refused,
    /// and `part` names it.
    pub refusal: Option<ReasonDocument>,
}

/// How far a measurement is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It ran.
    Done,
}

/// Accepted or refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VerdictName {
    /// There is a pose.
    Accepted,
    /// There is none.
    Refused,
}

/// The pose of the part's axis in the rail frame. Roll cannot be seen by the scan and is absent.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Pose)]
pub struct PoseDocument {
    /// The frame that the numbers are in.
    #[schema(example = "rail")]
    pub frame: &'static str,
    /// The axis, whatever its direction.
    pub axis: AxisDocument,
    /// Rotation towards +Y; null, as all numbers along X, where the axis lies 60° or more from X.
    pub deflection_deg: Option<f64>,
    /// Rotation towards +Z.
    pub pitch_deg: Option<f64>,
    /// Where the axis meets the plane x = 0.
    pub y_c0_mm: Option<f64>,
    /// Where the axis meets the plane x = 0.
    pub z_c0_mm: Option<f64>,
    /// Mean x of what was used (valid profiles, or points on the part): the position is known best there.
    pub x_ref_mm: Option<f64>,
    /// The axis at `x_ref_mm`.
    pub y_ref_mm: Option<f64>,
    /// The axis at `x_ref_mm`.
    pub z_ref_mm: Option<f64>,
    /// Unit vector along the axis, as in `axis`.
    pub direction: [f64; 3],
    /// Radius of the part.
    pub radius_mm: f64,
    /// Where the radius came from.
    #[schema(example = "fitted")]
    pub radius_source: &'static str,
    /// Where the axis meets the end plane that was asked for, the near one where both were; null where none was asked for
    /// or it is not seen.
    pub end_face: Option<EndFaceDocument>,
    /// Where the axis meets the far end plane where both were asked for; null else.
    pub far_end_face: Option<EndFaceDocument>,
}

/// A line in the frame that is named beside it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = Axis)]
pub struct AxisDocument {
    /// The point of the axis that is known best.
    pub point_mm: [f64; 3],
    /// Unit vector along the axis.
    pub direction: [f64; 3],
}

/// A point of the part's end plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = EndFace)]
pub struct EndFaceDocument {
    /// Along the rail.
    pub x_mm: f64,
    /// Across.
    pub y_mm: f64,
    /// Up.
    pub z_mm: f64,
}

/// How well the geometry of the scan determines a pose, over the valid profiles, or over all where none is valid.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Conditioning)]
pub struct ConditioningDocument {
    /// Median arc of the sections; null without a section.
    pub arc_deg: Option<f64>,
    /// Span along x.
    pub axial_length_mm: f64,
    /// Why the pose is less certain than its uncertainty states.
    pub warnings: Vec<ReasonDocument>,
}

/// How many profiles passed, and what the others failed on.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = ProfileCounts)]
pub struct TallyDocument {
    /// All.
    pub total_count: u64,
    /// Those that passed.
    pub valid_count: u64,
    /// The others, by reason.
    #[schema(example = json!({"low_inlier_ratio": 17, "arc_too_short": 5}))]
    pub rejected: BTreeMap<&'static str, u64>,
}

/// How the points of the valid profiles lie about their sections.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = Residuals)]
pub struct ResidualsDocument {
    /// Median of the sections' robust spreads.
    pub sigma_mm: f64,
    /// Share of the points nearer than epsilon.
    pub inlier_ratio: f64,
}

/// Where a result comes from: enough to make it again, to the bit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Provenance)]
pub struct ProvenanceDocument {
    /// The scan; its bytes are at `/v1/scans/{scan_id}/content`.
    #[schema(pattern = "^s-[0-9a-f]{64}$")]
    pub scan_id: String,
    /// SHA-256 of the scan's bytes.
    #[schema(pattern = "^[0-9a-f]{64}$")]
    pub scan_sha256: String,
    /// The format in which the scan was read.
    #[schema(example = "ply")]
    pub format: &'static str,
    /// Unit that the file's coordinates were read in: as declared by request, recipe or file, millimetres where none does.
    #[schema(example = "mm")]
    pub unit: &'static str,
    /// Points in the file.
    pub points_count: u64,
    /// Points that the file marks as missing, besides.
    pub missing_count: u64,
    /// How the points were grouped into profiles.
    #[schema(example = "x_value")]
    pub profile_rule: String,
    /// Name of the recipe; null where none was named.
    pub recipe_name: Option<String>,
    /// The complete settings of the measurement.
    pub recipe: RecipeDocument,
    /// Always null: there are no calibrations yet.
    pub calibration_id: Option<String>,
    /// The software that measured it.
    #[schema(example = json!(concat!("coaxis ", env!("CARGO_PKG_VERSION"))))]
    pub software: String,
}

/// A refusal or a warning: a code for programs, words for people, and the numbers that decided it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Reason, example = json!({"code": "short_arc", "detail": "the sections span 97°: …", "arc_deg": 97.2}))]
pub struct ReasonDocument {
    /// Stable name.
    #[schema(pattern = "^[a-z_]{1,32}$")]
    pub code: &'static str,
    /// A description, and the remedy.
    pub detail: String,
    /// The numbers behind it.
    #[serde(flatten)]
    #[schema(ignore)]
    pub numbers: Map<String, Value>,
}

impl From<&Measurement> for MeasurementDocument {
    fn from(measurement: &Measurement) -> Self {
        let (result, sole) = (&measurement.result, measurement.result.sole());
        let refusal = result.refusal().map(|(part, refusal)| match part {
            Some(part) => ReasonDocument::from(refusal).of_part(part),
            None => refusal.into(),
        });
        Self {
            id: measurement.id.clone(),
            state: State::Done,
            verdict: measurement.verdict().into(),
            method: measurement.method.name(),
            created_at: measurement.created_at,
            duration_ms: measurement.duration_ms,
            pose: sole.and_then(pose).map(PoseDocument::from),
            uncertainty: sole.and_then(pose).map(UncertaintyDocument::from),
            conditioning: sole.map(|finding| (&finding.conditioning).into()),
            profiles: (&measurement.counts).into(),
            residuals: sole.and_then(|finding| finding.residuals).map(ResidualsDocument::from),
            parts_count: result.parts_count(),
            parts: result.parts().map(|parts| parts.iter().map(PartDocument::from).collect()),
            provenance: measurement.into(),
            refusal,
        }
    }
}

impl From<Verdict> for VerdictName {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Accepted => Self::Accepted,
            Verdict::Refused => Self::Refused,
        }
    }
}

impl From<&Pose> for PoseDocument {
    fn from(pose: &Pose) -> Self {
        let Axis { point_mm, direction } = pose.axis_in_scan();
        let line = pose.on_rail().map(|found| (found.axis, found.x_ref));
        let reference = line.map(|(axis, x_ref)| axis.at(x_ref));
        Self {
            frame: "rail",
            axis: AxisDocument { point_mm, direction },
            deflection_deg: line.map(|(axis, _)| axis.deflection().degrees()),
            pitch_deg: line.map(|(axis, _)| axis.pitch().degrees()),
            y_c0_mm: line.map(|(axis, _)| axis.y0),
            z_c0_mm: line.map(|(axis, _)| axis.z0),
            x_ref_mm: line.map(|(_, x_ref)| x_ref),
            y_ref_mm: reference.map(|[y, _]| y),
            z_ref_mm: reference.map(|[_, z]| z),
            direction,
            radius_mm: pose.radius,
            radius_source: match pose.radius_source {
                RadiusSource::Fitted => "fitted",
                RadiusSource::Nominal => "nominal",
                RadiusSource::Prior => "prior",
            },
            end_face: pose.end_faces.asked_one().map(EndFaceDocument::from),
            far_end_face: pose.end_faces.other_one().map(EndFaceDocument::from),
        }
    }
}

impl From<EndFace> for EndFaceDocument {
    fn from(EndFace { centre: [x_mm, y_mm, z_mm], .. }: EndFace) -> Self {
        Self { x_mm, y_mm, z_mm }
    }
}

impl From<&Conditioning> for ConditioningDocument {
    fn from(conditioning: &Conditioning) -> Self {
        Self {
            arc_deg: conditioning.arc.map(|arc| arc.degrees()),
            axial_length_mm: conditioning.axial_length,
            warnings: conditioning.warnings.iter().map(ReasonDocument::from).collect(),
        }
    }
}

impl From<&ProfileCounts> for TallyDocument {
    fn from(tally: &ProfileCounts) -> Self {
        let rejected = tally.rejected.iter().map(|(reason, count): (&Reason, _)| (reason.name(), *count)).collect();
        Self { total_count: tally.total_count, valid_count: tally.valid_count, rejected }
    }
}

impl From<Residuals> for ResidualsDocument {
    fn from(Residuals { sigma, inlier_ratio }: Residuals) -> Self {
        Self { sigma_mm: sigma, inlier_ratio }
    }
}

impl From<&Measurement> for ProvenanceDocument {
    fn from(measurement: &Measurement) -> Self {
        Self {
            scan_id: measurement.scan_id(),
            scan_sha256: measurement.scan_sha256.clone(),
            format: measurement.format.name(),
            unit: measurement.unit.name(),
            points_count: measurement.points_count,
            missing_count: measurement.missing_count,
            profile_rule: measurement.profile_rule.clone(),
            recipe_name: measurement.recipe_name.clone(),
            recipe: measurement.recipe.clone().into(),
            calibration_id: None,
            software: measurement.software.clone(),
        }
    }
}

impl ReasonDocument {
    fn of_part(mut self, part: &str) -> Self {
        self.detail = format!("part {part}: {}", self.detail);
        self.numbers.insert("part".to_owned(), part.into());
        self
    }
}

impl From<&Refusal> for ReasonDocument {
    fn from(refusal: &Refusal) -> Self {
        Self { code: refusal.code(), detail: refusal.to_string(), numbers: numbers(refusal) }
    }
}

impl From<&Warning> for ReasonDocument {
    fn from(warning: &Warning) -> Self {
        Self { code: warning.code(), detail: warning.to_string(), numbers: numbers(warning) }
    }
}

/// The fields of a reason besides its code.
fn numbers(reason: &impl Serialize) -> Map<String, Value> {
    match serde_json::to_value(reason) {
        Ok(Value::Object(mut members)) => {
            members.remove("code");
            members
        }
        _ => Map::new(),
    }
}

/// The result for one part: accepted with a pose, or refused with a reason, as if it had been scanned alone.
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
    /// Counts of its profiles by their verdict.
    pub profiles: TallyDocument,
    /// How the points of its valid profiles lie about their sections; null where no profile is valid.
    pub residuals: Option<ResidualsDocument>,
    /// Why there is no pose; null where the verdict is `accepted`.
    pub refusal: Option<ReasonDocument>,
}

/// The pose of a result, if it has one.
pub(in crate::http) fn pose(finding: &PoseResult) -> Option<&Pose> {
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
            profiles: (&part.counts).into(),
            residuals: finding.residuals.map(ResidualsDocument::from),
            refusal: finding.refusal().map(ReasonDocument::from),
        }
    }
}
