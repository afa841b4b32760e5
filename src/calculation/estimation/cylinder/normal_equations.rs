//! The sums that a Gauss-Newton or Newton step needs, and the step itself, with the radius free, fixed or with a prior.

use crate::estimation::settings::{RadiusRule, Settings};
use nalgebra::{Matrix5, Vector5};

/// How the radius is treated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RadiusConstraint {
    /// Estimated from the data alone.
    Free,
    /// Known exactly, mm.
    Fixed { radius: f64 },
    /// Known to be `radius` ± `sigma` (standard uncertainty), mm.
    Prior { radius: f64, sigma: f64 },
}

impl RadiusConstraint {
    /// From the settings.
    pub(super) fn of(settings: &Settings) -> Self {
        match (settings.radius, settings.nominal_radius_mm) {
            (RadiusRule::Fixed, Some(radius)) => Self::Fixed { radius },
            (RadiusRule::Prior, Some(radius)) => Self::Prior { radius, sigma: settings.radius_sigma_mm.unwrap_or(0.0) },
            _ => Self::Free,
        }
    }
}

/// The index vector of the radius among the parameters.
const RADIUS: Vector5<f64> = Vector5::new(0.0, 0.0, 0.0, 0.0, 1.0);
/// All other parameters.
pub(super) const OTHERS: Vector5<f64> = Vector5::new(1.0, 1.0, 1.0, 1.0, 0.0);

/// The normal matrix and gradient including the constraint on the radius. `noise` is the points' standard deviation, mm.
///
/// A fixed radius becomes a separate unit equation, so that the same 5×5 system serves every case.
pub(super) fn system(
    sums: &Sums,
    constraint: RadiusConstraint,
    noise: f64,
    radius: f64,
) -> (Matrix5<f64>, Vector5<f64>) {
    let (mut normal, mut gradient) = (sums.normal, sums.gradient);
    match constraint {
        RadiusConstraint::Free => {}
        RadiusConstraint::Fixed { radius: known } => {
            let others = Matrix5::from_diagonal(&OTHERS);
            // The radius moves to its value in one step, and the other parameters have to follow in the same step.
            gradient += normal * RADIUS * (known - radius);
            normal = others * normal * others + Matrix5::from_diagonal(&RADIUS);
            gradient = gradient.component_mul(&OTHERS) + RADIUS * (radius - known);
        }
        RadiusConstraint::Prior { radius: expected, sigma } => {
            let stiffness = (noise / sigma).powi(2);
            normal += Matrix5::from_diagonal(&(RADIUS * stiffness));
            gradient += RADIUS * (stiffness * (radius - expected));
        }
    }
    (normal, gradient)
}

/// The step −N⁻¹ g, scaled by the diagonal so that millimetres and slopes have equal weight; `None` if N is not positive definite.
pub(super) fn solve(normal: &Matrix5<f64>, gradient: &Vector5<f64>) -> Option<Vector5<f64>> {
    let scale = normal.diagonal().map(|v| v.sqrt().recip());
    let scaled = Matrix5::from_diagonal(&scale) * normal * Matrix5::from_diagonal(&scale);
    let step = scaled.cholesky()?.solve(&gradient.component_mul(&scale));
    let step = -step.component_mul(&scale);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// The inverse of the normal matrix, scaled likewise.
pub(super) fn invert(normal: &Matrix5<f64>) -> Option<Matrix5<f64>> {
    let scale = Matrix5::from_diagonal(&normal.diagonal().map(|v| v.sqrt().recip()));
    let inverse = scale * (scale * normal * scale).cholesky()?.inverse() * scale;
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn position_and_slopes_follow_a_fixed_radius_in_the_same_step() {
        let normal = Matrix5::from_fn(|i, j| 1.0 / (1.0 + i as f64 + j as f64)) + Matrix5::identity();
        let sums = Sums { gradient: Vector5::new(0.3, -0.2, 0.1, 0.4, -0.5), normal, weight: 1.0 };
        let (system, gradient) = system(&sums, RadiusConstraint::Fixed { radius: 20.5 }, 0.05, 20.0);
        let step = solve(&system, &gradient).expect("definite");
        assert!((step[4] - 0.5).abs() < 1e-12);
        // At the minimum of the quadratic function with that radius, the gradient by the other parameters is zero.
        let left = sums.gradient + normal * step;
        assert!(left.fixed_rows::<4>(0).norm() < 1e-12, "{left}");
    }
}
