//! The joint fit over every point of every profile by Newton's method.
//!
//! A sample's start is off by many standard deviations of the final fit, so one step over some of the profiles brings it
//! near first; from there one pass over all points is usually enough. What a Newton step leaves is the curvature of the
//! gradient, ½ Σ ψ″ (J·step)² J: in standard deviations at most ½ |ψ″|σ · m²/√Σw for a step of m of them. ½ |ψ″|σ is 0.38 at
//! the worst distance from the surface and averages to nothing over both sides; 0.1 is as if a quarter of all points lay at
//! the worst distance on one side. So a step is the last when that is below a hundredth, and the gradients and counts of its
//! pass serve for the profiles: the gradients corrected to first order, the counts as they are, for such a step moves the
//! surface by a few hundredths of σ at most.

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
    /// The stations that serve.
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
    /// Of (p, q, y_ref, z_ref, R), and the degrees of freedom of its variances.
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: Vector5<f64>,
    /// One a station, at the solution.
    pub(super) profiles: Vec<Sums>,
    /// The inliers within ε of it, one entry a station.
    pub(super) inner: Vec<Inner>,
    /// Passes over all points.
    pub(super) passes_count: u32,
    /// Covariance of (p, q, y_ref, z_ref, R) by what neighbouring parts of the surface share, where they do.
    pub(super) field: Option<Matrix5<f64>>,
}

impl Solution {
    /// Σ over all profiles.
    pub(super) fn total(&self) -> Sums {
        let mut total = Sums::zero();
        self.profiles.iter().for_each(|profile| total.add(profile));
        total
    }

    /// The change of (p, q, y_ref, z_ref, R) by a gradient: the inverse of the normal matrix; `None` where it is singular.
    pub(super) fn bread(&self, constraint: RadiusConstraint) -> Option<Matrix5<f64>> {
        normal_equations::invert(
            &normal_equations::system(&self.total(), constraint, self.sigma, self.cylinder.radius).0,
        )
    }
}

const STEPS_MAX: u32 = 10;
/// The error that a step leaves, in units of its own standard deviation, below which another step would change nothing.
const SETTLED: f64 = 1e-2;
/// ½ |ψ″| σ, averaged over the points.
const CURVED: f64 = 0.1;
/// At most so many profiles of a scan, and so many points of each, are used to locate the part.
const SEEN_PROFILES: usize = 256;
const SEEN_POINTS: usize = 32;
/// Points of a first step, in units of √n: its five unknowns lie √(5n/m) standard deviations from where all n points put
/// them, so the next step is the last from m = 5 CURVED/SETTLED·√n on, and not all points are on the part.
const FEW: f64 = 90.0;
/// Profiles of the first step at least.
const FEW_PROFILES_MIN: usize = 32;
/// Stations in one piece of work: fixed, so that sums do not depend on threads.
const CHUNK: usize = 16;

/// Solves from what a sample settled on.
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

/// The error that a step of the squared length `moved2` leaves, both in standard deviations, with the weight Σw.
fn left(moved2: f64, weight: f64) -> f64 {
    (CURVED * moved2 / weight.max(1.0).sqrt()).min(moved2.sqrt())
}

fn serving<'a>(problem: &Problem<'a>) -> Vec<&'a Station> {
    let stations = problem.scan.stations().iter().zip(problem.used);
    stations.filter(|(_, used)| **used).map(|(station, _)| station).collect()
}

/// Mean x of some points on the start, where position and slopes are nearly uncorrelated, and the direction in which the
/// axis sees them.
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

/// One step over some of the profiles, evenly spread; `None` where that would not pay or not help.
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
