//! How far a free ellipse on a part of its arc is pulled from the truth. The direct fit is biased along the viewing direction,
//! more on shorter arcs and rougher surfaces, and no number of profiles removes that; so it belongs into the budget. Found by a
//! parametric bootstrap: profiles are made on the fitted ellipse with the fitted spread, and noise that is as like from point
//! to point as the residuals are (speckle), and fitted again; what they are off on average is the bias. The draws come from a
//! fixed seed.

use super::section::Bench;
use crate::estimation::estimate::Section;
use crate::estimation::settings::Settings;
use crate::geometry::SectionEllipse;
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
/// Rounds, and profiles of each, that tell the noise from what of it shows.
const CALIBRATIONS: usize = 3;
const CALIBRATION_DRAWS: u64 = 48;
/// More points than this are thinned out, and their noise with them: bias and scatter depend on both alike.
const POINTS_MAX: usize = 640;
/// Noise that is more alike than this is none.
const LIKENESS_MAX: f64 = 0.99;

/// The bias of a profile whose points (y, z) gave `section`. Zero where nothing can be made of them.
pub(super) fn bias(section: &Section, y: &[f64], z: &[f64], settings: &Settings) -> Bias {
    let stride = y.len().div_ceil(POINTS_MAX).max(1);
    let places: Vec<Place> = y.iter().zip(z).step_by(stride).map(|(&y, &z)| place(&section.ellipse, y, z)).collect();
    let seen = Seen { section, points: places.iter().map(|p| section.ellipse.point(p.parameter)).collect(), settings };
    let shown = Noise { sigma: section.sigma, alike: likeness(&places, settings.epsilon_mm) };
    let mut noise = shown;
    // A fit hides some of the noise, most of what is alike over the arc: what made profiles show must be what this one shows.
    for _ in 0..CALIBRATIONS {
        let made = seen.refits(&noise, CALIBRATION_DRAWS);
        let (sigma, alike) = (mean(&made, |refit| refit.noise.sigma), mean(&made, |refit| refit.noise.alike));
        if sigma <= 0.0 || sigma.is_nan() {
            return Bias::default();
        }
        noise.sigma *= shown.sigma / sigma;
        noise.alike = (noise.alike + shown.alike - alike).clamp(0.0, LIKENESS_MAX);
    }
    let refits = seen.refits(&noise, DRAWS);
    let radius = mean(&refits, |refit| refit.radius);
    let radius_scatter = (mean(&refits, |refit| refit.radius * refit.radius) - radius * radius).max(0.0).sqrt();
    Bias { y: mean(&refits, |refit| refit.y), z: mean(&refits, |refit| refit.z), radius, radius_scatter }
}

fn mean(refits: &[Refit], pick: impl Fn(&Refit) -> f64) -> f64 {
    refits.iter().map(pick).sum::<f64>() / refits.len().max(1) as f64
}

/// Noise along a profile.
#[derive(Debug, Clone, Copy)]
struct Noise {
    /// Standard deviation in y and in z, mm.
    sigma: f64,
    /// Correlation from point to point.
    alike: f64,
}

/// How far off a made profile was fitted, mm, and what noise its residuals show.
struct Refit {
    y: f64,
    z: f64,
    radius: f64,
    noise: Noise,
}

/// A profile without its noise.
struct Seen<'a> {
    section: &'a Section,
    points: Vec<[f64; 2]>,
    settings: &'a Settings,
}

impl Seen<'_> {
    /// Fits of so many profiles that are made with this noise, in order, so that no sum depends on threads.
    fn refits(&self, noise: &Noise, draws: u64) -> Vec<Refit> {
        (0..draws).into_par_iter().filter_map(|draw| self.refit(noise, draw)).collect()
    }

    fn refit(&self, noise: &Noise, draw: u64) -> Option<Refit> {
        let normal = Normal::new(0.0, noise.sigma).ok()?;
        let (alike, fresh) = (noise.alike, (1.0 - noise.alike * noise.alike).sqrt());
        let (mut chance, mut bench) = (ChaCha8Rng::seed_from_u64(draw), Bench::default());
        let mut off = [normal.sample(&mut chance), normal.sample(&mut chance)];
        for [y, z] in &self.points {
            bench.y.push(y + off[0]);
            bench.z.push(z + off[1]);
            off = off.map(|off| alike * off + fresh * normal.sample(&mut chance));
        }
        let section = bench.fit(&Settings { points_min: 6, ..*self.settings }).ok()?;
        let (found, made) = (section.ellipse, self.section.ellipse);
        let places: Vec<Place> = bench.y.iter().zip(&bench.z).map(|(&y, &z)| place(&found, y, z)).collect();
        Some(Refit {
            y: found.centre_y - made.centre_y,
            z: found.centre_z - made.centre_z,
            radius: found.semi_minor - made.semi_minor,
            noise: Noise { sigma: section.sigma, alike: likeness(&places, self.settings.epsilon_mm) },
        })
    }
}

/// Where on the ellipse a point was seen, and how far from it.
struct Place {
    /// Parameter of the ellipse, radians.
    parameter: f64,
    /// Along the line of sight from the centre, positive outside, mm.
    off: f64,
}

fn place(ellipse: &SectionEllipse, y: f64, z: f64) -> Place {
    let (sin, cos) = ellipse.rotation.radians().sin_cos();
    let [u, w] = [y - ellipse.centre_y, z - ellipse.centre_z];
    let [along, across] = [(u * cos + w * sin) / ellipse.semi_major, (w * cos - u * sin) / ellipse.semi_minor];
    let reach = along.hypot(across).max(f64::MIN_POSITIVE);
    Place { parameter: across.atan2(along), off: u.hypot(w) * (1.0 - 1.0 / reach) }
}

/// Correlation of neighbours' distances, 0 to [`LIKENESS_MAX`]; points farther than ε say nothing.
fn likeness(places: &[Place], epsilon: f64) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for pair in places.windows(2) {
        if let [a, b] = pair
            && a.off.abs() < epsilon
            && b.off.abs() < epsilon
        {
            product += a.off * b.off;
            square += 0.5 * (a.off * a.off + b.off * b.off);
        }
    }
    if square > 0.0 { (product / square).clamp(0.0, LIKENESS_MAX) } else { 0.0 }
}
