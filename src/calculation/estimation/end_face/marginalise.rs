//! The distribution of the end plane over all poses that the covariance allows: some of them fit an edge in several columns better
//! than others.
//!
//! The covariance of the pose moves the columns along the axis in at most three ways (all equally, as the sine, and as the cosine
//! of the angle). The two that move the columns most relative to each other are treated separately, because an edge in several
//! columns determines them. The remainder moves all columns equally.
//!
//! The nodes of a grid over the two motions are weighted by their normal density and by the likelihood of their planes, and the
//! grid contracts about the nodes with most weight. The posterior of the plane is that of all nodes together.

use super::likelihood::{Step, sums};
use super::unroll::{Columns, View};
use nalgebra::{Matrix2, Matrix4, Vector2, Vector4};
use std::f64::consts::FRAC_1_SQRT_2;

/// Planes that are less likely by e¹⁶ (10⁷) are left out.
const LOG_RATIO_MAX: f64 = 16.0;
/// Nodes along each motion, and their range in standard deviations: 99.7 % of a normal density, at steps of one.
const NODES: usize = 7;
const REACH: f64 = 3.0;
/// Number of contractions of the grid. If the pose is very uncertain, the first grids are too coarse for a sharp edge.
const CONTRACTIONS: usize = 5;
/// Share of the variance between nodes by which steps are softened, so that coarse grids do not miss the edge. The full variance,
/// taken as independent from step to step, would hide the edge.
const SOFTENED: f64 = 0.03;
/// A step at an uncertain position is divided at these of its standard deviations, each in the middle of its part.
const PARTS: [f64; 8] = [-2.45, -1.75, -1.05, -0.35, 0.35, 1.05, 1.75, 2.45];
const HALF_PART: f64 = 0.35;
/// A smaller step is not divided.
const GAIN_MIN: f64 = 0.5;

/// A plane with uniform density between two positions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub(super) from: f64,
    pub(super) to: f64,
    /// Logarithm of its density up to a constant.
    pub(super) log: f64,
}

impl Piece {
    /// The weight relative to a piece of this logarithm.
    pub(super) fn weight(&self, largest: f64) -> f64 {
        (self.log - largest).exp() * (self.to - self.from)
    }
}

pub(super) fn largest(pieces: &[Piece]) -> f64 {
    pieces.iter().map(|piece| piece.log).fold(f64::NEG_INFINITY, f64::max)
}

fn likely(mut pieces: Vec<Piece>) -> Vec<Piece> {
    let least = largest(&pieces) - LOG_RATIO_MAX;
    pieces.retain(|piece| piece.log > least);
    pieces
}

/// The possible positions of the plane, up to `to`, from steps in order of t; `None` without steps or weights.
pub(super) fn planes(steps: &[Step], motions: &Motions, to: f64) -> Option<Vec<Piece>> {
    let near = Near::of(steps, motions, to)?;
    let mut grid = Grid { centre: Motion::zeros(), reach: Matrix2::from_diagonal_element(REACH) };
    for _ in 0..CONTRACTIONS {
        grid = grid.contracted(&near.softened(grid)?)?;
    }
    let near = near.softened(grid)?;
    Some(likely(grid.nodes().flat_map(|at| likely(near.planes(at))).collect()))
}

impl Step {
    /// The step divided by its uncertain position: up to z standard deviations the likelihood has grown by ln(1 + (e^gain −
    /// 1)·Φ(z)).
    fn parts(self) -> impl Iterator<Item = Self> {
        let Self { t, gain, variance, .. } = self;
        let grown = move |z: f64| (gain.exp_m1() * 0.5 * libm::erfc(-z * FRAC_1_SQRT_2)).ln_1p();
        let whole = variance <= 0.0 || gain.abs() <= GAIN_MIN;
        let part = move |(index, z): (usize, f64)| {
            let from = if index == 0 { 0.0 } else { grown(z - HALF_PART) };
            let to = if index + 1 == PARTS.len() { gain } else { grown(z + HALF_PART) };
            Self { t: t + z * variance.sqrt(), gain: to - from, ..self }
        };
        let parts = PARTS.into_iter().enumerate().map(part).filter(move |_| !whole);
        parts.chain(whole.then_some(self))
    }
}

/// The steps that a motion can bring to a possible position of the plane, in order of t.
struct Near<'a> {
    steps: Vec<Step>,
    motions: &'a Motions,
    to: f64,
}

impl<'a> Near<'a> {
    fn of(steps: &[Step], motions: &'a Motions, to: f64) -> Option<Self> {
        let variance = steps.iter().map(|step| step.variance).fold(0.0, f64::max);
        Self::within(steps, motions, to, 2.0 * REACH * (motions.largest() + variance.sqrt()))
    }

    /// The steps within a margin about the likely positions of the plane; `None` without any.
    fn within(steps: &[Step], motions: &'a Motions, to: f64, margin: f64) -> Option<Self> {
        let most = sums(steps).map(|step| step.gain).fold(f64::NEG_INFINITY, f64::max);
        let likely = || sums(steps).filter(|step| step.gain > most - LOG_RATIO_MAX).map(|step| step.t);
        let (first, last) = (likely().next()?, likely().last()?);
        let next = steps.iter().find(|step| step.t > last).map_or(to, |step| step.t);
        let to = to.min(next + margin);
        let steps = steps.iter().filter(|step| step.t >= first - margin && step.t <= to).copied().collect();
        Some(Self { steps, motions, to })
    }

    /// The steps softened for a node, which represents all poses about it: poses between nodes move the steps by the added
    /// variance.
    fn softened(&self, grid: Grid) -> Option<Self> {
        let between = grid.between() * SOFTENED;
        let met = |step: &Step| {
            let variance = step.variance + self.motions.variance_by(step.column, &between);
            Step { variance, ..*step }.parts()
        };
        let mut parts: Vec<Step> = self.steps.iter().flat_map(met).collect();
        parts.sort_by(|a, b| a.t.total_cmp(&b.t));
        Self::within(&parts, self.motions, self.to, 2.0 * REACH * self.motions.largest())
    }

    /// The planes with the columns in their positions at a node.
    fn planes(&self, at: Motion) -> Vec<Piece> {
        let moved = |step: &Step| [step.t + self.motions.of_column(step.column, at), step.gain];
        let mut steps: Vec<[f64; 2]> = self.steps.iter().map(moved).collect();
        steps.sort_unstable_by(|[a, _], [b, _]| a.total_cmp(b));
        let ends = steps.iter().skip(1).map(|[t, _]| *t).chain([self.to]);
        let mut log = -0.5 * at.norm_squared();
        let piece = |([from, gain], to): (&[f64; 2], f64)| {
            log += gain;
            Piece { from: *from, to, log }
        };
        steps.iter().zip(ends).map(piece).filter(|piece| piece.to > piece.from).collect()
    }
}

/// A grid over the motions.
#[derive(Debug, Clone, Copy)]
struct Grid {
    centre: Motion,
    /// Its range along its two directions, one in each column.
    reach: Matrix2<f64>,
}

impl Grid {
    /// Covariance of the motions that are nearer to a node than to another.
    fn between(self) -> Matrix2<f64> {
        let step = self.reach * (2.0 / (NODES - 1) as f64);
        step * step.transpose() / 12.0
    }

    fn nodes(self) -> impl Iterator<Item = Motion> {
        let place = |index: usize| 2.0 * index as f64 / (NODES - 1) as f64 - 1.0;
        let node = move |i: usize, j: usize| self.centre + self.reach * Motion::new(place(i), place(j));
        (0..NODES).flat_map(move |i| (0..NODES).map(move |j| node(i, j)))
    }

    /// The grid about the nodes with weight, as far as they extend.
    fn contracted(self, near: &Near<'_>) -> Option<Self> {
        let weigh = |at: Motion| {
            let planes = near.planes(at);
            let most = largest(&planes);
            (at, most + planes.iter().map(|plane| plane.weight(most)).sum::<f64>().ln())
        };
        let nodes: Vec<(Motion, f64)> = self.nodes().map(weigh).collect();
        let most = nodes.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
        let weighed = || nodes.iter().map(|(at, log)| (*at, (log - most).exp()));
        let all: f64 = weighed().map(|(_, weight)| weight).sum();
        let centre = weighed().map(|(at, weight)| at * weight).sum::<Motion>() / all;
        let square = |(at, weight): (Motion, f64)| (at - centre) * (at - centre).transpose() * weight;
        let covariance = weighed().map(square).sum::<Matrix2<f64>>() / all;
        let eigen = covariance.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let between = self.between();
        let reach = |direction: Vector2<f64>, variance: f64| {
            // Poses between nodes are not resolved.
            let least = direction.dot(&(between * direction));
            direction * (REACH * variance.max(least).min(1.0).sqrt())
        };
        let [first, second] = [0, 1].map(|index| eigen.eigenvectors.column(index).into_owned());
        let [of_first, of_second] = <[f64; 2]>::from(eigen.eigenvalues);
        Some(Self { centre, reach: Matrix2::from_columns(&[reach(first, of_first), reach(second, of_second)]) })
    }
}

/// Displacement of the pose along the two motions, in standard deviations.
pub(super) type Motion = Vector2<f64>;

/// Eigenvalue iterations converge within a few sweeps.
pub(super) const SWEEPS_MAX: usize = 100;

/// Motions of the columns, independent of each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Motions {
    /// Displacement of each column by a standard deviation of either motion, mm.
    columns: Vec<Motion>,
    /// Variance of the displacement common to all columns, mm².
    pub(super) common: f64,
}

impl Motions {
    /// The motions of the columns about a position along the axis; `covariance` is that of (deflection, pitch, y_ref, z_ref).
    /// `None` if it cannot be decomposed.
    pub(super) fn about(t: f64, view: &View, columns: &Columns, covariance: Matrix4<f64>) -> Option<Self> {
        let derivatives: Vec<_> = columns.all.iter().map(|column| view.edge_by_pose(column.angle, t)).collect();
        Self::of(&derivatives, covariance)
    }

    /// The motions from the derivatives of each column's position by the pose.
    pub(super) fn of(derivatives: &[Vector4<f64>], covariance: Matrix4<f64>) -> Option<Self> {
        let eigen = covariance.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let root = Matrix4::from_diagonal(&eigen.eigenvalues.map(|value| value.max(0.0).sqrt()));
        let by: Vec<Vector4<f64>> = derivatives.iter().map(|by| root * eigen.eigenvectors.tr_mul(by)).collect();
        let count = by.len().max(1) as f64;
        let mean = by.iter().sum::<Vector4<f64>>() / count;
        let against: Matrix4<f64> = by.iter().map(|by| (by - mean) * (by - mean).transpose()).sum();
        let eigen = against.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let mut motions: Vec<(f64, Vector4<f64>)> =
            eigen.eigenvalues.iter().copied().zip(eigen.eigenvectors.column_iter().map(Into::into)).collect();
        motions.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let [(_, first), (_, second), rest @ ..] = motions.as_slice() else { return None };
        let common: f64 = rest.iter().map(|(_, motion)| by.iter().map(|by| by.dot(motion).powi(2)).sum::<f64>()).sum();
        let columns = by.iter().map(|by| Motion::new(by.dot(first), by.dot(second))).collect();
        Some(Self { columns, common: common / count })
    }

    /// Displacement of a column by the pose, mm.
    pub(super) fn of_column(&self, column: usize, at: Motion) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&at))
    }

    /// Mean displacement of these columns by a standard deviation of either motion, mm; `None` without columns.
    pub(super) fn mean(&self, columns: impl Iterator<Item = usize>) -> Option<Motion> {
        let moved = columns.filter_map(|column| self.columns.get(column));
        let (sum, count) = moved.fold((Motion::zeros(), 0.0), |(sum, count), by| (sum + by, count + 1.0));
        (count > 0.0).then(|| sum / count)
    }

    /// Variance of a column's position by a covariance of the motions, mm².
    pub(super) fn variance_by(&self, column: usize, covariance: &Matrix2<f64>) -> f64 {
        self.columns.get(column).map_or(0.0, |by| by.dot(&(covariance * by)))
    }

    /// The largest standard deviation of a column by both motions, mm.
    pub(super) fn largest(&self) -> f64 {
        self.columns.iter().map(Vector2::norm_squared).fold(0.0, f64::max).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};

    /// The mean of the plane with two columns that a motion of standard deviation `moved` moves in opposite directions.
    fn mean(steps: &[(f64, f64, usize, f64)], moved: f64, to: f64) -> f64 {
        let by = Vector4::new(moved, 0.0, 0.0, 0.0);
        let motions = Motions::of(&[by, -by], Matrix4::identity()).expect("motions");
        let step = |&(t, gain, column, variance): &(f64, f64, usize, f64)| Step { t, gain, column, variance };
        let pieces = planes(&steps.iter().map(step).collect::<Vec<_>>(), &motions, to).expect("planes");
        let most = largest(&pieces);
        let weighed = pieces.iter().map(|p| [p.weight(most), p.weight(most) * 0.5 * (p.from + p.to)]);
        let [weight, moment] = weighed.fold([0.0; 2], |[a, b], [x, y]| [a + x, b + y]);
        moment / weight
    }

    #[test]
    fn a_plane_lies_anywhere_between_a_cell_that_shows_the_part_and_one_that_lacks_it() {
        let found = mean(&[(1.0, 9.0, 0, 0.0), (3.0, -9.0, 1, 0.0)], 0.0, 4.0);
        assert!((found - 2.0).abs() < 1e-3, "{found}");
    }

    /// Column 0 has the plane within (0.0, 0.2), column 1 within (0.4, 0.6). A motion of 0.2 of either reconciles them; without one
    /// the plane is at the last cell that shows the part, since a drop-out is likelier than a stray point.
    #[test]
    fn conflicting_columns_that_the_pose_explains_give_the_middle() {
        let steps = [(0.0, 9.0, 0, 0.0), (0.2, -5.0, 0, 0.0), (0.4, 9.0, 1, 0.0), (0.6, -9.0, 1, 0.0)];
        let [rigid, moved] = [0.0, 0.2].map(|by| mean(&steps, by, 1.0));
        assert!((rigid - 0.5).abs() < 0.01 && (moved - 0.3).abs() < 0.02, "{rigid} {moved}");
    }

    /// ∫ (1 − Φ((x − 3)/0.2)) dx from 1 = 2, as with a sharp end at 3; ∫ (x − 1)·(1 − Φ) dx = (2² + 0.2²)/2.
    #[test]
    fn a_cell_at_an_uncertain_position_ends_the_plane_gradually() {
        let found = mean(&[(1.0, 20.0, 0, 0.0), (3.0, -20.0, 1, 0.04)], 0.0, 5.0);
        assert!((found - (1.0 + 2.02 / 2.0)).abs() < 5e-3, "{found}");
    }
}

#[cfg(test)]
mod motions_tests {
    use super::*;

    /// Columns over 140° of a cylinder of radius 100, moved by slopes of 1e-4 and 2e-4, and an offset of 1e-3 with the derivative
    /// 0.5 that moves all equally.
    #[test]
    fn the_two_slopes_move_columns_relative_to_each_other_and_an_offset_does_not() {
        let angles = (-70..=70).map(|degrees| f64::from(degrees).to_radians());
        let derivatives: Vec<_> = angles.map(|a| Vector4::new(100.0 * a.sin(), 100.0 * a.cos(), 0.5, 0.0)).collect();
        let covariance = Matrix4::from_diagonal(&Vector4::new(1e-8, 4e-8, 1e-6, 1e-6));
        let motions = Motions::of(&derivatives, covariance).expect("motions");
        for (column, by) in derivatives.iter().enumerate() {
            let expected = by.component_mul(by).dot(&covariance.diagonal());
            let variance = motions.variance_by(column, &Matrix2::identity());
            assert!((variance + motions.common - expected).abs() < 1e-8, "{column}");
        }
        assert!((motions.common - 0.25e-6).abs() < 0.05e-6, "{motions:?}");
    }

    #[test]
    fn without_uncertainty_nothing_moves() {
        let motions = Motions::of(&[Vector4::repeat(7.0); 3], Matrix4::zeros()).expect("motions");
        assert!(motions.largest() < 1e-12 && motions.common < 1e-12, "{motions:?}");
    }
}
