//! How a cylinder fit answers to a shift in z of the points at each place of the laser line, in all profiles at once.
//!
//! A point that is shifted by δ in z has its distance changed by ∂d/∂z·δ = −b·δ with b = ∂d/∂z_ref. The estimating equation
//! Σ w·d·J = 0 then moves the parameters by −B Σ ψ′ J (−b δ) = B Σ ψ′ J b δ, B the inverse of Σ ψ′ J Jᵀ.

use super::patches::{self, Near};
use super::solve::Solution;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::linearity::{PatchInfluence, Patches};
use crate::estimation::robust;
use crate::scan::Scan;
use nalgebra::Vector5;

const RADIUS: usize = 4;

/// The answer to each patch; empty where there is none.
pub(super) fn influences(scan: &Scan, solution: &Solution, hold: Hold) -> Vec<PatchInfluence> {
    answers(scan, solution, hold).unwrap_or_default()
}

fn answers(scan: &Scan, solution: &Solution, hold: Hold) -> Option<Vec<PatchInfluence>> {
    let cut_off = robust::cut_off_squared(solution.sigma);
    let used: Vec<bool> = solution.profiles.iter().map(|sums| sums.weight > 0.0).collect();
    let surface = patches::look(scan, &used, &solution.cylinder, cut_off.sqrt())?;
    let patches = Patches::over(surface.near.iter().map(|point| point.y))?;
    let stands_for = surface.thinned() as f64;
    let (mut sums, mut shifts) = (Sums::zero(), vec![Vector5::zeros(); Patches::count()]);
    for point in &surface.near {
        let Near { y, z, d, .. } = *point;
        let response = solution.cylinder.slice(point.x).response(y, z);
        let (a, b, t) = (response.a, response.b, response.t);
        let (row, share) = (Vector5::new(a * t, b * t, a, b, -1.0), d * d / cut_off);
        let bend = stands_for * (1.0 - share) * (1.0 - 5.0 * share);
        sums.normal += row * row.transpose() * bend;
        if let Some(shift) = shifts.get_mut(patches.index(y)) {
            *shift += row * (bend * b);
        }
    }
    // The inverse over the same points, so that a shift of all patches is exactly a shift of z_ref.
    let bread = step::invert(&step::system(&sums, hold, solution.sigma, solution.cylinder.radius).0)?;
    let effect = |shift: Vector5<f64>| {
        let mut effect = bread * shift;
        if matches!(hold, Hold::Fixed { .. }) {
            effect.fill_row(RADIUS, 0.0);
        }
        effect
    };
    Some(patches.influences(shifts.into_iter().map(effect).collect()))
}
