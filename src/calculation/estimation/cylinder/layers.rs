//! Layers close to the surface: tape, a weld bead, a thin clamp, nearly as low as the noise. A single point does not show whether
//! it belongs to the part, but averages over patches do. Returns the fit without the points in layers, or the reason why the part
//! is undetermined.
//!
//! If the averages scatter no more than differences between neighbours suggest, and none is far off, the fit remains as it is.
//! Otherwise the surfaces are searched again among the averages, with the same consensus and the same choice. Patches off the part
//! are removed, those next to them with half of the tolerance, and the remaining points are fitted once more.
//!
//! Two deviations are not layers and are subtracted first: a form deviation of the part, which is smooth while a layer has edges,
//! and the drift of a stage, which shifts whole profiles. A polynomial of the fourth degree along the arc and the second along x
//! follows an oval, a taper and a bow to a few hundredths of their height. It does not follow a step: a step in the middle leaves a
//! fifth of its height.

use super::candidates::{self, COVERAGE_MIN, Candidate, Choice, Noise, Settled};
use super::consensus::Bounds;
use super::field;
use super::model::Cylinder;
use super::patches::{self, Averages, Cut, Patch, Surface};
use super::pieces::Subset;
use super::solve::{self, Problem, Solution};
use crate::estimation::statistics;
use crate::scan::Scan;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// Points within this many cut-offs of the fit are averaged.
const REACH: f64 = 1.5;
/// A layer is suspected if averages scatter by more than this factor times the differences of neighbours,
const SUSPICIOUS: f64 = 1.5;
/// or if more than this share of them is far off.
const OFF_SHARE: f64 = 0.005;
/// A quarter of normal noise lies within this many standard deviations.
const QUARTER_TO_SIGMA: f64 = 0.3186;
/// If a larger share of the surface lies in layers, the remainder may be a layer as well.
const LAYER_RATIO_MAX: f64 = 0.3;
/// Averages of many points show every form deviation of a real part; one below this share of the points' noise is not treated as a
/// layer.
const SCATTER_MIN: f64 = 0.3;
/// An average is off beyond this many of the averages' standard deviations,
const OFF: f64 = 3.5;
/// or beyond half of that if a neighbour is off.
const OFF_BESIDE: f64 = 1.75;
/// Tolerance about a start among the averages, in units of their scatter.
const TOLERANCE: f64 = 3.0;
/// Number of points of a patch.
const POINTS_WANTED: usize = 12;
const ROUNDS: usize = 3;

/// The result for the fit.
pub(super) enum Verdict {
    /// The fit stays as it is.
    Unchanged,
    /// Fitted again without the layers.
    Mended(Box<Solution>),
    /// Two surfaces could be the part.
    Two(Candidate, Candidate),
    /// The share in layers is so large that the remainder may be a layer or a mixture of both.
    Undecided { layer_ratio: f64, reach_mm: f64 },
}

/// Finds layers near the fit and removes them.
pub(super) fn mend(
    problem: &Problem<'_>,
    fit: &Solution,
    bounds: &Bounds,
    nominal_radius: Option<f64>,
    surface: &Surface,
) -> Verdict {
    let Some(averages) = surface.average(Cut::Points(POINTS_WANTED)) else { return Verdict::Unchanged };
    let constraint = problem.constraint;
    let own = own_scatter(&averages).max(SCATTER_MIN * fit.sigma);
    if !suspicious(&averages, own) || explained(&averages, own) {
        return Verdict::Unchanged;
    }
    let sample = averages.sample();
    let closer = Bounds { tolerance: TOLERANCE * own, ..*bounds };
    let found = candidates::candidates(&sample, &closer, Noise::Known(own), constraint);
    let part = match candidates::choose(&found, nominal_radius, &sample) {
        // A surface that is not on most profiles is not the part; whole profiles that are off are not layers.
        Choice::One(candidate) if candidate.coverage < COVERAGE_MIN => return Verdict::Unchanged,
        Choice::One(candidate) => candidate.settled,
        Choice::Two(a, b) => return Verdict::Two(a, b),
        Choice::None => return Verdict::Unchanged,
    };
    let off = off(&averages, &part);
    let layer_ratio = off.iter().filter(|off| **off).count() as f64 / averages.patches.iter().flatten().count() as f64;
    if layer_ratio > LAYER_RATIO_MAX || rough(&averages, &part, own) {
        // If the part is certain, the fit remains as it is: the field covers the uncertainty from the layers.
        return match nominal_radius {
            Some(_) => Verdict::Unchanged,
            None => Verdict::Undecided { layer_ratio, reach_mm: reach(fit) },
        };
    }
    refit(problem, fit, &part, &averages, &off).map_or(Verdict::Unchanged, |mended| Verdict::Mended(Box::new(mended)))
}

fn reach(fit: &Solution) -> f64 {
    REACH * statistics::TUKEY_C * fit.sigma
}

/// The points near the fit; `None` if there are none.
pub(super) fn look(problem: &Problem<'_>, fit: &Solution) -> Option<Surface> {
    patches::look(problem.scan, problem.used, &fit.cylinder, reach(fit))
}

/// Whether the averages, after subtraction of a smooth form of the part or of shifts of profiles, scatter no more than their own
/// scatter.
fn explained(averages: &Averages, own: f64) -> bool {
    let level = without_shifts(averages);
    let without = without_form(averages);
    !suspicious(&level, own) || without.is_some_and(|without| !suspicious(&without, own))
}

/// The scatter of the averages themselves: the larger of the differences of neighbours along the arc and along x. Along x vibration
/// shifts whole profiles, which is not a layer.
fn own_scatter(averages: &Averages) -> f64 {
    scatter_along_arc(averages).max(lower_sigma(averages.squared_differences_along_x()))
}

/// The difference of neighbours along the arc, as a standard deviation of one average.
fn scatter_along_arc(averages: &Averages) -> f64 {
    statistics::sigma(&averages.squared_differences_along_arc(), &mut Vec::new())
}

/// Robust standard deviation from the lower quarter, which clamps on part of the length do not affect.
fn lower_sigma(mut squared: Vec<f64>) -> f64 {
    let quarter = squared.len() / 4;
    if squared.is_empty() {
        return 0.0;
    }
    let (_, lower, _) = squared.select_nth_unstable_by(quarter, f64::total_cmp);
    lower.sqrt() / QUARTER_TO_SIGMA
}

/// Whether the averages on the part scatter more than their own scatter, which indicates a mixture of two surfaces.
fn rough(averages: &Averages, part: &Settled, own: f64) -> bool {
    let squared = averages.patches.iter().flatten().map(|patch| {
        let [y, z] = averages.grid.point(patch.x, patch);
        part.cylinder.slice(patch.x).distance(y, z).powi(2)
    });
    let on: Vec<f64> = squared.filter(|d2| *d2 < (OFF * own).powi(2)).collect();
    statistics::sigma(&on, &mut Vec::new()) > SUSPICIOUS * own
}

fn suspicious(averages: &Averages, own: f64) -> bool {
    let squared: Vec<f64> = averages.patches.iter().flatten().map(|patch| patch.d * patch.d).collect();
    let scatter = statistics::sigma(&squared, &mut Vec::new());
    let limit = OFF * scatter.min(SUSPICIOUS * own);
    let far = |patch: &Option<Patch>| patch.as_ref().is_some_and(|p| p.d * p.d * p.share > limit * limit);
    let far: Vec<bool> = averages.patches.iter().map(far).collect();
    // A layer is larger than a patch, while a spike displaces a single patch.
    let together = |index: &usize| neighbours(averages, *index).any(|beside| far.get(beside) == Some(&true));
    let far_count = far.iter().enumerate().filter(|(_, far)| **far).filter(|(index, _)| together(index)).count();
    scatter > SUSPICIOUS * own || far_count as f64 > OFF_SHARE * squared.len() as f64
}

/// The patches next to one, along the arc and along x.
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

/// Fits the points without the patches that are off.
fn refit(problem: &Problem<'_>, fit: &Solution, part: &Settled, averages: &Averages, off: &[bool]) -> Option<Solution> {
    let Problem { scan, used, constraint, .. } = *problem;
    let reach = reach(fit);
    let rest = Subset::of(scan, used, |index, station| {
        let slice = fit.cylinder.slice(station.x);
        move |[x, y, z]| {
            let slice = slice.at(x);
            let is_off = off.get(averages.grid.place(index, &slice, y, z)).copied().unwrap_or(true);
            slice.distance(y, z).abs() < reach && !is_off
        }
    })?;
    let sigma = scatter(&rest.scan, &part.cylinder, fit.sigma);
    let uncounted = problem.progress.uncounted();
    let rest_problem = Problem { scan: &rest.scan, used: &rest.used, progress: &uncounted, ..*problem };
    let mut solution = solve::solve(&rest_problem, &Settled { cylinder: part.cylinder, sigma })?;
    solution.field = look(&rest_problem, &solution).and_then(|left| field::covariance(&left, &solution, constraint));
    Some(rest.restore(solution))
}

/// Robust spread of the remaining points about the part.
fn scatter(rest: &Scan, part: &Cylinder, widest: f64) -> f64 {
    let (mut squared, mut scratch) = (Vec::new(), Vec::new());
    for station in rest.stations() {
        let slice = part.slice(station.x);
        squared.extend(rest.points_of(station).map(|[x, y, z]| slice.at(x).distance(y, z).powi(2)));
    }
    let mut sigma = widest;
    for _ in 0..ROUNDS {
        squared.retain(|d2| *d2 < statistics::cut_off_squared(sigma));
        sigma = statistics::sigma(&squared, &mut scratch).min(widest);
    }
    sigma
}

const ALONG_ARC: usize = 5;
const ALONG_X: usize = 3;
const TERMS: usize = ALONG_ARC * ALONG_X;
/// With fewer patches for each term the polynomial follows the noise.
const PATCHES_A_TERM: usize = 4;

/// The averages after subtraction of the form that a polynomial finds in them; `None` if they are too few.
pub(super) fn without_form(averages: &Averages) -> Option<Averages> {
    let patches = || averages.patches.iter().flatten();
    if patches().count() < PATCHES_A_TERM * TERMS {
        return None;
    }
    let [x, angle] = [range(patches().map(|patch| patch.x))?, range(patches().map(|patch| patch.angle))?];
    let terms = |patch: &Patch| terms(unit(patch.x, x), unit(patch.angle, angle));
    let (mut normal, mut right) = (SMatrix::<f64, TERMS, TERMS>::zeros(), SVector::<f64, TERMS>::zeros());
    for patch in patches() {
        let row = terms(patch);
        normal += row * row.transpose() * patch.share;
        right += row * (patch.d * patch.share);
    }
    let form = normal.cholesky()?.solve(&right);
    let left = |patch: &Patch| Patch { d: patch.d - terms(patch).dot(&form), ..*patch };
    let patches = averages.patches.iter().map(|patch| patch.as_ref().map(left)).collect();
    Some(Averages { grid: averages.grid.clone(), patches })
}

/// The averages after subtraction of the shift in y and in z of each block of profiles.
pub(super) fn without_shifts(averages: &Averages) -> Averages {
    let direction = |patch: &Patch| Vector2::new(patch.angle.cos(), patch.angle.sin());
    let mut patches = Vec::with_capacity(averages.patches.len());
    for block in averages.patches.chunks(averages.grid.sectors().max(1)) {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for patch in block.iter().flatten() {
            let row = direction(patch);
            normal += row * row.transpose() * patch.share;
            right += row * (patch.d * patch.share);
        }
        // A block with too few points remains unchanged.
        let shift = normal.cholesky().map_or_else(Vector2::zeros, |normal| normal.solve(&right));
        let left = |patch: &Patch| Patch { d: patch.d - direction(patch).dot(&shift), ..*patch };
        patches.extend(block.iter().map(|patch| patch.as_ref().map(left)));
    }
    Averages { grid: averages.grid.clone(), patches }
}

fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    let ends = |[low, high]: [f64; 2], v: f64| [low.min(v), high.max(v)];
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], ends);
    (high > low).then_some([low, high])
}

/// Maps the range to −1 … 1.
fn unit(value: f64, [low, high]: [f64; 2]) -> f64 {
    (2.0 * value - low - high) / (high - low)
}

/// Products of Chebyshev polynomials, T_k = cos(k arccos t).
fn terms(x: f64, angle: f64) -> SVector<f64, TERMS> {
    let chebyshev = |degree: usize, t: f64| (degree as f64 * t.clamp(-1.0, 1.0).acos()).cos();
    SVector::from_fn(|index, _| chebyshev(index % ALONG_ARC, angle) * chebyshev(index / ALONG_ARC, x))
}
