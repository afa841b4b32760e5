//! Layers close to the surface: tape, a weld bead, a thin jaw, nearly as high as the noise. No single point tells them from
//! the part, averages over patches do. In: the fit. Out: the fit without what lies in layers, or why nobody can tell.
//! Must not know how a fit is made.
//!
//! Averages that scatter no more than their neighbours make likely, and none far off, leave the fit as it is. Otherwise the
//! surfaces are looked for again, among the averages, by the same consensus and with the same choice; patches off the part
//! are taken out, those beside them with half of the patience, and the points that are left are fitted once more.

use super::areas;
use super::candidates::{self, COVERAGE_MIN, Candidate, Choice, Noise};
use super::consensus::Bounds;
use super::extent;
use super::model::Cylinder;
use super::patches::{self, Averages, Cut, Patch, Surface};
use super::readings;
use super::repeats;
use super::resample;
use super::rest::Rest;
use super::settle::Settled;
use super::smooth;
use super::solve::{self, Problem, Solution};
use super::step::Hold;
use crate::estimation::{Progress, robust};
use crate::scan::Scan;
use nalgebra::Vector5;
use std::borrow::Cow;

/// Points within so many cut-offs of the fit are averaged.
const REACH: f64 = 1.5;
/// Averages may scatter by this much more than neighbours differ before a layer is suspected,
const SUSPICIOUS: f64 = 1.5;
/// and this share of them may be far off by chance.
const OFF_SHARE: f64 = 0.005;
/// A quarter of normal noise lies within this many standard deviations.
const QUARTER_TO_SIGMA: f64 = 0.3186;
/// Where more than this share of the surface lies in layers, what is left is not certain to be the part.
const LAYER_RATIO_MAX: f64 = 0.3;
/// Another reading of a mixture of surfaces is on this share of the profiles at least.
const RIVAL_COVERAGE: f64 = 0.5;
/// Averages of many points show every deviation of a real part's form; below this share of the points' noise it is no layer.
const SCATTER_MIN: f64 = 0.3;
/// Far off is an average beyond so many of their standard deviations,
const OFF: f64 = 3.5;
/// or half of that beside one that is.
const OFF_BESIDE: f64 = 1.75;
/// What is near a start among the averages, in what they scatter by for themselves.
const TOLERANCE: f64 = 3.0;
/// Points that make a patch.
const POINTS_WANTED: usize = 12;
const ROUNDS: usize = 3;
/// Where y_ref and, behind it, z_ref stand among the parameters.
const Y_REF: usize = 2;
/// A shift of the profile follows about half of a layer's height.
const LEVELLED: f64 = 2.0;

/// What became of the fit.
pub(super) enum Verdict {
    /// No layer.
    Clean,
    /// Fitted again without the layers.
    Mended(Box<Solution>),
    /// Left as it is: the nominal radius vouches for the part, but not for what of it lies in layers.
    Open { rivals: Vec<Vector5<f64>> },
    /// Two surfaces could be the part.
    Two(Candidate, Candidate),
    /// So much lies in layers that what is left may be one, too, or a mixture of both.
    Undecided { layer_ratio: f64, reach_mm: f64 },
}

/// Looks for layers about the fit, and takes them out.
pub(super) fn mend(
    problem: &Problem<'_>,
    fit: &Solution,
    surface: Option<&Surface>,
    bounds: &Bounds,
    nominal_radius: Option<f64>,
) -> Verdict {
    let mut verdict = Verdict::Clean;
    let mut rivals = Vec::new();
    let mut surface = surface.map(Cow::Borrowed);
    if let Some(averages) = surface.as_ref().and_then(|surface| surface.average(Cut::Points(POINTS_WANTED))) {
        match mend_at(problem, fit, bounds, nominal_radius, &averages) {
            Verdict::Clean => {}
            Verdict::Open { rivals: readings } => rivals.extend(readings),
            Verdict::Mended(mended) => {
                surface = look(problem, &mended).map(Cow::Owned);
                verdict = Verdict::Mended(mended);
            }
            refused @ (Verdict::Two(..) | Verdict::Undecided { .. }) => return refused,
        }
    }
    let base: &Solution = if let Verdict::Mended(mended) = &verdict { mended } else { fit };
    if let Some(surface) = surface.as_deref() {
        let mut low_readings = readings::lower(surface, &base.cylinder, problem.hold, base.sigma);
        // What is taken out would repeat; of what is left it was asked before.
        let (asked, answered) = match &verdict {
            Verdict::Mended(mended) => (false, !mended.rivals.is_empty()),
            _ => (true, false),
        };
        let excess = beyond_roughness(base, problem.roughness);
        let height = if asked { repeating(base, surface, excess) } else { None };
        if !answered && (height.is_some() || !rivals.is_empty() || !low_readings.is_empty()) {
            low_readings.extend(low(problem.hold, base, surface, excess.max(height.unwrap_or(0.0))));
        }
        let resampled = if low_readings.is_empty() { None } else { resample::standard(surface, base, problem.hold) };
        // They answer one question in several ways, so the worst of them counts, not their sum.
        let bounded = low_readings.into_iter().map(|reading| resample::bounded(reading, resampled.as_ref()));
        let aside = |reading: &Vector5<f64>| reading.fixed_rows::<2>(Y_REF).norm();
        rivals.extend(bounded.max_by(|one, other| aside(one).total_cmp(&aside(other))));
    }
    match verdict {
        verdict if rivals.is_empty() => verdict,
        Verdict::Mended(mended) => {
            rivals.extend(&mended.rivals);
            Verdict::Mended(Box::new(Solution { rivals, ..*mended }))
        }
        _ => Verdict::Open { rivals },
    }
}

/// How high a layer is that profiles repeat, where they do.
fn repeating(fit: &Solution, surface: &Surface, excess: f64) -> Option<f64> {
    let repeated = repeats::repeated(surface, robust::TUKEY_C * fit.sigma);
    repeated.tells(excess / fit.sigma).then_some(LEVELLED * repeated.shared)
}

/// What a layer does to the fit by which points scatter so much more.
fn low(hold: Hold, fit: &Solution, surface: &Surface, scatter: f64) -> Option<Vector5<f64>> {
    // Half of the points above the middle and half below scatter by half of the height.
    readings::beside(surface, &fit.cylinder, hold, fit.sigma, 2.0 * scatter)
}

/// What points scatter by beyond their own roughness, mm; 0 where chance may be all of it.
fn beyond_roughness(fit: &Solution, roughness: f64) -> f64 {
    let excess = (fit.sigma.powi(2) - roughness.powi(2)).max(0.0).sqrt();
    if excess > repeats::ROUGHER * fit.sigma { excess } else { 0.0 }
}

fn reach(fit: &Solution) -> f64 {
    REACH * robust::TUKEY_C * fit.sigma
}

/// What is near the fit; `None` where nothing is.
pub(super) fn look(problem: &Problem<'_>, fit: &Solution) -> Option<Surface> {
    patches::look(problem.scan, problem.used, &fit.cylinder, reach(fit))
}

fn mend_at(
    problem: &Problem<'_>,
    fit: &Solution,
    bounds: &Bounds,
    nominal_radius: Option<f64>,
    averages: &Averages,
) -> Verdict {
    let hold = problem.hold;
    let own = own_scatter(averages).max(SCATTER_MIN * fit.sigma);
    if !suspicious(averages, own) || explained(averages, own) {
        return Verdict::Clean;
    }
    let sample = averages.sample();
    let finer = Bounds { tolerance: TOLERANCE * own, ..*bounds };
    let found = candidates::candidates(&sample, &finer, Noise::Known(own), hold);
    let part = match candidates::choose(&found, nominal_radius, &sample) {
        // What is not on most profiles is not the part; whole profiles that are off are no layers.
        Choice::One(candidate) if candidate.coverage < COVERAGE_MIN => return Verdict::Clean,
        Choice::One(candidate) => candidate.settled,
        Choice::Two(a, b) => return Verdict::Two(a, b),
        Choice::None => return Verdict::Clean,
    };
    let off = off(averages, &part);
    let layer_ratio = off.iter().filter(|off| **off).count() as f64 / averages.patches.iter().flatten().count() as f64;
    if layer_ratio > LAYER_RATIO_MAX || rough(averages, &part, own) {
        // A part that is known to be there is answered as it is fitted, with the other readings in the uncertainty.
        return match nominal_radius {
            Some(_) => Verdict::Open { rivals: rival_readings(fit, &part, &found) },
            None => Verdict::Undecided { layer_ratio, reach_mm: reach(fit) },
        };
    }
    refit(problem, fit, &part, averages, &off).map_or(Verdict::Clean, |mended| Verdict::Mended(Box::new(mended)))
}

/// How far the fit is from the readings that a mixture of surfaces allows.
fn rival_readings(fit: &Solution, part: &Settled, found: &[Candidate]) -> Vec<Vector5<f64>> {
    let shown = found.iter().filter(|other| other.coverage >= RIVAL_COVERAGE && other.settled != *part);
    let readings = shown.map(|other| other.settled);
    readings.chain([*part]).map(|reading| fit.cylinder.to(&reading.cylinder)).collect()
}

/// Whether the averages, without a smooth form of the part, scatter as they do for themselves.
pub(super) fn smooth(averages: &Averages) -> bool {
    explained(averages, own_scatter(averages))
}

fn explained(averages: &Averages, own: f64) -> bool {
    let level = smooth::without_shifts(averages);
    let without = smooth::without_form(averages);
    !suspicious(&level, own) || without.is_some_and(|without| !suspicious(&without, own))
}

/// What averages scatter by for themselves: the larger of what neighbours along the arc and along x differ by. Along x
/// whole profiles may be off (vibration), which is no layer.
pub(super) fn own_scatter(averages: &Averages) -> f64 {
    scatter_along_arc(averages).max(lower_sigma(averages.squared_differences_along_x()))
}

/// What neighbours along the arc differ by, as a standard deviation of one average.
pub(super) fn scatter_along_arc(averages: &Averages) -> f64 {
    robust::sigma(&averages.squared_differences_along_arc(), &mut Vec::new())
}

/// Robust standard deviation by the lower quarter: clamps that come and go along x leave it alone.
pub(super) fn lower_sigma(mut squared: Vec<f64>) -> f64 {
    let quarter = squared.len() / 4;
    if squared.is_empty() {
        return 0.0;
    }
    let (_, lower, _) = squared.select_nth_unstable_by(quarter, f64::total_cmp);
    lower.sqrt() / QUARTER_TO_SIGMA
}

/// Whether the averages on the part scatter more than they do for themselves: a mixture of two surfaces.
fn rough(averages: &Averages, part: &Settled, own: f64) -> bool {
    let squared = averages.patches.iter().flatten().map(|patch| {
        let [y, z] = averages.grid.point(patch.x, patch);
        part.cylinder.slice(patch.x).distance(y, z).powi(2)
    });
    let on: Vec<f64> = squared.filter(|d2| *d2 < (OFF * own).powi(2)).collect();
    robust::sigma(&on, &mut Vec::new()) > SUSPICIOUS * own
}

fn suspicious(averages: &Averages, own: f64) -> bool {
    let squared: Vec<f64> = averages.patches.iter().flatten().map(|patch| patch.d * patch.d).collect();
    let scatter = robust::sigma(&squared, &mut Vec::new());
    let limit = OFF * scatter.min(SUSPICIOUS * own);
    let far = |patch: &Option<Patch>| patch.as_ref().is_some_and(|p| p.d * p.d * p.share > limit * limit);
    let far: Vec<bool> = averages.patches.iter().map(far).collect();
    // A layer is larger than a patch; a spike makes one patch far by itself.
    let together = |index: &usize| neighbours(averages, *index).any(|beside| far.get(beside) == Some(&true));
    let far_count = far.iter().enumerate().filter(|(_, far)| **far).filter(|(index, _)| together(index)).count();
    scatter > SUSPICIOUS * own || far_count as f64 > OFF_SHARE * squared.len() as f64
}

/// The patches beside one, along the arc and along x.
fn neighbours(averages: &Averages, index: usize) -> impl Iterator<Item = usize> {
    let (sectors, column) = (averages.grid.sectors(), index % averages.grid.sectors().max(1));
    let along_arc = [(column > 0).then(|| index - 1), (column + 1 < sectors).then_some(index + 1)];
    let along_x = [index.checked_sub(sectors), Some(index + sectors)];
    along_arc.into_iter().chain(along_x).flatten()
}

/// Which patches lie off the part.
fn off(averages: &Averages, part: &Settled) -> Vec<bool> {
    let distance = |patch: &Patch| {
        let [y, z] = averages.grid.point(patch.x, patch);
        part.cylinder.slice(patch.x).distance(y, z).abs() * patch.share.sqrt() / part.sigma
    };
    let distances: Vec<Option<f64>> = averages.patches.iter().map(|patch| patch.as_ref().map(distance)).collect();
    let far = |index: usize| distances.get(index).is_some_and(|d| d.is_some_and(|d| d > OFF));
    let beside = |index: usize| neighbours(averages, index).any(far);
    let off = |(index, d): (usize, &Option<f64>)| d.is_some_and(|d| d > OFF || (d > OFF_BESIDE && beside(index)));
    distances.iter().enumerate().map(off).collect()
}

/// Fits what is left without the patches that are off.
fn refit(problem: &Problem<'_>, fit: &Solution, part: &Settled, averages: &Averages, off: &[bool]) -> Option<Solution> {
    let Problem { scan, used, hold, .. } = *problem;
    let reach = reach(fit);
    let rest = Rest::of(scan, used, |index, station| {
        let slice = fit.cylinder.slice(station.x);
        move |[x, y, z]| {
            let slice = slice.at(x);
            let is_off = off.get(averages.grid.place(index, &slice, y, z)).copied().unwrap_or(true);
            slice.distance(y, z).abs() < reach && !is_off
        }
    })?;
    let sigma = scatter(&rest.scan, &part.cylinder, fit.sigma);
    let silent = Progress::default();
    let roughness = extent::roughness(&rest.scan);
    let rest_problem = Problem { scan: &rest.scan, used: &rest.used, roughness, progress: &silent, ..*problem };
    let mut solution = solve::solve(&rest_problem, &Settled { cylinder: part.cylinder, sigma })?;
    if let Some(left) = look(&rest_problem, &solution) {
        areas::widen(&rest_problem, &left, &mut solution);
        let excess = beyond_roughness(&solution, roughness);
        let height = repeating(&solution, &left, excess);
        if let Some(reading) = height.and_then(|height| low(hold, &solution, &left, excess.max(height))) {
            let resampled = resample::standard(&left, &solution, hold);
            solution.rivals.push(resample::bounded(reading, resampled.as_ref()));
        }
    }
    Some(rest.restore(solution))
}

/// Robust spread of the points that are left about the part.
fn scatter(rest: &Scan, part: &Cylinder, widest: f64) -> f64 {
    let (mut squared, mut scratch) = (Vec::new(), Vec::new());
    for station in rest.stations() {
        let slice = part.slice(station.x);
        squared.extend(rest.points_of(station).map(|[x, y, z]| slice.at(x).distance(y, z).powi(2)));
    }
    let mut sigma = widest;
    for _ in 0..ROUNDS {
        squared.retain(|d2| *d2 < robust::cut_off_squared(sigma));
        sigma = robust::sigma(&squared, &mut scratch).min(widest);
    }
    sigma
}
