//! The bias of a free ellipse on a part of its arc. The direct fit is biased along the viewing direction, more on shorter arcs and
//! rougher surfaces, and averaging over profiles does not reduce the bias, so it is a line of the budget. It is calculated by a
//! parametric bootstrap: profiles are simulated on the fitted ellipse with the fitted spread and the correlation of the residuals
//! from point to point (speckle), and fitted again; their mean error is the bias. The draws come from a fixed seed.

use super::section::Workspace;
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

/// Number of simulated profiles: the bias is then accurate to a sixteenth of a profile's scatter.
const DRAWS: u64 = 256;
/// Rounds, and profiles of each, for finding the noise that gives residuals like the observed ones.
const CALIBRATIONS: usize = 3;
const CALIBRATION_DRAWS: u64 = 48;
/// More points than this are thinned out together with their noise: bias and scatter depend equally on both.
const POINTS_MAX: usize = 640;
/// Largest correlation of the noise.
const CORRELATION_MAX: f64 = 0.99;

/// The bias of a profile whose points (y, z) gave `section`. Zero if it cannot be determined.
pub(super) fn bias(section: &Section, y: &[f64], z: &[f64], settings: &Settings) -> Bias {
    let stride = y.len().div_ceil(POINTS_MAX).max(1);
    let places: Vec<Place> = y.iter().zip(z).step_by(stride).map(|(&y, &z)| place(&section.ellipse, y, z)).collect();
    let seen = Seen { section, points: places.iter().map(|p| section.ellipse.point(p.parameter)).collect(), settings };
    let shown = Noise { sigma: section.sigma, correlation: correlation(&places, settings.epsilon_mm) };
    let mut noise = shown;
    // A fit absorbs some of the noise, most of the noise that is correlated over the arc: simulated profiles must have the
    // residuals of this one.
    for _ in 0..CALIBRATIONS {
        let simulated = seen.refits(&noise, CALIBRATION_DRAWS);
        let (sigma, correlation) =
            (mean(&simulated, |refit| refit.noise.sigma), mean(&simulated, |refit| refit.noise.correlation));
        if sigma <= 0.0 || sigma.is_nan() {
            return Bias::default();
        }
        noise.sigma *= shown.sigma / sigma;
        noise.correlation = (noise.correlation + shown.correlation - correlation).clamp(0.0, CORRELATION_MAX);
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
    correlation: f64,
}

/// The error of the fit of a simulated profile, mm, and the noise of its residuals.
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
    /// Fits of this many profiles simulated with this noise, in order, so that no sum depends on the number of threads.
    fn refits(&self, noise: &Noise, draws: u64) -> Vec<Refit> {
        (0..draws).into_par_iter().filter_map(|draw| self.refit(noise, draw)).collect()
    }

    fn refit(&self, noise: &Noise, draw: u64) -> Option<Refit> {
        let normal = Normal::new(0.0, noise.sigma).ok()?;
        let (kept, fresh) = (noise.correlation, (1.0 - noise.correlation * noise.correlation).sqrt());
        let (mut chance, mut workspace) = (ChaCha8Rng::seed_from_u64(draw), Workspace::default());
        let mut off = [normal.sample(&mut chance), normal.sample(&mut chance)];
        for [y, z] in &self.points {
            workspace.y.push(y + off[0]);
            workspace.z.push(z + off[1]);
            off = off.map(|off| kept * off + fresh * normal.sample(&mut chance));
        }
        let section = workspace.fit(&Settings { points_min: 6, ..*self.settings }).ok()?;
        let (found, simulated) = (section.ellipse, self.section.ellipse);
        let places: Vec<Place> = workspace.y.iter().zip(&workspace.z).map(|(&y, &z)| place(&found, y, z)).collect();
        Some(Refit {
            y: found.centre_y - simulated.centre_y,
            z: found.centre_z - simulated.centre_z,
            radius: found.semi_minor - simulated.semi_minor,
            noise: Noise { sigma: section.sigma, correlation: correlation(&places, self.settings.epsilon_mm) },
        })
    }
}

/// Position of a point on the ellipse and its distance from it.
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

/// Correlation of neighbours' distances, 0 to [`CORRELATION_MAX`]; points farther than ε are ignored.
fn correlation(places: &[Place], epsilon: f64) -> f64 {
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
    if square > 0.0 { (product / square).clamp(0.0, CORRELATION_MAX) } else { 0.0 }
}
