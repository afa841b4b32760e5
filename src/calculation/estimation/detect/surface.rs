//! The surfaces that the search compares (cylinders in any direction, and planes, which must not be taken for cylinders), and the
//! score by which it compares them: how unlikely it is that the points lie on a surface by chance. The score compares a rough
//! surface of many points with a smooth one of few, and a plane with a cylinder, without a tolerance from the user.
//!
//! Of n points spread evenly over the volume of the cloud, each lies within t of the surface with the probability p(t) = 2 t · area
//! / volume. The probability that k or more do is at most exp(−n·KL(k/n, p)) (Chernoff's bound of the binomial tail); the points
//! that determine the surface are not counted. The score is the greatest −log over t (the a-contrario criterion of Desolneux,
//! Moisan and Morel, as in AC-RANSAC).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

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

/// The largest rotation of an axis in one step, rad: beyond it the linearisation is invalid.
const TURN_MAX: f64 = 0.5;

impl Cylinder {
    /// Signed distance of a point, positive outside.
    #[inline]
    pub(super) fn distance(&self, point: &Vector3<f64>) -> f64 {
        let from = point - self.point;
        let along = from.dot(&self.direction);
        (from - self.direction * along).norm() - self.radius
    }

    /// Coordinate of a point along the axis, from the reference point of the axis.
    pub(super) fn along(&self, point: &Vector3<f64>) -> f64 {
        (point - self.point).dot(&self.direction)
    }

    /// Two unit vectors perpendicular to the axis and to each other.
    pub(super) fn basis(&self) -> [Vector3<f64>; 2] {
        basis(&self.direction)
    }

    /// The same axis with its reference point near `to`.
    pub(super) fn based_at(&self, to: &Vector3<f64>) -> Self {
        Self { point: self.point + self.direction * self.along(to), ..*self }
    }

    /// The cylinder after two rotations of the axis about its point, two shifts perpendicular to it and a change of the radius.
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
    /// The plane that is nearest to weighted points; `None` if their weight is zero.
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

/// Number of half octaves of the distance from the smallest one to the size of the cloud, which is 1.
const BINS: usize = 56;
/// The first bin ends at 2⁻²⁷, below the resolution of single-precision coordinates.
const FIRST_BIN: u64 = (1023 - 28) << 1;
/// Volume of the ball whose diameter is the size of the cloud.
const VOLUME: f64 = PI / 6.0;
/// Area of a plane through the middle of the ball.
const PLANE_AREA: f64 = PI / 4.0;

/// Bins of an octave.
const OCTAVE: usize = 2;
/// Points must be denser on the surface than in strips of the same width on either side, by this factor.
const DENSER: usize = 2;
/// Widest tolerance of a cylinder, in radii.
const TOLERANCE_RADII: f64 = 0.6;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Score {
    /// −ln of the probability that this many points agree by chance.
    pub(super) evidence: f64,
    /// The distance with the greatest evidence.
    pub(super) tolerance: f64,
    /// The points within this distance.
    pub(super) count: usize,
}

/// Number of coordinates that determine a surface: a point fixes one of them.
fn freedom(surface: &Surface) -> f64 {
    match surface {
        Surface::Cylinder(_) => 5.0,
        Surface::Plane(_) => 3.0,
    }
}

/// p(t)/t: a thin tube takes less of the volume than a plane, so points are on it by chance less often.
fn chance_per_distance(surface: &Surface) -> f64 {
    let area = match surface {
        Surface::Cylinder(cylinder) => (2.0 * PI * cylinder.radius).min(FRAC_PI_2),
        Surface::Plane(_) => PLANE_AREA,
    };
    2.0 * area / VOLUME
}

/// The score of a surface over points of a cloud of size 1.
pub(super) fn score(surface: &Surface, points: &[Vector3<f64>]) -> Score {
    let mut bins = [0_usize; BINS];
    let mut count = |distance: f64| {
        let place = (distance.abs().to_bits() >> 51).saturating_sub(FIRST_BIN);
        if let Some(bin) = usize::try_from(place).ok().and_then(|place| bins.get_mut(place)) {
            *bin += 1;
        }
    };
    match surface {
        Surface::Cylinder(cylinder) => points.iter().for_each(|point| count(cylinder.distance(point))),
        Surface::Plane(_) => points.iter().for_each(|point| count(surface.distance(point))),
    }
    // Points that lie near a thin tube's axis, inside and outside alike, are a bundle and not a surface.
    let widest = match surface {
        Surface::Cylinder(cylinder) => TOLERANCE_RADII * cylinder.radius,
        Surface::Plane(_) => 1.0,
    };
    let (taken, per_distance) = (freedom(surface), chance_per_distance(surface));
    let within: Vec<usize> = bins
        .iter()
        .scan(0, |count, bin| {
            *count += bin;
            Some(*count)
        })
        .collect();
    let mut best = Score { evidence: 0.0, tolerance: 0.0, count: 0 };
    for (place, &count) in within.iter().enumerate() {
        let tolerance = f64::from_bits((FIRST_BIN + place as u64 + 1) << 51);
        if tolerance > widest {
            break;
        }
        let beside = within.get(place + OCTAVE).or(within.last()).map_or(0, |both| both - count);
        let evidence = evidence(count as f64 - taken, points.len() as f64 - taken, per_distance * tolerance);
        if count >= DENSER * beside && evidence > best.evidence {
            best = Score { evidence, tolerance, count };
        }
    }
    best
}

/// The evidence above which a surface among this many points is significant: as many surfaces are possible as there are ways to
/// choose the points that determine one.
pub(super) fn significant(surface: &Surface, points_count: usize) -> f64 {
    let taken = freedom(surface);
    let choices = |i: u32| ((points_count as f64 - f64::from(i)) / f64::from(i + 1)).max(1.0).ln();
    (0..taken as u32).map(choices).sum()
}

/// −ln of the bound of the probability that `count` or more of `all` points have a property of probability `chance`.
fn evidence(count: f64, all: f64, chance: f64) -> f64 {
    if count <= 0.0 || count <= all * chance {
        return 0.0;
    }
    let others = all - count;
    let of_others = if others > 0.0 { others * (others / (all * (1.0 - chance))).ln() } else { 0.0 };
    count * (count / (all * chance)).ln() + of_others
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_bounds_the_binomial_tail() {
        // P(k >= 8 of 10 with p = 0.1) = Σ C(10, k) 0.1^k 0.9^(10−k) = 3.7e-7.
        let exact = -(3.736_1e-7_f64).ln();
        let bound = evidence(8.0, 10.0, 0.1);
        assert!(bound < exact && bound > exact - 10.0_f64.ln(), "{bound} {exact}");
        assert_eq!(evidence(1.0, 10.0, 0.1), 0.0);
        assert!((evidence(10.0, 10.0, 0.1) - 10.0 * 10.0_f64.ln()).abs() < 1e-12);
    }
}
