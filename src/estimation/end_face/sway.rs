//! How the columns move along the axis as the pose moves within its uncertainty. Must not know cells or where the part ends.
//!
//! A column's place has derivatives by the pose; with them the covariance of the pose is one of the columns' places. It has
//! next to no more than three motions (all alike, as the sine, and as the cosine of the angle), and of these the two in
//! which columns move most against each other are told apart: an edge that several columns show says which of them it was.

use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};

/// How far along either motion the pose is, in its standard deviations.
pub(super) type Motion = Vector2<f64>;

/// Decompositions converge within a few sweeps.
pub(super) const SWEEPS_MAX: usize = 100;

/// Motions of the columns, independent of each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sway {
    /// How far each column moves with a standard deviation of either motion, mm.
    columns: Vec<Motion>,
    /// Variance of what moves all columns alike, mm².
    alike: f64,
}

impl Sway {
    /// From the derivatives of each column's place by (deflection, pitch, y_ref, z_ref), and the covariance of these. `None`
    /// where that has no decomposition.
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
        let alike = rest.iter().map(|(_, motion)| by.iter().map(|by| by.dot(motion).powi(2)).sum::<f64>()).sum::<f64>();
        let columns = by.iter().map(|by| Motion::new(by.dot(first), by.dot(second))).collect();
        Some(Self { columns, alike: alike / count })
    }

    /// How far the pose moves a column, mm.
    pub(super) fn of_column(&self, column: usize, at: Motion) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&at))
    }

    /// How far columns move with a standard deviation of either motion, on average, mm; `None` without columns.
    pub(super) fn mean(&self, columns: impl Iterator<Item = usize>) -> Option<Motion> {
        let moved = columns.filter_map(|column| self.columns.get(column));
        let (sum, count) = moved.fold((Motion::zeros(), 0.0), |(sum, count), by| (sum + by, count + 1.0));
        (count > 0.0).then(|| sum / count)
    }

    /// The variance of a column by this covariance of the motions, mm².
    pub(super) fn variance_by(&self, column: usize, covariance: &Matrix2<f64>) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&(covariance * by)))
    }

    /// The variance of a column by both motions, mm².
    pub(super) fn variance_of(&self, column: usize) -> f64 {
        self.variance_by(column, &Matrix2::identity())
    }

    /// The largest standard deviation of a column by both motions, mm.
    pub(super) fn most(&self) -> f64 {
        (0..self.columns.len()).map(|column| self.variance_of(column)).fold(0.0, f64::max).sqrt()
    }

    /// Variance of what moves all columns alike, mm².
    pub(super) const fn alike(&self) -> f64 {
        self.alike
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns over 140° of a cylinder of radius 100, which slopes of 1e-4 and 2e-4 move, and an offset of 1e-3 with
    /// derivative 0.5 that moves all alike.
    #[test]
    fn the_two_slopes_are_told_apart_and_an_offset_is_not() {
        let angles = (-70..=70).map(|degrees| f64::from(degrees).to_radians());
        let derivatives: Vec<_> = angles.map(|a| Vector4::new(100.0 * a.sin(), 100.0 * a.cos(), 0.5, 0.0)).collect();
        let covariance = Matrix4::from_diagonal(&Vector4::new(1e-8, 4e-8, 1e-6, 1e-6));
        let sway = Sway::of(&derivatives, covariance).expect("a sway");
        for (column, by) in derivatives.iter().enumerate() {
            let expected = by.component_mul(by).dot(&covariance.diagonal());
            assert!((sway.variance_of(column) + sway.alike() - expected).abs() < 1e-8, "{column}");
        }
        assert!((sway.alike() - 0.25e-6).abs() < 0.05e-6, "{sway:?}");
    }

    #[test]
    fn without_uncertainty_nothing_moves() {
        let sway = Sway::of(&[Vector4::repeat(7.0); 3], Matrix4::zeros()).expect("a sway");
        assert!(sway.most() < 1e-12 && sway.alike() < 1e-12, "{sway:?}");
    }
}
