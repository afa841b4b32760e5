//! How far the fit moves when pieces of the surface are left out: groups of neighbouring sectors of the arc, and of neighbouring
//! profiles.
//!
//! The delete-a-group jackknife (m − 1)/m Σ_g δ_g δ_gᵀ with δ_g = (N − N_g)⁻¹ G_g is the covariance of the fit if the errors of
//! different groups are independent, whatever is shared within them (Efron and Stein, Annals of Statistics 9, 1981). A form of
//! the part or a layer on it is shared within a group, so no interpretation of the surface moves the fit by many times as much.

use super::patches::{Near, Surface};
use super::solve::Solution;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::robust;
use nalgebra::{Matrix5, Vector5};

/// Groups of sectors by groups of profiles. Six of either see an error that a sixth of the surface shares, and each still holds
/// what neighbours share.
const PARTITIONS: [[usize; 2]; 2] = [[6, 1], [1, 6]];

/// Standard deviations of (p, q, y_ref, z_ref, R), the largest over the partitions; `None` where a group is needed to solve.
pub(super) fn standard(surface: &Surface, solution: &Solution, hold: Hold) -> Option<Vector5<f64>> {
    let found: Option<Vec<Matrix5<f64>>> =
        PARTITIONS.iter().map(|partition| jackknife(surface, solution, hold, *partition)).collect();
    let variances = found?.iter().fold(Vector5::zeros(), |most: Vector5<f64>, found| most.sup(&found.diagonal()));
    Some(variances.map(f64::sqrt))
}

/// An interpretation of the surface that takes half of it for the part moves the fit from that to all of it by at most √5 times
/// what leaving out a sixth at a time shows. If anything up to there is as likely, its standard deviation is √5/√3 = 1.29 of it
/// (JCGM 100, 4.3.7); a little more, since the sixths are not alike.
const REFITS: f64 = std::f64::consts::SQRT_2;

/// A shift of the parameters that is no larger than fits to pieces of the surface make likely.
pub(super) fn bounded(shift: Vector5<f64>, standard: Option<&Vector5<f64>>) -> Vector5<f64> {
    let Some(standard) = standard else { return shift };
    let beyond = shift.zip_map(standard, |shift, standard| shift.abs() / (REFITS * standard));
    shift / beyond.iter().copied().filter(|beyond| beyond.is_finite()).fold(1.0, f64::max)
}

/// The delete-a-group jackknife; `None` where a group is needed to solve at all.
fn jackknife(surface: &Surface, solution: &Solution, hold: Hold, partition: [usize; 2]) -> Option<Matrix5<f64>> {
    let [sectors, blocks] = partition;
    let mut groups = vec![Sums::zero(); sectors * blocks];
    let cut_off = robust::cut_off_squared(solution.sigma);
    let serving: Vec<&Near> = surface.near.iter().filter(|point| point.d * point.d < cut_off).collect();
    let by_angle = bounds(serving.iter().map(|point| point.angle).collect(), sectors);
    let by_place = bounds(serving.iter().map(|point| point.index as f64).collect(), blocks);
    for point in serving {
        let block = by_place.partition_point(|bound| *bound <= point.index as f64);
        let sector = by_angle.partition_point(|bound| *bound <= point.angle);
        if let Some(group) = groups.get_mut(block * sectors + sector) {
            group.add(&point_sums(point, solution, cut_off));
        }
    }
    let mut whole = Sums::zero();
    groups.iter().for_each(|group| whole.add(group));
    let mask = if matches!(hold, Hold::Fixed { .. }) { step::OTHERS } else { Vector5::repeat(1.0) };
    let mask = Matrix5::from_diagonal(&mask);
    let inverse = |sums: &Sums| step::invert(&step::system(sums, hold, solution.sigma, solution.cylinder.radius).0);
    // The points that are looked at say a little else than all of them.
    let off = inverse(&whole)? * mask * whole.gradient;
    groups.retain(|group| group.weight > 0.0);
    let mut sum = Matrix5::zeros();
    for group in &groups {
        let rest = inverse(&Sums { normal: whole.normal - group.normal, ..whole })? * mask;
        let shift = rest * (group.gradient - group.normal * off);
        sum += shift * shift.transpose();
    }
    let count = groups.len() as f64;
    (count >= 2.0).then(|| sum * ((count - 1.0) / count))
}

fn point_sums(point: &Near, solution: &Solution, cut_off_squared: f64) -> Sums {
    let response = solution.cylinder.slice(point.x).response(point.y, point.z);
    let row = Vector5::new(response.a * response.t, response.b * response.t, response.a, response.b, -1.0);
    let rest = 1.0 - response.d * response.d / cut_off_squared;
    let (weight, slope) = (rest * rest, rest * (5.0 * rest - 4.0));
    Sums { gradient: row * (weight * response.d), normal: row * row.transpose() * slope, weight }
}

/// Values between which so many groups hold as many of these each.
fn bounds(mut values: Vec<f64>, groups: usize) -> Vec<f64> {
    values.sort_unstable_by(f64::total_cmp);
    (1..groups).filter_map(|group| values.get(values.len() * group / groups)).copied().collect()
}
