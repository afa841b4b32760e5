//! The residuals of a fit as averages over cells of the surface: blocks of profiles by sectors of the arc. In: the fit and the
//! points near it. Out: per cell the mean residual and its weight, and what a displacement of a sector does to the fit.

use super::patches::{Cut, Grid, Near, Surface};
use super::solve::Solution;
use crate::estimation::robust;
use nalgebra::{DMatrix, DVector, Dyn, OMatrix, U5};
use std::f64::consts::TAU;

/// Blocks at most and at least: with fewer a straight line leaves no scatter.
const BLOCKS_MAX: usize = 16;
const BLOCKS_MIN: usize = 4;
/// Sectors at least and at most.
const SECTORS: [usize; 2] = [8, 24];
/// Points that a cell should have.
const POINTS: usize = 4;
/// What one laser line sees of a cylinder at most before it meets the surface too steeply, 140°, radians: longer arcs are put
/// together from several views.
const SEEN: f64 = 2.44;

/// Averages over cells, blocks in rows and sectors in columns.
pub(super) struct Cells {
    /// Mean residuals, mm, and their weights, in points.
    pub(super) residuals: DMatrix<f64>,
    pub(super) weights: DMatrix<f64>,
    /// Where the blocks lie along x, from −√3 to √3: evenly spread, their mean square is 1.
    pub(super) places: DVector<f64>,
    /// What a shift of the section in y and in z changes each sector's residual by.
    pub(super) shifts: [DVector<f64>; 2],
    /// What a displacement of each sector by 1 mm does to the gradient of (p, q, y_ref, z_ref, R), and one by the place.
    pub(super) pulls: [OMatrix<f64, U5, Dyn>; 2],
    /// Angle from the first point to the last one, radians.
    arc: f64,
}

/// 0 where nothing is to be divided by.
pub(super) fn quotient(sum: f64, by: f64) -> f64 {
    if by > 0.0 { sum / by } else { 0.0 }
}

fn increase(sum: Option<&mut f64>, what: f64) {
    if let Some(sum) = sum {
        *sum += what;
    }
}

impl Cells {
    /// `None` where there are too few points or profiles.
    pub(super) fn of(surface: &Surface, solution: &Solution) -> Option<Self> {
        let [least, most] = SECTORS;
        let sectors = (surface.near.len() / (surface.stations_count().min(BLOCKS_MAX) * POINTS)).clamp(least, most);
        let grid = surface.grid(Cut::Cells { sectors, blocks: BLOCKS_MAX })?;
        let cut_off_squared = robust::cut_off_squared(solution.sigma);
        let serving: Vec<&Near> = surface.near.iter().filter(|point| point.d * point.d < cut_off_squared).collect();
        let ends = |[low, high]: [f64; 2], point: &&Near| [low.min(point.x), high.max(point.x)];
        let [low, high] = serving.iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends);
        let (middle, unit) = (0.5 * (low + high), 0.5 * (high - low) / 3.0_f64.sqrt());
        let blocks = serving.iter().map(|point| point.index / grid.block()).max()? + 1;
        if blocks < BLOCKS_MIN || unit <= 0.0 {
            return None;
        }
        let [first, last] = surface.ends();
        let mut cells = Self::empty(blocks, sectors, (last - first).max(f64::MIN_POSITIVE));
        for point in serving {
            cells.add(point, &grid, (point.x - middle) / unit, solution, cut_off_squared);
        }
        cells.divide();
        Some(cells)
    }

    fn empty(blocks: usize, sectors: usize, arc: f64) -> Self {
        Self {
            residuals: DMatrix::zeros(blocks, sectors),
            weights: DMatrix::zeros(blocks, sectors),
            places: DVector::zeros(blocks),
            shifts: [DVector::zeros(sectors), DVector::zeros(sectors)],
            pulls: [OMatrix::<f64, U5, Dyn>::zeros(sectors), OMatrix::<f64, U5, Dyn>::zeros(sectors)],
            arc,
        }
    }

    fn add(&mut self, point: &Near, grid: &Grid, place: f64, solution: &Solution, cut_off_squared: f64) {
        let response = solution.cylinder.slice(point.x).response(point.y, point.z);
        let row = response.row();
        let squared = response.d * response.d;
        let (weight, slope) =
            (robust::weight(squared, cut_off_squared), robust::weight_slope(squared, cut_off_squared));
        let (block, sector) = (point.index / grid.block(), grid.sector(point.angle));
        increase(self.residuals.get_mut((block, sector)), weight * response.d);
        increase(self.weights.get_mut((block, sector)), weight);
        increase(self.places.get_mut(block), weight * place);
        for (shift, by) in self.shifts.iter_mut().zip([response.a, response.b]) {
            increase(shift.get_mut(sector), weight * by);
        }
        for (pull, by) in self.pulls.iter_mut().zip([1.0, place]) {
            let mut column = pull.column_mut(sector);
            column += row * (slope * by);
        }
    }

    /// Sums become means.
    fn divide(&mut self) {
        self.residuals.zip_apply(&self.weights, |sum, by| *sum = quotient(*sum, by));
        self.places.zip_apply(&self.weights.column_sum(), |sum, by| *sum = quotient(*sum, by));
        let of_sectors = self.weights.row_sum().transpose();
        for shift in &mut self.shifts {
            shift.zip_apply(&of_sectors, |sum, by| *sum = quotient(*sum, by));
        }
    }

    pub(super) fn sectors(&self) -> usize {
        self.weights.ncols()
    }

    pub(super) fn blocks(&self) -> usize {
        self.weights.nrows()
    }

    /// exp(−Δφ/ℓ) between the sectors, with ℓ in lengths of the arc, of at most [`SEEN`]. All around, the last sector is beside
    /// the first.
    pub(super) fn kernel(&self, length: f64) -> DMatrix<f64> {
        let (step, length) = (self.arc / self.sectors() as f64, length * self.arc.min(SEEN));
        DMatrix::from_fn(self.sectors(), self.sectors(), |one, other| {
            let straight = one.abs_diff(other) as f64 * step;
            (-straight.min(TAU - straight) / length).exp()
        })
    }
}
