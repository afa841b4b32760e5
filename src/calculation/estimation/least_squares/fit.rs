//! The Gaussian associated cylinder of points (ISO 22432): the least sum of squared orthogonal distances over all points,
//! each with the weight one, in any direction and to the precision of the numbers.
//!
//! ```text
//! points --sample--> at most 1024 --starts--> cylinders --descend--> minima --descend, all points--> GaussianCylinder
//!            (directions over the half sphere)                (Newton)
//! ```

use super::cylinder::{Cylinder, Minimum, basis_of, descend};
use super::points::{Lanes, Points, Terms};
use super::starts;
use crate::estimation::progress::Progress;
use nalgebra::{Matrix5, Vector3, Vector5};
use rayon::prelude::*;

/// One more than there are parameters, so that a scatter can be calculated.
const POINTS_MIN: usize = 6;
const PARAMETERS: usize = 5;
/// The squares of coordinates up to this bound are far from infinite.
const COORDINATE_MAX: f64 = 1e100;
/// Half a unit in the last place of a number between 1 and 2.
const ROUNDING: f64 = f64::EPSILON / 2.0;
/// The rounding of a sum of 4096 terms, relative to its largest: that of one term times √4096. A matrix of such sums whose
/// least eigenvalue is smaller may be singular.
const SINGULAR: f64 = 64.0 * f64::EPSILON;
const SWEEPS_MAX: usize = 64;
/// Minima nearer than this are the same: a descent ends some eight digits below it.
const SAME: f64 = 1e-5;
/// Largest number of minima of the sample that are compared over all points.
const COMPARED_MAX: usize = 8;

/// Why points have no Gaussian associated cylinder.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// A coordinate is not a number, or its square is not finite.
    #[error(
        "point {index} has a coordinate that is not finite or is beyond 1e100 mm; remove the point or check the unit"
    )]
    Coordinate {
        /// Position of the point, from 0.
        index: usize,
    },
    /// Five parameters and their scatter require six points.
    #[error(
        "there are {distinct_count} different points among {points_count}, a cylinder with its uncertainty needs {POINTS_MIN}; \
         measure more points"
    )]
    TooFewPoints {
        /// Number of points.
        points_count: usize,
        /// Number of different points among them.
        distinct_count: usize,
    },
    /// The points lie on a straight line.
    #[error("all {points_count} points lie on a straight line; measure points around the cylinder")]
    Collinear {
        /// Number of points.
        points_count: usize,
    },
    /// The points lie in a plane: a cylinder and its mirror image in that plane fit equally well.
    #[error("all {points_count} points lie in one plane; measure points in a second section of the cylinder")]
    Coplanar {
        /// Number of points.
        points_count: usize,
    },
    /// No cylinder fits better than a plane does.
    #[error(
        "the {points_count} points show no curvature; measure points on a longer arc, or check that the part is a cylinder"
    )]
    NoCurvature {
        /// Number of points.
        points_count: usize,
    },
    /// A parameter can change without changing any distance.
    #[error(
        "the {points_count} points leave a parameter of the cylinder undetermined; measure points in three or more \
         directions about the axis and in two or more sections"
    )]
    Undetermined {
        /// Number of points.
        points_count: usize,
    },
    /// Different cylinders fit equally well.
    #[error("{cylinders_count} different cylinders fit the {points_count} points equally well; measure more points")]
    Ambiguous {
        /// Number of points.
        points_count: usize,
        /// Number of cylinders with the same sum of squared distances.
        cylinders_count: usize,
    },
}

/// The cylinder of least squares and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussianCylinder {
    /// The point of the axis that is nearest to the centroid of the points, mm.
    pub point: [f64; 3],
    /// Of length one; its component of largest magnitude is positive.
    pub direction: [f64; 3],
    /// Radius, mm.
    pub radius: f64,
    /// Standard deviation of the points about the cylinder, mm: √(Σ d²/(n − 5)). A fit of five parameters takes five degrees of
    /// freedom from the distances, whose sum of squares is (n − 5) σ² on average if the points scatter with σ.
    pub sigma: f64,
    /// Covariance σ² (JᵀJ)⁻¹ of (tilt of the direction towards e1, tilt towards e2, shift of `point` along e1, shift along e2,
    /// radius) in rad and mm, where e1 and e2 are the [`basis`] of `direction`. It is valid if the errors of the points are
    /// independent of each other.
    pub covariance: [[f64; 5]; 5],
}

/// Two unit vectors perpendicular to a direction and to each other, the second being direction × first: the basis of the covariance
/// of a [`GaussianCylinder`].
#[must_use]
pub fn basis(direction: [f64; 3]) -> [[f64; 3]; 2] {
    let direction = Vector3::from(direction).try_normalize(0.0).unwrap_or_else(Vector3::x);
    basis_of(&direction).map(Into::into)
}

/// The Gaussian associated cylinder of all points given, in mm. The result does not depend on the number of threads.
///
/// # Errors
/// [`LeastSquaresError`] if the points determine no cylinder, or more than one.
pub fn least_squares_cylinder(points: &[[f64; 3]]) -> Result<GaussianCylinder, LeastSquaresError> {
    cylinder_of(points, &Progress::default())
}

pub(super) fn cylinder_of(points: &[[f64; 3]], progress: &Progress) -> Result<GaussianCylinder, LeastSquaresError> {
    let points_count = points.len();
    let (low, high) = bounds(points)?;
    let distinct_count = count_distinct(points);
    if distinct_count < POINTS_MIN {
        return Err(LeastSquaresError::TooFewPoints { points_count, distinct_count });
    }
    let middle = (low + high) * 0.5;
    let magnification = power_of_two_below((high - low).amax()).recip();
    let about_middle = Points::new(points, middle, magnification);
    let centroid = middle + Vector3::from(about_middle.sum(&Coordinates)) / (points_count as f64 * magnification);
    let all = Points::new(points, centroid, magnification);
    let rounding = ROUNDING * (low.abs().sup(&high.abs()).amax() * magnification);

    let sampled = starts::sample(&all);
    let sample = Points::new(&sampled, Vector3::zeros(), 1.0);
    if dimensions(&sample, rounding) < 3 {
        match dimensions(&all, rounding) {
            0 | 1 => return Err(LeastSquaresError::Collinear { points_count }),
            2 => return Err(LeastSquaresError::Coplanar { points_count }),
            _ => {}
        }
    }
    let minima =
        distinct(starts::starts(&sample).par_iter().filter_map(|start| descend(&sample, start, progress)).collect());
    // Over all points another of the minima may be the least: the sum of squares of a sample scatters by √(2/count), which is 5 of
    // these standard deviations at most.
    let scatter = if all.count() > sample.count() { 5.0 * (2.0 / sample.count() as f64).sqrt() } else { 0.0 };
    let least = minima.first().map_or(0.0, |least| least.sums.squares);
    let margin = |minimum: &&Minimum| {
        minimum.sums.squares <= least * (1.0 + scatter) + 2.0 * uncertainty_of_sum(minimum, &sample, rounding)
    };
    let compared = minima.iter().filter(margin).take(COMPARED_MAX);
    let minima = distinct(compared.filter_map(|minimum| descend(&all, &minimum.cylinder, progress)).collect());
    let best = minima.first().ok_or(LeastSquaresError::NoCurvature { points_count })?;
    // Newton's steps that stop shrinking at this size creep along a valley.
    let settled = best.step < SAME;
    let inverse =
        inverse(&best.sums.normal).filter(|_| settled).ok_or(LeastSquaresError::Undetermined { points_count })?;
    let tolerance = 2.0 * uncertainty_of_sum(best, &all, rounding);
    let equal = |minimum: &&Minimum| minimum.sums.squares <= best.sums.squares + tolerance;
    let cylinders_count = minima.iter().filter(equal).count();
    if cylinders_count > 1 {
        return Err(LeastSquaresError::Ambiguous { points_count, cylinders_count });
    }
    Ok(result(best, &inverse, &all, centroid, magnification))
}

/// The cylinder in the coordinates of the points.
fn result(
    best: &Minimum,
    inverse: &Matrix5<f64>,
    points: &Points<'_>,
    centroid: Vector3<f64>,
    magnification: f64,
) -> GaussianCylinder {
    let Cylinder { foot, direction, radius } = best.cylinder;
    let size = magnification.recip();
    let variance = best.sums.squares / (points.count() - PARAMETERS) as f64;
    let units = Matrix5::from_diagonal(&Vector5::new(1.0, 1.0, size, size, size));
    GaussianCylinder {
        point: (centroid + foot * size).into(),
        direction: direction.into(),
        radius: radius * size,
        sigma: variance.sqrt() * size,
        covariance: (units * inverse * units * variance).into(),
    }
}

/// The corners of the bounding box of the points.
fn bounds(points: &[[f64; 3]]) -> Result<(Vector3<f64>, Vector3<f64>), LeastSquaresError> {
    let mut low = Vector3::from_element(f64::INFINITY);
    let mut high = -low;
    for (index, point) in points.iter().enumerate() {
        // The comparison is written so that NaN fails it.
        if !point.iter().all(|value| value.abs() <= COORDINATE_MAX) {
            return Err(LeastSquaresError::Coordinate { index });
        }
        let point = Vector3::from(*point);
        (low, high) = (low.inf(&point), high.sup(&point));
    }
    Ok((low, high))
}

/// The number of different points, counted up to [`POINTS_MIN`].
fn count_distinct(points: &[[f64; 3]]) -> usize {
    let mut found: Vec<[f64; 3]> = Vec::with_capacity(POINTS_MIN);
    for point in points {
        if !found.contains(point) {
            found.push(*point);
        }
        if found.len() == POINTS_MIN {
            break;
        }
    }
    found.len()
}

struct Coordinates;

impl Terms<3> for Coordinates {
    #[inline(always)]
    fn of(&self, x: Lanes, y: Lanes, z: Lanes) -> [Lanes; 3] {
        [x, y, z]
    }
}

/// Dividing by a power of two does not round. For a length that is too small, this is the least normal number.
fn power_of_two_below(length: f64) -> f64 {
    f64::from_bits(length.max(f64::MIN_POSITIVE).to_bits() & 0x7ff0_0000_0000_0000)
}

/// The number of dimensions that points span beyond the rounding of their coordinates, relative to the line through the farthest
/// point and the plane through the point farthest from that line. Two roundings of three coordinates each, of a point and of the
/// plane, add up to less than eight.
fn dimensions(points: &Points<'_>, rounding: f64) -> usize {
    let tolerance = 8.0 * (rounding + ROUNDING);
    let (first, length) = points.farthest(Vector3::norm);
    if length <= tolerance {
        return 0;
    }
    let along = first / length;
    let off_line = |point: &Vector3<f64>| (point - along * along.dot(point)).norm();
    let (second, height) = points.farthest(off_line);
    if height <= tolerance {
        return 1;
    }
    let across = (second - along * along.dot(&second)) / height;
    let normal = along.cross(&across);
    let (_, depth) = points.farthest(|point| normal.dot(point).abs());
    if depth <= tolerance { 2 } else { 3 }
}

/// Sorts minima and removes duplicates.
fn distinct(mut minima: Vec<Minimum>) -> Vec<Minimum> {
    minima.sort_by(|one, other| one.sums.squares.total_cmp(&other.sums.squares));
    let mut found: Vec<Minimum> = Vec::new();
    for minimum in minima {
        if found.iter().all(|known| known.cylinder.distance(&minimum.cylinder) > SAME) {
            found.push(minimum);
        }
    }
    found
}

/// The largest effect of rounding on a sum of squared distances: a distance is calculated from three rounded coordinates and a
/// rounded radius, and Σ (d + δ)² − Σ d² is at most 2 δ √(n Σ d²) + n δ².
fn uncertainty_of_sum(minimum: &Minimum, points: &Points<'_>, rounding: f64) -> f64 {
    let delta = 4.0 * (rounding + ROUNDING * minimum.cylinder.radius.max(1.0));
    let count = points.count() as f64;
    2.0 * delta * (count * minimum.sums.squares).sqrt() + count * delta * delta
}

/// The inverse of JᵀJ, or `None` if it may be singular within its rounding.
fn inverse(normal: &Matrix5<f64>) -> Option<Matrix5<f64>> {
    // Scaled to a unit diagonal, as the columns of J have different units.
    let scale: Vector5<f64> = normal.diagonal().map(|value| value.sqrt().recip());
    let scale = Matrix5::from_diagonal(&scale);
    let scaled = scale * normal * scale;
    if !scaled.iter().all(|value| value.is_finite()) {
        return None;
    }
    let least = scaled.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?.eigenvalues.min();
    (least > SINGULAR).then_some(scale * scaled.cholesky()?.inverse() * scale)
}
