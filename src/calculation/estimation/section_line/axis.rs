//! A robust straight line through the centres of the sections, and how well it is known.
//!
//! y = y_ref + p·(x − x_ref) and z likewise, each by weighted least squares, re-weighted by Tukey on the distance of the centre
//! from the line, |P_i P_0 × T| / |T|, until it settles. The covariance is the sandwich B (Σ G_i G_iᵀ) Bᵀ with the profile as
//! the cluster: whatever the points of a profile share is in its centre, so nothing is assumed about them. In: centres and
//! radii of profiles. Out: axis, radius, covariance, weights.

use crate::estimation::robust;
use crate::estimation::student::{TWO_SIGMA, coverage_ratio};
use crate::estimation::type_b::Influence;
use crate::geometry::AxisLine;
use nalgebra::{Matrix2, Matrix5, Vector2, Vector5};

/// What one profile says about the axis, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Centre {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
    pub(super) radius: f64,
}

/// The line and what belongs to it.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) axis: AxisLine,
    pub(super) x_ref: f64,
    pub(super) radius: f64,
    /// Of (p, q, y_ref, z_ref, radius), widened for its degrees of freedom.
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: f64,
    /// One a centre; 0 where it lies off the axis.
    pub(super) weights: Vec<f64>,
    /// How the line answers to the shift of a centre; one for each with a weight.
    pub(super) influences: Vec<Influence>,
}

/// Whether centres that do not agree lose their say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reweighting {
    Tukey,
    None,
}

/// No centre has all of the say, or nothing could be told of its error.
const LEVERAGE_MAX: f64 = 0.95;
const ROUNDS_MAX: usize = 100;
/// Where y_ref and, behind it, z_ref stand among the parameters.
const Y_REF: usize = 2;
/// Weights have settled when none moves by more.
const SETTLED: f64 = 1e-9;
/// Distances below this share of the lengths involved are rounding.
const SPREAD_FLOOR: f64 = 1e-10;

/// Fits the line; `None` where fewer than two distinct x remain.
pub(super) fn fit(centres: &[Centre], reweighting: Reweighting) -> Option<Fit> {
    let middle = centres.iter().map(|c| c.x).sum::<f64>() / centres.len() as f64;
    let mut weights = vec![1.0; centres.len()];
    let mut axis = line(centres, &weights, middle)?;
    let mut cut_off = f64::INFINITY;
    if reweighting == Reweighting::Tukey {
        for _ in 0..ROUNDS_MAX {
            let squared: Vec<f64> = centres.iter().map(|c| axis.distance([c.x, c.y, c.z]).powi(2)).collect();
            let size = centres.iter().fold(0.0_f64, |size, c| size.max(c.y.abs()).max(c.z.abs()).max(c.radius));
            let sigma = robust::sigma(&squared, &mut Vec::new()).max(SPREAD_FLOOR * size).max(f64::MIN_POSITIVE.sqrt());
            cut_off = robust::cut_off_squared(sigma);
            let before = weights;
            weights = squared.iter().map(|&r2| robust::weight(r2, cut_off)).collect();
            axis = line(centres, &weights, middle)?;
            if weights.iter().zip(&before).all(|(now, before)| (now - before).abs() < SETTLED) {
                break;
            }
        }
    }
    let (x_sum, used_count) = centres
        .iter()
        .zip(&weights)
        .filter(|(_, w)| **w > 0.0)
        .fold((0.0, 0.0), |(sum, count), (c, _)| (sum + c.x, count + 1.0));
    let x_ref = x_sum / used_count;
    let sum: f64 = weights.iter().sum();
    let radius = centres.iter().zip(&weights).map(|(c, w)| w * c.radius).sum::<f64>() / sum;
    // Two parameters a coordinate were taken from the centres that are left.
    let freedom = (used_count - 2.0).max(1.0);
    let (covariance, influences) = sensitivity(centres, &weights, &axis, x_ref, radius, cut_off)?;
    let covariance = covariance * coverage_ratio(freedom, TWO_SIGMA).powi(2);
    Some(Fit { axis, x_ref, radius, covariance, freedom, weights, influences })
}

/// Weighted least squares of y and z on x.
fn line(centres: &[Centre], weights: &[f64], middle: f64) -> Option<AxisLine> {
    let mut normal = Matrix2::zeros();
    let (mut right_y, mut right_z) = (Vector2::zeros(), Vector2::zeros());
    for (c, &w) in centres.iter().zip(weights) {
        let row = Vector2::new(1.0, c.x - middle);
        normal += row * row.transpose() * w;
        right_y += row * (w * c.y);
        right_z += row * (w * c.z);
    }
    let inverse = normal.cholesky()?;
    let (y, z) = (inverse.solve(&right_y), inverse.solve(&right_z));
    let axis = AxisLine::through([middle, y.x, z.x], y.y, z.y);
    [axis.p, axis.q, axis.y0, axis.z0].iter().all(|v| v.is_finite()).then_some(axis)
}

/// What the scatter of the centres does to the line, and what a shift of each would.
fn sensitivity(
    centres: &[Centre],
    weights: &[f64],
    axis: &AxisLine,
    x_ref: f64,
    radius: f64,
    cut_off: f64,
) -> Option<(Matrix5<f64>, Vec<Influence>)> {
    // Order inside: p, q, y_ref, z_ref, radius.
    let (mut hessian, mut scatter) = (Matrix5::<f64>::zeros(), Matrix5::<f64>::zeros());
    let mut blocks = Vec::with_capacity(centres.len());
    let (weight, spread) = centres
        .iter()
        .zip(weights)
        .fold((0.0, 0.0), |(weight, spread), (c, &w)| (weight + w, spread + w * (c.x - x_ref).powi(2)));
    for (c, &w) in centres.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
        let dx = c.x - x_ref;
        let [line_y, line_z] = axis.at(c.x);
        let (ry, rz) = (c.y - line_y, c.z - line_z);
        // A centre pulls the line towards itself; its residual is made as large as if it had not (MacKinnon and White, HC3).
        let leverage = (w / weight + w * dx * dx / spread).min(LEVERAGE_MAX);
        let gradient = Vector5::new(dx * ry, dx * rz, ry, rz, c.radius - radius) * (w / (1.0 - leverage));
        scatter += gradient * gradient.transpose();
        // d(w r)/dr = w·1 − 4·√w/cut² · r rᵀ for Tukey's weight.
        let bend = 4.0 * w.sqrt() / cut_off;
        let (kyy, kyz, kzz) = (w - bend * ry * ry, -bend * ry * rz, w - bend * rz * rz);
        #[rustfmt::skip]
        let block = Matrix5::new(
            dx * dx * kyy, dx * dx * kyz, dx * kyy, dx * kyz, 0.0,
            dx * dx * kyz, dx * dx * kzz, dx * kyz, dx * kzz, 0.0,
            dx * kyy, dx * kyz, kyy, kyz, 0.0,
            dx * kyz, dx * kzz, kyz, kzz, 0.0,
            0.0, 0.0, 0.0, 0.0, w,
        );
        hessian += block;
        blocks.push((c.x, block));
    }
    let bread = hessian.try_inverse()?;
    let matrix = bread * scatter * bread.transpose();
    let matrix = (matrix + matrix.transpose()) * 0.5;
    let influence = |(x, block): (f64, Matrix5<f64>)| Influence { x, effect: bread * block.fixed_columns::<2>(Y_REF) };
    let influences = blocks.into_iter().map(influence).collect();
    matrix.iter().all(|v| v.is_finite()).then_some((matrix, influences))
}
