//! Errors common to neighbouring parts of the surface, modelled as a random field: a layer too low to be removed, the flank of a
//! bead, a form deviation. The covariance by profiles treats profiles as independent, which is wrong with such errors, so the
//! covariance of the field is added.
//!
//! The mean residual of a cell (block b of profiles, sector j of the arc, weight n_bj in points) is modelled as
//!
//! ```text
//! y_bj = α_j + β_j (u_b − ū_j) + e_bj,      u along x, from −√3 to √3, ū_j its mean over the sector
//! cov(e_bj, e_bk) = σ_e² (δ_jk / n_bj + g exp(−Δφ/ℓ_e)) within a block, 0 between blocks, beside shifts of a block in y and z
//! cov(α_j, α_k) = v exp(−Δφ/ℓ), the covariance of steps in random places; of β likewise
//! ```
//!
//! e is the noise that is independent between profiles: σ_e², g and ℓ_e follow by maximum likelihood from the residuals about α and
//! β. For the means α, and separately for the slopes β, the restricted likelihood (REML: of the components that the parameters of
//! the fit do not absorb) is calculated over v and ℓ. If no value exceeds that of v = 0 by more than chance, there is no field.
//! Otherwise its covariance is the mean of v A K Aᵀ over the likelihood, with A the effect of a displacement of the sectors on the
//! parameters.
//!
//! [`Cells`] contains the mean residuals and their weights, and the effect of a displacement of a sector on the fit.

use super::normal_equations::{self, RadiusConstraint};
use super::patches::{Cut, Grid, Near, Surface};
use super::solve::Solution;
use crate::estimation::statistics;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix5, OMatrix, U5, Vector5};
use std::f64::consts::TAU;

/// Correlation lengths of the field, in lengths of the arc. The fit absorbs longer fields.
const LENGTHS: [f64; 4] = [0.06, 0.12, 0.25, 0.5];
/// Correlation lengths of the noise within a profile, and g, in units of 1/n.
const NOISE_LENGTHS: [f64; 3] = [0.03, 0.1, 0.4];
const NOISE_SHARES: [f64; 5] = [0.0, 0.2, 0.6, 2.0, 6.0];
/// v, in units of the variance of α or β from the noise.
const VARIANCES: [f64; 15] = [0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 1e2, 3e2, 1e3, 3e3, 1e4, 1e5, 1e6, 1e7];
/// Chance raises twice the logarithm of the likelihood by this much once in twenty scans (half of χ² with one degree of freedom).
const CERTAIN: f64 = 2.71;
/// A variance that is large beside all others: it leaves a parameter practically free.
const FREE: f64 = 1e10;
/// Sectors with a smaller share of the average weight are left out: at the edges of the arc the noise is larger than elsewhere, and
/// the few points may all be stray points.
const SHARE_MIN: f64 = 0.1;
/// Values that must remain after the fit has absorbed its parameters.
const VALUES_MIN: usize = 3;
/// Degrees of freedom that the straight line of a sector absorbs from the blocks, and the two shifts of a block from its residuals.
const LINE: f64 = 2.0;
const SHIFTS: f64 = 2.0;

/// The covariance of (p, q, y_ref, z_ref, R) from the field; `None` if chance explains the residuals.
pub(super) fn covariance(surface: &Surface, solution: &Solution, constraint: RadiusConstraint) -> Option<Matrix5<f64>> {
    let cells = Cells::of(surface, solution)?;
    let [mean, slope] = SectorMeans::both(&cells);
    let noise = ProfileNoise::of(&cells, &mean, &slope)?;
    let is_fixed = matches!(constraint, RadiusConstraint::Fixed { .. });
    let radius = (!is_fixed).then(|| DVector::repeat(cells.sectors(), 1.0));
    // The examined points represent all points.
    let points_per_point = solution.total().weight / cells.weights.sum();
    let free = if is_fixed { normal_equations::OTHERS } else { Vector5::repeat(1.0) };
    let bread = Matrix5::from_diagonal(&free) * solution.bread(constraint)? * points_per_point;
    let [mean_pull, mut slope_pull] = cells.pulls.each_ref().map(|pull| bread * pull);
    for (mut slope, (mean, middle)) in slope_pull.column_iter_mut().zip(mean_pull.column_iter().zip(&mean.middle)) {
        slope -= mean * *middle;
    }
    let found = [
        mean.field(&cells, &noise, cells.shifts.iter().chain(&radius), &mean_pull),
        slope.field(&cells, &noise, cells.shifts.iter(), &slope_pull),
    ];
    found.into_iter().flatten().reduce(|mean, slope| mean + slope)
}

/// Σ v vᵀ.
fn outer<'a>(columns: impl Iterator<Item = &'a DVector<f64>>) -> DMatrix<f64> {
    columns.map(|column| column * column.transpose()).sum()
}

/// α or β of all sectors.
struct SectorMeans {
    values: DVector<f64>,
    /// Their weights, in points.
    weights: DVector<f64>,
    /// Mean position of each sector, about which α and β are uncorrelated.
    middle: DVector<f64>,
    /// The share of its variance that remains of an error common to a whole block if every sector is present on every block.
    /// Otherwise this understates the noise, and a field is found too often, which is the safe side.
    per_blocks: f64,
}

impl SectorMeans {
    /// α and β by least squares, sector by sector.
    fn both(cells: &Cells) -> [Self; 2] {
        let (weights, places) = (&cells.weights, &cells.places);
        let moments = weights.component_mul(&cells.residuals);
        let n = weights.row_sum().transpose();
        let mean = moments.row_sum().transpose().zip_map(&n, quotient);
        let middle = weights.tr_mul(places).zip_map(&n, quotient);
        let squares = weights.tr_mul(&places.component_mul(places));
        let spread = squares.zip_zip_map(&n, &middle, |squares, n, middle| (squares - n * middle * middle).max(0.0));
        let tilted = moments.tr_mul(places) - mean.component_mul(&middle).component_mul(&n);
        let slope = tilted.zip_map(&spread, quotient);
        let [per_count, per_squares] = [cells.blocks() as f64, places.norm_squared()].map(|by| quotient(1.0, by));
        [
            Self { values: mean, weights: n, middle: middle.clone(), per_blocks: per_count },
            Self { values: slope, weights: spread, middle, per_blocks: per_squares },
        ]
    }

    /// The mean of v A K Aᵀ over the likelihood, with A the `effect` of the sectors; `None` if chance explains the values, or if
    /// too few of them remain beside the `shapes` that the fit absorbs.
    fn field<'a>(
        &self,
        cells: &Cells,
        noise: &ProfileNoise,
        shapes: impl Iterator<Item = &'a DVector<f64>> + Clone,
        effect: &OMatrix<f64, U5, Dyn>,
    ) -> Option<Matrix5<f64>> {
        let usual_weight = self.weights.mean();
        let usual = noise.variance * (quotient(1.0, usual_weight) + noise.share * self.per_blocks);
        let counts = |weight: f64| weight > SHARE_MIN * usual_weight;
        if self.weights.iter().filter(|weight| counts(**weight)).count() < shapes.clone().count() + VALUES_MIN {
            return None;
        }
        let own = self.weights.map(|weight| if counts(weight) { noise.variance / weight } else { FREE * usual });
        let shared = cells.kernel(noise.length) * (noise.share * noise.variance * self.per_blocks);
        let noise = DMatrix::from_diagonal(&own) + shared + outer(shapes) * (FREE * usual);
        let without = self.twice_log_likelihood(noise.clone())?;
        let mut found = Vec::with_capacity(LENGTHS.len() * VARIANCES.len());
        for kernel in LENGTHS.map(|length| cells.kernel(length)) {
            let moved: Matrix5<f64> = effect * &kernel * effect.transpose();
            for variance in VARIANCES.map(|variance| variance * usual) {
                if let Some(with) = self.twice_log_likelihood(&noise + &kernel * variance) {
                    found.push((with - without, moved * variance));
                }
            }
        }
        let most = found.iter().map(|(gain, _)| *gain).fold(0.0, f64::max);
        let weight = |gain: f64| (0.5 * (gain - most)).exp();
        let weights: f64 = found.iter().map(|(gain, _)| weight(*gain)).sum();
        (most > CERTAIN).then(|| found.iter().map(|(gain, moved)| moved * (weight(*gain) / weights)).sum())
    }

    fn twice_log_likelihood(&self, covariance: DMatrix<f64>) -> Option<f64> {
        let cholesky = Cholesky::new(covariance)?;
        Some(-log_determinant(&cholesky) - self.values.dot(&cholesky.solve(&self.values)))
    }
}

fn log_determinant(cholesky: &Cholesky<f64, Dyn>) -> f64 {
    2.0 * cholesky.l_dirty().diagonal().iter().map(|v| v.ln()).sum::<f64>()
}

/// The noise that is independent from profile to profile: σ_e², g and ℓ_e.
struct ProfileNoise {
    variance: f64,
    share: f64,
    length: f64,
}

impl ProfileNoise {
    /// The values of the greatest likelihood for the residuals √n e, whose covariance is σ_e² (δ_jk + g √(n_j n_k) exp(−Δφ/ℓ_e)).
    fn of(cells: &Cells, mean: &SectorMeans, slope: &SectorMeans) -> Option<Self> {
        let blocks = cells.blocks() as f64;
        let is_filled = cells.weights.map(|weight| f64::from(u8::from(weight > 0.0)));
        let at_centre = &mean.values - slope.values.component_mul(&slope.middle);
        let ones = DVector::repeat(cells.blocks(), 1.0);
        let line = ones * at_centre.transpose() + &cells.places * slope.values.transpose();
        let roots = cells.weights.map(f64::sqrt);
        let left = (&cells.residuals - line).component_mul(&roots);
        let scatter = left.tr_mul(&left).zip_map(&is_filled.tr_mul(&is_filled), quotient) * (blocks / (blocks - LINE));
        let usual_weights = mean.weights.zip_map(&is_filled.row_sum().transpose(), quotient);
        let filled_count = usual_weights.iter().filter(|weight| **weight > 0.0).count() as f64;
        let usual_weight = quotient(usual_weights.sum(), filled_count);
        let scale = usual_weights.map(|weight| quotient(weight, usual_weight).sqrt());
        let shifts = outer(cells.shifts.iter()).component_mul(&(&scale * scale.transpose())) * FREE;
        let free_count = filled_count - SHIFTS;
        if free_count < 1.0 {
            return None;
        }
        let mut best: Option<(f64, Self)> = None;
        for length in NOISE_LENGTHS {
            let kernel = cells.kernel(length).component_mul(&(&scale * scale.transpose()));
            for share in NOISE_SHARES {
                let identity = DMatrix::identity(cells.sectors(), cells.sectors());
                let Some(cholesky) = Cholesky::new(identity + &kernel * share + &shifts) else { continue };
                let variance = cholesky.solve(&scatter).trace() / free_count;
                let likelihood = -free_count * variance.ln() - log_determinant(&cholesky);
                if best.as_ref().is_none_or(|(most, _)| likelihood > *most) {
                    best = Some((likelihood, Self { variance, share: share / usual_weight, length }));
                }
            }
        }
        best.map(|(_, noise)| noise).filter(|noise| noise.variance > 0.0 && noise.share.is_finite())
    }
}

/// The largest and smallest number of blocks: with fewer, a straight line leaves no scatter.
const BLOCKS_MAX: usize = 16;
const BLOCKS_MIN: usize = 4;
/// Sectors at least and at most.
const SECTORS: [usize; 2] = [8, 24];
/// Points that a cell should have.
const POINTS: usize = 4;
/// The longest arc of a cylinder that one laser line covers before it meets the surface too steeply, 140°, radians: longer arcs are
/// composed of several views.
const SEEN: f64 = 2.44;

/// Averages over cells, blocks in rows and sectors in columns.
pub(super) struct Cells {
    /// Mean residuals, mm, and their weights, in points.
    pub(super) residuals: DMatrix<f64>,
    pub(super) weights: DMatrix<f64>,
    /// Positions of the blocks along x, from −√3 to √3: for evenly spread blocks their mean square is 1.
    pub(super) places: DVector<f64>,
    /// The change of the residual of each sector by a shift of the section in y and in z.
    pub(super) shifts: [DVector<f64>; 2],
    /// The change of the gradient of (p, q, y_ref, z_ref, R) by a displacement of each sector by 1 mm, and by one in proportion to
    /// its position.
    pub(super) pulls: [OMatrix<f64, U5, Dyn>; 2],
    /// Angle from the first point to the last one, radians.
    arc: f64,
}

/// The quotient; 0 if the divisor is 0.
pub(super) fn quotient(sum: f64, by: f64) -> f64 {
    if by > 0.0 { sum / by } else { 0.0 }
}

fn increase(sum: Option<&mut f64>, what: f64) {
    if let Some(sum) = sum {
        *sum += what;
    }
}

impl Cells {
    /// `None` if there are too few points or profiles.
    pub(super) fn of(surface: &Surface, solution: &Solution) -> Option<Self> {
        let [least, most] = SECTORS;
        let sectors = (surface.near.len() / (surface.stations_count().min(BLOCKS_MAX) * POINTS)).clamp(least, most);
        let grid = surface.grid(Cut::Cells { sectors, blocks: BLOCKS_MAX })?;
        let cut_off_squared = statistics::cut_off_squared(solution.sigma);
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
            (statistics::weight(squared, cut_off_squared), statistics::weight_slope(squared, cut_off_squared));
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

    /// Turns the sums into means.
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

    /// exp(−Δφ/ℓ) between the sectors, with ℓ in lengths of the arc, of at most [`SEEN`]. On a full circle the last sector is next
    /// to the first.
    pub(super) fn kernel(&self, length: f64) -> DMatrix<f64> {
        let (step, length) = (self.arc / self.sectors() as f64, length * self.arc.min(SEEN));
        DMatrix::from_fn(self.sectors(), self.sectors(), |one, other| {
            let straight = one.abs_diff(other) as f64 * step;
            (-straight.min(TAU - straight) / length).exp()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::search;
    use super::*;
    use crate::estimation::{Progress, Settings};
    use crate::scan::synthetic::{ClampShape, Interference, Part, make};

    fn solution(part: &Part) -> Solution {
        let (scan, _) = make(part).expect("a part");
        let used = vec![true; scan.stations().len()];
        search::search(&scan, &used, &Settings::default(), None, &Progress::default()).expect("a cylinder")
    }

    fn part(seed: u64) -> Part {
        Part { profiles_count: 80, points_count: 120, arc_deg: 120.0, ..Part::smooth(seed) }
    }

    /// α and β each exceed 2.71 once in twenty or slightly more often, because the best of four lengths is taken. Of 40 about four
    /// are expected, and more than ten once in 600.
    #[test]
    fn noise_gives_no_field_with_correlated_points_and_with_clamps() {
        let clamps = Interference { clamps: 0.6, clamp_arc: 0.5, clamp_height_mm: 20.0, ..Interference::NONE };
        for (noise_correlation, interference) in [(0.0, Interference::NONE), (0.9, Interference::NONE), (0.0, clamps)] {
            let is_field = |seed: &u64| {
                let part = Part { noise_correlation, interference, ..part(*seed) };
                solution(&part).field.is_some()
            };
            let count = (0..40).filter(is_field).count();
            assert!(count <= 10, "{count} of 40 with {noise_correlation} and {interference:?}");
        }
    }

    #[test]
    fn a_layer_too_low_to_be_removed_gives_a_field_of_the_size_of_its_effect() {
        let layer = Interference {
            clamps: 0.5,
            clamp_arc: 0.5,
            clamp_height_mm: 0.06,
            clamp_shape: ClampShape::Concentric,
            ..Interference::NONE
        };
        let (mut squares, mut fields_count) = (0.0, 0);
        for seed in 0..20 {
            let part = Part { interference: layer, ..part(seed) };
            let (_, truth) = make(&part).expect("a part");
            let Solution { cylinder, covariance, field, .. } = solution(&part);
            fields_count += usize::from(field.is_some());
            let variance = covariance[(4, 4)] + field.map_or(0.0, |field| field[(4, 4)]);
            squares += (cylinder.radius - truth.radius_mm).powi(2) / variance / 20.0;
        }
        // The layer has a height of 1.2 σ on half of the arc of half of the profiles; normal errors would give 1.
        assert!(fields_count >= 15, "{fields_count} of 20");
        assert!(squares.sqrt() > 0.2 && squares.sqrt() < 2.5, "errors of the radius: {} u", squares.sqrt());
    }
}
