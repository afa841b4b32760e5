//! Finds the parts of a scan by what lies between them: stretches of the rail without a profile that shows a part.
//!
//! A profile that shows an arc all by itself among its neighbours is an accident and counts as none. A stretch of profiles
//! that is too short to be measured (fewer than `profiles_min`, or shorter than `axial_length_min_mm`) is no part.

use super::super::conclude::median;
use super::rule::ByGap;
use super::shows::shows;
use crate::estimation::settings::Settings;
use crate::scan::{Scan, Station};
use std::ops::Range;

/// A gap is at least so many usual distances between profiles: a coarse scan has no gap after every profile.
const GAP_SPACINGS: f64 = 2.5;
/// Profiles on either side among which a profile must find another one that shows a part.
const NEIGHBOURS: usize = 2;

/// The stations of each part, in order of x, from the first profile that shows it to the last.
pub(super) fn parts(scan: &Scan, settings: &Settings, rule: &ByGap) -> Vec<Range<usize>> {
    let stations = scan.stations();
    let gap = rule.gap_min_mm.max(GAP_SPACINGS * spacing(stations));
    let mut found: Vec<Stretch> = Vec::new();
    for (index, station) in confirmed(&shows(scan, settings)).filter_map(|index| Some((index, stations.get(index)?))) {
        match found.last_mut() {
            Some(last) if station.x - last.x_max < gap => last.extend(index, station.x),
            _ => found.push(Stretch { range: index..index + 1, x_min: station.x, x_max: station.x, count: 1 }),
        }
    }
    found.retain(|stretch| stretch.is_long(settings));
    found.into_iter().map(|stretch| stretch.range).collect()
}

/// Profiles that show a part with no gap between them.
struct Stretch {
    range: Range<usize>,
    x_min: f64,
    x_max: f64,
    /// Of those that show a part.
    count: usize,
}

impl Stretch {
    fn extend(&mut self, index: usize, x: f64) {
        (self.range.end, self.x_max, self.count) = (index + 1, x, self.count + 1);
    }

    fn is_long(&self, settings: &Settings) -> bool {
        self.count >= settings.profiles_min as usize
            && self.x_max - self.x_min >= settings.axial_length_min_mm.unwrap_or(0.0)
    }
}

/// Median distance of a profile from the next; 0 for a single one.
fn spacing(stations: &[Station]) -> f64 {
    median(stations.iter().zip(stations.iter().skip(1)).map(|(a, b)| b.x - a.x)).unwrap_or(0.0)
}

/// The profiles that show a part, and near which another one does.
fn confirmed(shown: &[bool]) -> impl Iterator<Item = usize> {
    (0..shown.len()).filter(|&index| {
        let near = shown.iter().take(index + NEIGHBOURS + 1).skip(index.saturating_sub(NEIGHBOURS));
        shown.get(index) == Some(&true) && near.filter(|shown| **shown).count() > 1
    })
}
