//! The joint fit over every point of every profile by Newton's method, and its covariance with the profile as the cluster.
//! Must not know how the start was found or what becomes of the profiles.
//!
//! Points of one profile share errors (speckle, vibration), so a covariance that takes them as independent is wrong. The
//! sandwich B (Σ_i G_i G_iᵀ) Bᵀ, with G_i the sum of w·d·J over profile i and B the inverse of Σ ψ′ J Jᵀ, assumes nothing
//! about points of the same profile.

use super::model::Cylinder;
use super::settle::Settled;
use super::step::{self, Hold};
use super::sums::{Curvature, Sums, Weighting, sum};
use crate::estimation::robust;
use crate::scan::{Scan, Station};
use nalgebra::{Matrix5, Vector5};
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
}

const STEPS_MAX: usize = 10;
/// A step below this share of its own standard deviation changes nothing that could be told.
const SETTLED: f64 = 1e-2;
/// Stations in one piece of work: fixed, so that sums do not depend on threads.
const CHUNK: usize = 16;

/// Solves from what a sample settled on, with the stations that `used` marks.
pub(super) fn solve(scan: &Scan, used: &[bool], start: &Settled, hold: Hold) -> Option<Solution> {
    let (mut cylinder, sigma) = (start.cylinder, start.sigma);
    for _ in 0..STEPS_MAX {
        let profiles = pass(scan, used, &cylinder, sigma);
        let mut sums = Sums::zero();
        profiles.iter().for_each(|profile| sums.add(profile));
        let (normal, gradient) = step::system(&sums, hold, sigma, cylinder.radius);
        let step = step::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        if (normal * step).dot(&step).abs().sqrt() < SETTLED * sigma {
            let covariance = sandwich(&normal, &profiles, hold)?;
            return Some(Solution { cylinder, sigma, covariance, profiles });
        }
    }
    None
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

fn sandwich(normal: &Matrix5<f64>, profiles: &[Sums], hold: Hold) -> Option<Matrix5<f64>> {
    let bread = step::invert(normal)?;
    let (mut meat, mut clusters_count) = (Matrix5::zeros(), 0.0_f64);
    for profile in profiles.iter().filter(|profile| profile.weight > 0.0) {
        let mut gradient: Vector5<f64> = profile.gradient;
        if hold == Hold::Fixed {
            gradient[4] = 0.0;
        }
        meat += gradient * gradient.transpose();
        clusters_count += 1.0;
    }
    let freedom = clusters_count / (clusters_count - 5.0).max(1.0);
    Some(bread * meat * bread.transpose() * freedom)
}
