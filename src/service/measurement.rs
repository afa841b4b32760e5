//! A measurement as it is kept: what was measured, with what, and what came out. The profiles lie beside it, since a list
//! of measurements has no use for them. Must not know how it is sent.

use super::{Prepared, Recipe, Resolved};
use crate::estimation::{Conditioning, Estimate, Method, Outcome, Profile, Reason, Residuals};
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
    /// What measured it.
    pub software: String,
    /// How the pose was found.
    pub method: Method,
    /// The pose, or why there is none.
    pub outcome: Outcome,
    /// How well the scan determines a pose.
    pub conditioning: Conditioning,
    /// How the points lie about their sections.
    pub residuals: Option<Residuals>,
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
}

impl Measurement {
    /// The record of what was measured, and its profiles.
    #[must_use]
    pub fn record(
        identity: Identity,
        prepared: &Prepared,
        estimate: Estimate,
        resolved: &Resolved,
    ) -> (Self, Vec<Profile>) {
        let Identity { id, created_at, duration_ms, scan_sha256, recipe_name } = identity;
        let Estimate { method, outcome, profiles, conditioning, residuals } = estimate;
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
            software: SOFTWARE.to_owned(),
            method,
            outcome,
            conditioning,
            residuals,
            tally: Tally::of(&profiles),
        };
        (measurement, profiles)
    }

    /// The id of its scan.
    #[must_use]
    pub fn scan_id(&self) -> String {
        format!("s-{}", self.scan_sha256)
    }

    /// Whether there is a pose.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        match self.outcome {
            Outcome::Accepted(_) => Verdict::Accepted,
            Outcome::Refused(_) => Verdict::Refused,
        }
    }

    /// The estimate as it was, put together again with its profiles.
    #[must_use]
    pub fn estimate(&self, profiles: Vec<Profile>) -> Estimate {
        Estimate {
            method: self.method,
            outcome: self.outcome.clone(),
            profiles,
            conditioning: self.conditioning.clone(),
            residuals: self.residuals,
        }
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
