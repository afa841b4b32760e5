//! The section of one profile by the published robust method: an ellipse, re-weighted until the outliers have no weight. Returns
//! the section and its diagnostics, or the reason why there is none.
//!
//! The ellipse is a weighted direct least-squares fit. The conic F = A u² + B uv + C v² + D u + E v + G = 0 that minimises Σ w F²
//! under 4AC − B² = 1 is always an ellipse (Fitzgibbon, Pilu and Fisher 1999). Halír and Flusser (1998) eliminate the linear part,
//! which leaves M a = λ K a with M symmetric 3×3 and K of the constraint. Here M⁻¹ᐟ² K M⁻¹ᐟ² is diagonalised instead: it is
//! symmetric, has exactly one positive eigenvalue by Sylvester's law, and remains definite on exact data, where M is singular. The
//! conic is fitted in centred and scaled coordinates.

use crate::estimation::estimate::Section;
use crate::estimation::refusal::Reason;
use crate::estimation::settings::{Method, Settings};
use crate::estimation::statistics;
use crate::estimation::type_b::Patches;
use crate::geometry::{Angle, SectionEllipse};
use nalgebra::{Matrix3, Matrix6, Vector3};
use std::f64::consts::TAU;

/// A residual spread below this share of the profile's size is rounding, not noise.
const SPREAD_FLOOR: f64 = 1e-9;
/// Re-weighting has settled when the ellipse moves by less than this share of ε.
const SETTLED: f64 = 1e-3;
/// Shift of the points of a patch for finite differences, in units of the profile's spread: its square is far below one, and
/// rounding is far below it.
const SHIFT: f64 = 1e-4;

/// Buffers for one profile, reused between profiles.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    pub(super) y: Vec<f64>,
    pub(super) z: Vec<f64>,
    weights: Vec<f64>,
    squared: Vec<f64>,
    scratch: Vec<u64>,
}

/// Centre and size that move a profile's points near the unit circle.
#[derive(Debug, Clone, Copy)]
struct Normalisation {
    y: f64,
    z: f64,
    scale: f64,
}

impl Workspace {
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

    /// The response of centre y, centre z and semi-minor axis to a shift of the points of each patch in z, with unchanged weights.
    /// Fits the profile as [`Self::fit`] does; empty if it has no ellipse.
    pub(super) fn responses(&mut self, settings: &Settings, patches: &Patches) -> Vec<[f64; 3]> {
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
        let sigma = statistics::sigma(&self.squared, &mut self.scratch).max(SPREAD_FLOOR);
        let cut_off = statistics::cut_off_squared(sigma);
        self.weights.clear();
        self.weights.extend(self.squared.iter().map(|&r2| statistics::weight(r2, cut_off)));
    }

    fn judge(&mut self, ellipse: &SectionEllipse, to: Normalisation, epsilon: f64, iterations_count: u32) -> Section {
        let sigma = statistics::sigma(&self.squared, &mut self.scratch) * to.scale;
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

/// Difference of two ellipses in centre and axes.
fn movement(a: &SectionEllipse, b: &SectionEllipse) -> f64 {
    (a.centre_y - b.centre_y)
        .hypot(a.centre_z - b.centre_z)
        .max((a.semi_major - b.semi_major).abs())
        .max((a.semi_minor - b.semi_minor).abs())
}

/// Angle between the outermost of the given directions, relative to their mean; 360° if they surround it.
fn arc(directions: impl Iterator<Item = [f64; 2]> + Clone) -> f64 {
    let (mean_u, mean_v) = directions.clone().fold((0.0, 0.0), |(su, sv), [u, v]| (su + u, sv + v));
    // 1 − cos with the sign of the side has the order of the angle and needs no arc tangent for each point.
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

/// Coefficients of (u², uv, v², u, v, 1).
#[derive(Debug, Clone, Copy)]
pub(super) struct Conic([f64; 6]);

/// The weighted sums Σ w uⁱ vʲ, i + j ≤ 4, in independent lanes so that the loop vectorises.
struct Moments([f64; 15]);

const LANES: usize = 4;

impl Moments {
    fn sum(u: &[f64], v: &[f64], w: &[f64]) -> Self {
        let mut lanes = [[0.0; LANES]; 15];
        let (u_whole, u_rest) = u.as_chunks::<LANES>();
        let (v_whole, v_rest) = v.as_chunks::<LANES>();
        let (w_whole, w_rest) = w.as_chunks::<LANES>();
        for ((u, v), w) in u_whole.iter().zip(v_whole).zip(w_whole) {
            Self::add(&mut lanes, u, v, w);
        }
        for ((u, v), w) in u_rest.iter().zip(v_rest).zip(w_rest) {
            Self::add(&mut lanes, &[*u, 0.0, 0.0, 0.0], &[*v, 0.0, 0.0, 0.0], &[*w, 0.0, 0.0, 0.0]);
        }
        Self(lanes.map(|lane| lane.iter().sum()))
    }

    #[inline]
    fn add(lanes: &mut [[f64; LANES]; 15], u: &[f64; LANES], v: &[f64; LANES], w: &[f64; LANES]) {
        for i in 0..LANES {
            #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
            let (u, v, w) = (u[i], v[i], w[i]);
            let (uu, uv, vv) = (u * u, u * v, v * v);
            let (wuu, wuv, wvv) = (w * uu, w * uv, w * vv);
            let terms = [
                w,
                w * u,
                w * v,
                wuu,
                wuv,
                wvv,
                wuu * u,
                wuu * v,
                wvv * u,
                wvv * v,
                wuu * uu,
                wuu * uv,
                wuu * vv,
                wvv * uv,
                wvv * vv,
            ];
            for (lane, term) in lanes.iter_mut().zip(terms) {
                #[expect(clippy::indexing_slicing, reason = "i runs over the constant length of the arrays")]
                {
                    lane[i] += term;
                }
            }
        }
    }

    /// Σ w D Dᵀ for D = (u², uv, v², u, v, 1).
    #[rustfmt::skip]
    fn scatter(&self) -> Matrix6<f64> {
        let [m00, m10, m01, m20, m11, m02, m30, m21, m12, m03, m40, m31, m22, m13, m04] = self.0;
        Matrix6::from_row_slice(&[
            m40, m31, m22, m30, m21, m20,
            m31, m22, m13, m21, m12, m11,
            m22, m13, m04, m12, m03, m02,
            m30, m21, m12, m20, m11, m10,
            m21, m12, m03, m11, m02, m01,
            m20, m11, m02, m10, m01, m00,
        ])
    }
}

/// The 3×3 part of the constraint 4AC − B².
#[rustfmt::skip]
const CONSTRAINT: Matrix3<f64> = Matrix3::new(
    0.0, 0.0, 2.0,
    0.0, -1.0, 0.0,
    2.0, 0.0, 0.0,
);

/// Eigenvalues of M below this share of the largest are rounding.
const SINGULAR: f64 = 1e-17;

impl Conic {
    /// Fits points (u, v) with weights w, all of one length. `None` if they define no ellipse.
    pub(super) fn fit(u: &[f64], v: &[f64], w: &[f64]) -> Option<Self> {
        let scatter = Moments::sum(u, v, w).scatter();
        let quadratic: Matrix3<f64> = scatter.fixed_view::<3, 3>(0, 0).into_owned();
        let mixed: Matrix3<f64> = scatter.fixed_view::<3, 3>(0, 3).into_owned();
        let linear: Matrix3<f64> = scatter.fixed_view::<3, 3>(3, 3).into_owned();
        let eliminate = -linear.cholesky()?.solve(&mixed.transpose());
        let reduced = quadratic + mixed * eliminate;
        let a = constrained_minimum(&((reduced + reduced.transpose()) * 0.5))?;
        let b = eliminate * a;
        Self([a.x, a.y, a.z, b.x, b.y, b.z]).checked()
    }

    fn checked(self) -> Option<Self> {
        let [a, b, c, ..] = self.0;
        let definite = 4.0 * a * c - b * b;
        (self.0.iter().all(|v| v.is_finite()) && definite > 0.0).then(|| Self(self.0.map(|v| v / definite.sqrt())))
    }

    #[inline]
    fn value(&self, u: f64, v: f64) -> f64 {
        let [a, b, c, d, e, g] = self.0;
        a * u * u + b * u * v + c * v * v + d * u + e * v + g
    }

    /// Squared first-order distances F²/|∇F|² of the points, into `squared` (cleared first).
    pub(super) fn squared_distances(&self, u: &[f64], v: &[f64], squared: &mut Vec<f64>) {
        let [a, b, c, d, e, g] = self.0;
        squared.clear();
        squared.extend(u.iter().zip(v).map(|(&u, &v)| {
            let (gu, gv) = (2.0 * a * u + b * v + d, b * u + 2.0 * c * v + e);
            let value = 0.5 * (u * (gu + d) + v * (gv + e)) + g;
            value * value / (gu * gu + gv * gv).max(f64::MIN_POSITIVE)
        }));
    }

    /// The ellipse in the coordinates of the fit; `None` if the conic has no real points.
    pub(super) fn ellipse(&self) -> Option<SectionEllipse> {
        let [a, b, c, d, e, _] = self.0;
        let definite = 4.0 * a * c - b * b;
        let centre_y = (b * e - 2.0 * c * d) / definite;
        let centre_z = (b * d - 2.0 * a * e) / definite;
        let at_centre = self.value(centre_y, centre_z);
        // Eigenvalues of [[a, b/2], [b/2, c]]; the smaller one belongs to the major axis.
        let (mean, spread) = (0.5 * (a + c), 0.5 * (a - c).hypot(b));
        let sign = mean.signum();
        let (small, large) = (mean - sign * spread, mean + sign * spread);
        let (semi_major, semi_minor) = ((-at_centre / small).sqrt(), (-at_centre / large).sqrt());
        let rotation = if spread == 0.0 { 0.0 } else { 0.5 * (-sign * b).atan2(-sign * (a - c)) };
        let finite = [centre_y, centre_z, semi_major, semi_minor].iter().all(|v| v.is_finite());
        (finite && semi_minor > 0.0).then(|| SectionEllipse {
            centre_y,
            centre_z,
            semi_major,
            semi_minor,
            rotation: Angle::from_radians(rotation),
        })
    }
}

/// Minimises aᵀ M a under aᵀ K a > 0 of fixed value.
fn constrained_minimum(reduced: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let eigen = reduced.try_symmetric_eigen(f64::EPSILON, 100)?;
    let largest = eigen.eigenvalues.max();
    if !(largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let inverse_root = eigen.eigenvalues.map(|value| value.max(largest * SINGULAR).sqrt().recip());
    let half = eigen.eigenvectors * Matrix3::from_diagonal(&inverse_root);
    let eigen = (half.transpose() * CONSTRAINT * half).try_symmetric_eigen(f64::EPSILON, 100)?;
    let best = eigen.eigenvalues.imax();
    Some(half * eigen.eigenvectors.column(best))
}
