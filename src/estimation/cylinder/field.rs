//! What neighbouring parts of the surface share: a layer too low to be told from the part, the flank of a bead, a part that is
//! not quite round. The covariance by profiles takes these as independent of each other, which such errors are not. In: the fit
//! and the points near it. Out: the covariance that they add. Does not move the fit.
//!
//! The mean residual of a cell (block b of profiles, sector s of the arc, weight n_bs in points) is modelled as
//!
//! ```text
//! y_bs = α_s + β_s u_b + e_bs,      u along x, from −√3 to √3, so that its mean square is 1
//! cov e_bs = τ² (δ_st / n_bs + g exp(−Δφ/ℓ_e)) within a block and 0 between blocks, beside shifts of each block in y and z
//! cov α_s = s² exp(−Δφ/ℓ), the covariance of steps in random places; cov β_s likewise
//! ```
//!
//! e is noise, which no two profiles share: its τ², g and ℓ_e have the greatest likelihood for the scatter of the blocks about
//! α + β u. For the means α over x, and by itself for the slopes β, the restricted likelihood (REML: of what the parameters of
//! the fit do not take up) follows for each s² and ℓ. Where none exceeds that of s = 0 by more than chance, there is no field;
//! else its covariance is the mean of s² A K Aᵀ over the likelihood, with A what a displacement of the sectors does to the
//! parameters.

use super::cells::Cells;
use super::patches::Surface;
use super::solve::Solution;
use super::step::{self, Hold};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix5, OMatrix, U5, Vector5};

/// Correlation lengths of the field, in lengths of the arc. Of longer fields the fit takes up what would show them.
const LENGTHS: [f64; 4] = [0.06, 0.12, 0.25, 0.5];
/// Those of the noise of a profile, and g, in units of 1/n.
const NOISE_LENGTHS: [f64; 3] = [0.03, 0.1, 0.4];
const NOISE_SHARES: [f64; 5] = [0.0, 0.2, 0.6, 2.0, 6.0];
/// s², in units of the variance of α or β by the noise.
const VARIANCES: [f64; 15] = [0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 1e2, 3e2, 1e3, 3e3, 1e4, 1e5, 1e6, 1e7];
/// Chance raises twice the logarithm of the likelihood by so much once in twenty (half of χ² with one degree of freedom).
const CERTAIN: f64 = 2.71;
/// A variance that is large beside all others: what has it is as good as free.
const FREE: f64 = 1e10;
/// Sectors with a smaller share of what sectors weigh on average have no say: at the edges of the arc the noise is larger than it
/// is elsewhere, and a few strays are all that there is.
const SHARE_MIN: f64 = 0.1;
/// Blocks that the straight line of each sector takes up, and residuals of a block that its shifts do.
const LINE: f64 = 2.0;
const SHIFTS: f64 = 2.0;

/// The covariance of (p, q, y_ref, z_ref, R) by the field; `None` where none is told from chance.
pub(super) fn covariance(surface: &Surface, solution: &Solution, hold: Hold) -> Option<Matrix5<f64>> {
    let cells = Cells::of(surface, solution)?;
    let [mean, slope] = Line::both(&cells);
    let noise = Noise::of(&cells, &mean, &slope)?;
    let is_fixed = matches!(hold, Hold::Fixed { .. });
    let radius = (!is_fixed).then(|| DVector::repeat(cells.sectors(), 1.0));
    // Not all points were looked at.
    let thinned = solution.total().weight / cells.weights.sum();
    let free = if is_fixed { step::OTHERS } else { Vector5::repeat(1.0) };
    let bread = Matrix5::from_diagonal(&free) * solution.bread(hold)? * thinned;
    let [mean_pull, slope_pull] = cells.pulls.each_ref().map(|pull| bread * pull);
    let found = [
        mean.field(&cells, &noise, &outer(cells.shifts.iter().chain(&radius)), &mean_pull),
        slope.field(&cells, &noise, &outer(cells.shifts.iter()), &slope_pull),
    ];
    found.into_iter().flatten().reduce(|mean, slope| mean + slope)
}

/// Σ v vᵀ.
fn outer<'a>(columns: impl Iterator<Item = &'a DVector<f64>>) -> DMatrix<f64> {
    columns.map(|column| column * column.transpose()).sum()
}

fn quotient(a: f64, b: f64) -> f64 {
    if b > 0.0 { a / b } else { 0.0 }
}

/// α or β of all sectors.
struct Line {
    values: DVector<f64>,
    /// Their weights, in points.
    weights: DVector<f64>,
    /// Mean place of each sector, at which α and β do not depend on each other.
    middle: DVector<f64>,
    /// What an error that a whole block shares leaves of its variance.
    per_blocks: f64,
}

impl Line {
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

    /// The mean of s² A K Aᵀ over the likelihood, with A the `effect` of the sectors; `None` where there need be no field. What
    /// the fit takes up has the `shape`.
    fn field(
        &self,
        cells: &Cells,
        noise: &Noise,
        shape: &DMatrix<f64>,
        effect: &OMatrix<f64, U5, Dyn>,
    ) -> Option<Matrix5<f64>> {
        let usual_weight = self.weights.mean();
        let usual = noise.variance * (quotient(1.0, usual_weight) + noise.share * self.per_blocks);
        let has_say = |weight: f64| weight > SHARE_MIN * usual_weight;
        let own = self.weights.map(|weight| if has_say(weight) { noise.variance / weight } else { FREE * usual });
        let shared = cells.kernel(noise.length) * (noise.share * noise.variance * self.per_blocks);
        let noise = DMatrix::from_diagonal(&own) + shared + shape * (FREE * usual);
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

/// What profiles do not share with each other: τ², g and ℓ_e.
struct Noise {
    variance: f64,
    share: f64,
    length: f64,
}

impl Noise {
    /// Of the greatest likelihood for the residuals √n e, whose covariance is τ² (δ_st + g √(n_s n_t) exp(−Δφ/ℓ_e)).
    fn of(cells: &Cells, mean: &Line, slope: &Line) -> Option<Self> {
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
        let mut best: Option<(f64, Self)> = None;
        for length in NOISE_LENGTHS {
            let kernel = cells.kernel(length).component_mul(&(&scale * scale.transpose()));
            for share in NOISE_SHARES {
                let identity = DMatrix::identity(cells.sectors(), cells.sectors());
                let Some(cholesky) = Cholesky::new(identity + &kernel * share + &shifts) else { continue };
                let variance = cholesky.solve(&scatter).trace() / free_count.max(1.0);
                let likelihood = -free_count * variance.ln() - log_determinant(&cholesky);
                if best.as_ref().is_none_or(|(most, _)| likelihood > *most) {
                    best = Some((likelihood, Self { variance, share: share / usual_weight, length }));
                }
            }
        }
        best.map(|(_, noise)| noise).filter(|noise| noise.variance > 0.0 && noise.share.is_finite())
    }
}
