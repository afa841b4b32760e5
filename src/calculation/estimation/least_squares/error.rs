//! Why points have no Gaussian cylinder: what was found, and what to measure instead.

use super::POINTS_MIN;

/// Why points have no Gaussian associated cylinder.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// A coordinate is not a number, or so large that its square is none.
    #[error(
        "point {index} has a coordinate that is not finite or is beyond 1e100 mm; remove the point or check the unit"
    )]
    Coordinate {
        /// Position of the point, from 0.
        index: usize,
    },
    /// Five parameters and their scatter need six points.
    #[error(
        "there are {distinct_count} different points among {points_count}, a cylinder with its uncertainty needs {POINTS_MIN}; \
         measure more points"
    )]
    TooFewPoints {
        /// Points given.
        points_count: usize,
        /// Points among them that differ from all others.
        distinct_count: usize,
    },
    /// The points lie on a straight line.
    #[error("all {points_count} points lie on a straight line; measure points around the cylinder")]
    Collinear {
        /// Points given.
        points_count: usize,
    },
    /// The points lie in a plane: a cylinder and its mirror image in that plane fit equally well.
    #[error("all {points_count} points lie in one plane; measure points in a second section of the cylinder")]
    Coplanar {
        /// Points given.
        points_count: usize,
    },
    /// No cylinder fits better than a plane does.
    #[error(
        "the {points_count} points show no curvature; measure points on a longer arc, or check that the part is a cylinder"
    )]
    NoCurvature {
        /// Points given.
        points_count: usize,
    },
    /// A parameter can change without changing any distance.
    #[error(
        "the {points_count} points leave a parameter of the cylinder undetermined; measure points in three or more \
         directions about the axis and in two or more sections"
    )]
    Undetermined {
        /// Points given.
        points_count: usize,
    },
    /// Different cylinders fit equally well.
    #[error("{cylinders_count} different cylinders fit the {points_count} points equally well; measure more points")]
    Ambiguous {
        /// Points given.
        points_count: usize,
        /// Cylinders with the same sum of squared distances.
        cylinders_count: usize,
    },
}
