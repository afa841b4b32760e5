//! Another surface about the same axis beneath the one that was fitted: then that may be a jaw or a sleeve that follows the
//! part, and what shows beside it the part. In: the sample and the fit. Out: how deep it lies and on how many profiles. Must
//! not decide which of them is the part.

use super::model::Cylinder;
use super::sample::Sample;
use crate::estimation::robust;
use crate::scan::Station;

/// Points of one surface lie within this many σ.
const THICKNESS: f64 = 4.0;
/// It holds this share of the points at least; the bottoms of holes hold less,
const SUPPORT_MIN: f64 = 0.12;
/// and is on this share of the profiles,
const COVERAGE_MIN: f64 = 0.3;
/// on each with this share of its points, and the fit on half of these.
const SHOWN_SHARE: f64 = 0.08;

/// A surface beneath.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Beneath {
    /// Below the fit, mm.
    pub(super) depth: f64,
    /// Share of the profiles that show it.
    pub(super) coverage: f64,
}

/// The surface about the same axis that holds the most points below the fit; `None` where none is large enough.
pub(super) fn beneath(sample: &Sample, cylinder: &Cylinder, sigma: f64) -> Option<Beneath> {
    let profiles: Vec<Vec<f64>> = sample.stations.iter().map(|station| depths(sample, station, cylinder)).collect();
    let reach = robust::TUKEY_C * sigma;
    let mut below: Vec<f64> = profiles.iter().flatten().copied().filter(|depth| *depth > reach).collect();
    below.sort_unstable_by(f64::total_cmp);
    let thickness = THICKNESS * sigma;
    let held = |(index, first): (usize, &f64)| {
        (below.partition_point(|depth| *depth <= first + thickness).saturating_sub(index), *first)
    };
    let (count, first) = below.iter().enumerate().map(held).max_by_key(|(count, _)| *count)?;
    let shows = |profile: &[f64], [least, most]: [f64; 2]| {
        let within = profile.iter().filter(|depth| (least..=most).contains(*depth));
        within.count() as f64 >= SHOWN_SHARE * profile.len() as f64
    };
    let lower: Vec<&Vec<f64>> = profiles.iter().filter(|profile| shows(profile, [first, first + thickness])).collect();
    // Parts of different radii, one after the other, share no profile.
    let both_count = lower.iter().filter(|profile| shows(profile, [-reach, reach])).count();
    let coverage = lower.len() as f64 / profiles.len() as f64;
    let enough = count as f64 >= SUPPORT_MIN * sample.y.len() as f64 && coverage >= COVERAGE_MIN;
    (enough && 2 * both_count >= lower.len()).then_some(Beneath { depth: first + 0.5 * thickness, coverage })
}

/// How far the sampled points of a profile lie below the fit, mm.
fn depths(sample: &Sample, station: &Station, cylinder: &Cylinder) -> Vec<f64> {
    let slice = cylinder.slice(station.x);
    let (y, z) = sample.points(station);
    y.iter().zip(z).map(|(y, z)| -slice.distance(*y, *z)).collect()
}
