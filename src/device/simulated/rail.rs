//! How straight the rail is: what the stage carries the sensor off, smooth along it, seeded. Must not know who rides on it.

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

impl Rail {
    /// One that is never more than `bound_mm` off.
    pub(super) fn new(bound_mm: f64, start_mm: f64, length_mm: f64, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(1);
        let phases = [(); 2].map(|()| WAVES.map(|_| chance.random_range(0.0..TAU)));
        Self { bound_mm, length_mm, start_mm, phases }
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
    fn it_keeps_its_bound_and_is_smooth() {
        let rail = Rail::new(0.01, 0.0, 1000.0, 4);
        let off: Vec<_> = (0..=1000).map(|x| rail.off(f64::from(x))[1]).collect();
        assert!(off.iter().all(|off| off.abs() <= 0.01) && off.iter().any(|off| off.abs() > 0.003));
        // Steepest where all waves rise at once: 2π/1000 · (0.5 + 0.6 + 0.6) of the bound.
        let steepest = off.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(steepest <= 0.01 * 1.7 * TAU / 1000.0, "{steepest}");
    }
}
