//! Tukey's biweight and the robust scale that goes with it: what re-weights points about a section and centres about an axis.
//!
//! w(r) = (1 − (r/cσ)²)² for |r| < cσ, else 0; c = 4.6851 keeps 95 % of the efficiency of least squares on normal
//! noise. σ = 1.4826 · median |r|. (Tukey's biweight as in Huber and Ronchetti, Robust Statistics.)
//!
//! Everything here works on squared residuals: they order like the absolute ones and cost no square root.

/// Tukey's tuning constant: the weight is zero from this many standard deviations on.
pub const TUKEY_C: f64 = 4.6851;
/// Makes the median absolute residual a standard deviation on normal noise.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Robust standard deviation from squared residuals; 0 for none. `scratch` is overwritten.
pub(super) fn sigma(squared_residuals: &[f64], scratch: &mut Vec<u64>) -> f64 {
    scratch.clear();
    // Floats that are not negative order like their bits, and integers are selected faster.
    scratch.extend(squared_residuals.iter().map(|r2| r2.to_bits()));
    if scratch.is_empty() {
        return 0.0;
    }
    let middle = scratch.len() / 2;
    let (_, median, _) = scratch.select_nth_unstable(middle);
    MAD_TO_SIGMA * f64::from_bits(*median).sqrt()
}

/// Squared distance at which the weight becomes zero.
pub(super) fn cut_off_squared(sigma: f64) -> f64 {
    (TUKEY_C * sigma).powi(2)
}

/// Weight of a squared residual.
#[inline]
pub(super) fn weight(squared_residual: f64, cut_off_squared: f64) -> f64 {
    let rest = (1.0 - squared_residual / cut_off_squared).max(0.0);
    rest * rest
}

/// Slope of the influence function ψ = w·d, the weight in Newton's method.
pub(super) fn weight_slope(squared_residual: f64, cut_off_squared: f64) -> f64 {
    let rest = (1.0 - squared_residual / cut_off_squared).max(0.0);
    rest * (5.0 * rest - 4.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_slope_of_tukeys_loss_over_the_residual() {
        // ρ(r) = c²/6 · (1 − (1 − (r/c)²)³), so w = ρ′/r.
        let c2 = cut_off_squared(0.3);
        let loss = |r: f64| c2 / 6.0 * (1.0 - (1.0 - r * r / c2).max(0.0).powi(3));
        for r in [0.01, 0.2, 0.9, 1.3, 1.5, 4.0] {
            let slope = (loss(r + 1e-6) - loss(r - 1e-6)) / 2e-6;
            assert!((weight(r * r, c2) - slope / r).abs() < 1e-6, "at {r}");
        }
    }

    #[test]
    fn sigma_is_the_scaled_median_and_ignores_a_minority() {
        let mut scratch = Vec::new();
        let squared: Vec<f64> = [0.1, -0.2, 0.3, 1e9, -1e9].iter().map(|r: &f64| r * r).collect();
        assert!((sigma(&squared, &mut scratch) - 1.4826 * 0.3).abs() < 1e-12);
        assert_eq!(sigma(&[], &mut scratch), 0.0);
    }
}
