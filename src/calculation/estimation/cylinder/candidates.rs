//! Which cylinders a scan could be, and which of them is the part.
//!
//! A clamp that follows the part can have most of the points and still not be the part, which is the surface common to the
//! profiles. So a candidate is rated by its coverage, the share of the profiles that show it. If two candidates cover nearly all
//! profiles, the nominal radius decides; without one the choice is refused.
//!
//! A rough cylinder becomes the nearest robust fit of a sample by iteratively re-weighted least squares whose window shrinks from
//! coarse to fine, so that the surface with most points near the start prevails over points beside it. [`settle`] estimates the
//! noise from the points. [`narrow`] is for a sample of known noise: its window shrinks to a multiple of that noise, so that two
//! surfaces a few σ apart are not taken for one rough surface.

use super::consensus::{self, Bounds};
use super::kernel::Curvature;
use super::model::{ANY_DIRECTION, Cylinder};
use super::normal_equations::{self, RadiusConstraint, Sums};
use super::sample::Sample;
use crate::estimation::statistics;
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

/// The noise of the points, if it is known beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Noise {
    /// Unknown: it is estimated for each surface.
    Unknown,
    /// Its standard deviation, mm.
    Known(f64),
}

/// The result of the choice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Choice {
    One(Candidate),
    /// Two that could both be the part.
    Two(Candidate, Candidate),
    None,
}

/// Starts that are refined before the best is taken.
const STARTS_MAX: usize = 12;
/// The number of refined starts whose windows are then widened.
const OPENED: usize = 3;
/// How often a window may double.
const GROWTHS_MAX: usize = 8;
/// The largest number of surfaces to search for.
const SURFACES_MAX: usize = 3;
/// A profile shows a surface when at least this many of its sampled points lie on it,
const SHOWN_POINTS: usize = 5;
/// or this share of them, if there are few,
const SHOWN_FEW: f64 = 0.15;
/// and at least this share of them.
const SHOWN_SHARE: f64 = 0.08;
/// A surface on fewer profiles than this is not the part if another surface is on more.
pub(super) const COVERAGE_MIN: f64 = 0.75;
/// A larger difference of coverage decides between two candidates.
const COVERAGE_LEAD: f64 = 0.08;
/// Radii are different if they differ by more standard uncertainties than this.
const RADIUS_SIGMAS: f64 = 3.0;
/// A radius beyond the largest allowed one by this factor is a plane.
const PLANE: f64 = 1.5;
/// A surface with a smaller share of the points is a chance result.
const SUPPORT_MIN: f64 = 0.1;
/// The sample without a surface is searched again if more than this share remains.
const REST_MIN: f64 = 0.1;
/// A second surface that is rougher than the first by more than this factor is rejected.
const ROUGHER: f64 = 3.0;

/// The surfaces of a sample, the best supported first.
pub(super) fn candidates(
    sample: &Sample,
    bounds: &Bounds,
    noise: Noise,
    constraint: RadiusConstraint,
) -> Vec<Candidate> {
    let mut found: Vec<Settled> = Vec::new();
    let mut rest = sample.clone();
    while found.len() < SURFACES_MAX && rest.len() as f64 >= REST_MIN * sample.len() as f64 {
        let Some(settled) = best(&rest, bounds, noise, constraint) else { break };
        if found.first().is_some_and(|first| settled.sigma > ROUGHER * first.sigma) {
            break;
        }
        found.push(settled);
        // The window is wide, so that the tail of the noise is not taken for a separate surface.
        let reach = 2.0 * statistics::TUKEY_C * settled.sigma;
        let before = rest.len();
        rest = rest.without(|[x, y, z]| settled.cylinder.slice(x).distance(y, z).abs() < reach);
        if rest.len() == before || rest.stations.len() < 2 {
            break;
        }
    }
    // A scan that shows only a plane is refused later.
    if found.iter().any(|settled| !is_plane(settled, sample, bounds)) {
        found.retain(|settled| !is_plane(settled, sample, bounds));
    }
    counted(&found, sample)
}

/// A support or the face of a clamp is a plane: a cylinder of any large radius fits it, and none of these is the part.
fn is_plane(settled: &Settled, sample: &Sample, bounds: &Bounds) -> bool {
    let [_, most] = bounds.radius_mm;
    let radius = settled.cylinder.radius;
    radius > PLANE * most || radius < RADIUS_SIGMAS * radius_uncertainty(settled, sample)
}

/// The start that agrees with most points after it has settled. Widening the window of a poor start can take many rounds, so only
/// the windows of the best ones are widened.
fn best(sample: &Sample, bounds: &Bounds, noise: Noise, constraint: RadiusConstraint) -> Option<Settled> {
    let starts = consensus::hypotheses(sample, bounds, STARTS_MAX);
    let window = 2.0 * bounds.tolerance;
    let settle_one = |start: Cylinder| match noise {
        Noise::Unknown => settle(sample, start, window, constraint),
        Noise::Known(sigma) => narrow(sample, start, window, sigma, constraint),
    };
    let least_reach = match noise {
        Noise::Unknown => 0.25 * bounds.tolerance,
        Noise::Known(sigma) => WINDOW * sigma,
    };
    let settled: Vec<Settled> = starts.par_iter().filter_map(|start| settle_one(start.cylinder)).collect();
    let ranked = ranked(settled, sample, noise, least_reach);
    if matches!(noise, Noise::Known(_)) {
        return ranked.into_iter().next();
    }
    let opened = ranked.chunks(OPENED).find_map(|best| {
        let opened: Vec<Settled> = best.par_iter().filter_map(|one| opened(sample, *one, window, constraint)).collect();
        (!opened.is_empty()).then_some(opened)
    })?;
    self::ranked(opened, sample, noise, least_reach).into_iter().next()
}

/// The surfaces sorted by the number of points within the tolerance of the finest of them.
fn ranked(mut settled: Vec<Settled>, sample: &Sample, noise: Noise, least_reach: f64) -> Vec<Settled> {
    let finest = settled.iter().map(|s| s.sigma).fold(f64::INFINITY, f64::min);
    let reach = match noise {
        Noise::Unknown => (statistics::TUKEY_C * finest).max(least_reach),
        Noise::Known(_) => least_reach,
    };
    settled.sort_by_cached_key(|s| consensus::score_whole(sample, &s.cylinder, reach).to_bits());
    settled
}

/// The surface after its window has been widened until it covers the noise.
fn opened(sample: &Sample, mut settled: Settled, mut window: f64, constraint: RadiusConstraint) -> Option<Settled> {
    for _ in 0..GROWTHS_MAX {
        let wanted = statistics::TUKEY_C * settled.sigma;
        if wanted <= window {
            break;
        }
        window = wanted.min(2.0 * window);
        settled = settle(sample, settled.cylinder, window, constraint)?;
    }
    Some(settled)
}

/// How much of the sample lies on each surface. A point counts only for the nearest surface: a cylinder that crosses the part
/// shares a strip of it in every profile without being the surface common to the profiles.
fn counted(found: &[Settled], sample: &Sample) -> Vec<Candidate> {
    let (mut shown_counts, mut on_counts) = (vec![0_usize; found.len()], vec![0_usize; found.len()]);
    let mut on = vec![0_usize; found.len()];
    for station in &sample.stations {
        let slices: Vec<_> = found.iter().map(|settled| settled.cylinder.slice(station.x)).collect();
        let points_count = (station.end - station.start) as f64;
        on.fill(0);
        for [x, y, z] in sample.points(station) {
            let distances = slices.iter().map(|slice| slice.at(x).distance(y, z).abs()).zip(found).enumerate();
            let near = distances.filter(|(_, (d, settled))| *d < statistics::TUKEY_C * settled.sigma);
            let nearest = near.min_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b));
            if let Some(count) = nearest.and_then(|(index, _)| on.get_mut(index)) {
                *count += 1;
            }
        }
        let least = SHOWN_POINTS.min((points_count * SHOWN_FEW).ceil() as usize).max(2);
        for ((shown, all), on) in shown_counts.iter_mut().zip(&mut on_counts).zip(&on) {
            *all += on;
            *shown += usize::from(*on >= least && *on as f64 >= SHOWN_SHARE * points_count);
        }
    }
    let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
    let counts = shown_counts.into_iter().zip(on_counts);
    let candidate = |(settled, (shown, on)): (&Settled, (usize, usize))| Candidate {
        settled: *settled,
        coverage: share(shown, sample.stations.len()),
        support: share(on, sample.len()),
    };
    found.iter().zip(counts).map(candidate).filter(|candidate| candidate.support >= SUPPORT_MIN).collect()
}

/// The part among the candidates.
pub(super) fn choose(candidates: &[Candidate], nominal_radius: Option<f64>, sample: &Sample) -> Choice {
    let mut possible: Vec<&Candidate> = candidates.iter().collect();
    if let Some(nominal) = nominal_radius {
        // The nominal radius decides if the data distinguish the radii.
        let off = |c: &Candidate| (c.settled.cylinder.radius - nominal).abs();
        let nearest = possible.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)));
        let known = |c: &Candidate| RADIUS_SIGMAS * radius_uncertainty(&c.settled, sample);
        possible.retain(|c| nearest.is_some_and(|nearest| off(c) - off(nearest) <= known(c).hypot(known(nearest))));
    }
    let widest = possible.iter().copied().max_by(|a, b| a.coverage.total_cmp(&b.coverage)).copied();
    possible.retain(|c| widest.is_some_and(|widest| c.coverage >= widest.coverage - COVERAGE_LEAD));
    match possible.as_slice() {
        [] => Choice::None,
        [first, second, ..] if second.coverage >= COVERAGE_MIN => Choice::Two(**first, **second),
        [first, ..] => Choice::One(**first),
    }
}

/// Standard uncertainty of a candidate's radius, for independent points of the sample.
fn radius_uncertainty(settled: &Settled, sample: &Sample) -> f64 {
    let Settled { cylinder, sigma } = *settled;
    let sums = total(sample, &cylinder, statistics::TUKEY_C * sigma);
    normal_equations::invert(&sums.normal).map_or(f64::INFINITY, |inverse| {
        let [.., variance]: [f64; 5] = inverse.diagonal().into();
        sigma * f64::max(variance, 0.0).sqrt()
    })
}

/// A cylinder that the points of a sample agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Settled {
    pub(super) cylinder: Cylinder,
    /// Robust standard deviation of the points on it, mm.
    pub(super) sigma: f64,
}

const ROUNDS_MAX: usize = 60;
/// The window never shrinks faster than this in one round, so that the fit can follow.
const SHRINK: f64 = 0.5;
/// A spread below this share of the radius is rounding.
const SPREAD_FLOOR: f64 = 1e-11;

/// Settles from `start`, beginning with the points within `window` mm of it.
pub(super) fn settle(sample: &Sample, start: Cylinder, window: f64, constraint: RadiusConstraint) -> Option<Settled> {
    let (mut cylinder, mut window) = (start, window);
    let mut sigma = window / statistics::TUKEY_C;
    let (mut squared, mut scratch) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS_MAX {
        let sums = total(sample, &cylinder, window);
        let (normal, gradient) = normal_equations::system(&sums, constraint, sigma, cylinder.radius);
        let step = normal_equations::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        squared_distances_within(sample, &cylinder, window, &mut squared);
        sigma = statistics::sigma(&squared, &mut scratch).max(SPREAD_FLOOR * cylinder.radius).max(sample.resolution());
        let narrowed = (statistics::TUKEY_C * sigma).clamp(window * SHRINK, window);
        // The step in units of its own standard deviation.
        let moved = (normal * step).dot(&step).abs().sqrt();
        let settled = moved < 1e-3 * sigma && narrowed > window * 0.999;
        window = narrowed;
        if settled {
            break;
        }
    }
    Some(Settled { cylinder, sigma })
}

/// Sums over the points of a sample within `window` mm of the cylinder.
pub(super) fn total(sample: &Sample, cylinder: &Cylinder, window: f64) -> Sums {
    let view = cylinder.facing(ANY_DIRECTION);
    let mut sums = Sums::zero();
    for station in &sample.stations {
        sums.add(&sample.profile(station).sums(&view, window * window, Curvature::Weight));
    }
    view.unturned(&sums)
}

fn squared_distances_within(sample: &Sample, cylinder: &Cylinder, window: f64, squared: &mut Vec<f64>) {
    squared.clear();
    let view = cylinder.facing(ANY_DIRECTION);
    for station in &sample.stations {
        sample.profile(station).squared_distances(&view, |found| {
            squared.extend(found.iter().filter(|d2| **d2 < window * window));
        });
    }
}

/// Half of the window in units of the noise. It is narrower than Tukey's for efficiency, because it only affects the choice of a
/// surface.
pub(super) const WINDOW: f64 = 3.0;
const NARROWINGS_MAX: usize = 40;
/// The window shrinks by this in one round.
const NARROWING: f64 = 0.7;
/// A step below this share of its own standard deviation ends the iteration.
const STEP_SHARE_MIN: f64 = 1e-3;

/// Narrows from `start` to the noise `sigma`, beginning with the points within `window` mm of it.
pub(super) fn narrow(
    sample: &Sample,
    start: Cylinder,
    window: f64,
    sigma: f64,
    constraint: RadiusConstraint,
) -> Option<Settled> {
    let (mut cylinder, mut window, least) = (start, window, WINDOW * sigma);
    for _ in 0..NARROWINGS_MAX {
        let sums = total(sample, &cylinder, window);
        let (normal, gradient) = normal_equations::system(&sums, constraint, sigma, cylinder.radius);
        let step = normal_equations::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        let moved = (normal * step).dot(&step).abs().sqrt();
        if moved < STEP_SHARE_MIN * sigma && window <= least {
            break;
        }
        window = (NARROWING * window).max(least);
    }
    Some(Settled { cylinder, sigma })
}
