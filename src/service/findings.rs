//! What came out of a measurement, as it is kept: for the whole scan, or part by part. The profiles lie beside it.

use super::error::ServiceError;
use super::measurement::{Tally, Verdict};
use crate::estimation::{
    Conditioning, Estimate, Outcome, PartEstimate, Parts, Profile, Refusal, Residuals, ScanEstimate,
};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What came out. Records from before there were parts read as one finding.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Findings {
    /// Of the parts of the scan, where they were asked for.
    Parts {
        /// In order of x.
        parts: Vec<MeasuredPart>,
        /// Why the scan is not one of such parts.
        refusal: Option<Refusal>,
    },
    /// Of the whole scan.
    Whole(Finding),
}

/// An estimate without its profiles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The pose, or why there is none.
    pub outcome: Outcome,
    /// How well the scan determines a pose.
    pub conditioning: Conditioning,
    /// How the points lie about their sections.
    pub residuals: Option<Residuals>,
}

/// What came out for one part of several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPart {
    /// What it is called.
    pub name: String,
    /// Least x of its window, or of its profiles where it was found, mm.
    pub x_min: f64,
    /// Largest x of the same.
    pub x_max: f64,
    /// Index of its first profile among those of the scan.
    pub first_profile: usize,
    /// What became of its profiles.
    pub tally: Tally,
    /// What came out.
    #[serde(flatten)]
    pub finding: Finding,
}

/// The part of a measurement that somebody asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Chosen<'a> {
    /// All of the scan, where no parts were asked for.
    Whole(&'a Finding),
    /// One of its parts, and its number from 1.
    Part(&'a MeasuredPart, usize),
    /// None: the scan was refused before it had parts.
    None(&'a Refusal),
}

impl Findings {
    /// Takes an estimate apart.
    #[must_use]
    pub fn of(estimate: ScanEstimate) -> (Self, Vec<Profile>) {
        match estimate {
            ScanEstimate::Whole(Estimate { profiles, outcome, conditioning, residuals, .. }) => {
                (Self::Whole(Finding { outcome, conditioning, residuals }), profiles)
            }
            ScanEstimate::Parts(found) => {
                let profiles = found.profiles();
                let Parts { parts, refusal, .. } = found;
                let parts = parts.into_iter().map(MeasuredPart::from).collect();
                (Self::Parts { parts, refusal }, profiles)
            }
        }
    }

    /// Whether there is a pose, of every part where there are parts.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        if self.refusal().is_none() { Verdict::Accepted } else { Verdict::Refused }
    }

    /// The first reason why not, with the name of the part that it is about.
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

    /// The finding, where there is exactly one.
    #[must_use]
    pub fn sole(&self) -> Option<&Finding> {
        match self {
            Self::Whole(finding) => Some(finding),
            Self::Parts { parts, .. } => match parts.as_slice() {
                [part] => Some(&part.finding),
                _ => None,
            },
        }
    }

    /// The parts; `None` where none were asked for.
    #[must_use]
    pub fn parts(&self) -> Option<&[MeasuredPart]> {
        match self {
            Self::Whole(_) => None,
            Self::Parts { parts, .. } => Some(parts),
        }
    }

    /// How many parts there are, also where they are too many to be measured; `None` where none were asked for.
    #[must_use]
    pub fn parts_count(&self) -> Option<u64> {
        let count = match self {
            Self::Whole(_) => return None,
            Self::Parts { refusal: Some(Refusal::PartsCountDiffers { parts_count, .. }), .. } => *parts_count,
            Self::Parts { parts, .. } => parts.len(),
        };
        Some(u64::try_from(count).unwrap_or(u64::MAX))
    }

    /// The part of a name or of a number from 1; the first where nobody says.
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

impl Finding {
    /// Why there is no pose; `None` where there is one.
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
        let count = usize::try_from(self.tally.total_count).unwrap_or(usize::MAX);
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
            tally: Tally::of(&profiles),
            finding: Finding { outcome, conditioning, residuals },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REFUSED: &str = r#"{"refused":{"code":"too_few_profiles","profiles_count":1,"profiles_min":3}}"#;

    fn read(text: &str) -> Findings {
        serde_json::from_str(text).expect("readable")
    }

    #[test]
    fn a_record_from_before_there_were_parts_reads_as_one_finding() {
        let found = read(&format!(
            r#"{{"outcome":{REFUSED},"conditioning":{{"arc":null,"axial_length":0.0,"warnings":[]}},"residuals":null}}"#
        ));
        assert!(matches!(found, Findings::Whole(_)) && found.parts().is_none());
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
            tally: Tally { total_count: 3, ..Tally::default() },
            finding: Finding {
                outcome: Outcome::Refused(Refusal::WindowEmpty { x_min_mm: 0.1, x_max_mm: 0.2 }),
                conditioning: Conditioning::default(),
                residuals: None,
            },
        };
        let found = Findings::Parts { parts: vec![part("moving", 0), part("fixed", 5)], refusal: None };
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
