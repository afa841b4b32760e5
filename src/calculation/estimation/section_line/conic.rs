//! Weighted direct least-squares fit of an ellipse, and the shape of the conic it returns.
//!
//! The conic F = A u² + B uv + C v² + D u + E v + G = 0 that minimises Σ w F² under 4AC − B² = 1 is always an ellipse
//! (Fitzgibbon, Pilu and Fisher 1999). Halír and Flusser (1998) eliminate the linear part and leave M a = λ K a with
//! M symmetric 3×3 and K of the constraint; here M⁻¹ᐟ² K M⁻¹ᐟ² is diagonalised instead, which is symmetric, has exactly one
//! positive eigenvalue by Sylvester's law, and stays defined on exact data, where M is singular.
//!
//! Coordinates come centred and scaled.

use crate::geometry::{Angle, SectionEllipse};
use nalgebra::{Matrix3, Matrix6, Vector3};

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
    /// Fits points (u, v) with weights w, all of one length. `None` where they define no ellipse.
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

    /// The ellipse in the coordinates of the fit; `None` where the conic has no real points.
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
