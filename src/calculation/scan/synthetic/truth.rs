//! The truth of a synthetic scan, and the Cramér-Rao bound of the pose from the points that lie on the part, for independent
//! normal noise along the surface normal.
//!
//! The bound does not hold for scans with sensor errors, encoder noise or rounding, which make a pose less certain than it says,
//! nor under heavy tails, where an estimator can undercut it.

use super::Part;
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Vector5};
use serde::{Deserialize, Serialize};

/// The truth beside a synthetic scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Profiles made.
    pub profiles_count: usize,
    /// Points a profile before drop-outs.
    pub points_per_profile_count: usize,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Standard deviation of the noise in y and in z, mm.
    pub noise_sigma_mm: f64,
    /// atan p, degrees.
    pub deflection_deg: f64,
    /// atan q, degrees.
    pub pitch_deg: f64,
    /// Where the axis meets x = 0, mm.
    pub y_c0_mm: f64,
    /// Where the axis meets x = 0, mm.
    pub z_c0_mm: f64,
    /// Middle of the profiles, mm.
    pub x_ref_mm: f64,
    /// The axis at `x_ref_mm`, mm.
    pub y_ref_mm: f64,
    /// The axis at `x_ref_mm`, mm.
    pub z_ref_mm: f64,
    /// Standard deviations that no unbiased estimator can undercut; `None` without noise.
    pub bound: Option<Bound>,
    /// Where the axis meets the near end plane, mm; `None` where the part goes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub near_end_face_mm: Option<[f64; 3]>,
    /// Where the axis meets the far end plane, mm; `None` where the part goes on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub far_end_face_mm: Option<[f64; 3]>,
    /// Share of each profile's points that lie on the part.
    pub inner_ratio_per_profile: Vec<f64>,
    #[serde(skip)]
    information: Matrix5<f64>,
}

/// Cramér-Rao bounds of the pose with the radius free.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bound {
    /// Of the deflection, degrees.
    pub deflection_deg: f64,
    /// Of the pitch, degrees.
    pub pitch_deg: f64,
    /// Of y at x_ref, mm.
    pub y_ref_mm: f64,
    /// Of z at x_ref, mm.
    pub z_ref_mm: f64,
    /// Of the radius, mm.
    pub radius_mm: f64,
}

impl Truth {
    /// The axis.
    #[must_use]
    pub fn axis(&self) -> AxisLine {
        let slope = |degrees: f64| degrees.to_radians().tan();
        let (p, q) = (slope(self.deflection_deg), slope(self.pitch_deg));
        AxisLine { p, q, y0: self.y_c0_mm, z0: self.z_c0_mm }
    }

    pub(super) fn begin(part: &Part) -> Self {
        let x_ref_mm = part.x_start_mm + part.length_mm / 2.0;
        let [y_ref_mm, z_ref_mm] = part.axis.at(x_ref_mm);
        Self {
            profiles_count: part.profiles_count,
            points_per_profile_count: part.points_count,
            radius_mm: part.radius_mm,
            noise_sigma_mm: part.noise_sigma_mm,
            deflection_deg: part.axis.deflection().degrees(),
            pitch_deg: part.axis.pitch().degrees(),
            y_c0_mm: part.axis.y0,
            z_c0_mm: part.axis.z0,
            x_ref_mm,
            y_ref_mm,
            z_ref_mm,
            bound: None,
            near_end_face_mm: part.edges.near.map(|edge| edge.centre(&part.axis)),
            far_end_face_mm: part.edges.far.map(|edge| edge.centre(&part.axis)),
            inner_ratio_per_profile: Vec::with_capacity(part.profiles_count),
            information: Matrix5::zeros(),
        }
    }

    /// Adds what a point on the surface tells about (p, q, y_ref, z_ref, R): the derivatives of its distance from the
    /// cylinder, ∂d/∂y_ref = −(u − p·s)/ρ, ∂d/∂z_ref = −(w − q·s)/ρ, the slopes' are those times (dx + s), ∂d/∂R = −1.
    pub(super) fn add_inner_point(&mut self, part: &Part, [x, y, z]: [f64; 3]) {
        let (p, q, dx) = (part.axis.p, part.axis.q, x - self.x_ref_mm);
        let [axis_y, axis_z] = part.axis.at(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let s = (p * u + q * w) / (1.0 + p * p + q * q);
        let (by_y, by_z) = (-(u - p * s) / part.radius_mm, -(w - q * s) / part.radius_mm);
        let row = Vector5::new(by_y * (dx + s), by_z * (dx + s), by_y, by_z, -1.0);
        self.information += row * row.transpose();
    }

    pub(super) fn end_profile(&mut self, inner_count: usize, points_count: usize) {
        self.inner_ratio_per_profile.push(inner_count as f64 / points_count.max(1) as f64);
    }

    pub(super) fn end(mut self, part: &Part) -> Self {
        self.bound = self.information.try_inverse().filter(|_| part.noise_sigma_mm > 0.0).map(|inverse| {
            let standard = inverse.diagonal().map(|variance| variance.sqrt() * part.noise_sigma_mm);
            let [p, q, y_ref_mm, z_ref_mm, radius_mm] = standard.into();
            Bound {
                deflection_deg: f64::to_degrees(p / (1.0 + part.axis.p.powi(2))),
                pitch_deg: f64::to_degrees(q / (1.0 + part.axis.q.powi(2))),
                y_ref_mm,
                z_ref_mm,
                radius_mm,
            }
        });
        self
    }
}
