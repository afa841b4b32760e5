//! The joint fit over every point of every profile by Newton's method.
//!
//! A sample's start is off by many standard deviations of the final fit, so a step over some of the profiles first brings it near
//! the solution; from there one pass over all points is usually enough. The remaining error of a Newton step comes from the
//! curvature of the gradient, ½ Σ ψ″ (J·step)² J: in standard deviations at most ½ |ψ″|σ · m²/√Σw for a step of m of them. ½ |ψ″|σ
//! is 0.38 at the worst distance from the surface and averages to zero over both sides; 0.1 corresponds to a quarter of all points
//! at the worst distance on one side. A step is the last if that error is below a hundredth. The gradients and counts of its pass
//! are then used for the profiles: the gradients corrected to first order, the counts unchanged, because the step moves the surface
//! by a few hundredths of σ at most.

use super::candidates::Settled;
use super::covariance::{Scatter, over_runs, sandwich};
use super::kernel::{Curvature, Inner};
use super::model::{Cylinder, View};
use super::normal_equations::{self, RadiusConstraint, Sums};
use super::sample::{ProfilePoints, spread};
use crate::estimation::progress::Progress;
use crate::estimation::statistics;
use crate::scan::{Grouping, Scan, Station};
use nalgebra::{Matrix5, Vector5};
use rayon::prelude::*;

/// The inputs of a fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Problem<'a> {
    pub(super) scan: &'a Scan,
    /// The stations that are used.
    pub(super) used: &'a [bool],
    pub(super) constraint: RadiusConstraint,
    /// Distance of an inlier, mm.
    pub(super) epsilon: f64,
    pub(super) progress: &'a Progress,
}

/// The fit, and each profile's share in it.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub(super) cylinder: Cylinder,
    pub(super) sigma: f64,
    /// Covariance of (p, q, y_ref, z_ref, R), and the degrees of freedom of its variances.
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: Vector5<f64>,
    /// The sums of each station at the solution.
    pub(super) profiles: Vec<Sums>,
    /// The inliers within ε of the solution, one entry a station.
    pub(super) inner: Vec<Inner>,
    /// Number of passes over all points.
    pub(super) passes_count: u32,
    /// Covariance of (p, q, y_ref, z_ref, R) from errors common to neighbouring parts of the surface, if there are any.
    pub(super) field: Option<Matrix5<f64>>,
}

impl Solution {
    /// Σ over all profiles.
    pub(super) fn total(&self) -> Sums {
        let mut total = Sums::zero();
        self.profiles.iter().for_each(|profile| total.add(profile));
        total
    }

    /// The change of (p, q, y_ref, z_ref, R) by a gradient: the inverse of the normal matrix; `None` if it is singular.
    pub(super) fn bread(&self, constraint: RadiusConstraint) -> Option<Matrix5<f64>> {
        normal_equations::invert(
            &normal_equations::system(&self.total(), constraint, self.sigma, self.cylinder.radius).0,
        )
    }
}

const STEPS_MAX: u32 = 10;
/// The remaining error of a step, in units of its own standard deviation, below which another step would have no effect.
const SETTLED: f64 = 1e-2;
/// ½ |ψ″| σ, averaged over the points.
const CURVED: f64 = 0.1;
/// The largest number of profiles of a scan, and of points of each, that are used to locate the part.
const SEEN_PROFILES: usize = 256;
const SEEN_POINTS: usize = 32;
/// Points of a first step, in units of √n. With m points its five unknowns lie √(5n/m) standard deviations from the solution for
/// all n points, so the next step is the last for m ≥ 5 CURVED/SETTLED·√n; some margin is added, since not all points are on the
/// part.
const FEW: f64 = 90.0;
/// Least number of profiles of the first step.
const FEW_PROFILES_MIN: usize = 32;
/// Stations in one unit of work: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 16;

/// Solves from the cylinder on which a sample settled.
pub(super) fn solve(problem: &Problem<'_>, start: &Settled) -> Option<Solution> {
    let sigma = start.sigma;
    let stations = serving(problem);
    let (x_ref, facing) = whereabouts(problem.scan, &stations, start);
    let mut cylinder = start.cylinder.about(x_ref);
    cylinder = nearer(problem, &stations, cylinder.facing(facing), sigma).unwrap_or(cylinder);
    for passes_count in 1..=STEPS_MAX {
        if problem.progress.is_stopped() {
            return None;
        }
        let progress = (passes_count == 1).then_some(problem.progress);
        let (mut profiles, inner) = pass(problem, &cylinder.facing(facing), sigma, progress);
        let mut sums = Sums::zero();
        profiles.iter().for_each(|profile| sums.add(profile));
        let (normal, gradient) = normal_equations::system(&sums, problem.constraint, sigma, cylinder.radius);
        let step = normal_equations::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        if left((normal * step).dot(&step).abs() / (sigma * sigma), sums.weight) < SETTLED {
            profiles.iter_mut().for_each(|profile| profile.gradient += profile.normal * step);
            let clustered = match problem.scan.grouping() {
                Grouping::Given | Grouping::SharedX => sandwich,
                Grouping::Slabs | Grouping::Chosen => over_runs,
            };
            let Scatter { covariance, freedom } = clustered(&normal, &profiles, problem.constraint)?;
            return Some(Solution { cylinder, sigma, covariance, freedom, profiles, inner, passes_count, field: None });
        }
    }
    None
}

/// The remaining error of a step of the squared length `moved2`, both in standard deviations, with the weight Σw.
fn left(moved2: f64, weight: f64) -> f64 {
    (CURVED * moved2 / weight.max(1.0).sqrt()).min(moved2.sqrt())
}

fn serving<'a>(problem: &Problem<'a>) -> Vec<&'a Station> {
    let stations = problem.scan.stations().iter().zip(problem.used);
    stations.filter(|(_, used)| **used).map(|(station, _)| station).collect()
}

/// Mean x of some points on the start, about which position and slopes are nearly uncorrelated, and their direction from the axis.
fn whereabouts(scan: &Scan, stations: &[&Station], start: &Settled) -> (f64, [f64; 2]) {
    let reach = statistics::TUKEY_C * start.sigma;
    let (mut x, mut count, mut towards) = (0.0, 0.0, [0.0; 2]);
    for station in spread(stations.len(), SEEN_PROFILES).filter_map(|index| stations.get(index)) {
        let slice = start.cylinder.slice(station.x);
        let places = spread(station.end - station.start, SEEN_POINTS).map(|place| station.start + place);
        for [own_x, y, z] in places.filter_map(|index| scan.point(station, index)) {
            let slice = slice.at(own_x);
            if slice.distance(y, z).abs() < reach {
                (x, count) = (x + own_x, count + 1.0);
                towards = [towards[0] + y - slice.y, towards[1] + z - slice.z];
            }
        }
    }
    (if count > 0.0 { x / count } else { start.cylinder.x_ref }, towards)
}

/// One step over some of the profiles, evenly spread; `None` if it would not save work or not converge.
fn nearer(problem: &Problem<'_>, stations: &[&Station], view: View, sigma: f64) -> Option<Cylinder> {
    let Problem { scan, constraint, .. } = *problem;
    let points_count: usize = stations.iter().map(|station| station.end - station.start).sum();
    let share = FEW / (points_count as f64).sqrt();
    let few = ((stations.len() as f64 * share).ceil() as usize).max(FEW_PROFILES_MIN);
    if 2 * few > stations.len() {
        return None;
    }
    let cut_off_squared = statistics::cut_off_squared(sigma);
    let profile = |station: &&Station| ProfilePoints::of(scan, station).sums(&view, cut_off_squared, Curvature::Slope);
    let chosen: Vec<&Station> = spread(stations.len(), few).filter_map(|index| stations.get(index).copied()).collect();
    let each: Vec<Sums> = chosen.par_iter().map(profile).collect();
    let mut sums = Sums::zero();
    each.iter().for_each(|profile| sums.add(profile));
    let (normal, gradient) = normal_equations::system(&view.unturned(&sums), constraint, sigma, view.cylinder().radius);
    let step: Vector5<f64> = normal_equations::solve(&normal, &gradient)?;
    view.cylinder().moved(&step)
}

/// One pass over all points.
fn pass(problem: &Problem<'_>, view: &View, sigma: f64, progress: Option<&Progress>) -> (Vec<Sums>, Vec<Inner>) {
    let cut_off_squared = statistics::cut_off_squared(sigma);
    let profile = |station: &Station| {
        let points = ProfilePoints::of(problem.scan, station);
        let (sums, inner) = points.sums_and_inner(view, cut_off_squared, problem.epsilon);
        (view.unturned(&sums), inner)
    };
    let work = |(stations, used): (&[Station], &[bool])| {
        let one = |(station, used): (&Station, &bool)| {
            if let Some(progress) = progress {
                progress.advance();
            }
            if *used && !problem.progress.is_stopped() { profile(station) } else { (Sums::zero(), Inner::none()) }
        };
        stations.iter().zip(used).map(one).collect::<Vec<_>>()
    };
    let stations = problem.scan.stations().par_chunks(CHUNK).zip(problem.used.par_chunks(CHUNK));
    stations.flat_map_iter(work).unzip()
}
