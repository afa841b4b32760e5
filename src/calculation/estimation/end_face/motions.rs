//! How the columns move along the axis as the pose moves within its uncertainty.
//!
//! The covariance of the pose gives the columns no more than three motions (all alike, as the sine, and as the cosine of the
//! angle). The two in which columns move most against each other are kept apart: an edge that several columns show
//! determines them. What remains moves all columns alike.

use super::unroll::{Columns, View};
use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

/// How far the pose is along either motion, in standard deviations.
pub(super) type Motion = Vector2<f64>;

/// Eigenvalue iterations converge within a few sweeps.
pub(super) const SWEEPS_MAX: usize = 100;

/// Motions of the columns, independent of each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Motions {
    /// How far each column moves with a standard deviation of either motion, mm.
    columns: Vec<Motion>,
    /// Variance of what moves all columns alike, mm².
    pub(super) common: f64,
}

impl Motions {
    /// Of the columns about a place along the axis; `covariance` is that of (deflection, pitch, y_ref, z_ref). `None` if it
    /// cannot be decomposed.
    pub(super) fn about(t: f64, view: &View, columns: &Columns, covariance: Matrix4<f64>) -> Option<Self> {
        let derivatives: Vec<_> = columns.all.iter().map(|column| view.edge_by_pose(column.angle, t)).collect();
        Self::of(&derivatives, covariance)
    }

    /// From the derivatives of each column's place by the pose.
    pub(super) fn of(derivatives: &[Vector4<f64>], covariance: Matrix4<f64>) -> Option<Self> {
        let eigen = covariance.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let root = Matrix4::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()));
        let by: Vec<Vector4<f64>> = derivatives.iter().map(|by| root * eigen.eigenvectors.tr_mul(by)).collect();
        let count = by.len().max(1) as f64;
        let mean = by.iter().sum::<Vector4<f64>>() / count;
        let against: Matrix4<f64> = by.iter().map(|by| (by - mean) * (by - mean).transpose()).sum();
        let eigen = against.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let mut motions: Vec<(f64, Vector4<f64>)> =
            eigen.eigenvalues.iter().copied().zip(eigen.eigenvectors.column_iter().map(Into::into)).collect();
        motions.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let [(_, first), (_, second), rest @ ..] = motions.as_slice() else { return None };
        let common: f64 = rest.iter().map(|(_, motion)| by.iter().map(|by| by.dot(motion).powi(2)).sum::<f64>()).sum();
        let columns = by.iter().map(|by| Motion::new(by.dot(first), by.dot(second))).collect();
        Some(Self { columns, common: common / count })
    }

    /// How far the pose moves a column, mm.
    pub(super) fn of_column(&self, column: usize, at: Motion) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&at))
    }

    /// How far these columns move with a standard deviation of either motion, on average, mm; `None` without columns.
    pub(super) fn mean(&self, columns: impl Iterator<Item = usize>) -> Option<Motion> {
        let moved = columns.filter_map(|column| self.columns.get(column));
        let (sum, count) = moved.fold((Motion::zeros(), 0.0), |(sum, count), by| (sum + by, count + 1.0));
        (count > 0.0).then(|| sum / count)
    }

    /// Variance of a column's place by a covariance of the motions, mm².
    pub(super) fn variance_by(&self, column: usize, covariance: &Matrix2<f64>) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&(covariance * by)))
    }

    /// The largest standard deviation of a column by both motions, mm.
    pub(super) fn largest(&self) -> f64 {
        self.columns.iter().map(Vector2::norm_squared).fold(0.0, f64::max).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns over 140° of a cylinder of radius 100, which slopes of 1e-4 and 2e-4 move, and an offset of 1e-3 with the
    /// derivative 0.5 that moves all alike.
    #[test]
    fn the_two_slopes_move_columns_against_each_other_and_an_offset_does_not() {
        let angles = (-70..=70).map(|degrees| f64::from(degrees).to_radians());
        let derivatives: Vec<_> = angles.map(|a| Vector4::new(100.0 * a.sin(), 100.0 * a.cos(), 0.5, 0.0)).collect();
        let covariance = Matrix4::from_diagonal(&Vector4::new(1e-8, 4e-8, 1e-6, 1e-6));
        let motions = Motions::of(&derivatives, covariance).expect("motions");
        for (column, by) in derivatives.iter().enumerate() {
            let expected = by.component_mul(by).dot(&covariance.diagonal());
            let variance = motions.variance_by(column, &Matrix2::identity());
            assert!((variance + motions.common - expected).abs() < 1e-8, "{column}");
        }
        assert!((motions.common - 0.25e-6).abs() < 0.05e-6, "{motions:?}");
    }

    #[test]
    fn without_uncertainty_nothing_moves() {
        let motions = Motions::of(&[Vector4::repeat(7.0); 3], Matrix4::zeros()).expect("motions");
        assert!(motions.largest() < 1e-12 && motions.common < 1e-12, "{motions:?}");
    }
}
