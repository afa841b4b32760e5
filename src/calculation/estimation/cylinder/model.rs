//! A cylinder about an axis that crosses every profile, its signed distance from a point and the derivatives of that distance.
//!
//! With dx = x − x_ref, u = y − (y_ref + p·dx), w = z − (z_ref + q·dx), n² = 1 + p² + q² and s = (p·u + q·w)/n²: ρ² = u² + w² −
//! (p·u + q·w)²/n² and d = ρ − R. Derivatives: ∂d/∂y_ref = −(u − p·s)/ρ, ∂d/∂z_ref = −(w − q·s)/ρ, those by p and q are the same
//! times (dx + s), ∂d/∂R = −1.
//!
//! A [`View`] is the cylinder seen along its axis: the points of a profile are projected on the plane perpendicular to the axis,
//! where every section is the same circle. e₁, e₂ and the direction of the axis are orthonormal. A point (u, w) of its profile,
//! measured from the intersection of the axis with the plane of the profile, lies at X = e₁·(0, u, w) and Y = e₂·(0, u, w), so ρ² =
//! X² + Y² without a difference of large numbers. With C = X/ρ and S = Y/ρ the derivatives of d = ρ − R are −(C, S) in the
//! coordinates of e₁ and e₂, times t = dx + s for the slopes, where s = −(e₁ₓX + e₂ₓY) is the distance along the axis from its
//! intersection with the plane.

use super::normal_equations::Sums;
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Vector3, Vector5};

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

/// A cylinder in one plane x = const.
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

/// Distance of a point and its derivatives.
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

    /// The same cylinder with another reference point along x.
    pub(super) fn about(self, x_ref: f64) -> Self {
        let [y_ref, z_ref] = self.axis().at(x_ref);
        Self { x_ref, y_ref, z_ref, ..self }
    }

    /// The cylinder with `step` added to (p, q, y_ref, z_ref, R); `None` if the result is not a cylinder.
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
    /// The cylinder in another plane.
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

/// A cylinder with e₁ in the direction of its points.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    cylinder: Cylinder,
    first: Vector3<f64>,
    second: Vector3<f64>,
}

/// The direction of a view whose result does not depend on the direction.
pub(super) const ANY_DIRECTION: [f64; 2] = [0.0, 1.0];

/// The projection of one plane x = const.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    pub(super) dx: f64,
    pub(super) radius: f64,
    centre: [f64; 2],
    across: [f64; 2],
    up: [f64; 2],
    pub(super) axial: [f64; 2],
}

/// The projection of points with individual x: as [`Projection`], with the position along the axis divided by n, which is the lever
/// t of the slopes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oblique {
    pub(super) radius: f64,
    reference: [f64; 3],
    across: [f64; 3],
    up: [f64; 3],
    along: [f64; 3],
}

impl Cylinder {
    /// The cylinder seen along its axis, with e₁ as near to `direction` (y, z) as possible.
    pub(super) fn facing(self, direction: [f64; 2]) -> View {
        let [y, z] = direction;
        let axis = Vector3::new(1.0, self.p, self.q).normalize();
        let wanted = Vector3::new(0.0, y, z).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::z);
        // Never zero: the axis crosses every profile, so it does not lie in the plane of the direction.
        let first = (wanted - axis * axis.dot(&wanted)).normalize();
        View { cylinder: self, first, second: axis.cross(&first) }
    }
}

impl View {
    pub(super) fn cylinder(&self) -> &Cylinder {
        &self.cylinder
    }

    /// Signed distance of the point (x, y, z) from the surface, mm.
    #[inline(always)]
    pub(super) fn distance(&self, [x, y, z]: [f64; 3]) -> f64 {
        let (dx, u, w) = (x - self.cylinder.x_ref, y - self.cylinder.y_ref, z - self.cylinder.z_ref);
        let across = self.first.x * dx + self.first.y * u + self.first.z * w;
        let up = self.second.x * dx + self.second.y * u + self.second.z * w;
        (across * across + up * up).sqrt() - self.cylinder.radius
    }

    /// The profile at `x`.
    pub(super) fn at(&self, x: f64) -> Projection {
        let (dx, cylinder) = (x - self.cylinder.x_ref, &self.cylinder);
        Projection {
            dx,
            radius: cylinder.radius,
            centre: [cylinder.y_ref + cylinder.p * dx, cylinder.z_ref + cylinder.q * dx],
            across: [self.first.y, self.first.z],
            up: [self.second.y, self.second.z],
            axial: [-self.first.x, -self.second.x],
        }
    }

    /// The projection of points with individual x.
    pub(super) fn oblique(&self) -> Oblique {
        let Cylinder { x_ref, y_ref, z_ref, p, q, radius } = self.cylinder;
        let along = Vector3::new(1.0, p, q) / (1.0 + p * p + q * q);
        let [across, up, along] = [self.first, self.second, along].map(|axis| axis.into());
        Oblique { radius, reference: [x_ref, y_ref, z_ref], across, up, along }
    }

    /// Transforms sums in the parameters along e₁ and e₂ into sums in those along y and z.
    pub(super) fn unturned(&self, sums: &Sums) -> Sums {
        let ((ay, az), (by, bz)) = ((self.first.y, self.first.z), (self.second.y, self.second.z));
        #[rustfmt::skip]
        let turn = Matrix5::new(
            ay, by, 0.0, 0.0, 0.0,
            az, bz, 0.0, 0.0, 0.0,
            0.0, 0.0, ay, by, 0.0,
            0.0, 0.0, az, bz, 0.0,
            0.0, 0.0, 0.0, 0.0, 1.0,
        );
        Sums { gradient: turn * sums.gradient, normal: turn * sums.normal * turn.transpose(), weight: sums.weight }
    }
}

impl Oblique {
    /// X, Y and t of a point.
    #[inline(always)]
    pub(super) fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [x_ref, y_ref, z_ref] = self.reference;
        let (dx, u, w) = (x - x_ref, y - y_ref, z - z_ref);
        [self.across, self.up, self.along].map(|[by_x, by_y, by_z]| by_x * dx + by_y * u + by_z * w)
    }
}

impl Projection {
    /// (X, Y) of the point (y, z).
    #[inline(always)]
    pub(super) fn place(&self, y: f64, z: f64) -> [f64; 2] {
        let ([centre_y, centre_z], [ay, az], [by, bz]) = (self.centre, self.across, self.up);
        let (u, w) = (y - centre_y, z - centre_z);
        [ay * u + az * w, by * u + bz * w]
    }

    /// s of the point at (X, Y), mm.
    #[inline(always)]
    pub(super) fn axial(&self, across: f64, up: f64) -> f64 {
        let [a, b] = self.axial;
        a * across + b * up
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
    fn a_point_of_the_section_has_the_distance_zero() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let section = cylinder.axis().section(50.0, 70.0);
        for turn in 0..7 {
            let [y, z] = section.point(f64::from(turn));
            assert!(cylinder.slice(70.0).distance(y, z).abs() < 1e-12);
        }
    }
}
