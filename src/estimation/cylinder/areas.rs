//! What neighbouring profiles share: a layer too low to be told from the part, a bead's flank, a part that is not quite
//! round. The covariance takes profiles as independent; where residuals go together over larger areas, it is widened by as
//! much as they do. In: the fit and its points. Out: the fit, with its covariance widened. Must not move the fit.
//!
//! The sandwich is taken once more with areas of the surface as the clusters, on areas of five shapes. Where the variance of a
//! parameter comes out several times that by profiles, chance is excluded, and it takes its place.

use super::patches::{self, Cut, Grid, Near};
use super::solve::Solution;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::robust;
use crate::scan::Scan;
use nalgebra::{Matrix5, Vector5};

/// Fewer profiles say too little about what areas share.
const PROFILES_MIN: usize = 12;
/// The surface in cells: blocks of profiles and sectors of the arc.
const CELLS: usize = 24;
/// Areas as cells along x by cells along the arc.
const AREAS: [[usize; 2]; 5] = [[2, 6], [4, 12], [6, 3], [CELLS, 2], [2, CELLS]];
/// Twelve clusters and more give a variance this many times too large less than once in a thousand.
const CHANCE: f64 = 3.0;

/// Widens the covariance where areas of the surface share errors.
pub(super) fn widen(scan: &Scan, used: &[bool], solution: &mut Solution, hold: Hold) {
    let reach = robust::TUKEY_C * solution.sigma;
    let cut = Cut::Cells { sectors: CELLS, blocks: CELLS };
    let Some((grid, near)) = patches::cut(scan, used, &solution.cylinder, reach, cut) else { return };
    let mut sums = Sums::zero();
    solution.profiles.iter().for_each(|profile| sums.add(profile));
    let (normal, _) = step::system(&sums, hold, solution.sigma, solution.cylinder.radius);
    let Some(bread) = step::invert(&normal) else { return };
    if used.iter().filter(|used| **used).count() < PROFILES_MIN {
        return;
    }
    let strips = gradients(scan, &grid, &near, solution);
    let usual = variances(&bread, &gathered(&strips, [1, CELLS]));
    let mut factor = Vector5::repeat(1.0_f64);
    for area in AREAS {
        let [blocks, sectors] = area;
        // What a profile shares within the area is in the usual variance already (Cameron, Gelbach and Miller).
        let own = variances(&bread, &gathered(&strips, [1, sectors]));
        let shared = variances(&bread, &gathered(&strips, [blocks * grid.block(), sectors])) - own;
        let ratio = shared.zip_map(&usual, |shared, usual| if usual > 0.0 { 1.0 + shared / usual } else { 1.0 });
        factor = factor.zip_map(&ratio, |factor, ratio| if ratio > CHANCE { factor.max(ratio) } else { factor });
    }
    let widen = Matrix5::from_diagonal(&factor.map(f64::sqrt));
    solution.covariance = widen * solution.covariance * widen;
}

/// Σ w·d·J by profile and sector, profile after profile.
fn gradients(scan: &Scan, grid: &Grid, near: &[Near], solution: &Solution) -> Vec<Vector5<f64>> {
    let mut strips = vec![Vector5::zeros(); scan.stations().len() * CELLS];
    let cut_off = robust::cut_off_squared(solution.sigma);
    for point in near {
        let slice = solution.cylinder.slice(point.x);
        let response = slice.response(point.y, point.z);
        let (a, b, t) = (response.a, response.b, response.t);
        let pull = robust::weight(response.d * response.d, cut_off) * response.d;
        let sector = grid.place(point.index, &slice, point.y, point.z) % CELLS;
        if let Some(strip) = strips.get_mut(point.index * CELLS + sector) {
            *strip += Vector5::new(a * t, b * t, a, b, -1.0) * pull;
        }
    }
    strips
}

/// Strips put together to areas of so many profiles and sectors.
fn gathered(strips: &[Vector5<f64>], [profiles, sectors]: [usize; 2]) -> Vec<Vector5<f64>> {
    let columns = CELLS / sectors;
    let mut areas = vec![Vector5::zeros(); (strips.len() / CELLS).div_ceil(profiles) * columns];
    for (index, strip) in strips.iter().enumerate() {
        let (row, column) = (index / CELLS / profiles, index % CELLS / sectors);
        if let Some(area) = areas.get_mut(row * columns + column) {
            *area += strip;
        }
    }
    areas
}

fn variances(bread: &Matrix5<f64>, clusters: &[Vector5<f64>]) -> Vector5<f64> {
    let squares = |cluster: &Vector5<f64>| (bread * cluster).map(|v| v * v);
    clusters.iter().map(squares).sum()
}
