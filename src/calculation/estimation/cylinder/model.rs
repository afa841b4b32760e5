//! A cylinder about an axis that crosses every profile, its signed distance from a point and the derivatives of it.
//!
//! With dx = x − x_ref, u = y − (y_ref + p·dx), w = z − (z_ref + q·dx), n² = 1 + p² + q² and s = (p·u + q·w)/n²:
//! ρ² = u² + w² − (p·u + q·w)²/n² and d = ρ − R. Derivatives: ∂d/∂y_ref = −(u − p·s)/ρ, ∂d/∂z_ref = −(w − q·s)/ρ,
//! those of p and q are the same times (dx + s), ∂d/∂R = −1.

use crate::geometry::AxisLine;
use nalgebra::Vector5;

/// The parameters (p, q, y_ref, z_ref, R) about a fixed x_ref, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cylinder {
    pub(super) x_ref: f64,
    pub(super) p: f64,
    pub(super) q: f64,
    pub(super) y_ref: f64,
    pub(super) z_ref: f64,
    pub(super) radius: f64,
}

/// A cylinder as one plane x = const sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slice {
    x: f64,
    pub(super) dx: f64,
    pub(super) y: f64,
    pub(super) z: f64,
    pub(super) p: f64,
    pub(super) q: f64,
    /// 1/n².
    pub(super) per_n2: f64,
    pub(super) radius: f64,
}

/// Distance of a point and what it depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Response {
    /// Signed distance from the surface, positive outside, mm.
    pub(super) d: f64,
    /// ∂d/∂y_ref.
    pub(super) a: f64,
    /// ∂d/∂z_ref.
    pub(super) b: f64,
    /// Lever of the slopes: ∂d/∂p = a·t, ∂d/∂q = b·t, mm.
    pub(super) t: f64,
}

impl Response {
    /// ∂d/∂(p, q, y_ref, z_ref, R).
    #[inline]
    pub(super) fn row(&self) -> Vector5<f64> {
        Vector5::new(self.a * self.t, self.b * self.t, self.a, self.b, -1.0)
    }
}

impl Cylinder {
    pub(super) fn axis(&self) -> AxisLine {
        AxisLine::through([self.x_ref, self.y_ref, self.z_ref], self.p, self.q)
    }

    /// The same cylinder with its reference elsewhere along x.
    pub(super) fn about(self, x_ref: f64) -> Self {
        let [y_ref, z_ref] = self.axis().at(x_ref);
        Self { x_ref, y_ref, z_ref, ..self }
    }

    /// The cylinder with `step` added to (p, q, y_ref, z_ref, R); `None` where that is no cylinder.
    pub(super) fn moved(self, step: &Vector5<f64>) -> Option<Self> {
        let [p, q, y_ref, z_ref, radius] = (*step).into();
        let moved = Self {
            x_ref: self.x_ref,
            p: self.p + p,
            q: self.q + q,
            y_ref: self.y_ref + y_ref,
            z_ref: self.z_ref + z_ref,
            radius: self.radius + radius,
        };
        let finite = [moved.p, moved.q, moved.y_ref, moved.z_ref, moved.radius].iter().all(|v| v.is_finite());
        (finite && moved.radius > 0.0).then_some(moved)
    }

    pub(super) fn slice(&self, x: f64) -> Slice {
        let dx = x - self.x_ref;
        Slice {
            x,
            dx,
            y: self.y_ref + self.p * dx,
            z: self.z_ref + self.q * dx,
            p: self.p,
            q: self.q,
            per_n2: 1.0 / (1.0 + self.p * self.p + self.q * self.q),
            radius: self.radius,
        }
    }
}

impl Slice {
    /// The cylinder as another plane sees it.
    #[inline]
    pub(super) fn at(&self, x: f64) -> Self {
        let step = x - self.x;
        Self { x, dx: self.dx + step, y: self.y + self.p * step, z: self.z + self.q * step, ..*self }
    }

    /// Signed distance of the point (y, z) of this plane, mm.
    #[inline]
    pub(super) fn distance(&self, y: f64, z: f64) -> f64 {
        let (u, w) = (y - self.y, z - self.z);
        let along = self.p * u + self.q * w;
        (u * u + w * w - along * along * self.per_n2).max(0.0).sqrt() - self.radius
    }

    /// Distance and derivatives of the point (y, z) of this plane.
    #[inline]
    pub(super) fn response(&self, y: f64, z: f64) -> Response {
        let (u, w) = (y - self.y, z - self.z);
        let along = self.p * u + self.q * w;
        let s = along * self.per_n2;
        let rho = (u * u + w * w - along * s).max(f64::MIN_POSITIVE).sqrt();
        let per_rho = 1.0 / rho;
        Response { d: rho - self.radius, a: (self.p * s - u) * per_rho, b: (self.q * s - w) * per_rho, t: self.dx + s }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivatives_are_the_slopes_of_the_distance() {
        let cylinder = Cylinder { x_ref: 100.0, p: 0.1, q: -0.15, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let (x, y, z) = (240.0, 30.0, 41.0);
        let response = cylinder.slice(x).response(y, z);
        let expected = [response.a * response.t, response.b * response.t, response.a, response.b, -1.0];
        for (index, expected) in expected.into_iter().enumerate() {
            let mut step = Vector5::zeros();
            step[index] = 1e-6;
            let ahead = cylinder.moved(&step).expect("valid").slice(x).distance(y, z);
            let behind = cylinder.moved(&-step).expect("valid").slice(x).distance(y, z);
            let slope = (ahead - behind) / 2e-6;
            assert!((slope - expected).abs() < 1e-6 * expected.abs().max(1.0), "{index}: {slope} {expected}");
        }
    }

    #[test]
    fn a_point_of_the_section_has_no_distance() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let section = cylinder.axis().section(50.0, 70.0);
        for turn in 0..7 {
            let [y, z] = section.point(f64::from(turn));
            assert!(cylinder.slice(70.0).distance(y, z).abs() < 1e-12);
        }
    }
}
