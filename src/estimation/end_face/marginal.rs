//! The plane over all poses that the uncertainty leaves open: an edge that several columns show fits some of them better than
//! others. Must not know cells, profiles or poses.
//!
//! Nodes of an even grid over the two motions of [`Sway`] are weighed by their normal density and by the likelihood of the
//! planes with the columns where they are at that node; the grid draws in about those that weigh. The posterior of the plane
//! is that of all nodes together.

use super::posterior::{Piece, Posterior};
use super::sway::{Motion, SWEEPS_MAX, Sway};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::FRAC_1_SQRT_2;

/// Planes e¹⁶ less likely than another count for nothing.
const LOG_MOST: f64 = 16.0;
/// Nodes along each motion, in so many standard deviations to either side.
const NODES: usize = 7;
const REACH: f64 = 3.0;
/// How many grids there are, each drawn in about those of the nodes before it that weigh: where the pose is known badly, the
/// first ones are too coarse for a sharp edge. So that they do not miss it, steps are softened by this share of the variance
/// between nodes; all of it, taken for independent from step to step, would hide the edge.
const GRIDS: usize = 6;
const SOFTENED: f64 = 0.03;
/// A step whose place is not known well is taken in parts at these many of its standard deviations, each of which goes
/// half-way to the next; a step less than [`WHOLE_MOST`] is taken whole.
const PARTS: [f64; 8] = [-2.45, -1.75, -1.05, -0.35, 0.35, 1.05, 1.75, 2.45];
const HALF_PART: f64 = 0.35;
const WHOLE_MOST: f64 = 0.5;

/// Where the likelihood of a plane changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    pub(super) t: f64,
    /// By how much its logarithm grows as the plane passes.
    pub(super) gain: f64,
    pub(super) column: usize,
    /// Variance of `t`, independent of that of any other step, mm².
    pub(super) variance: f64,
}

impl Step {
    /// The step as a plane meets it that may lie to either side of its place: up to z standard deviations the likelihood has
    /// grown by ln(1 + (e^gain − 1)·Φ(z)).
    fn parts(self) -> impl Iterator<Item = Self> {
        let Self { t, gain, variance, .. } = self;
        let grown = move |z: f64| (gain.exp_m1() * 0.5 * libm::erfc(-z * FRAC_1_SQRT_2)).ln_1p();
        let whole = variance <= 0.0 || gain.abs() <= WHOLE_MOST;
        let part = move |(index, z): (usize, f64)| {
            let from = if index == 0 { 0.0 } else { grown(z - HALF_PART) };
            let to = if index + 1 == PARTS.len() { gain } else { grown(z + HALF_PART) };
            Self { t: t + z * variance.sqrt(), gain: to - from, ..self }
        };
        let parts = PARTS.into_iter().enumerate().map(part).filter(move |_| !whole);
        parts.chain(whole.then_some(self))
    }
}

/// Just beyond each step, in their order, the logarithm of the likelihood but for a constant.
pub(super) fn sums(steps: &[Step]) -> impl Iterator<Item = Step> {
    steps.iter().scan(0.0, |sum, step| {
        *sum += step.gain;
        Some(Step { gain: *sum, ..*step })
    })
}

/// Where the plane is, up to `to`, from steps in order of t.
pub(super) fn posterior(steps: &[Step], sway: &Sway, to: f64) -> Option<Posterior> {
    let local = Local::of(steps, sway, to)?;
    let nodes = Nodes::that_weigh(&local)?;
    let soft = local.soft(nodes)?;
    let planes = likely(nodes.all().flat_map(|at| likely(soft.planes(at))).collect());
    let most = most(&planes);
    Posterior::of(planes.iter().map(|p| Piece { from: p.from, to: p.to, weight: p.weight(most) }).collect())
}

/// A plane anywhere from here to there.
#[derive(Debug, Clone, Copy)]
struct Plane {
    from: f64,
    to: f64,
    /// Logarithm of its density but for a constant.
    log: f64,
}

impl Plane {
    fn weight(&self, most: f64) -> f64 {
        (self.log - most).exp() * (self.to - self.from)
    }
}

fn likely(mut planes: Vec<Plane>) -> Vec<Plane> {
    let least = most(&planes) - LOG_MOST;
    planes.retain(|plane| plane.log > least);
    planes
}

fn most(planes: &[Plane]) -> f64 {
    planes.iter().map(|plane| plane.log).fold(f64::NEG_INFINITY, f64::max)
}

/// The steps that a motion can bring to where the plane may be, in order of t.
struct Local<'a> {
    steps: Vec<Step>,
    sway: &'a Sway,
    to: f64,
}

impl<'a> Local<'a> {
    /// From steps in order of t.
    fn of(steps: &[Step], sway: &'a Sway, to: f64) -> Option<Self> {
        let variance = steps.iter().map(|step| step.variance).fold(0.0, f64::max);
        let window = Window::of(steps, 2.0 * REACH * (sway.most() + variance.sqrt()), to)?;
        Some(Self { steps: window.of_them(steps).copied().collect(), sway, to: window.to })
    }

    /// As a node meets them, which stands for all poses about it: those in between would move them by so much more.
    fn soft(&self, nodes: Nodes) -> Option<Self> {
        let between = nodes.between() * SOFTENED;
        let meets =
            |step: &Step| Step { variance: step.variance + self.sway.variance_by(step.column, &between), ..*step };
        let mut parts: Vec<Step> = self.steps.iter().flat_map(|step| meets(step).parts()).collect();
        parts.sort_by(|a, b| a.t.total_cmp(&b.t));
        let window = Window::of(&parts, 2.0 * REACH * self.sway.most(), self.to)?;
        Some(Self { steps: window.of_them(&parts).copied().collect(), sway: self.sway, to: window.to })
    }

    /// The planes with the columns where they are at a node.
    fn planes(&self, at: Motion) -> Vec<Plane> {
        let moved = |step: &Step| [step.t + self.sway.of_column(step.column, at), step.gain];
        let mut steps: Vec<[f64; 2]> = self.steps.iter().map(moved).collect();
        steps.sort_unstable_by(|[a, _], [b, _]| a.total_cmp(b));
        let ends = steps.iter().skip(1).map(|[t, _]| *t).chain([self.to]);
        let mut log = -0.5 * at.norm_squared();
        let plane = |([from, gain], to): (&[f64; 2], f64)| {
            log += gain;
            Plane { from: *from, to, log }
        };
        steps.iter().zip(ends).map(plane).filter(|plane| plane.to > plane.from).collect()
    }
}

/// Where the plane may be.
#[derive(Debug, Clone, Copy)]
struct Window {
    from: f64,
    to: f64,
}

impl Window {
    /// Up to `to`, a margin about where steps in order of t leave the plane likely; `None` without any.
    fn of(steps: &[Step], margin: f64, to: f64) -> Option<Self> {
        let most = sums(steps).map(|step| step.gain).fold(f64::NEG_INFINITY, f64::max);
        let likely = || sums(steps).filter(|step| step.gain > most - LOG_MOST).map(|step| step.t);
        let (first, last) = (likely().next()?, likely().last()?);
        let end = steps.iter().find(|step| step.t > last).map_or(to, |step| step.t);
        Some(Self { from: first - margin, to: to.min(end + margin) })
    }

    fn of_them<'a>(&self, steps: &'a [Step]) -> impl Iterator<Item = &'a Step> {
        let Self { from, to } = *self;
        steps.iter().filter(move |step| step.t >= from && step.t <= to)
    }
}

/// A grid over the motions.
#[derive(Debug, Clone, Copy)]
struct Nodes {
    centre: Motion,
    /// How far it reaches along its two directions, one a column.
    reach: Matrix2<f64>,
}

impl Nodes {
    /// About the poses that weigh.
    fn that_weigh(local: &Local<'_>) -> Option<Self> {
        let mut nodes = Self { centre: Motion::zeros(), reach: Matrix2::from_diagonal_element(REACH) };
        for _ in 1..GRIDS {
            nodes = nodes.drawn_in(&local.soft(nodes)?)?;
        }
        Some(nodes)
    }

    /// Covariance of the motions that are nearer to a node than to another.
    fn between(self) -> Matrix2<f64> {
        let step = self.reach * (2.0 / (NODES - 1) as f64);
        step * step.transpose() / 12.0
    }

    fn all(self) -> impl Iterator<Item = Motion> {
        let place = |index: usize| 2.0 * index as f64 / (NODES - 1) as f64 - 1.0;
        let node = move |i: usize, j: usize| self.centre + self.reach * Motion::new(place(i), place(j));
        (0..NODES).flat_map(move |i| (0..NODES).map(move |j| node(i, j)))
    }

    /// About the nodes that weigh, as far as they do.
    fn drawn_in(self, local: &Local<'_>) -> Option<Self> {
        let evidence = |at: Motion| {
            let planes = local.planes(at);
            let most = most(&planes);
            (at, most + planes.iter().map(|plane| plane.weight(most)).sum::<f64>().ln())
        };
        let nodes: Vec<(Motion, f64)> = self.all().map(evidence).collect();
        let most = nodes.iter().map(|(_, log)| *log).fold(f64::NEG_INFINITY, f64::max);
        let weighed = || nodes.iter().map(|(at, log)| (*at, (log - most).exp()));
        let all: f64 = weighed().map(|(_, weight)| weight).sum();
        let centre = weighed().map(|(at, weight)| at * weight).sum::<Motion>() / all;
        let square = |(at, weight): (Motion, f64)| (at - centre) * (at - centre).transpose() * weight;
        let covariance = weighed().map(square).sum::<Matrix2<f64>>() / all;
        let eigen = covariance.try_symmetric_eigen(f64::EPSILON, SWEEPS_MAX)?;
        let between = self.between();
        let reach = |direction: Vector2<f64>, variance: f64| {
            // What lies between nodes is not told apart.
            let least = direction.dot(&(between * direction));
            direction * (REACH * variance.max(least).min(1.0).sqrt())
        };
        let [first, second] = [0, 1].map(|index| eigen.eigenvectors.column(index).into_owned());
        let [of_first, of_second] = <[f64; 2]>::from(eigen.eigenvalues);
        Some(Self { centre, reach: Matrix2::from_columns(&[reach(first, of_first), reach(second, of_second)]) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};

    /// Two columns that a motion of standard deviation `sway` moves against each other.
    fn pair(sway: f64) -> Sway {
        let by = Vector4::new(sway, 0.0, 0.0, 0.0);
        Sway::of(&[by, -by], Matrix4::identity()).expect("a sway")
    }

    fn step(t: f64, gain: f64, column: usize, variance: f64) -> Step {
        Step { t, gain, column, variance }
    }

    #[test]
    fn a_plane_lies_anywhere_between_a_cell_that_shows_the_part_and_one_that_lacks_it() {
        let steps = [step(1.0, 9.0, 0, 0.0), step(3.0, -9.0, 1, 0.0)];
        let found = posterior(&steps, &pair(0.0), 4.0).expect("a posterior");
        assert!((found.mean() - 2.0).abs() < 1e-3, "{found:?}");
        assert!((found.half_of_expanded(0.0) - 0.4772).abs() < 2e-3, "{found:?}");
    }

    /// Column 0 has the plane within (0.0, 0.2), column 1 within (0.4, 0.6). A motion of 0.2 of either brings them together;
    /// without one, lacks being cheap, the plane would be where the last cell shows the part.
    #[test]
    fn columns_at_odds_that_the_pose_explains_meet_in_the_middle() {
        let steps = [step(0.0, 9.0, 0, 0.0), step(0.2, -5.0, 0, 0.0), step(0.4, 9.0, 1, 0.0), step(0.6, -9.0, 1, 0.0)];
        let rigid = posterior(&steps, &pair(0.0), 1.0).expect("a posterior");
        assert!((rigid.mean() - 0.5).abs() < 0.01, "{rigid:?}");
        let found = posterior(&steps, &pair(0.2), 1.0).expect("a posterior");
        assert!((found.mean() - 0.3).abs() < 0.02, "{found:?}");
        // The intersection is at most 0.2 wide.
        assert!(found.half_of_expanded(0.0) < 0.08, "{found:?}");
    }

    /// ∫ (1 − Φ((x − 3)/0.2)) dx from 1 = 2, as with a sharp end at 3; ∫ (x − 1)·(1 − Φ) dx = (2² + 0.2²)/2.
    #[test]
    fn a_cell_whose_place_is_not_known_well_ends_the_plane_softly() {
        let steps = [step(1.0, 20.0, 0, 0.0), step(3.0, -20.0, 1, 0.04)];
        let found = posterior(&steps, &pair(0.0), 5.0).expect("a posterior");
        assert!((found.mean() - (1.0 + 2.02 / 2.0)).abs() < 5e-3, "{found:?}");
    }
}
