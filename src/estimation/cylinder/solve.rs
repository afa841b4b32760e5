//! The joint fit over every point of every profile by Newton's method.
//! Must not know how the start was found or what becomes of the profiles.

use super::covariance::sandwich;
use super::model::Cylinder;
use super::settle::Settled;
use super::step::{self, Hold};
use super::sums::{Curvature, Sums, Weighting, sum};
use crate::estimation::robust;
use crate::scan::{Scan, Station};
use nalgebra::Matrix5;
use rayon::prelude::*;

/// The fit, and each profile's share in it.
#[derive(Debug, Clone)]
pub(super) struct Solution {
    pub(super) cylinder: Cylinder,
    pub(super) sigma: f64,
    /// Of (p, q, y_ref, z_ref, R).
    pub(super) covariance: Matrix5<f64>,
    /// One a station, at the last step but one.
    pub(super) profiles: Vec<Sums>,
    /// Passes over all points.
    pub(super) passes_count: u32,
}

const STEPS_MAX: u32 = 10;
/// A step below this share of its own standard deviation changes nothing that could be told.
const SETTLED: f64 = 1e-2;
/// Points of a profile that decide how much it counts in the middle.
const MIDDLE_POINTS: usize = 32;
/// Stations in one piece of work: fixed, so that sums do not depend on threads.
const CHUNK: usize = 16;

/// Solves from what a sample settled on, with the stations that `used` marks.
pub(super) fn solve(scan: &Scan, used: &[bool], start: &Settled, hold: Hold) -> Option<Solution> {
    let (mut cylinder, sigma) = (start.cylinder.about(middle(scan, used, start)), start.sigma);
    for passes_count in 1..=STEPS_MAX {
        let profiles = pass(scan, used, &cylinder, sigma);
        let mut sums = Sums::zero();
        profiles.iter().for_each(|profile| sums.add(profile));
        let (normal, gradient) = step::system(&sums, hold, sigma, cylinder.radius);
        let step = step::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        if (normal * step).dot(&step).abs().sqrt() < SETTLED * sigma {
            let covariance = sandwich(&normal, &profiles, hold)?;
            return Some(Solution { cylinder, sigma, covariance, profiles, passes_count });
        }
    }
    None
}

/// Mean x of the points on the start, by a few of each profile: where position and slopes are nearly uncorrelated.
fn middle(scan: &Scan, used: &[bool], start: &Settled) -> f64 {
    let reach = robust::TUKEY_C * start.sigma;
    let (mut sum, mut count) = (0.0, 0.0);
    for (station, _) in scan.stations().iter().zip(used).filter(|(_, used)| **used) {
        let slice = start.cylinder.slice(station.x);
        let stride = ((station.end - station.start) / MIDDLE_POINTS).max(1);
        let points = (station.start..station.end).step_by(stride).filter_map(|index| scan.columns().get(index));
        let on = points.filter(|[y, z]| slice.distance(*y, *z).abs() < reach).count() as f64;
        (sum, count) = (sum + on * station.x, count + on);
    }
    if count > 0.0 { sum / count } else { start.cylinder.x_ref }
}

fn pass(scan: &Scan, used: &[bool], cylinder: &Cylinder, sigma: f64) -> Vec<Sums> {
    let weighting = Weighting { cut_off_squared: robust::cut_off_squared(sigma), curvature: Curvature::Slope };
    let work = |(stations, used): (&[Station], &[bool])| {
        let (mut y, mut z) = (Vec::new(), Vec::new());
        let mut profile = |station: &Station| {
            scan.load(*station, &mut y, &mut z);
            sum(cylinder, station.x, &y, &z, weighting)
        };
        let sums = stations.iter().zip(used).map(|(s, used)| if *used { profile(s) } else { Sums::zero() });
        sums.collect::<Vec<_>>()
    };
    scan.stations().par_chunks(CHUNK).zip(used.par_chunks(CHUNK)).flat_map_iter(work).collect()
}
