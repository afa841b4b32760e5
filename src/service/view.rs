//! What a picture is drawn of: one part of a measurement with its profiles, or all of the scan. Must not know how a picture
//! looks, nor where scan and profiles come from.

use super::{Chosen, Finding, Measurement};
use crate::estimation::{Conditioning, Estimate, Outcome, Profile};
use crate::scan::Scan;

/// A scan and what came out of it, as pictures take them.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The profiles of the part; of all parts where it has none.
    pub scan: Scan,
    /// What came out, put together again with its profiles.
    pub estimate: Estimate,
    /// Index of its first profile among those of the whole scan.
    pub first_profile: usize,
    /// Name of the part, where there are parts.
    pub part: Option<String>,
}

impl Measurement {
    /// What is seen of the part that was chosen, with `profile` (its index in the whole scan) in any case.
    #[must_use]
    pub fn view(&self, scan: &Scan, profiles: &[Profile], chosen: Chosen<'_>, profile: Option<usize>) -> View {
        // The profiles are those of the sections that the pose was found in.
        let sections = match chosen {
            Chosen::Whole(Finding { outcome: Outcome::Accepted(pose), .. }) => {
                let same = |sections: &Scan| sections.stations().len() == profiles.len();
                pose.cut.and_then(|cut| cut.apply(scan)).filter(same)
            }
            _ => None,
        };
        let scan = sections.as_ref().unwrap_or(scan);
        let all = 0..scan.stations().len();
        let (finding, stations, part) = match chosen {
            Chosen::Whole(finding) => (finding.clone(), all.clone(), None),
            Chosen::Part(part, _) => (part.finding.clone(), part.stations(), Some(part.name.clone())),
            Chosen::None(refusal) => {
                let (outcome, conditioning) = (Outcome::Refused(refusal.clone()), Conditioning::default());
                (Finding { outcome, conditioning, residuals: None }, all.clone(), None)
            }
        };
        let (stations, part) = match profile {
            // One that lies outside every part can only be seen among all.
            Some(index) if !stations.contains(&index) => (all.clone(), None),
            _ => (stations, part),
        };
        // So can a window that holds none.
        let (scan, stations) = match scan.part(stations.clone()) {
            Some(part) => (part, stations),
            None => (scan.clone(), all),
        };
        let Finding { outcome, conditioning, residuals } = finding;
        let first_profile = stations.start;
        let profiles = profiles.get(stations).unwrap_or_default().to_vec();
        let estimate = Estimate { method: self.method, outcome, profiles, conditioning, residuals };
        View { scan, estimate, first_profile, part }
    }

    /// The same of every part, or of the whole scan where there are none.
    #[must_use]
    pub fn views(&self, scan: &Scan, profiles: &[Profile]) -> Vec<View> {
        let chosen: Vec<Chosen<'_>> = match self.findings.parts() {
            Some(parts) if !parts.is_empty() => {
                parts.iter().enumerate().map(|(index, part)| Chosen::Part(part, index + 1)).collect()
            }
            _ => self.findings.choose(None).into_iter().collect(),
        };
        chosen.into_iter().map(|chosen| self.view(scan, profiles, chosen, None)).collect()
    }
}
