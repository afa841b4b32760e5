//! The straightness error of the simulated rail: smooth along the rail, from a seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Weights of the waves that the error is made of; their sum is 1, so that it never exceeds its bound.
const WAVES: [f64; 3] = [0.5, 0.3, 0.2];

/// The straightness error of a rail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rail {
    bound_mm: f64,
    length_mm: f64,
    start_mm: f64,
    /// Of y and of z.
    phases: [[f64; 3]; 2],
}

/// The straightness of a rail, as a calibration states it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Straightness {
    /// Standard uncertainty of the deviation from a straight line, in y and in z, at any place, mm.
    pub standard_mm: f64,
    /// Places this far apart are off with the correlation exp(−1/2), mm.
    pub correlation_length_mm: f64,
}

impl Rail {
    /// One that is never more than `bound_mm` off.
    pub(super) fn new(bound_mm: f64, start_mm: f64, length_mm: f64, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(1);
        let phases = [(); 2].map(|()| WAVES.map(|_| chance.random_range(0.0..TAU)));
        Self { bound_mm, length_mm, start_mm, phases }
    }

    /// What a calibration could state of such a rail: a wave of unknown phase has the variance amplitude²/2 and the correlation
    /// cos(2πk·distance/length), and all of them together begin as exp(−distance²/(2L²)) does, with L² =
    /// Σ variance / Σ variance·(2πk/length)².
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

    /// How far the sensor is off in y and in z, mm.
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
    fn its_calibration_is_what_many_rails_show() {
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
        // 8000 products scatter by about 1 % of the variance. At the correlation length the waves are alike by 0.576 instead
        // of exp(−1/2) = 0.607, since their correlation only begins as a normal curve does.
        for (product, expected) in products.into_iter().zip([1.0, 0.880, 0.576]) {
            assert!((product / standard_mm.powi(2) - expected).abs() < 0.04, "{product} for {expected}");
        }
    }

    #[test]
    fn it_keeps_its_bound_and_is_smooth() {
        let rail = Rail::new(0.01, 0.0, 1000.0, 4);
        let off: Vec<_> = (0..=1000).map(|x| rail.off(f64::from(x))[1]).collect();
        assert!(off.iter().all(|off| off.abs() <= 0.01) && off.iter().any(|off| off.abs() > 0.003));
        // Steepest where all waves rise at once: 2π/1000 · (0.5 + 0.6 + 0.6) of the bound.
        let steepest = off.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(steepest <= 0.01 * 1.7 * TAU / 1000.0, "{steepest}");
    }
}
