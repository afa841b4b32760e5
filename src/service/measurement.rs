//! A measurement as it is kept: what was measured, with what, and what came out. The profiles lie beside it, since a list of
//! measurements has no use for them.

use super::acquisition::Acquisition;
use super::findings::Findings;
use super::measure::Prepared;
use super::recipe::{Recipe, Resolved};
use crate::estimation::{Method, Profile, Reason, ScanEstimate};
use crate::scan::decode::{Format, Unit};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The software that measures, with its version.
pub const SOFTWARE: &str = concat!("coaxis ", env!("CARGO_PKG_VERSION"));

/// A measurement that ran.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// `m-` and a number that grows with time.
    pub id: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// Reading and calculation, milliseconds; what was read while it came in is not counted.
    pub duration_ms: u64,
    /// SHA-256 of the scan, 64 lower-case hexadecimal digits.
    pub scan_sha256: String,
    /// What the scan was read as.
    pub format: Format,
    /// Unit that the file's coordinates were read in.
    pub unit: Unit,
    /// How its profiles were told apart, in words.
    pub profile_rule: String,
    /// Points that the file holds.
    pub points_count: u64,
    /// Points that the file marks as missing.
    pub missing_count: u64,
    /// What it was measured with, nothing left out.
    pub recipe: Recipe,
    /// Name of the recipe, where one was named.
    pub recipe_name: Option<String>,
    /// When the scan was taken, or arrived; not known of a file that was measured without a service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<Acquisition>,
    /// What measured it.
    pub software: String,
    /// How the pose was found.
    pub method: Method,
    /// What came out.
    #[serde(flatten)]
    pub findings: Findings,
    /// What became of the profiles.
    pub tally: Tally,
}

/// How many profiles passed, and what the others failed on.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tally {
    /// All.
    pub total_count: u64,
    /// Those that passed.
    pub valid_count: u64,
    /// The others by reason; only reasons that occurred.
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
    /// The verdict of a name, where it is one.
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

/// What a measurement is known by, and what only the caller knows about it.
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
    /// The record of what was measured, and its profiles.
    #[must_use]
    pub fn record(
        identity: Identity,
        prepared: &Prepared,
        estimate: ScanEstimate,
        resolved: &Resolved,
    ) -> (Self, Vec<Profile>) {
        let Identity { id, created_at, duration_ms, scan_sha256, recipe_name, acquisition } = identity;
        let (findings, profiles) = Findings::of(estimate);
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
            findings,
            tally: Tally::of(&profiles),
        };
        (measurement, profiles)
    }

    /// The id of its scan.
    #[must_use]
    pub fn scan_id(&self) -> String {
        format!("s-{}", self.scan_sha256)
    }

    /// Whether there is a pose, of every part where there are parts.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        self.findings.verdict()
    }
}

impl Tally {
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    /// A record as it was written before there were parts.
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
    fn a_record_from_before_there_were_parts_reads_and_writes_as_it_was() {
        let text = record().to_string();
        let measurement: Measurement = serde_json::from_str(&text).expect("readable");
        assert_eq!(measurement.verdict(), Verdict::Accepted);
        assert_eq!(
            measurement.findings.sole().and_then(|finding| finding.residuals).map(|r| r.inlier_ratio),
            Some(0.97)
        );
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
