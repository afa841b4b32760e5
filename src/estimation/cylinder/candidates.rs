//! Which cylinders a scan could be, and which of them is the part.
//!
//! A clamp that follows the part can hold most of the points and still not be the part: what the profiles have in common is.
//! So a candidate counts by its coverage, the share of the profiles that show it. Where two are on nearly all profiles, the
//! nominal radius decides; without one nobody can. Must not know how a candidate was found, nor refine one.

use super::consensus::{self, Bounds};
use super::sample::Sample;
use super::settle::{Settled, settle};
use super::step::Hold;
use crate::estimation::robust;
use rayon::prelude::*;

/// A cylinder that the scan could be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Candidate {
    pub(super) settled: Settled,
    /// Share of the profiles that show it.
    pub(super) coverage: f64,
    /// Share of the points that lie on it.
    pub(super) support: f64,
}

/// What became of the choice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Choice {
    One(Candidate),
    /// Two that could both be the part.
    Two(Candidate, Candidate),
    None,
}

/// Starts that are settled before the best is taken.
const STARTS_MAX: usize = 12;
/// Surfaces that are looked for.
const SURFACES_MAX: usize = 3;
/// A profile shows a surface when at least this many of its sampled points lie on it,
const SHOWN_POINTS: usize = 5;
/// and at least this share of them.
const SHOWN_SHARE: f64 = 0.08;
/// A surface on fewer profiles than this cannot be the part where another is on more.
const COVERAGE_MIN: f64 = 0.75;
/// Coverages that differ by more than this decide.
const COVERAGE_LEAD: f64 = 0.08;
/// Less of a scan than this on a surface is chance.
const SUPPORT_MIN: f64 = 0.1;
/// What is left of a sample after a surface was taken out is worth another search above this share.
const REST_MIN: f64 = 0.1;
/// A second surface may be so much rougher than the first before it is no surface.
const ROUGHER: f64 = 3.0;

/// The surfaces of a sample, the best supported first.
pub(super) fn candidates(sample: &Sample, bounds: &Bounds, hold: Hold) -> Vec<Candidate> {
    let mut found: Vec<Candidate> = Vec::new();
    let mut rest = sample.without(|_, _, _| false);
    while found.len() < SURFACES_MAX && rest.y.len() as f64 >= REST_MIN * sample.y.len() as f64 {
        let Some(settled) = best(&rest, bounds, hold) else { break };
        let candidate = Candidate::of(settled, sample);
        if found.first().is_some_and(|first| settled.sigma > ROUGHER * first.settled.sigma) {
            break;
        }
        if candidate.support >= SUPPORT_MIN {
            found.push(candidate);
        }
        // Generously, so that the rim of the noise is not taken for a surface of its own.
        let reach = 2.0 * robust::TUKEY_C * settled.sigma;
        let before = rest.y.len();
        rest = rest.without(|x, y, z| settled.cylinder.slice(x).distance(y, z).abs() < reach);
        if rest.y.len() == before || rest.stations.len() < 2 {
            break;
        }
    }
    found
}

/// The start that most points agree with once it has settled.
fn best(sample: &Sample, bounds: &Bounds, hold: Hold) -> Option<Settled> {
    let starts = consensus::hypotheses(sample, bounds, STARTS_MAX);
    let window = 2.0 * bounds.tolerance;
    let settled: Vec<Settled> =
        starts.par_iter().filter_map(|start| settle(sample, start.cylinder, window, hold)).collect();
    let finest = settled.iter().map(|s| s.sigma).fold(f64::INFINITY, f64::min);
    let reach = (robust::TUKEY_C * finest).max(0.25 * bounds.tolerance);
    let score = |s: &Settled| consensus::score_whole(sample, &s.cylinder, reach);
    settled.into_iter().min_by(|a, b| score(a).total_cmp(&score(b)))
}

impl Candidate {
    fn of(settled: Settled, sample: &Sample) -> Self {
        let reach = robust::TUKEY_C * settled.sigma;
        let (mut shown_count, mut on_count) = (0_usize, 0_usize);
        for station in &sample.stations {
            let slice = settled.cylinder.slice(station.x);
            let (y, z) = sample.points(station);
            let on = y.iter().zip(z).filter(|(y, z)| slice.distance(**y, **z).abs() < reach).count();
            on_count += on;
            shown_count += usize::from(on >= SHOWN_POINTS && on as f64 >= SHOWN_SHARE * y.len() as f64);
        }
        Self {
            settled,
            coverage: shown_count as f64 / sample.stations.len().max(1) as f64,
            support: on_count as f64 / sample.y.len().max(1) as f64,
        }
    }
}

/// The part among the candidates.
pub(super) fn choose(candidates: &[Candidate], nominal_radius: Option<f64>) -> Choice {
    let widest = candidates.iter().map(|c| c.coverage).fold(0.0, f64::max);
    let could_be = |c: &&Candidate| c.coverage >= widest - COVERAGE_LEAD;
    let mut possible: Vec<&Candidate> = candidates.iter().filter(could_be).collect();
    if let Some(nominal) = nominal_radius {
        let off = |c: &Candidate| (c.settled.cylinder.radius - nominal).abs();
        // The radius speaks for itself; coverage counts only where it is the same.
        possible = candidates.iter().collect();
        possible.sort_by(|a, b| off(a).total_cmp(&off(b)));
        possible.truncate(1);
    }
    match possible.as_slice() {
        [] => Choice::None,
        [first, second, ..] if second.coverage >= COVERAGE_MIN => Choice::Two(**first, **second),
        [first, ..] => Choice::One(**first),
    }
}
