//! A cylinder seen along its axis: points of a profile projected on the plane square to the axis, where every section is the
//! same circle.
//!
//! e₁, e₂ and the axis' direction are orthonormal; a point (u, w) of its profile, from where the axis meets the profile's
//! plane, lies at X = e₁·(0, u, w) and Y = e₂·(0, u, w), so ρ² = X² + Y² without a difference of large numbers. With
//! C = X/ρ and S = Y/ρ the derivatives of d = ρ − R are −(C, S) in the coordinates of e₁ and e₂, times t = dx + s for the
//! slopes, where s = −(e₁ₓX + e₂ₓY) is how far along the axis the point is seen from where the axis meets its plane.

use super::model::Cylinder;
use super::sums::Sums;
use nalgebra::{Matrix5, Vector3};

/// A cylinder with e₁ towards where its points are.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    cylinder: Cylinder,
    first: Vector3<f64>,
    second: Vector3<f64>,
}

/// To look at a cylinder for what does not depend on where from.
pub(super) const ANY_DIRECTION: [f64; 2] = [0.0, 1.0];

/// How one plane x = const is projected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Projection {
    pub(super) dx: f64,
    pub(super) radius: f64,
    centre: [f64; 2],
    across: [f64; 2],
    up: [f64; 2],
    pub(super) axial: [f64; 2],
}

/// How points with an x of their own are projected: as [`Projection`], with how far along the axis they are, divided by n, so
/// that it is the lever t of the slopes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oblique {
    pub(super) radius: f64,
    reference: [f64; 3],
    across: [f64; 3],
    up: [f64; 3],
    along: [f64; 3],
}

impl Cylinder {
    /// The cylinder seen along its axis, with e₁ as near to `direction` (y, z) as can be.
    pub(super) fn facing(self, direction: [f64; 2]) -> View {
        let [y, z] = direction;
        let axis = Vector3::new(1.0, self.p, self.q).normalize();
        let wanted = Vector3::new(0.0, y, z).try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::z);
        // Never zero: the axis crosses every profile, so it does not lie in the direction's plane.
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

    /// Points with an x of their own.
    pub(super) fn oblique(&self) -> Oblique {
        let Cylinder { x_ref, y_ref, z_ref, p, q, radius } = self.cylinder;
        let along = Vector3::new(1.0, p, q) / (1.0 + p * p + q * q);
        let [across, up, along] = [self.first, self.second, along].map(|axis| axis.into());
        Oblique { radius, reference: [x_ref, y_ref, z_ref], across, up, along }
    }

    /// Sums in the parameters along e₁ and e₂ as sums in those along y and z.
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
