//! The section of one profile by the published robust method: an ellipse, re-weighted until the points that do not belong to it
//! have lost their say. In: the points of one profile. Out: the section and its diagnostics, or the reason why there is none.

use super::conic::Conic;
use crate::estimation::estimate::{Reason, Section};
use crate::estimation::linearity::Patches;
use crate::estimation::robust;
use crate::estimation::settings::{Method, Settings};
use crate::geometry::{Angle, SectionEllipse};
use std::f64::consts::TAU;

/// A residual spread below this share of the profile's size is rounding, not noise.
const SPREAD_FLOOR: f64 = 1e-9;
/// Re-weighting has settled when the ellipse moves by less than this share of ε.
const SETTLED: f64 = 1e-3;
/// Shift of the points of a patch, in units of the profile's spread, by which derivatives are taken: its square is far below
/// one, and rounding is far below it.
const SHIFT: f64 = 1e-4;

/// Room for one profile, kept between profiles.
#[derive(Debug, Default)]
pub(super) struct Bench {
    pub(super) y: Vec<f64>,
    pub(super) z: Vec<f64>,
    weights: Vec<f64>,
    squared: Vec<f64>,
    scratch: Vec<u64>,
}

/// Centre and size that bring a profile's points near the unit circle.
#[derive(Debug, Clone, Copy)]
struct Normalisation {
    y: f64,
    z: f64,
    scale: f64,
}

impl Bench {
    /// Fits the profile whose points lie in `self.y` and `self.z`, which are overwritten.
    pub(super) fn fit(&mut self, settings: &Settings) -> Result<Section, Reason> {
        if self.y.len() < settings.points_min as usize {
            return Err(Reason::TooFewPoints);
        }
        let normalisation = self.normalise().ok_or(Reason::TooFewPoints)?;
        let epsilon = settings.epsilon_mm / normalisation.scale;
        let (conic, iterations_count) = self.reweight(settings, epsilon).ok_or(Reason::NotConverged)?;
        let ellipse = conic.ellipse().ok_or(Reason::NotConverged)?;
        conic.squared_distances(&self.y, &self.z, &mut self.squared);
        Ok(self.judge(&ellipse, normalisation, epsilon, iterations_count))
    }

    /// How centre y, centre z and semi-minor axis answer to a shift of the points of each patch in z, the weights unchanged.
    /// Fits the profile as [`Self::fit`] does; empty where it has no ellipse.
    pub(super) fn answers(&mut self, settings: &Settings, patches: &Patches) -> Vec<[f64; 3]> {
        let Some(to) = self.normalise() else { return Vec::new() };
        if self.reweight(settings, settings.epsilon_mm / to.scale).is_none() {
            return Vec::new();
        }
        let places: Vec<usize> = self.y.iter().map(|y| patches.index(to.y + y * to.scale)).collect();
        let mut shifted = self.z.clone();
        let mut shape = |patch: usize, shift: f64| {
            for ((shifted, z), place) in shifted.iter_mut().zip(&self.z).zip(&places) {
                *shifted = if *place == patch { z + shift } else { *z };
            }
            let ellipse = Conic::fit(&self.y, &shifted, &self.weights)?.ellipse()?;
            Some([ellipse.centre_y, ellipse.centre_z, ellipse.semi_minor])
        };
        let mut answer = |patch: usize| {
            let ([y, z, radius], before) = shape(patch, SHIFT).zip(shape(patch, -SHIFT))?;
            let [y_before, z_before, radius_before] = before;
            Some([y - y_before, z - z_before, radius - radius_before].map(|change| change / (2.0 * SHIFT)))
        };
        (0..Patches::count()).map(|patch| answer(patch).unwrap_or_default()).collect()
    }

    /// Moves the points to their centroid and scales them to unit spread.
    fn normalise(&mut self) -> Option<Normalisation> {
        let count = self.y.len() as f64;
        let (y, z) = (self.y.iter().sum::<f64>() / count, self.z.iter().sum::<f64>() / count);
        let spread = self.y.iter().zip(&self.z).map(|(a, b)| (a - y).powi(2) + (b - z).powi(2)).sum::<f64>() / count;
        let scale = spread.sqrt();
        if !(scale.is_finite() && scale > y.abs().max(z.abs()) * f64::EPSILON * 16.0) {
            return None;
        }
        self.y.iter_mut().for_each(|v| *v = (*v - y) / scale);
        self.z.iter_mut().for_each(|v| *v = (*v - z) / scale);
        Some(Normalisation { y, z, scale })
    }

    fn reweight(&mut self, settings: &Settings, epsilon: f64) -> Option<(Conic, u32)> {
        self.weights.clear();
        self.weights.resize(self.y.len(), 1.0);
        let mut conic = Conic::fit(&self.y, &self.z, &self.weights)?;
        let mut fits_count = 1;
        if settings.method == Method::SectionLine {
            let mut before = conic.ellipse();
            for _ in 0..settings.iterations_max {
                self.reset_weights(&conic);
                conic = Conic::fit(&self.y, &self.z, &self.weights)?;
                fits_count += 1;
                let now = conic.ellipse();
                if before.zip(now).is_some_and(|(a, b)| movement(&a, &b) < SETTLED * epsilon) {
                    break;
                }
                before = now;
            }
        }
        Some((conic, fits_count))
    }

    fn reset_weights(&mut self, conic: &Conic) {
        conic.squared_distances(&self.y, &self.z, &mut self.squared);
        let sigma = robust::sigma(&self.squared, &mut self.scratch).max(SPREAD_FLOOR);
        let cut_off = robust::cut_off_squared(sigma);
        self.weights.clear();
        self.weights.extend(self.squared.iter().map(|&r2| robust::weight(r2, cut_off)));
    }

    fn judge(&mut self, ellipse: &SectionEllipse, to: Normalisation, epsilon: f64, iterations_count: u32) -> Section {
        let sigma = robust::sigma(&self.squared, &mut self.scratch) * to.scale;
        let inner = |r2: f64| r2 < epsilon * epsilon;
        let (inner_count, inner_sum) =
            self.squared.iter().filter(|r2| inner(**r2)).fold((0_usize, 0.0), |(count, sum), r2| (count + 1, sum + r2));
        let points = self.y.iter().zip(&self.z).zip(&self.squared);
        let arc =
            arc(points.filter(|(_, r2)| inner(**r2)).map(|((u, v), _)| [u - ellipse.centre_y, v - ellipse.centre_z]));
        Section {
            ellipse: SectionEllipse {
                centre_y: to.y + ellipse.centre_y * to.scale,
                centre_z: to.z + ellipse.centre_z * to.scale,
                semi_major: ellipse.semi_major * to.scale,
                semi_minor: ellipse.semi_minor * to.scale,
                rotation: ellipse.rotation,
            },
            sigma,
            inlier_ratio: inner_count as f64 / self.squared.len() as f64,
            rms: if inner_count == 0 { 0.0 } else { (inner_sum / inner_count as f64).sqrt() * to.scale },
            arc: Angle::from_radians(arc),
            iterations_count,
        }
    }
}

/// How far two ellipses lie apart, by centre and axes.
fn movement(a: &SectionEllipse, b: &SectionEllipse) -> f64 {
    (a.centre_y - b.centre_y)
        .hypot(a.centre_z - b.centre_z)
        .max((a.semi_major - b.semi_major).abs())
        .max((a.semi_minor - b.semi_minor).abs())
}

/// Angle between the outermost of the given directions, seen along their mean; a full turn where they surround it.
fn arc(directions: impl Iterator<Item = [f64; 2]> + Clone) -> f64 {
    let (mean_u, mean_v) = directions.clone().fold((0.0, 0.0), |(su, sv), [u, v]| (su + u, sv + v));
    // 1 − cos, signed by the side, orders directions like their angle and needs no arc tangent for each point.
    let outermost = directions.fold([None::<(f64, f64)>; 2], |[low, high], [u, v]| {
        let (along, across) = (u * mean_u + v * mean_v, v * mean_u - u * mean_v);
        let turn = (1.0 - along / along.hypot(across).max(f64::MIN_POSITIVE)).copysign(across);
        let angle = across.atan2(along);
        [
            if low.is_none_or(|(least, _)| turn < least) { Some((turn, angle)) } else { low },
            if high.is_none_or(|(most, _)| turn > most) { Some((turn, angle)) } else { high },
        ]
    });
    match outermost {
        [Some((_, low)), Some((_, high))] => (high - low).clamp(0.0, TAU),
        _ => 0.0,
    }
}
