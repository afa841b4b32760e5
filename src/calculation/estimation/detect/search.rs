//! Finds one surface after the other: the best supported one is refined and its points are removed from the sample, until enough
//! cylinders are found. Planes are searched as well, so that a support is removed before a part with fewer points is searched.

use super::sample::{Tree, quantile};
use super::settle::{self, Radii, Settled, settle};
use super::surface::{Cylinder, Score, Surface, score, significant};
use crate::estimation::statistics;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// A cylinder with the support by its points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) cylinder: Cylinder,
    pub(super) sigma: f64,
    /// Points within the cut-off of Tukey's weights.
    pub(super) count: usize,
    pub(super) extent: [f64; 2],
    pub(super) arc: f64,
    pub(super) evidence: f64,
}

/// Five points determine a cylinder, the sixth could contradict it.
const POINTS_MIN: usize = 6;
/// Draws in one round; rounds are fixed so that the result does not depend on threads.
const ROUND: usize = 48;
/// Number of rounds, so that a surface with 5 % of the points is missed with at most the probability MISS: the draws number −ln
/// MISS / (0.05 SUITED) = 553.
const ROUNDS_MAX: usize = 12;
/// Share of the draws at a point of a surface that find it: most sizes of patches do.
const SUITED: f64 = 0.25;
/// Points of the patches on which a surface grows, with these rounds of re-weighting.
const GROWN_POINTS: usize = 40;
const GROWING_ROUNDS: usize = 4;
/// How often a window may follow the tolerance.
const FOLLOWED: usize = 4;
/// Points whose neighbours are compared with a surface, and the neighbours of each.
const RESOLUTION_POINTS: usize = 96;
const RESOLUTION_NEIGHBOURS: usize = 8;
/// Least share of the mean squared distance that must come from the scatter among neighbours.
const RESOLVED: f64 = 1.0 / 25.0;
/// A scatter below this share of the size of the cloud is rounding.
const ROUNDING: f64 = 1e-7;
/// The search leaves the radius free: with a fixed radius it would settle on the flanks of other surfaces.
const FREE: Radii = Radii([0.0, f64::INFINITY]);
/// Points for the first test of a surface.
const SIEVE_POINTS: usize = 1024;
/// Surfaces of a round that are refined, with these rounds of re-weighting.
const REFINED: usize = 6;
const REFINING_ROUNDS: usize = 8;
const SETTLING_ROUNDS: usize = 40;
/// Probability of missing the best surface.
const MISS: f64 = 1e-3;
/// Every level of the neighbourhoods has a quarter of the points of the previous one, so its patches are twice as wide,
const THINNING: usize = 4;
/// and the coarsest has at least this many points.
const LEVEL_POINTS_MIN: usize = 32;
/// Points of a patch.
const PATCH_POINTS: [usize; 3] = [12, 24, 40];
/// Largest number of cylinders; each one takes time to find.
const CYLINDERS_MAX: usize = 16;
/// Largest number of other surfaces that are removed during the search.
const OTHERS_MAX: usize = 6;
/// A shorter arc, rad (11°), is a bent plane: profiles are refused below 15°.
const ARC_MIN: f64 = 0.2;
/// A tube that is rougher than this share of its radius is a bundle of points without a radius;
const ROUGHNESS_MAX: f64 = 0.25;
/// up to this roughness it is a rod, whose radius may be known,
const ROD_ROUGHNESS_MAX: f64 = 0.5;
/// if its length in radii is at least this, so that the length determines the direction.
const ROD_LENGTH_MIN: f64 = 20.0;
/// With a known radius the scatter may be larger by this factor: the added misfit is then no larger than the scatter.
const MISFIT_MAX: f64 = std::f64::consts::SQRT_2;
/// Share of the points that an extent covers.
const COVERED: f64 = 0.98;

/// A surface with its score.
#[derive(Debug, Clone, Copy)]
struct Scored {
    settled: Settled,
    score: Score,
}

/// The search for surfaces among points in random order within a cloud of size 1. Each surface has the most evidence among the
/// remaining points. A search continues after its last result, so that a request for more surfaces repeats nothing.
pub(super) struct Search {
    radii: Radii,
    rest: Vec<Vector3<f64>>,
    /// One entry for each surface that was removed: a cylinder if it is within the bounds.
    taken: Vec<Option<Found>>,
    ended: bool,
}

impl Search {
    pub(super) fn new(points: Vec<Vector3<f64>>, radii: Radii) -> Self {
        Self { radii, rest: points, taken: Vec::new(), ended: false }
    }

    /// The cylinders within the bounds, at most this many.
    pub(super) fn cylinders(&mut self, most: usize, is_wanted: impl Fn(&Found) -> bool) -> Vec<Found> {
        let mut found = Vec::new();
        let most = most.min(CYLINDERS_MAX);
        for stage in 0..most + OTHERS_MAX {
            if found.len() >= most {
                break;
            }
            if stage == self.taken.len() && !self.ended {
                self.ended = self.take_out(stage as u64).is_none();
            }
            let Some(taken) = self.taken.get(stage) else { break };
            found.extend(taken.filter(&is_wanted));
        }
        found
    }

    /// Removes the points of the best surface; `None` if no surface remains.
    fn take_out(&mut self, stage: u64) -> Option<()> {
        if self.rest.len() < POINTS_MIN {
            return None;
        }
        let best = best(&self.rest, stage)?;
        if best.score.evidence <= significant(&best.settled.surface, self.rest.len()) {
            return None;
        }
        self.taken.push(report(&best, &self.rest, self.radii));
        // The distance is wide, so that the tail of the noise is not taken for a separate surface.
        let reach = 2.0 * statistics::TUKEY_C * best.settled.sigma;
        let before = self.rest.len();
        self.rest.retain(|point| best.settled.surface.distance(point).abs() >= reach);
        (self.rest.len() < before).then_some(())
    }
}

/// The surface with the most evidence.
fn best(points: &[Vector3<f64>], stage: u64) -> Option<Scored> {
    let levels = levels(points);
    let sieve = points.get(..points.len().min(SIEVE_POINTS))?;
    let mut best: Option<Scored> = None;
    for round in 0..ROUNDS_MAX {
        let drawn: Vec<Vec<Scored>> = (0..ROUND)
            .into_par_iter()
            .map(|draw| {
                let seed = (stage << 32) + (round * ROUND + draw) as u64;
                let mut chance = ChaCha8Rng::seed_from_u64(seed);
                let surfaces = draw_surfaces(points, &levels, &mut chance);
                let scored = |settled: Settled| Scored { settled, score: score(&settled.surface, sieve) };
                surfaces.into_iter().map(scored).collect()
            })
            .collect();
        let mut drawn: Vec<Scored> = drawn.into_iter().flatten().collect();
        drawn.sort_by(|a, b| b.score.evidence.total_cmp(&a.score.evidence));
        drawn.truncate(REFINED);
        let refined: Vec<Scored> = drawn.par_iter().filter_map(|one| refine(one, points)).collect();
        for one in refined {
            let better = best.is_none_or(|best| one.score.evidence > best.score.evidence);
            if better && is_surface(&one.settled, sieve, levels.first()?) {
                best = Some(one);
            }
        }
        let share = best.map_or(0.0, |best| best.score.count as f64 / points.len() as f64);
        let chance = share * SUITED;
        if ((round + 1) * ROUND) as f64 * (-chance).ln_1p() < MISS.ln() {
            break;
        }
    }
    let best = settled_on(&best?, points, SETTLING_ROUNDS)?;
    let rivals = rivals(&best, points).into_iter();
    let surfaces = rivals.filter(|rival| levels.first().is_some_and(|all| is_surface(&rival.settled, sieve, all)));
    surfaces.chain([best]).max_by(|a, b| a.score.evidence.total_cmp(&b.score.evidence))
}

fn levels(points: &[Vector3<f64>]) -> Vec<Tree> {
    let mut levels = Vec::new();
    let mut count = points.len();
    while let Some(prefix) = points.get(..count) {
        levels.push(Tree::new(prefix.to_vec()));
        count /= THINNING;
        if count < LEVEL_POINTS_MIN {
            break;
        }
    }
    levels
}

/// The surfaces of the points about a random one, each grown as far as it fits.
fn draw_surfaces(points: &[Vector3<f64>], levels: &[Tree], chance: &mut ChaCha8Rng) -> Vec<Settled> {
    let seed = points.get(chance.random_range(0..points.len().max(1)));
    let first = chance.random_range(0..levels.len().max(1));
    let count = PATCH_POINTS.get(chance.random_range(0..PATCH_POINTS.len())).copied().unwrap_or(POINTS_MIN);
    let Some((seed, level)) = seed.zip(levels.get(first)) else { return Vec::new() };
    let mut patch = level.nearest(seed, count);
    // Half of the draws leave points out: if background points lie scattered among the others, small patches without them are more
    // frequent.
    if chance.random_range(0..2_u32) == 0 {
        let count = patch.len();
        let kept = (count / 2).max(POINTS_MIN + 1).min(count);
        for place in 0..kept {
            patch.swap(place, chance.random_range(place..count));
        }
        patch.truncate(kept);
    }
    let surfaces = settle::surfaces(&patch, FREE);
    let wider: Vec<Vec<Vector3<f64>>> =
        levels.iter().skip(first + 1).map(|level| level.nearest(seed, GROWN_POINTS)).collect();
    surfaces.into_iter().map(|settled| grow(settled, &wider)).collect()
}

/// Fits the surface on wider and wider patches, as long as half of the points lie on it: a direction that is uncertain from the
/// first patch becomes accurate enough for the whole surface.
fn grow(mut settled: Settled, wider: &[Vec<Vector3<f64>>]) -> Settled {
    for patch in wider {
        let window = 2.0 * statistics::TUKEY_C * settled.sigma;
        let Some(next) = settle(settled.surface, patch, [window, 0.0], FREE, GROWING_ROUNDS) else { break };
        let reach = statistics::TUKEY_C * next.sigma;
        let on = patch.iter().filter(|point| next.surface.distance(point).abs() < reach).count();
        if 2 * on < patch.len() {
            break;
        }
        settled = next;
    }
    settled
}

fn is_surface(settled: &Settled, sieve: &[Vector3<f64>], all: &Tree) -> bool {
    is_hollow(settled, sieve) && is_resolved(settled, sieve, all)
}

/// Whether a tube is wide enough for its roughness, or long enough to be a rod.
fn is_hollow(settled: &Settled, points: &[Vector3<f64>]) -> bool {
    let Surface::Cylinder(cylinder) = settled.surface else { return true };
    if settled.sigma <= ROUGHNESS_MAX * cylinder.radius {
        return true;
    }
    let on = near(&settled.surface, points, statistics::TUKEY_C * settled.sigma);
    let [low, high] = shortest(on.iter().map(|point| cylinder.along(point)).collect());
    settled.sigma <= ROD_ROUGHNESS_MAX * cylinder.radius && high - low >= ROD_LENGTH_MIN * cylinder.radius
}

/// Whether a surface is as fine as its points. If neighbours agree far better with each other than with the surface, it is an
/// envelope of other surfaces: at a coarse resolution everything is a plane or a large cylinder.
fn is_resolved(settled: &Settled, sieve: &[Vector3<f64>], all: &Tree) -> bool {
    let reach = statistics::TUKEY_C * settled.sigma;
    let (mut local, mut freedom, mut total, mut count) = (0.0, 0.0, 0.0, 0.0);
    let on = sieve.iter().filter(|point| settled.surface.distance(point).abs() < reach);
    for point in on.take(RESOLUTION_POINTS) {
        let around = all.nearest(point, RESOLUTION_NEIGHBOURS);
        let distances = || around.iter().map(|p| settled.surface.distance(p)).filter(|d| d.abs() < reach);
        let (found, sum) = distances().fold((0.0, 0.0), |(n, sum), d| (n + 1.0, sum + d));
        local += distances().map(|d| (d - sum / found).powi(2)).sum::<f64>();
        freedom += found - 1.0;
        total += distances().map(|d| d * d).sum::<f64>();
        count += found;
    }
    settled.sigma < ROUNDING || local * count >= RESOLVED * total * freedom
}

/// The surface refined on some of the points near it.
fn refine(one: &Scored, points: &[Vector3<f64>]) -> Option<Scored> {
    let window = (2.0 * one.score.tolerance).min(3.0 * statistics::TUKEY_C * one.settled.sigma);
    let mut near = near(&one.settled.surface, points, 2.0 * window);
    near.truncate(SIEVE_POINTS);
    let settled = settle(one.settled.surface, &near, [window, 0.0], FREE, REFINING_ROUNDS)?;
    Some(Scored { settled, score: score(&settled.surface, points) })
}

/// The surface refined on all points, with a window that follows the tolerance of the most evidence as long as the evidence grows.
fn settled_on(start: &Scored, points: &[Vector3<f64>], rounds: usize) -> Option<Scored> {
    let mut best: Option<Scored> = None;
    let mut next = *start;
    for _ in 0..FOLLOWED {
        let window = 2.0 * next.score.tolerance;
        let near = near(&next.settled.surface, points, 2.0 * window);
        let Some(settled) = settle(next.settled.surface, &near, [window, 0.5 * window], FREE, rounds) else { break };
        next = Scored { settled, score: score(&settled.surface, points) };
        let gained = best.is_none_or(|best| next.score.evidence > best.score.evidence);
        if !gained {
            break;
        }
        best = Some(next);
        if 2.0 * next.score.tolerance == window {
            break;
        }
    }
    best
}

fn near(surface: &Surface, points: &[Vector3<f64>], reach: f64) -> Vec<Vector3<f64>> {
    points.iter().filter(|point| surface.distance(point).abs() < reach).copied().collect()
}

/// Alternative surfaces through the same points: the plane for a cylinder, the cylinders for a plane.
fn rivals(best: &Scored, points: &[Vector3<f64>]) -> Vec<Scored> {
    let mut on = near(&best.settled.surface, points, 2.0 * best.score.tolerance);
    on.truncate(SIEVE_POINTS / 4);
    let surfaces = settle::surfaces(&on, FREE).into_iter();
    let is_plane = |surface: &Surface| matches!(surface, Surface::Plane(_));
    let others = surfaces.filter(|other| is_plane(&other.surface) != is_plane(&best.settled.surface));
    let scored = |settled: Settled| Scored { settled, score: score(&settled.surface, points) };
    others.map(scored).filter_map(|other| settled_on(&other, points, REFINING_ROUNDS)).collect()
}

/// The surface as a cylinder with an allowed radius.
fn with_wanted_radius(best: &Scored, points: &[Vector3<f64>], radii: Radii) -> Option<Settled> {
    let Surface::Cylinder(cylinder) = best.settled.surface else { return None };
    let Radii([least, most]) = radii;
    if (least..=most).contains(&cylinder.radius) {
        return Some(best.settled);
    }
    let reach = statistics::TUKEY_C * best.settled.sigma;
    let on = near(&best.settled.surface, points, reach);
    let middle = on.iter().sum::<Vector3<f64>>() / on.len().max(1) as f64;
    let start = Surface::Cylinder(settle::with_radius_within(cylinder, middle, radii));
    let settled = settle(start, &on, [2.0 * reach, 0.0], radii, SETTLING_ROUNDS)?;
    (settled.sigma <= MISFIT_MAX * best.settled.sigma).then_some(settled)
}

/// The result for a surface, if it is a cylinder with an allowed radius.
fn report(best: &Scored, points: &[Vector3<f64>], radii: Radii) -> Option<Found> {
    let Settled { surface, sigma } = with_wanted_radius(best, points, radii)?;
    let Surface::Cylinder(cylinder) = surface else { return None };
    let reach = statistics::TUKEY_C * sigma;
    let on: Vec<&Vector3<f64>> = points.iter().filter(|point| cylinder.distance(point).abs() < reach).collect();
    let middle = quantile(on.iter().map(|point| cylinder.along(point)), 0.5)?;
    let cylinder = Cylinder { point: cylinder.point + cylinder.direction * middle, ..cylinder };
    let extent = shortest(on.iter().map(|point| cylinder.along(point)).collect());
    let [e, f] = cylinder.basis();
    let angle = |point: &&Vector3<f64>| {
        let from = **point - cylinder.point;
        from.dot(&f).atan2(from.dot(&e))
    };
    let arc = arc(on.iter().map(angle));
    let (Radii([_, most]), [low, high]) = (radii, extent);
    let is_rod = most.is_finite() && high - low >= ROD_LENGTH_MIN * cylinder.radius;
    let roughness_max = if is_rod { ROD_ROUGHNESS_MAX } else { ROUGHNESS_MAX };
    let found = arc >= ARC_MIN && sigma <= roughness_max * cylinder.radius && on.len() >= POINTS_MIN;
    found.then_some(Found { cylinder, sigma, count: on.len(), extent, arc, evidence: best.score.evidence })
}

/// The shortest interval that contains nearly all values, widened in proportion for the values left out.
fn shortest(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let span = ((COVERED * values.len() as f64).ceil() as usize).max(1);
    let ends = values.iter().zip(values.iter().skip(span - 1));
    let least = ends.min_by(|(a, b), (c, d)| (*b - *a).total_cmp(&(*d - *c)));
    least.map_or([0.0; 2], |(low, high)| {
        let covered = span as f64 / values.len() as f64;
        let beyond = 0.5 * (high - low) * (1.0 / covered - 1.0);
        [low - beyond, high + beyond]
    })
}

/// The arc that contains nearly all angles, rad.
fn arc(angles: impl Iterator<Item = f64>) -> f64 {
    let mut angles: Vec<f64> = angles.collect();
    angles.sort_by(f64::total_cmp);
    let count = angles.len();
    let span = ((COVERED * count as f64).ceil() as usize).max(1);
    let again = angles.iter().map(|angle| angle + TAU);
    let ends = angles.iter().copied().chain(again).skip(span - 1);
    let shortest = angles.iter().zip(ends).map(|(low, high)| high - low).fold(TAU, f64::min);
    // A ring of few points has a gap before the first one.
    (shortest * count as f64 / span as f64).clamp(0.0, 2.0 * PI)
}
