//! Two surfaces close to each other, of which the fit lies between: a tube that is seen from both sides, second reflections of
//! half of the points. Their points are off the fit by about the same distance on either side, so few are near it.

use super::solve::Solution;
use crate::scan::Scan;

/// Points looked at, at most.
const POINTS_MAX: usize = 32_768;
/// Points nearer than half a σ are compared with those nearer than two σ: a quarter of an even distribution and 40 % of a
/// normal one.
const NEAR: f64 = 0.5;
pub(super) const WITHIN: f64 = 2.0;
/// Standard deviations of the binomial count near the fit; chance exceeds them once in 3·10⁶.
const CERTAIN: f64 = 5.0;

/// The share of the points within two σ that are farther than half a σ, where that is more than in an even distribution.
pub(super) fn share(scan: &Scan, solution: &Solution) -> Option<f64> {
    let step = scan.points().len().div_ceil(POINTS_MAX).max(1);
    let distance = |[x, y, z]: [f64; 3]| solution.cylinder.slice(x).distance(y, z).abs() / solution.sigma;
    let within: Vec<f64> = scan.every_nth_point(step).map(distance).filter(|distance| *distance < WITHIN).collect();
    let (count, near) = (within.len() as f64, within.iter().filter(|distance| **distance < NEAR).count() as f64);
    let even = NEAR / WITHIN;
    let is_hollow = near < even * count - CERTAIN * (even * (1.0 - even) * count).sqrt();
    is_hollow.then(|| 1.0 - near / count)
}
