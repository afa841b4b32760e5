//! The statistics that the methods share.
//!
//! Tukey's biweight and its robust scale, which re-weight points about a section and centres about an axis: w(r) = (1 − (r/cσ)²)²
//! for |r| < cσ, else 0; c = 4.6851 retains 95 % of the efficiency of least squares on normal noise. σ = 1.4826 · median |r|.
//! (Huber and Ronchetti, Robust Statistics.) The functions take squared residuals, which have the same order as the absolute ones
//! and need no square root.
//!
//! Student's t distribution, which widens an interval whose standard uncertainty has few degrees of freedom.

use libm::erfc;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::f64::consts::SQRT_2;

/// Tukey's tuning constant: the weight is zero from this many standard deviations on.
pub const TUKEY_C: f64 = 4.6851;
/// Factor that turns the median absolute residual of normal noise into its standard deviation.
const MAD_TO_SIGMA: f64 = 1.4826;

/// Robust standard deviation from squared residuals; 0 without residuals. `scratch` is overwritten.
pub(super) fn sigma(squared_residuals: &[f64], scratch: &mut Vec<u64>) -> f64 {
    scratch.clear();
    // Non-negative floats have the same order as their bits, and selection among integers is faster.
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

/// The quantile of the normal distribution with the two-sided coverage 95.45 %, to which the coverage factor k = 2 refers.
pub(super) const TWO_SIGMA: f64 = 2.0;

/// Below one degree of freedom the distribution has no mean.
const FREEDOM_MIN: f64 = 1.0;
/// Student's quantile exceeds the normal one z by the share (z² + 1)/4ν (Abramowitz and Stegun 26.7.5). Above this number of
/// degrees of freedom the excess is below 0.1 % for every z ≤ 6, and above 10⁷ the iteration of `statrs` for the incomplete beta
/// function does not end reliably.
const FREEDOM_MAX: f64 = 1e4;

/// Ratio of the quantile of Student's t distribution to `normal_quantile`, the quantile of the normal distribution with the same
/// two-sided coverage. `freedom` may be fractional.
pub(super) fn coverage_ratio(freedom: f64, normal_quantile: f64) -> f64 {
    let outside = erfc(normal_quantile / SQRT_2);
    #[expect(clippy::manual_clamp, reason = "NaN becomes the least value, while `clamp` would return NaN")]
    let freedom = freedom.max(FREEDOM_MIN).min(FREEDOM_MAX);
    let quantile = StudentsT::new(0.0, 1.0, freedom).map(|student| student.inverse_cdf(1.0 - 0.5 * outside));
    quantile.map_or(1.0, |quantile| quantile / normal_quantile)
}

/// The median; the upper one of two middle values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod robust_tests {
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

#[cfg(test)]
mod student_tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_table_of_the_gum() {
        // JCGM 100, table G.2, column 95.45 %, which has two decimals.
        for (freedom, quantile) in
            [(1.0, 13.97), (2.0, 4.53), (3.0, 3.31), (4.0, 2.87), (10.0, 2.28), (50.0, 2.05), (100.0, 2.025)]
        {
            assert!((TWO_SIGMA * coverage_ratio(freedom, TWO_SIGMA) - quantile).abs() < 0.005, "{freedom}");
        }
        // The same table, column 99.73 %.
        for (freedom, quantile) in [(1.0, 235.80), (3.0, 9.22), (10.0, 3.96)] {
            assert!((3.0 * coverage_ratio(freedom, 3.0) - quantile).abs() < 0.005, "{freedom}");
        }
    }

    #[test]
    fn fractional_degrees_of_freedom_interpolate_and_many_need_no_widening() {
        let mut before = f64::INFINITY;
        for step in 0..4000 {
            let freedom = (0.01 * f64::from(step)).exp();
            let ratio = coverage_ratio(freedom, TWO_SIGMA);
            assert!(ratio >= 1.0 && ratio <= before * (1.0 + 1e-9), "{freedom}: {ratio} after {before}");
            before = ratio;
        }
        assert!(before < 1.0002);
        assert!(coverage_ratio(f64::INFINITY, TWO_SIGMA) < 1.0002);
        assert!((coverage_ratio(f64::NAN, TWO_SIGMA) - coverage_ratio(1.0, TWO_SIGMA)).abs() < 1e-12);
    }
}
