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

/// What a shift of the points of a patch does to the gradient: of all of them by 1 mm, and of each by its z.
#[derive(Debug, Clone, Copy, Default)]
struct Shift {
    all: Vector5<f64>,
    by_z: Vector5<f64>,
    /// Sum of z, mm, and of points.
    z: f64,
    count: f64,
}

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
    let (mut sums, mut shifts) = (Sums::zero(), vec![Shift::default(); Patches::count()]);
    for point in &surface.near {
        let Near { y, z, d, .. } = *point;
        let response = solution.cylinder.slice(point.x).response(y, z);
        let (row, b) = (response.row(), response.b);
        let bend = stands_for * robust::weight_slope(d * d, cut_off);
        sums.normal += row * row.transpose() * bend;
        if let Some(shift) = shifts.get_mut(patches.index(y)) {
            shift.all += row * (bend * b);
            shift.by_z += row * (bend * b * z);
            (shift.z, shift.count) = (shift.z + z, shift.count + 1.0);
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
    let effects = |Shift { all, by_z, z, count }: Shift| [effect(all), effect(by_z - all * (z / f64::max(count, 1.0)))];
    Some(patches.influences(shifts.into_iter().map(effects).collect()))
}
