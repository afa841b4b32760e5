//! Start values: cylinders through few points, scored over the whole sample, so that an object that covers most of single profiles
//! cannot prevail over the surface common to all profiles.
//!
//! Three points of one profile give a circle, and two points of a distant profile its centre there: a minimal set of five. Newton's
//! method then gives the exact cylinder through the five. Scores are truncated squares (MSAC) over [`Scatter`], points with
//! individual x. The draws come from a fixed seed: the same scan always gives the same start.

use super::block::{BLOCK, LANES};
use super::model::{ANY_DIRECTION, Cylinder, Response, View};
use super::sample::Sample;
use crate::scan::Station;
use nalgebra::{Matrix5, RowVector5, Vector5};
use pulp::{Arch, Simd, WithSimd};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// The bounds of a start.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    /// Steepest |p| and |q|.
    pub(super) slope_max: f64,
    /// Least and largest radius, mm.
    pub(super) radius_mm: [f64; 2],
    /// Distance beyond which a point counts as off the surface, mm.
    pub(super) tolerance: f64,
}

/// A start and its score: the mean truncated square of the distances, 0 (best) to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) cylinder: Cylinder,
    pub(super) score: f64,
}

/// Draws in one round; rounds are fixed so that the result does not depend on threads.
const ROUND: usize = 512;
const ROUNDS_MAX: usize = 16;
/// Points of the first, coarse test.
const SIEVE_POINTS: usize = 800;
/// Starts that pass the test of a round.
const KEPT: usize = 16;
/// Steps of Newton's method from a nearly exact cylinder.
const NEWTON_STEPS: usize = 3;
/// Probability of missing the best surface.
const MISS: f64 = 1e-4;

/// The best starts, best first, without duplicates.
pub(super) fn hypotheses(sample: &Sample, bounds: &Bounds, most: usize) -> Vec<Hypothesis> {
    if sample.stations.len() < 2 {
        return Vec::new();
    }
    let sieve = sieve(sample);
    let mut best: Vec<Hypothesis> = Vec::new();
    for round in 0..ROUNDS_MAX {
        let drawn: Vec<Option<Hypothesis>> = (0..ROUND)
            .into_par_iter()
            .map(|draw| {
                let mut chance = ChaCha8Rng::seed_from_u64((round * ROUND + draw) as u64);
                let cylinder = draw_cylinder(sample, bounds, &mut chance)?;
                Some(Hypothesis {
                    cylinder,
                    score: sieve.truncated_squares(&cylinder.facing(ANY_DIRECTION), bounds.tolerance),
                })
            })
            .collect();
        let mut drawn: Vec<Hypothesis> = drawn.into_iter().flatten().collect();
        drawn.sort_by(|a, b| a.score.total_cmp(&b.score));
        drawn.truncate(KEPT);
        let whole =
            drawn.par_iter().map(|h| Hypothesis { score: score_whole(sample, &h.cylinder, bounds.tolerance), ..*h });
        best.extend(whole.collect::<Vec<_>>());
        best.sort_by(|a, b| a.score.total_cmp(&b.score));
        best = distinct(best, sample, bounds.tolerance, most);
        let share = best.first().map_or(0.0, |h| 1.0 - h.score);
        let drawn_count = ((round + 1) * ROUND) as f64;
        // Half of the draws fail the spread rules, so five points of the surface are drawn half as often as its share suggests.
        if drawn_count * 0.5 * share.powi(5) > -MISS.ln() {
            break;
        }
    }
    best
}

/// A few points of the whole sample, for the first test.
fn sieve(sample: &Sample) -> Scatter {
    let stride = (sample.len() / SIEVE_POINTS).max(1);
    sample.stations.iter().flat_map(|station| sample.points(station)).step_by(stride).collect()
}

/// The score over all of the sample.
pub(super) fn score_whole(sample: &Sample, cylinder: &Cylinder, tolerance: f64) -> f64 {
    let per_tolerance2 = 1.0 / (tolerance * tolerance);
    let view = cylinder.facing(ANY_DIRECTION);
    let profile = |station: &Station| sample.profile(station).truncated_squares(&view, per_tolerance2);
    sample.stations.iter().map(profile).sum::<f64>() / sample.len().max(1) as f64
}

fn draw_cylinder(sample: &Sample, bounds: &Bounds, chance: &mut ChaCha8Rng) -> Option<Cylinder> {
    let count = sample.stations.len();
    let first = chance.random_range(0..count);
    // The two points are far enough apart that noise does not dominate the direction.
    let second = (first + chance.random_range(count.div_ceil(4)..=count - count.div_ceil(4))) % count;
    let (first, second) = (sample.stations.get(first)?, sample.stations.get(second)?);
    let near = (first.x - second.x).abs();
    if near <= 0.0 {
        return None;
    }
    let mut draw = |station: &Station| sample.point(chance.random_range(station.start..station.end));
    let ([a, b, c], [d, e]) = ([draw(first)?, draw(first)?, draw(first)?], [draw(second)?, draw(second)?]);
    let (centre, radius) = circle([a, b, c].map(|[_, y, z]| [y, z]), bounds)?;
    let other = placed([d, e].map(|[_, y, z]| [y, z]), radius, centre)?;
    let cylinder = through(first.x, centre, second.x, other, radius, bounds)?;
    within(exact(cylinder, [a, b, c, d, e])?, bounds)
}

/// The circle through three points.
fn circle([a, b, c]: [[f64; 2]; 3], bounds: &Bounds) -> Option<([f64; 2], f64)> {
    let (by, bz, cy, cz) = (b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]);
    let area = 2.0 * (by * cz - bz * cy);
    let (bb, cc) = (by * by + bz * bz, cy * cy + cz * cz);
    let (u, w) = ((cz * bb - bz * cc) / area, (by * cc - cy * bb) / area);
    let radius = u.hypot(w);
    // The section of a tilted cylinder is wider by up to 1/cos of the tilt, so the bounds get some margin here.
    let [least, most] = bounds.radius_mm;
    (radius > least * 0.8 && radius < most * 1.25).then_some(([a[0] + u, a[1] + w], radius))
}

/// The centre of the circle of `radius` through two points that lies nearer to `to`.
fn placed([a, b]: [[f64; 2]; 2], radius: f64, to: [f64; 2]) -> Option<[f64; 2]> {
    let (dy, dz) = (b[0] - a[0], b[1] - a[1]);
    let chord = dy.hypot(dz);
    let height2 = radius * radius - 0.25 * chord * chord;
    // Points close together determine the centre poorly.
    if height2 < 0.0 || chord < 0.1 * radius {
        return None;
    }
    let (middle, height) = ([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])], height2.sqrt() / chord);
    let sides = [1.0, -1.0].map(|side| [middle[0] - side * dz * height, middle[1] + side * dy * height]);
    sides.into_iter().min_by(|a, b| gap(a, &to).total_cmp(&gap(b, &to)))
}

fn gap(a: &[f64; 2], b: &[f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn through(x1: f64, c1: [f64; 2], x2: f64, c2: [f64; 2], radius: f64, bounds: &Bounds) -> Option<Cylinder> {
    let (p, q) = ((c2[0] - c1[0]) / (x2 - x1), (c2[1] - c1[1]) / (x2 - x1));
    let x_ref = 0.5 * (x1 + x2);
    let steep = p.abs().max(q.abs()) > 1.5 * bounds.slope_max;
    let [y_ref, z_ref] = [0.5 * (c1[0] + c2[0]), 0.5 * (c1[1] + c2[1])];
    (!steep).then_some(Cylinder { x_ref, p, q, y_ref, z_ref, radius })
}

/// The cylinder that passes exactly through five points, by Newton's method from one that nearly does.
fn exact(mut cylinder: Cylinder, five: [[f64; 3]; 5]) -> Option<Cylinder> {
    for _ in 0..NEWTON_STEPS {
        let responses = five.map(|[x, y, z]| cylinder.slice(x).response(y, z));
        let rows = responses.map(|Response { a, b, t, .. }| RowVector5::new(a * t, b * t, a, b, -1.0));
        let distances = Vector5::from(responses.map(|response| response.d));
        cylinder = cylinder.moved(&-Matrix5::from_rows(&rows).lu().solve(&distances)?)?;
    }
    Some(cylinder)
}

fn within(cylinder: Cylinder, bounds: &Bounds) -> Option<Cylinder> {
    let [least, most] = bounds.radius_mm;
    let flat = cylinder.p.abs().max(cylinder.q.abs()) <= bounds.slope_max;
    (flat && cylinder.radius >= least && cylinder.radius <= most).then_some(cylinder)
}

/// Keeps the better of any two that describe the same surface.
fn distinct(sorted: Vec<Hypothesis>, sample: &Sample, tolerance: f64, most: usize) -> Vec<Hypothesis> {
    let ends = [sample.stations.first(), sample.stations.last()].map(|s| s.map_or(0.0, |s| s.x));
    let mut kept: Vec<Hypothesis> = Vec::new();
    for hypothesis in sorted {
        if kept.len() == most {
            break;
        }
        if !kept.iter().any(|other| alike(&other.cylinder, &hypothesis.cylinder, ends, tolerance)) {
            kept.push(hypothesis);
        }
    }
    kept
}

/// Whether two cylinders have the same axis at both ends and the same radius, to within `tolerance`.
pub(super) fn alike(a: &Cylinder, b: &Cylinder, ends: [f64; 2], tolerance: f64) -> bool {
    let apart = ends.map(|x| gap(&a.axis().at(x), &b.axis().at(x)));
    apart.into_iter().all(|apart| apart < tolerance) && (a.radius - b.radius).abs() < tolerance
}

/// Points (x, y, z), mm.
#[derive(Debug, Clone, Default)]
pub(super) struct Scatter {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
}

impl FromIterator<[f64; 3]> for Scatter {
    fn from_iter<I: IntoIterator<Item = [f64; 3]>>(points: I) -> Self {
        let mut scatter = Self::default();
        for [x, y, z] in points {
            scatter.x.push(x);
            scatter.y.push(y);
            scatter.z.push(z);
        }
        scatter
    }
}

impl Scatter {
    /// Mean of min(d²/`tolerance`², 1) over the points; 0 (best) to 1.
    pub(super) fn truncated_squares(&self, view: &View, tolerance: f64) -> f64 {
        let sum = Arch::new().dispatch(Truncate { scatter: self, view, per_tolerance2: 1.0 / (tolerance * tolerance) });
        sum / self.x.len().max(1) as f64
    }
}

struct Truncate<'a> {
    scatter: &'a Scatter,
    view: &'a View,
    per_tolerance2: f64,
}

impl WithSimd for Truncate<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let (mut sums, mut shares) = ([0.0; LANES], [0.0; BLOCK]);
        let Scatter { x, y, z } = self.scatter;
        for ((x, y), z) in x.chunks(BLOCK).zip(y.chunks(BLOCK)).zip(z.chunks(BLOCK)) {
            for (share, ((&x, &y), &z)) in shares.iter_mut().zip(x.iter().zip(y).zip(z)) {
                let d = self.view.distance([x, y, z]);
                let squared = d * d * self.per_tolerance2;
                *share = if squared < 1.0 { squared } else { 1.0 };
            }
            // Values of an earlier block beyond the last point are ignored.
            shares.iter_mut().skip(x.len()).for_each(|share| *share = 0.0);
            for row in shares.as_chunks::<LANES>().0 {
                for (sum, share) in sums.iter_mut().zip(row) {
                    *sum += share;
                }
            }
        }
        sums.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::cylinder::model::Cylinder;
    use pulp::Scalar;

    #[test]
    fn the_score_equals_the_scalar_sum_with_the_same_bits_on_every_processor() {
        let cylinder = Cylinder { x_ref: 10.0, p: 0.1, q: 0.05, y_ref: 3.0, z_ref: -5.0, radius: 50.0 };
        let place = |i: i32| {
            let (x, angle) = (f64::from(i), 0.1 * f64::from(i % 31));
            let [y, z] = cylinder.axis().section(50.0 + 0.3 * (f64::from(i) * 1.7).sin(), x).point(angle);
            [x, y, z]
        };
        let points: Vec<[f64; 3]> = (0..173).map(place).collect();
        let scatter: Scatter = points.iter().copied().collect();
        let view = cylinder.facing([0.0, 1.0]);
        let one = |[x, y, z]: &[f64; 3]| (cylinder.slice(*x).distance(*y, *z) / 0.2).powi(2).min(1.0);
        let expected = points.iter().map(one).sum::<f64>() / 173.0;
        let found = scatter.truncated_squares(&view, 0.2);
        assert!(expected > 0.2 && (found - expected).abs() < 1e-9);
        let plain = Truncate { scatter: &scatter, view: &view, per_tolerance2: 1.0 / (0.2 * 0.2) }.with_simd(Scalar);
        assert_eq!(found.to_bits(), (plain / 173.0).to_bits());
    }
}
