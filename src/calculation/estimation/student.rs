//! How much wider an interval has to be where its standard uncertainty rests on few degrees of freedom.

use libm::erfc;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::f64::consts::SQRT_2;

/// The quantile of the normal distribution whose two-sided coverage, 95.45 %, the coverage factor k = 2 stands for.
pub(super) const TWO_SIGMA: f64 = 2.0;

/// Below one degree of freedom the distribution has no mean that an interval could be about.
const FREEDOM_MIN: f64 = 1.0;
/// Student's quantile exceeds the normal one z by the share (z² + 1)/4ν (Abramowitz and Stegun 26.7.5): above this it is below
/// 0.1 % for every z ≤ 6, and the iteration of `statrs` for the incomplete beta function does not end reliably above 10⁷.
const FREEDOM_MAX: f64 = 1e4;

/// Quantile of Student's t distribution over that of the normal distribution with the same two-sided coverage, which is
/// given by `normal_quantile`. `freedom` may be fractional.
pub(super) fn coverage_ratio(freedom: f64, normal_quantile: f64) -> f64 {
    let outside = erfc(normal_quantile / SQRT_2);
    #[expect(clippy::manual_clamp, reason = "NaN becomes the least, where `clamp` would keep it")]
    let freedom = freedom.max(FREEDOM_MIN).min(FREEDOM_MAX);
    let quantile = StudentsT::new(0.0, 1.0, freedom).map(|student| student.inverse_cdf(1.0 - 0.5 * outside));
    quantile.map_or(1.0, |quantile| quantile / normal_quantile)
}

#[cfg(test)]
mod tests {
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
    fn fractional_degrees_of_freedom_lie_between_whole_ones_and_many_need_no_widening() {
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
