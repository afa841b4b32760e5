//! Several parts in one scan, in a row along the rail: the scan is cut along x, and each piece is estimated as a
//! scan of its own.
//!
//! ```text
//! Scan --windows or gap--> ranges of stations --Scan::part--> Scans that share its points --estimate--> Estimate, each
//! ```

mod gap;
mod rule;

pub use rule::{ByGap, PARTS_MAX, PartRule, PartsError, Window};

use super::checks::unusable;
use super::estimate::{Conditioning, Estimate, Outcome, Profile};
use super::orientation;
use super::progress::Progress;
use super::refusal::{Reason, Refusal};
use super::settings::{Orientation, Settings};
use super::warning::Warning;
use crate::scan::{Grouping, Scan};
use std::ops::Range;

/// The result for a scan.
#[derive(Debug, Clone, PartialEq)]
pub enum ScanEstimate {
    /// The estimate of the complete scan, if no parts were requested.
    Whole(Estimate),
    /// The estimates of its parts.
    Parts(Parts),
}

/// The parts of a scan and the profiles outside of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// The parts in order of x.
    pub parts: Vec<PartEstimate>,
    /// Why the complete scan is refused, irrespective of the result of each part.
    pub refusal: Option<Refusal>,
    /// The profiles that belong to no part, in station order.
    pub outside: Vec<Profile>,
}

/// One part.
#[derive(Debug, Clone, PartialEq)]
pub struct PartEstimate {
    /// Its name.
    pub name: String,
    /// Its window along x, or the x of its first and last profile, mm.
    pub x_mm: [f64; 2],
    /// Its profiles among those of the scan.
    pub stations: Range<usize>,
    /// The result, as for a scan of the part alone.
    pub estimate: Estimate,
}

impl ScanEstimate {
    /// Adds warnings about the whole scan to the estimate of each part.
    pub fn warn(&mut self, warnings: &[Warning]) {
        match self {
            Self::Whole(estimate) => estimate.conditioning.warnings.extend_from_slice(warnings),
            Self::Parts(parts) => {
                parts.parts.iter_mut().for_each(|part| part.estimate.conditioning.warnings.extend_from_slice(warnings));
            }
        }
    }
}

impl Parts {
    /// The verdict on every profile of the scan, in station order.
    #[must_use]
    pub fn profiles(&self) -> Vec<Profile> {
        let mut outside = self.outside.iter().cloned();
        let mut profiles: Vec<Profile> = Vec::new();
        for part in &self.parts {
            let before = part.stations.start.saturating_sub(profiles.len());
            profiles.extend(outside.by_ref().take(before));
            profiles.extend_from_slice(&part.estimate.profiles);
        }
        profiles.extend(outside);
        profiles
    }
}

/// A piece of a scan with one part.
struct Piece {
    name: String,
    x_mm: [f64; 2],
    stations: Range<usize>,
    settings: Settings,
    /// Planes without points on the part, mm.
    blanks: Vec<f64>,
}

/// Measures every part by the rule. The results do not depend on the number of threads, and the result of a part does not depend on
/// the others.
#[must_use]
pub fn estimate_parts(scan: &Scan, settings: &Settings, rule: &PartRule, progress: &Progress) -> ScanEstimate {
    match rule {
        PartRule::One => ScanEstimate::Whole(orientation::measure(scan, settings, progress)),
        PartRule::Windows(windows) => {
            ScanEstimate::Parts(measure(scan, &in_windows(scan, settings, windows), progress))
        }
        PartRule::ByGap(rule) => ScanEstimate::Parts(between_gaps(scan, settings, rule, progress)),
    }
}

fn in_windows(scan: &Scan, settings: &Settings, windows: &[Window]) -> Vec<Piece> {
    let mut windows: Vec<&Window> = windows.iter().collect();
    windows.sort_by(|a, b| a.x_min_mm.total_cmp(&b.x_min_mm));
    let mut end = 0;
    let piece = |window: &Window| {
        let below = |x: f64| scan.stations().partition_point(|station| station.x < x);
        let up_to = |x: f64| scan.stations().partition_point(|station| station.x <= x);
        // A profile at the common bound of two windows belongs to the first.
        let start = below(window.x_min_mm).max(end);
        end = up_to(window.x_max_mm).max(start);
        let x_mm = [window.x_min_mm, window.x_max_mm];
        // Points beyond a window are ignored, even as evidence that a part ends there.
        let blanks = scan.blanks().iter().copied().filter(|x| (window.x_min_mm..=window.x_max_mm).contains(x));
        let settings = window.settings(settings);
        Piece { name: window.name.clone(), x_mm, stations: start..end, settings, blanks: blanks.collect() }
    };
    windows.into_iter().map(piece).collect()
}

fn between_gaps(scan: &Scan, settings: &Settings, rule: &ByGap, progress: &Progress) -> Parts {
    let found = gap::parts(scan, settings, rule);
    let wrong_count = wrong_count(found.len(), rule);
    // A part ends where the profiles of the gap do not show it.
    let between =
        scan.stations().iter().enumerate().filter(|(index, _)| !found.iter().any(|part| part.contains(index)));
    let blanks: Vec<f64> = between.map(|(_, station)| station.x).chain(scan.blanks().iter().copied()).collect();
    let piece = |(index, stations): (usize, &Range<usize>)| {
        let x = |index: usize| scan.stations().get(index).map_or(0.0, |station| station.x);
        let x_mm = [x(stations.start), x(stations.end.saturating_sub(1))];
        let (name, blanks) = (format!("part_{}", index + 1), blanks.clone());
        Piece { name, x_mm, stations: stations.clone(), settings: *settings, blanks }
    };
    let mut pieces: Vec<Piece> = found.iter().enumerate().map(piece).collect();
    if pieces.len() > PARTS_MAX {
        pieces.clear();
    }
    let mut parts = measure(scan, &pieces, progress);
    // A scan without a part may have a refusal with a more specific cause.
    parts.refusal = if found.is_empty() { unusable(scan, settings).or(wrong_count) } else { wrong_count };
    if let Some(refusal) = &parts.refusal {
        // The parts cannot be assigned, so none of the poses may be used.
        parts.parts.iter_mut().for_each(|part| part.estimate.outcome = Outcome::Refused(refusal.clone()));
    }
    parts
}

fn wrong_count(parts_count: usize, rule: &ByGap) -> Option<Refusal> {
    let count = rule.count.map(|count| count as usize);
    let (parts_min_count, parts_max_count) = (count.unwrap_or(1), count.unwrap_or(PARTS_MAX));
    let gap_min_mm = rule.gap_min_mm;
    (!(parts_min_count..=parts_max_count).contains(&parts_count)).then_some(Refusal::PartsCountDiffers {
        parts_count,
        parts_min_count,
        parts_max_count,
        gap_min_mm,
    })
}

fn measure(scan: &Scan, pieces: &[Piece], progress: &Progress) -> Parts {
    let part = |piece: &Piece| PartEstimate {
        name: piece.name.clone(),
        x_mm: piece.x_mm,
        stations: piece.stations.clone(),
        estimate: match scan.part(piece.stations.clone()) {
            // Parts lie in a row along X, so the axis of each is searched along X.
            Some(part) => {
                let grouping = match scan.grouping() {
                    Grouping::Given | Grouping::SharedX => Grouping::Given,
                    Grouping::Slabs | Grouping::Chosen => Grouping::Slabs,
                };
                let part = part.with_blanks(piece.blanks.clone()).with_grouping(grouping);
                let settings = Settings { orientation: Orientation::Rail, ..piece.settings };
                orientation::measure(&part, &settings, progress)
            }
            None => empty(piece),
        },
    };
    let parts: Vec<PartEstimate> = pieces.iter().map(part).collect();
    let is_outside = |index: usize| !pieces.iter().any(|piece| piece.stations.contains(&index));
    let outside = scan.stations().iter().enumerate().filter(|(index, _)| is_outside(*index));
    let outside = outside.map(|(_, station)| Profile {
        x: station.x,
        points_count: station.end - station.start,
        rejected: Some(Reason::OutsideParts),
        section: None,
        offset: None,
    });
    Parts { parts, refusal: None, outside: outside.inspect(|_| progress.advance()).collect() }
}

fn empty(piece: &Piece) -> Estimate {
    let [x_min_mm, x_max_mm] = piece.x_mm;
    Estimate {
        method: piece.settings.method,
        outcome: Outcome::Refused(Refusal::WindowEmpty { x_min_mm, x_max_mm }),
        profiles: Vec::new(),
        conditioning: Conditioning::default(),
        residuals: None,
    }
}
