//! The sums that one Gauss-Newton or Newton step needs.

use nalgebra::{Matrix5, Vector5};

/// Sums over points: gradient Σ w·d·J and normal matrix Σ k·J Jᵀ of (p, q, y_ref, z_ref, R).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sums {
    pub(super) gradient: Vector5<f64>,
    pub(super) normal: Matrix5<f64>,
    /// Σ w.
    pub(super) weight: f64,
}

impl Sums {
    pub(super) fn zero() -> Self {
        Self { gradient: Vector5::zeros(), normal: Matrix5::zeros(), weight: 0.0 }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.gradient += other.gradient;
        self.normal += other.normal;
        self.weight += other.weight;
    }
}
