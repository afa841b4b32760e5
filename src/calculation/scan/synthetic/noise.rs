//! Random numbers of a synthetic scan: a stream for each effect, and the noise of every point: the noise common to neighbours along
//! the laser line (speckle), and the noise common to a profile (vibration of the stage).

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StudentT};

/// The noise along one profile.
///
/// e_k = φ·e_(k−1) + √(1 − φ²)·ε_k: for any correlation φ, a single point has the same standard deviation.
pub(super) struct Noise {
    sigma_mm: f64,
    /// Noise with heavy tails, and the factor that scales its standard deviation to 1.
    tails: Option<(StudentT<f64>, f64)>,
    correlation: f64,
    /// Displacement of the complete profile in y and z.
    shared: [f64; 2],
    /// Correlated noise of the last point; `None` before the first.
    last: Option<[f64; 2]>,
}

impl Noise {
    /// The noise of a new profile.
    pub(super) fn begin(
        sigma_mm: f64,
        correlation: f64,
        freedom: Option<f64>,
        jitter_sigma_mm: f64,
        chance: &mut ChaCha8Rng,
    ) -> Self {
        // Drawn only if requested, so that the scan of a part without it does not change.
        let shared = if jitter_sigma_mm > 0.0 {
            [normal(chance) * jitter_sigma_mm, normal(chance) * jitter_sigma_mm]
        } else {
            [0.0; 2]
        };
        let tails = freedom.and_then(tails);
        Self { sigma_mm, tails, correlation, shared, last: None }
    }

    /// Displacement of the next point in y and z.
    pub(super) fn next(&mut self, chance: &mut ChaCha8Rng) -> [f64; 2] {
        let fresh = [self.standard(chance) * self.sigma_mm, self.standard(chance) * self.sigma_mm];
        let rest = (1.0 - self.correlation * self.correlation).max(0.0).sqrt();
        let [fresh_y, fresh_z] = fresh;
        let now = self
            .last
            .map_or(fresh, |[y, z]| [self.correlation * y + rest * fresh_y, self.correlation * z + rest * fresh_z]);
        self.last = Some(now);
        let ([y, z], [shared_y, shared_z]) = (now, self.shared);
        [y + shared_y, z + shared_z]
    }

    /// A random number of standard deviation 1.
    fn standard(&self, chance: &mut ChaCha8Rng) -> f64 {
        match self.tails {
            Some((student, scale)) => student.sample(chance) * scale,
            None => normal(chance),
        }
    }
}

/// Student's t has the variance ν/(ν − 2), none for ν ≤ 2.
fn tails(freedom: f64) -> Option<(StudentT<f64>, f64)> {
    let scale = ((freedom - 2.0) / freedom).sqrt();
    if scale > 0.0 { StudentT::new(freedom).ok().map(|student| (student, scale)) } else { None }
}

pub(super) fn normal(chance: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(chance)
}

/// Random numbers of one effect, independent of those of the others.
#[derive(Debug, Clone, Copy)]
pub(super) enum Stream {
    Edges = 1,
    Sensor = 2,
    Travel = 3,
    Export = 4,
}

impl Stream {
    pub(super) fn of(self, seed: u64) -> ChaCha8Rng {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(self as u64);
        chance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::synthetic::Part;

    #[test]
    fn correlated_noise_scatters_as_much_and_follows_its_neighbour() {
        let part = Part { noise_sigma_mm: 0.05, noise_correlation: 0.9, ..Part::smooth(1) };
        let mut chance = ChaCha8Rng::seed_from_u64(5);
        let mut noise = part.noise(&mut chance);
        let drawn: Vec<f64> = (0..200_000).map(|_| noise.next(&mut chance)[1]).collect();
        let moment =
            |lag: usize| drawn.iter().zip(&drawn[lag..]).map(|(a, b)| a * b).sum::<f64>() / (drawn.len() - lag) as f64;
        // 19 points of it contain as much information as one independent point: 200 000 of them determine a moment to 1.4 %.
        assert!((moment(0).sqrt() - 0.05).abs() < 0.05 * 0.03, "{}", moment(0).sqrt());
        assert!((moment(1) / moment(0) - 0.9).abs() < 0.01, "{}", moment(1) / moment(0));
    }

    #[test]
    fn heavy_tails_keep_the_standard_deviation() {
        let part = Part { noise_sigma_mm: 0.05, noise_freedom: Some(5.0), ..Part::smooth(1) };
        let mut chance = ChaCha8Rng::seed_from_u64(5);
        let mut noise = part.noise(&mut chance);
        let drawn: Vec<f64> = (0..200_000).flat_map(|_| noise.next(&mut chance)).collect();
        let moment = |power: i32| drawn.iter().map(|e| (e / 0.05).powi(power)).sum::<f64>() / drawn.len() as f64;
        // Student's t with ν = 5 has a kurtosis of 3 + 6/(ν − 4) = 9: 400 000 squares determine the variance to √(8/4e5),
        // 0.45 %.
        assert!((moment(2) - 1.0).abs() < 4.0 * 0.0045, "{}", moment(2));
        // P(|t| > 3·√(5/3)) = 0.0117 for ν = 5 (tables); 0.0027 for normal noise.
        let far = drawn.iter().filter(|e| e.abs() > 0.15).count() as f64 / drawn.len() as f64;
        assert!((far - 0.0117).abs() < 0.001, "{far}");
    }

    #[test]
    fn jitter_is_the_same_for_all_points_of_a_profile() {
        let part = Part { noise_sigma_mm: 0.0, jitter_sigma_mm: 0.03, ..Part::smooth(1) };
        let mut chance = ChaCha8Rng::seed_from_u64(5);
        let mut noise = part.noise(&mut chance);
        let first = noise.next(&mut chance);
        assert!(first[0] != 0.0 && first == noise.next(&mut chance));
        assert!(first != part.noise(&mut chance).next(&mut chance));
    }
}
