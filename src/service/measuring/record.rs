//! The stored record of a measurement: the scan, the recipe, and the result for the complete scan or for each part. The profiles
//! are stored separately, because a list of measurements does not need them.

use super::pipeline::{Measured, Prepared};
use super::recipe::{Recipe, Resolved};
use crate::estimation::{
    Conditioning, Estimate, Method, Outcome, PartEstimate, Parts, Profile, Reason, Refusal, Residuals, ScanEstimate,
};
use crate::scan::decode::{Format, Unit};
use crate::service::acquisition::Acquisition;
use crate::service::error::ServiceError;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
/// The software and its version.
pub const SOFTWARE: &str = concat!("coaxis ", env!("CARGO_PKG_VERSION"));

/// A completed measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// `m-` and a number that grows with time.
    pub id: String,
    /// When it was recorded.
    pub created_at: Timestamp,
    /// Time for reading and calculation, milliseconds; reading during the upload is not counted.
    pub duration_ms: u64,
    /// SHA-256 of the scan, 64 lower-case hexadecimal digits.
    pub scan_sha256: String,
    /// Format of the scan.
    pub format: Format,
    /// Unit in which the file's coordinates were read.
    pub unit: Unit,
    /// The rule that separated its profiles, as text.
    pub profile_rule: String,
    /// Number of points in the file.
    pub points_count: u64,
    /// Number of points that the file marks as missing.
    pub missing_count: u64,
    /// The complete recipe, including defaults.
    pub recipe: Recipe,
    /// Name of the recipe, if one was given.
    pub recipe_name: Option<String>,
    /// When the scan was taken or arrived; unknown for an offline measurement.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<Acquisition>,
    /// The software that measured it.
    pub software: String,
    /// Estimation method.
    pub method: Method,
    /// The result.
    #[serde(flatten)]
    pub result: MeasurementResult,
    /// Verdicts on the profiles.
    #[serde(rename = "tally")]
    pub counts: ProfileCounts,
}

/// How many profiles are valid, and why the others were rejected.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ProfileCounts {
    /// All.
    pub total_count: u64,
    /// Valid profiles.
    pub valid_count: u64,
    /// Rejected profiles by reason; only reasons that occurred.
    pub rejected: BTreeMap<Reason, u64>,
}

/// Accepted or refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// There is a pose.
    Accepted,
    /// There is none.
    Refused,
}

impl Verdict {
    /// The verdict of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Accepted, Self::Refused].into_iter().find(|verdict| verdict.name() == name)
    }

    /// The name used in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Refused => "refused",
        }
    }
}

/// Identification of a measurement, and facts that only the caller knows.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// See [`Measurement::id`].
    pub id: String,
    /// See [`Measurement::created_at`].
    pub created_at: Timestamp,
    /// See [`Measurement::duration_ms`].
    pub duration_ms: u64,
    /// See [`Measurement::scan_sha256`].
    pub scan_sha256: String,
    /// See [`Measurement::recipe_name`].
    pub recipe_name: Option<String>,
    /// See [`Measurement::acquisition`].
    pub acquisition: Option<Acquisition>,
}

impl Measurement {
    /// The record of a measurement, and its profiles.
    #[must_use]
    pub fn record(
        identity: Identity,
        prepared: &Prepared,
        estimate: ScanEstimate,
        resolved: &Resolved,
    ) -> (Self, Vec<Profile>) {
        let Identity { id, created_at, duration_ms, scan_sha256, recipe_name, acquisition } = identity;
        let (result, profiles) = MeasurementResult::of(estimate);
        let measurement = Self {
            id,
            created_at,
            duration_ms,
            scan_sha256,
            format: prepared.format,
            unit: prepared.unit,
            profile_rule: prepared.scan.rule().to_owned(),
            points_count: prepared.points_count,
            missing_count: prepared.missing_count,
            recipe: resolved.recipe.clone(),
            recipe_name,
            acquisition,
            software: SOFTWARE.to_owned(),
            method: resolved.settings.method,
            result,
            counts: ProfileCounts::of(&profiles),
        };
        (measurement, profiles)
    }

    /// The id of its scan.
    #[must_use]
    pub fn scan_id(&self) -> String {
        format!("s-{}", self.scan_sha256)
    }

    /// Accepted if there is a pose, or a pose of every part if there are parts.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        self.result.verdict()
    }
}

impl ProfileCounts {
    /// Counts profiles.
    #[must_use]
    pub fn of(profiles: &[Profile]) -> Self {
        let mut tally = Self { total_count: wide(profiles.len()), ..Self::default() };
        for profile in profiles {
            match profile.rejected {
                None => tally.valid_count += 1,
                Some(reason) => *tally.rejected.entry(reason).or_default() += 1,
            }
        }
        tally
    }
}

fn wide(count: usize) -> u64 {
    u64::try_from(count).unwrap_or(u64::MAX)
}

/// The result. Records written before parts were supported are read as one result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum MeasurementResult {
    /// Results of the parts of the scan, if parts were requested.
    Parts {
        /// In order of x.
        parts: Vec<MeasuredPart>,
        /// Why the scan does not consist of the requested parts.
        refusal: Option<Refusal>,
    },
    /// Result of the complete scan.
    Whole(PoseResult),
}

/// An estimate without its profiles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseResult {
    /// The pose, or why there is none.
    pub outcome: Outcome,
    /// How well the scan determines a pose.
    pub conditioning: Conditioning,
    /// Distribution of the points about their sections.
    pub residuals: Option<Residuals>,
}

/// The result for one part of several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPart {
    /// Its name.
    pub name: String,
    /// Smallest x of its window, or of its profiles if it was detected, mm.
    pub x_min: f64,
    /// Largest x of the same.
    pub x_max: f64,
    /// Index of its first profile among those of the scan.
    pub first_profile: usize,
    /// Verdicts on its profiles.
    #[serde(rename = "tally")]
    pub counts: ProfileCounts,
    /// The result.
    #[serde(flatten)]
    pub finding: PoseResult,
}

/// The selected part of a measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Chosen<'a> {
    /// The complete scan, if no parts were requested.
    Whole(&'a PoseResult),
    /// One of its parts, and its number from 1.
    Part(&'a MeasuredPart, usize),
    /// None: the scan was refused before it was divided into parts.
    None(&'a Refusal),
}

impl MeasurementResult {
    /// Separates an estimate into the result and its profiles.
    #[must_use]
    pub fn of(estimate: ScanEstimate) -> (Self, Vec<Profile>) {
        match estimate {
            ScanEstimate::Whole(Estimate { profiles, outcome, conditioning, residuals, .. }) => {
                (Self::Whole(PoseResult { outcome, conditioning, residuals }), profiles)
            }
            ScanEstimate::Parts(found) => {
                let profiles = found.profiles();
                let Parts { parts, refusal, .. } = found;
                let parts = parts.into_iter().map(MeasuredPart::from).collect();
                (Self::Parts { parts, refusal }, profiles)
            }
        }
    }

    /// Accepted if there is a pose, or a pose of every part if there are parts.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        if self.refusal().is_none() { Verdict::Accepted } else { Verdict::Refused }
    }

    /// The first reason why not, with the name of the part concerned.
    #[must_use]
    pub fn refusal(&self) -> Option<(Option<&str>, &Refusal)> {
        match self {
            Self::Whole(finding) => finding.refusal().map(|refusal| (None, refusal)),
            Self::Parts { refusal: Some(refusal), .. } => Some((None, refusal)),
            Self::Parts { parts, refusal: None } => {
                parts.iter().find_map(|part| Some((Some(part.name.as_str()), part.finding.refusal()?)))
            }
        }
    }

    /// The result, if there is exactly one.
    #[must_use]
    pub fn sole(&self) -> Option<&PoseResult> {
        match self {
            Self::Whole(finding) => Some(finding),
            Self::Parts { parts, .. } => match parts.as_slice() {
                [part] => Some(&part.finding),
                _ => None,
            },
        }
    }

    /// The parts; `None` if none were requested.
    #[must_use]
    pub fn parts(&self) -> Option<&[MeasuredPart]> {
        match self {
            Self::Whole(_) => None,
            Self::Parts { parts, .. } => Some(parts),
        }
    }

    /// The number of parts, even if they are too many to be measured; `None` if none were requested.
    #[must_use]
    pub fn parts_count(&self) -> Option<u64> {
        let count = match self {
            Self::Whole(_) => return None,
            Self::Parts { refusal: Some(Refusal::PartsCountDiffers { parts_count, .. }), .. } => *parts_count,
            Self::Parts { parts, .. } => parts.len(),
        };
        Some(u64::try_from(count).unwrap_or(u64::MAX))
    }

    /// The part of this name or number (from 1); the first one by default.
    ///
    /// # Errors
    /// [`ServiceError::PartUnknown`].
    pub fn choose(&self, asked: Option<&str>) -> Result<Chosen<'_>, ServiceError> {
        let unknown = |asked: &str| {
            let names = self.parts().unwrap_or_default().iter().map(|part| part.name.clone()).collect();
            ServiceError::PartUnknown { part: asked.to_owned(), names }
        };
        match (self, asked) {
            (Self::Whole(finding), None | Some("1")) => Ok(Chosen::Whole(finding)),
            (Self::Whole(_), Some(asked)) => Err(unknown(asked)),
            (Self::Parts { parts, refusal: Some(refusal) }, None) if parts.is_empty() => Ok(Chosen::None(refusal)),
            (Self::Parts { parts, .. }, asked) => {
                let asked = asked.unwrap_or("1");
                let is_it =
                    |(index, part): &(usize, &MeasuredPart)| part.name == asked || asked == (index + 1).to_string();
                let found = parts.iter().enumerate().find(is_it);
                found.map(|(index, part)| Chosen::Part(part, index + 1)).ok_or_else(|| unknown(asked))
            }
        }
    }

    /// The name of the part that the profile of this index belongs to.
    #[must_use]
    pub fn part_of_profile(&self, index: usize) -> Option<&str> {
        let part = self.parts()?.iter().find(|part| part.stations().contains(&index))?;
        Some(&part.name)
    }
}

impl PoseResult {
    /// Why there is no pose; `None` if there is one.
    #[must_use]
    pub const fn refusal(&self) -> Option<&Refusal> {
        match &self.outcome {
            Outcome::Accepted(_) => None,
            Outcome::Refused(refusal) => Some(refusal),
        }
    }
}

impl MeasuredPart {
    /// Its profiles among those of the scan.
    #[must_use]
    pub fn stations(&self) -> Range<usize> {
        let count = usize::try_from(self.counts.total_count).unwrap_or(usize::MAX);
        self.first_profile..self.first_profile.saturating_add(count)
    }
}

impl From<PartEstimate> for MeasuredPart {
    fn from(part: PartEstimate) -> Self {
        let PartEstimate { name, x_mm: [x_min, x_max], stations, estimate } = part;
        let Estimate { outcome, profiles, conditioning, residuals, .. } = estimate;
        Self {
            name,
            x_min,
            x_max,
            first_profile: stations.start,
            counts: ProfileCounts::of(&profiles),
            finding: PoseResult { outcome, conditioning, residuals },
        }
    }
}

/// A measurement and its profiles, as stored.
pub(in crate::service) struct Calculated {
    pub(in crate::service) measurement: Measurement,
    pub(in crate::service) profiles: Vec<u8>,
}

impl Calculated {
    /// The record of a measurement. The profiles are serialised here because that is processor-bound.
    pub(in crate::service) fn of(
        identity: Identity,
        measured: Measured,
        resolved: &Resolved,
    ) -> Result<Self, ServiceError> {
        let (measurement, profiles) = Measurement::record(identity, &measured.prepared, measured.estimate, resolved);
        let unwritable = |source| ServiceError::RecordUnwritable { what: "list of profiles", source: Arc::new(source) };
        Ok(Self { measurement, profiles: serde_json::to_vec(&profiles).map_err(unwritable)? })
    }
}

/// The description of a scan that was taken by the sensor. It distinguishes this scan from an upload, because no client can set
/// the description of a scan.
pub(in crate::service) const TAKEN_BY_SENSOR: &str = "taken by the sensor";

/// The newest measurement, for polling clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Last {
    /// Its position in the order of recording.
    pub(in crate::service) sequence: u64,
    /// Its id.
    pub id: String,
    /// Whether it has a pose; `None` if the record has an unknown verdict.
    pub verdict: Option<Verdict>,
    /// When it was recorded.
    pub created_at: Timestamp,
}

#[cfg(test)]
mod measurement_tests {
    use super::*;
    use serde_json::{Value, json};

    /// A record as it was written before parts were supported.
    fn record() -> Value {
        let recipe = json!({"method": "section_line", "epsilon_mm": 0.111, "points_min": 20, "radius": "free"});
        let axis = json!({"p": 0.01, "q": -0.02, "y0": 1.5, "z0": -2.5});
        let matrix = json!([
            [1e-9, 0.0, 0.0, 0.0, 0.0],
            [0.0, 1e-9, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1e-4, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1e-4, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1e-4]
        ]);
        let budget = json!([{"source": "repeatability", "standard": [1e-5, 1e-5, 0.01, 0.01, 0.01]}]);
        let pose = json!({"axis": axis, "x_ref": 55.0, "radius": 200.0, "radius_source": "fitted",
            "uncertainty": {"covariance": matrix, "budget": budget}});
        json!({
            "id": "m-0199f0c8-0000-7000-8000-000000000000", "created_at": "2026-01-02T03:04:05Z", "duration_ms": 12,
            "scan_sha256": "00", "format": "csv", "unit": "mm", "profile_rule": "column=profile", "points_count": 720,
            "missing_count": 0, "recipe": recipe, "recipe_name": null, "software": "coaxis 0.1.0",
            "method": "section_line", "outcome": {"accepted": pose},
            "conditioning": {"arc": 2.4, "axial_length": 110.0, "warnings": [{"code": "short_arc", "arc_deg": 97.0}]},
            "residuals": {"sigma": 0.05, "inlier_ratio": 0.97},
            "tally": {"total_count": 12, "valid_count": 10, "rejected": {"low_inlier_ratio": 2}}
        })
    }

    #[test]
    fn a_record_from_before_parts_were_supported_reads_and_writes_unchanged() {
        let text = record().to_string();
        let measurement: Measurement = serde_json::from_str(&text).expect("readable");
        assert_eq!(measurement.verdict(), Verdict::Accepted);
        assert_eq!(measurement.result.sole().and_then(|finding| finding.residuals).map(|r| r.inlier_ratio), Some(0.97));
        let mut as_written_today = record();
        as_written_today["outcome"]["accepted"]["end_faces"] = json!({"asked": "none", "near": null, "far": null});
        let uncertainty = &mut as_written_today["outcome"]["accepted"]["uncertainty"];
        uncertainty["effective_freedom"] = json!([null, null, null, null, null]);
        uncertainty["effective_freedom_at_origin"] = json!([null, null]);
        uncertainty["budget"][0]["standard_at_origin"] = Value::Null;
        uncertainty["budget"][0]["covariance"] = Value::Null;
        as_written_today["outcome"]["accepted"]["cut"] = Value::Null;
        assert_eq!(serde_json::to_value(&measurement).expect("JSON"), as_written_today);
    }
}

#[cfg(test)]
mod findings_tests {
    use super::*;

    const REFUSED: &str = r#"{"refused":{"code":"too_few_profiles","profiles_count":1,"profiles_min":3}}"#;

    fn read(text: &str) -> MeasurementResult {
        serde_json::from_str(text).expect("readable")
    }

    #[test]
    fn a_record_from_before_parts_were_supported_reads_as_one_result() {
        let found = read(&format!(
            r#"{{"outcome":{REFUSED},"conditioning":{{"arc":null,"axial_length":0.0,"warnings":[]}},"residuals":null}}"#
        ));
        assert!(matches!(found, MeasurementResult::Whole(_)) && found.parts().is_none());
        assert_eq!(found.refusal().map(|(part, refusal)| (part, refusal.code())), Some((None, "too_few_profiles")));
        assert!(
            matches!(found.choose(None), Ok(Chosen::Whole(_)))
                && matches!(found.choose(Some("1")), Ok(Chosen::Whole(_)))
        );
        assert!(found.choose(Some("2")).is_err());
    }

    #[test]
    fn parts_are_chosen_by_name_or_number_and_a_record_reads_back() {
        let part = |name: &str, first_profile: usize| MeasuredPart {
            name: name.to_owned(),
            x_min: 0.1,
            x_max: 0.2,
            first_profile,
            counts: ProfileCounts { total_count: 3, ..ProfileCounts::default() },
            finding: PoseResult {
                outcome: Outcome::Refused(Refusal::WindowEmpty { x_min_mm: 0.1, x_max_mm: 0.2 }),
                conditioning: Conditioning::default(),
                residuals: None,
            },
        };
        let found = MeasurementResult::Parts { parts: vec![part("moving", 0), part("fixed", 5)], refusal: None };
        assert_eq!(read(&serde_json::to_string(&found).expect("JSON")), found);
        for (asked, number) in [(None, 1), (Some("1"), 1), (Some("moving"), 1), (Some("2"), 2), (Some("fixed"), 2)] {
            assert!(matches!(found.choose(asked), Ok(Chosen::Part(_, at)) if at == number), "{asked:?}");
        }
        for asked in ["0", "3", "01", "other", ""] {
            assert!(found.choose(Some(asked)).is_err(), "{asked}");
        }
        let names = [0, 2, 3, 4, 5, 8].map(|index| found.part_of_profile(index));
        assert_eq!(names, [Some("moving"), Some("moving"), None, None, Some("fixed"), None]);
        assert_eq!(found.refusal().map(|(part, _)| part), Some(Some("moving")));
        assert!(found.sole().is_none());
    }
}
