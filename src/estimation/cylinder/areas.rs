//! What neighbouring profiles share: a layer too low to be told from the part, a bead's flank, a part that is not quite
//! round. The covariance takes profiles as independent; where residuals go together over larger areas, it is widened by as
//! much as they do. In: the fit and the points near it. Out: the fit, with its covariance widened. Must not move the fit.
//!
//! The sandwich is taken once more with areas of the surface as the clusters, on areas of five shapes. Where the variance of a
//! parameter comes out several times that by profiles, and several times that by what a profile has in each area, chance is
//! excluded, and it takes its place.

use super::patches::{Cut, Grid, Surface};
use super::solve::{Problem, Solution};
use crate::estimation::robust;
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
pub(super) fn widen(problem: &Problem<'_>, surface: &Surface, solution: &mut Solution) {
    let Problem { scan, used, hold, .. } = *problem;
    if used.iter().filter(|used| **used).count() < PROFILES_MIN {
        return;
    }
    let Some(grid) = surface.grid(Cut::Cells { sectors: CELLS, blocks: CELLS }) else { return };
    let Some(bread) = solution.bread(hold) else { return };
    let strips = pulls(scan.stations().len(), &grid, surface, solution, &bread);
    let usual = variances(&strips, [1, CELLS]);
    let (mut factor, mut freedom) = (Vector5::repeat(1.0_f64), solution.freedom);
    for [blocks, sectors] in AREAS {
        // What a profile shares within the area is in the usual variance already (Cameron, Gelbach and Miller).
        let own = variances(&strips, [1, sectors]);
        let profiles = (blocks * grid.block()).div_ceil(surface.every);
        let shared = variances(&strips, [profiles, sectors]);
        // Of every n-th point what is shared shows n times less beside the points' own noise.
        let thinned = surface.thinned() as f64;
        let by_area = own.zip_zip_map(&shared, &usual, |own, shared, usual| {
            let chance = shared <= CHANCE * own || shared - own <= (CHANCE - 1.0) * usual;
            if chance { 1.0 } else { 1.0 + thinned * (shared - own) / usual }
        });
        let areas_count = (CELLS / blocks * (CELLS / sectors)) as f64;
        let fewer = solution.freedom.map(|freedom| freedom.min(areas_count));
        let widest = by_area.zip_map(&factor, |by_area, factor| by_area > factor);
        freedom = widest.zip_zip_map(&fewer, &freedom, |widest, fewer, freedom| if widest { fewer } else { freedom });
        factor = factor.sup(&by_area);
    }
    let widen = Matrix5::from_diagonal(&factor.map(f64::sqrt));
    solution.covariance = widen * solution.covariance * widen;
    solution.freedom = freedom;
}

/// What the points of each profile and sector do to the parameters, B Σ w·d·J, profile after profile.
fn pulls(
    stations_count: usize,
    grid: &Grid,
    surface: &Surface,
    solution: &Solution,
    bread: &Matrix5<f64>,
) -> Vec<Vector5<f64>> {
    let mut strips = vec![Vector5::zeros(); stations_count.div_ceil(surface.every) * CELLS];
    let cut_off = robust::cut_off_squared(solution.sigma);
    for point in surface.near.iter().filter(|point| point.d * point.d < cut_off) {
        let response = solution.cylinder.slice(point.x).response(point.y, point.z);
        let (a, b, t) = (response.a, response.b, response.t);
        let pull = robust::weight(response.d * response.d, cut_off) * response.d;
        if let Some(strip) = strips.get_mut(point.index / surface.every * CELLS + grid.sector(point.angle)) {
            *strip += bread * Vector5::new(a * t, b * t, a, b, -1.0) * pull;
        }
    }
    strips
}

/// Σ of the squares over areas of so many profiles and sectors.
fn variances(strips: &[Vector5<f64>], [profiles, sectors]: [usize; 2]) -> Vector5<f64> {
    let mut sum = Vector5::zeros();
    for block in strips.chunks(CELLS * profiles) {
        for first in (0..CELLS).step_by(sectors) {
            let mut area = Vector5::zeros();
            for profile in block.chunks(CELLS) {
                profile.iter().skip(first).take(sectors).for_each(|strip| area += strip);
            }
            sum += area.component_mul(&area);
        }
    }
    sum
}
