//! The surfaces that the search compares: cylinders in any direction, and the planes that it must not take for cylinders.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A circular cylinder without ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cylinder {
    /// A point of the axis.
    pub(super) point: Vector3<f64>,
    /// Unit vector along the axis.
    pub(super) direction: Vector3<f64>,
    pub(super) radius: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    pub(super) point: Vector3<f64>,
    /// Unit vector.
    pub(super) normal: Vector3<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Surface {
    Cylinder(Cylinder),
    Plane(Plane),
}

/// The largest turn of an axis in one step, rad: beyond it the linearisation says nothing.
const TURN_MAX: f64 = 0.5;

impl Cylinder {
    /// Signed distance of a point, positive outside.
    #[inline]
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        let from = point - self.point;
        let along = from.dot(&self.direction);
        (from - self.direction * along).norm() - self.radius
    }

    /// Coordinate of a point along the axis, from the axis's own point.
    pub(super) fn along(&self, point: &Vector3<f64>) -> f64 {
        (point - self.point).dot(&self.direction)
    }

    /// Two unit vectors perpendicular to the axis and to each other.
    pub(super) fn basis(&self) -> [Vector3<f64>; 2] {
        basis(&self.direction)
    }

    /// The same axis with a point of it near `to`.
    pub(super) fn based_at(&self, to: &Vector3<f64>) -> Self {
        Self { point: self.point + self.direction * self.along(to), ..*self }
    }

    /// After two turns of the axis about its point, two shifts perpendicular to it and a change of the radius.
    pub(super) fn moved(&self, [e, f]: [Vector3<f64>; 2], step: &SVector<f64, 5>) -> Option<Self> {
        let [turn_e, turn_f, shift_e, shift_f, grown] = (*step).into();
        let turn = turn_e.hypot(turn_f);
        let shortened = if turn > TURN_MAX { TURN_MAX / turn } else { 1.0 };
        let direction = (self.direction + (e * turn_e + f * turn_f) * shortened).normalize();
        let moved = Self { point: self.point + e * shift_e + f * shift_f, direction, radius: self.radius + grown };
        let finite = moved.point.iter().chain(moved.direction.iter()).all(|v| v.is_finite());
        (finite && moved.radius.is_finite() && moved.radius > 0.0).then_some(moved)
    }
}

impl Plane {
    /// The plane that is nearest to weighted points; `None` where they have no weight.
    pub(super) fn through(points: impl Iterator<Item = (f64, Vector3<f64>)> + Clone) -> Option<Self> {
        let weight: f64 = points.clone().map(|(w, _)| w).sum();
        let point = points.clone().map(|(w, p)| p * w).sum::<Vector3<f64>>() / weight;
        let moments = points.map(|(w, p)| (p - point) * (p - point).transpose() * w).sum::<Matrix3<f64>>();
        let [_, _, normal] = principal(moments / weight)?;
        Some(Self { point, normal })
    }
}

impl Surface {
    #[inline]
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        match self {
            Self::Cylinder(cylinder) => cylinder.distance(point),
            Self::Plane(plane) => (point - plane.point).dot(&plane.normal),
        }
    }
}

/// Two unit vectors perpendicular to a third and to each other.
pub(super) fn basis(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let least = direction.map(f64::abs).imin();
    let aside = match least {
        0 => Vector3::x(),
        1 => Vector3::y(),
        _ => Vector3::z(),
    };
    let first = direction.cross(&aside).normalize();
    [first, direction.cross(&first)]
}

/// Eigenvectors of a symmetric matrix, that of the largest eigenvalue first.
pub(super) fn principal(moments: SMatrix<f64, 3, 3>) -> Option<[Vector3<f64>; 3]> {
    if !moments.iter().all(|v| v.is_finite()) {
        return None;
    }
    let eigen = moments.symmetric_eigen();
    let mut axes: Vec<(f64, Vector3<f64>)> =
        eigen.eigenvalues.iter().copied().zip(eigen.eigenvectors.column_iter().map(Into::into)).collect();
    axes.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    match axes.as_slice() {
        [(_, a), (_, b), (_, c)] => Some([*a, *b, *c]),
        _ => None,
    }
}
