//! How far a free ellipse on a part of its arc is pulled from the truth. The direct fit is biased along the viewing
//! direction, more on shorter arcs and rougher surfaces, and no number of profiles removes that; so it belongs into the
//! budget. Found by a parametric bootstrap: profiles are made on the fitted ellipse with the fitted spread and fitted again;
//! what they are off on average is the bias. The draws come from a fixed seed. Must not know other profiles.

use super::section::Bench;
use crate::estimation::{Section, Settings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;

/// The mean error of a profile's fit, mm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bias {
    pub(super) y: f64,
    pub(super) z: f64,
    pub(super) radius: f64,
    /// Standard deviation of the radius from profile to profile.
    pub(super) radius_scatter: f64,
}

/// Profiles made: the bias is then known to a sixteenth of a profile's scatter.
const DRAWS: u64 = 256;
/// More points than this are thinned out, and their noise with them: bias and scatter depend on both alike.
const POINTS_MAX: usize = 640;

/// The bias of a profile whose points (y, z) gave `section`. Zero where nothing can be made of them.
pub(super) fn bias(section: &Section, y: &[f64], z: &[f64], settings: &Settings) -> Bias {
    let Ok(noise) = Normal::new(0.0, section.sigma) else { return Bias::default() };
    let ellipse = section.ellipse;
    let (sin, cos) = ellipse.rotation.radians().sin_cos();
    // Where on the ellipse each point was seen.
    let stride = y.len().div_ceil(POINTS_MAX).max(1);
    let seen: Vec<[f64; 2]> = y
        .iter()
        .zip(z)
        .step_by(stride)
        .map(|(y, z)| [y - ellipse.centre_y, z - ellipse.centre_z])
        .map(|[u, w]| ((w * cos - u * sin) / ellipse.semi_minor).atan2((u * cos + w * sin) / ellipse.semi_major))
        .map(|parameter| ellipse.point(parameter))
        .collect();
    let fit = |draw: u64| {
        let mut chance = ChaCha8Rng::seed_from_u64(draw);
        let mut bench = Bench::default();
        for [y, z] in &seen {
            bench.y.push(y + noise.sample(&mut chance));
            bench.z.push(z + noise.sample(&mut chance));
        }
        let found = bench.fit(&Settings { points_min: 6, ..*settings }).ok()?.ellipse;
        Some([
            found.centre_y - ellipse.centre_y,
            found.centre_z - ellipse.centre_z,
            found.semi_minor - ellipse.semi_minor,
        ])
    };
    // Collected in order, so that the sum does not depend on threads.
    let errors: Vec<[f64; 3]> = (0..DRAWS).into_par_iter().filter_map(fit).collect();
    let mean = |pick: fn(&[f64; 3]) -> f64| errors.iter().map(pick).sum::<f64>() / errors.len().max(1) as f64;
    let radius = mean(|e| e[2]);
    let radius_scatter = (mean(|e| e[2] * e[2]) - radius * radius).max(0.0).sqrt();
    Bias { y: mean(|e| e[0]), z: mean(|e| e[1]), radius, radius_scatter }
}
