//! The straightness error of the simulated rail: a smooth function of the position, generated from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Weights of the sine waves of the error; their sum is 1, so that the error never exceeds its bound.
const WAVES: [f64; 3] = [0.5, 0.3, 0.2];

/// The straightness error of a rail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rail {
    bound_mm: f64,
    length_mm: f64,
    start_mm: f64,
    /// Phases for y and for z.
    phases: [[f64; 3]; 2],
}

/// The straightness of a rail, as a calibration states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straightness {
    /// Standard uncertainty of the deviation from a straight line, in y and in z, at any position, mm.
    pub standard_mm: f64,
    /// Distance at which the deviations at two positions have the correlation exp(−1/2), mm.
    pub correlation_length_mm: f64,
}

impl Rail {
    /// A rail whose deviation never exceeds `bound_mm`.
    pub(super) fn new(bound_mm: f64, start_mm: f64, length_mm: f64, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(1);
        let phases = [(); 2].map(|()| WAVES.map(|_| chance.random_range(0.0..TAU)));
        Self { bound_mm, length_mm, start_mm, phases }
    }

    /// The calibration of such a rail: a wave of unknown phase has the variance amplitude²/2 and the correlation
    /// cos(2πk·distance/length); their sum agrees for short distances with exp(−distance²/(2L²)), where L² = Σ variance / Σ
    /// variance·(2πk/length)².
    pub(super) fn calibration(bound_mm: f64, length_mm: f64) -> Straightness {
        let squares = |of_wave: fn(f64) -> f64| -> f64 {
            WAVES.iter().zip(1..).map(|(weight, k)| (weight * of_wave(f64::from(k))).powi(2)).sum()
        };
        let (size, steepness) = (squares(|_| 1.0), squares(|k| k));
        Straightness {
            standard_mm: bound_mm * (size / 2.0).sqrt(),
            correlation_length_mm: length_mm / TAU * (size / steepness).sqrt(),
        }
    }

    /// The deviation of the sensor in y and in z, mm.
    pub(super) fn off(&self, x: f64) -> [f64; 2] {
        let turn = TAU * (x - self.start_mm) / self.length_mm;
        self.phases.map(|phases| {
            let waves = WAVES.iter().zip(phases).zip(1..);
            self.bound_mm * waves.map(|((weight, phase), k)| weight * (f64::from(k) * turn + phase).sin()).sum::<f64>()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calibration_agrees_with_the_statistics_of_many_rails() {
        let (bound_mm, length_mm) = (0.01, 1000.0);
        let Straightness { standard_mm, correlation_length_mm } = Rail::calibration(bound_mm, length_mm);
        let rails_count = 4000;
        let distances = [0.0, 0.5, 1.0].map(|share| share * correlation_length_mm);
        let mut products = [0.0; 3];
        for seed in 0..rails_count {
            let rail = Rail::new(bound_mm, 0.0, length_mm, seed);
            for (product, distance) in products.iter_mut().zip(distances) {
                let (here, there) = (rail.off(300.0), rail.off(300.0 + distance));
                *product += (here[0] * there[0] + here[1] * there[1]) / (2.0 * rails_count as f64);
            }
        }
        // 8000 products have a standard deviation of about 1 % of the variance. At the correlation length the waves have the
        // correlation 0.576 instead of exp(−1/2) = 0.607, because they agree with the normal curve only for short distances.
        for (product, expected) in products.into_iter().zip([1.0, 0.880, 0.576]) {
            assert!((product / standard_mm.powi(2) - expected).abs() < 0.04, "{product} for {expected}");
        }
    }

    #[test]
    fn the_straightness_error_is_bounded_and_smooth() {
        let rail = Rail::new(0.01, 0.0, 1000.0, 4);
        let off: Vec<_> = (0..=1000).map(|x| rail.off(f64::from(x))[1]).collect();
        assert!(off.iter().all(|off| off.abs() <= 0.01) && off.iter().any(|off| off.abs() > 0.003));
        // The slope is greatest where all waves rise at once: 2π/1000 · (0.5 + 0.6 + 0.6) of the bound.
        let steepest = off.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(steepest <= 0.01 * 1.7 * TAU / 1000.0, "{steepest}");
    }
}
