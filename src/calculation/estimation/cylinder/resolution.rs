//! What the resolution of the coordinates does to the fit: points whose coordinates lie on a lattice share the error of their
//! cell, however many they are.

use super::patches::Surface;
use super::solve::Solution;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::robust;
use nalgebra::{Matrix5, Vector5};
use std::collections::HashMap;

/// Standard deviation of a value that is rounded to a step of 1 (JCGM 100, 4.3.7).
const OF_STEP: f64 = 0.288_675_134_594_812_9;

/// Standard deviation that the resolution of y and z makes, mm; 0 where one of them lies on no lattice, since a raster across
/// the profile rounds nothing.
pub(super) fn standard([_, y, z]: [f64; 3]) -> f64 {
    OF_STEP * y.min(z)
}

/// The covariance of (p, q, y_ref, z_ref, R) where the errors of the cells are independent of each other and each is shared by
/// all points of its cell; `None` where the coordinates lie on no lattice.
pub(super) fn covariance(surface: &Surface, steps: [f64; 3], solution: &Solution, hold: Hold) -> Option<Matrix5<f64>> {
    let standard = standard(steps);
    let [_, step_y, step_z] = steps;
    if standard <= 0.0 {
        return None;
    }
    let cut_off = robust::cut_off_squared(solution.sigma);
    let (mut cells, mut whole) = (HashMap::<[i64; 2], Vector5<f64>>::new(), Sums::zero());
    for point in surface.near.iter().filter(|point| point.d * point.d < cut_off) {
        let response = solution.cylinder.slice(point.x).response(point.y, point.z);
        let row = response.row();
        let weight = robust::weight(response.d * response.d, cut_off);
        whole.normal += row * row.transpose() * weight;
        let cell = [(point.y / step_y).round() as i64, (point.z / step_z).round() as i64];
        *cells.entry(cell).or_default() += row * weight;
    }
    // Each point stands for those that were not looked at, beside which a prior weighs as it does in the fit.
    let stands_for = surface.thinned() as f64;
    whole.normal *= stands_for;
    cells.values_mut().for_each(|pull| *pull *= stands_for);
    let (normal, _) = step::system(&whole, hold, solution.sigma, solution.cylinder.radius);
    let bread = step::invert(&normal)?;
    let mask = if matches!(hold, Hold::Fixed { .. }) { step::OTHERS } else { Vector5::repeat(1.0) };
    // In a fixed order, so that the sum is the same in every run.
    let mut cells: Vec<([i64; 2], Vector5<f64>)> = cells.into_iter().collect();
    cells.sort_unstable_by_key(|(cell, _)| *cell);
    let scatter: Matrix5<f64> = cells
        .iter()
        .map(|(_, pull)| {
            let shift = bread * pull.component_mul(&mask);
            shift * shift.transpose()
        })
        .sum();
    Some(scatter * (standard * standard))
}
