//! The covariance of the joint fit, with the profile as the cluster. Must not know the points.
//!
//! Points of one profile share errors (speckle, vibration), so a covariance that takes them as independent is wrong. The
//! sandwich B (Σ_i G_i G_iᵀ) Bᵀ, with G_i the sum of w·d·J over profile i and B the inverse of Σ ψ′ J Jᵀ, assumes nothing
//! about points of the same profile.

use super::step::{self, Hold};
use super::sums::Sums;
use nalgebra::Matrix5;

/// Of (p, q, y_ref, z_ref, R), from the joint normal matrix and each profile's gradient; `None` where it is singular.
pub(super) fn sandwich(normal: &Matrix5<f64>, profiles: &[Sums], hold: Hold) -> Option<Matrix5<f64>> {
    let bread = step::invert(normal)?;
    let (mut meat, mut clusters_count) = (Matrix5::zeros(), 0.0_f64);
    for profile in profiles.iter().filter(|profile| profile.weight > 0.0) {
        // A fixed radius has no say and learns nothing.
        let fixed = matches!(hold, Hold::Fixed { .. });
        let gradient = if fixed { profile.gradient.component_mul(&step::OTHERS) } else { profile.gradient };
        meat += gradient * gradient.transpose();
        clusters_count += 1.0;
    }
    let freedom = clusters_count / (clusters_count - 5.0).max(1.0);
    Some(bread * meat * bread.transpose() * freedom)
}
