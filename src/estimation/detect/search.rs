//! One surface after the other: the best supported is found, refined and taken out of the sample, until enough cylinders
//! are found. Planes take part, so that a floor is out of the way before a part that holds fewer points is looked for.

use super::patch;
use super::sample::quantile;
use super::score::{Score, score};
use super::settle::{Radii, Settled, settle};
use super::surface::{Cylinder, Plane, Surface};
use super::tree::Tree;
use crate::estimation::robust;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// What a cylinder must satisfy.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted {
    pub(super) radii: Radii,
    /// A direction and the cosine of the largest angle to it.
    pub(super) along: Option<(Vector3<f64>, f64)>,
    /// Cylinders that are looked for.
    pub(super) most: usize,
}

/// A cylinder with what its points say.
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
const ROUNDS_MAX: usize = 16;
/// Points for the first look at a surface.
const SIEVE_POINTS: usize = 1024;
/// Surfaces of a round that are refined, with these rounds of re-weighting.
const REFINED: usize = 6;
const REFINING_ROUNDS: usize = 12;
const SETTLING_ROUNDS: usize = 60;
/// Chance of missing the best surface.
const MISS: f64 = 1e-3;
/// Every level of the neighbourhoods has a quarter of the points of the one before, so its patches are twice as wide,
const THINNING: usize = 4;
/// and the coarsest has no fewer points than this.
const LEVEL_POINTS_MIN: usize = 32;
/// Points of a patch.
const PATCH_POINTS: [usize; 3] = [12, 24, 40];
/// Surfaces beyond the cylinders wanted that may be taken out on the way.
const OTHERS_MAX: usize = 4;
/// A shorter arc, rad (11°), is a bent plane: profiles are refused below 15°.
const ARC_MIN: f64 = 0.2;
/// A tube that is rougher than this share of its radius is a bundle of points.
const ROUGHNESS_MAX: f64 = 1.0 / 3.0;
/// Share of the points that an extent covers.
const COVERED: f64 = 0.98;

/// A surface that is to be compared.
#[derive(Debug, Clone, Copy)]
struct Scored {
    settled: Settled,
    score: Score,
}

/// The cylinders of points in random order within a cloud of size 1, best first.
pub(super) fn cylinders(points: &[Vector3<f64>], wanted: &Wanted) -> Vec<Found> {
    let mut rest = points.to_vec();
    let mut found: Vec<Found> = Vec::new();
    for stage in 0..wanted.most.saturating_add(OTHERS_MAX) {
        if rest.len() < POINTS_MIN || found.len() >= wanted.most {
            break;
        }
        let Some(best) = best(&rest, wanted, stage as u64) else { break };
        found.extend(report(&best, &rest, wanted));
        // Generously, so that the rim of the noise is not taken for a surface of its own.
        let reach = 2.0 * robust::TUKEY_C * best.settled.sigma;
        let before = rest.len();
        rest.retain(|point| best.settled.surface.distance(point).abs() >= reach);
        if rest.len() == before {
            break;
        }
    }
    found.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    found
}

/// The surface with the most evidence.
fn best(points: &[Vector3<f64>], wanted: &Wanted, stage: u64) -> Option<Scored> {
    let levels = levels(points);
    let sieve = points.get(..points.len().min(SIEVE_POINTS))?;
    let mut best: Option<Scored> = None;
    for round in 0..ROUNDS_MAX {
        let drawn: Vec<Vec<(Surface, Score)>> = (0..ROUND)
            .into_par_iter()
            .map(|draw| {
                let seed = (stage << 32) + (round * ROUND + draw) as u64;
                let mut chance = ChaCha8Rng::seed_from_u64(seed);
                let patch = draw_patch(points, &levels, &mut chance);
                let surfaces = patch::surfaces(&patch, wanted.radii).into_iter();
                let possible = surfaces.filter(|surface| is_wanted(surface, wanted));
                possible.map(|surface| (surface, score(&surface, sieve))).collect()
            })
            .collect();
        let mut drawn: Vec<(Surface, Score)> = drawn.into_iter().flatten().collect();
        drawn.sort_by(|(_, a), (_, b)| b.evidence.total_cmp(&a.evidence));
        drawn.truncate(REFINED);
        let refined: Vec<Scored> =
            drawn.par_iter().filter_map(|(surface, score)| refine(surface, score, sieve, points, wanted)).collect();
        for one in refined {
            if best.is_none_or(|best| one.score.evidence > best.score.evidence) {
                best = Some(one);
            }
        }
        let share = best.map_or(0.0, |best| best.score.count as f64 / points.len() as f64);
        // A patch about a point of the surface shows it on one of the levels.
        let chance = share / (2 * levels.len()) as f64;
        if ((round + 1) * ROUND) as f64 * (-chance).ln_1p() < MISS.ln() {
            break;
        }
    }
    let best = best?;
    rivals(&best, points, wanted).into_iter().chain([best]).max_by(|a, b| {
        a.score.evidence.total_cmp(&b.score.evidence)
    })
}

fn is_wanted(surface: &Surface, wanted: &Wanted) -> bool {
    match (surface, wanted.along) {
        (Surface::Cylinder(cylinder), Some((along, cos_min))) => cylinder.direction.dot(&along).abs() >= cos_min,
        _ => true,
    }
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

/// Some of the points about a random one.
fn draw_patch(points: &[Vector3<f64>], levels: &[Tree], chance: &mut ChaCha8Rng) -> Vec<Vector3<f64>> {
    let seed = points.get(chance.random_range(0..points.len().max(1)));
    let level = levels.get(chance.random_range(0..levels.len().max(1)));
    let count = PATCH_POINTS.get(chance.random_range(0..PATCH_POINTS.len())).copied().unwrap_or(POINTS_MIN);
    let Some((seed, level)) = seed.zip(level) else { return Vec::new() };
    let mut patch = level.nearest(seed, count);
    // Half of the draws leave points out: where foreign points lie scattered among the others, few are clean more often.
    if chance.random_range(0..2_u32) == 0 {
        let kept = (patch.len() / 2).max(POINTS_MIN + 1).min(patch.len());
        let count = patch.len();
        for place in 0..kept {
            patch.swap(place, chance.random_range(place..count));
        }
        patch.truncate(kept);
    }
    patch
}

/// Settled on a few points, then on all, and wider again as long as this adds evidence.
fn refine(
    surface: &Surface,
    first: &Score,
    sieve: &[Vector3<f64>],
    points: &[Vector3<f64>],
    wanted: &Wanted,
) -> Option<Scored> {
    let rough = settle(*surface, sieve, 2.0 * first.tolerance, wanted.radii, REFINING_ROUNDS);
    let rough = rough.map_or(*surface, |settled| settled.surface);
    let scores = [rough, *surface].map(|surface| (surface, score(&surface, points)));
    let (surface, score) = scores.into_iter().max_by(|(_, a), (_, b)| a.evidence.total_cmp(&b.evidence))?;
    settled_on(&surface, &score, points, wanted)
}

fn settled_on(surface: &Surface, first: &Score, points: &[Vector3<f64>], wanted: &Wanted) -> Option<Scored> {
    let mut best: Option<Scored> = None;
    let mut next = (*surface, *first);
    for _ in 0..4 {
        let (surface, tolerance) = (next.0, next.1.tolerance);
        let Some(settled) = settle(surface, points, 2.0 * tolerance, wanted.radii, SETTLING_ROUNDS) else { break };
        if !is_wanted(&settled.surface, wanted) {
            break;
        }
        let score = score(&settled.surface, points);
        let gained = best.is_none_or(|best| score.evidence > best.score.evidence * (1.0 + 1e-9));
        if !gained {
            break;
        }
        best = Some(Scored { settled, score });
        next = (settled.surface, score);
    }
    best
}

/// What else the points on a surface could be: the plane of a cylinder, the cylinders of a plane.
fn rivals(best: &Scored, points: &[Vector3<f64>], wanted: &Wanted) -> Vec<Scored> {
    let reach = 2.0 * best.score.tolerance;
    let on = points.iter().filter(|point| best.settled.surface.distance(point).abs() < reach);
    let some: Vec<Vector3<f64>> = on.take(SIEVE_POINTS / 4).copied().collect();
    let surfaces = match best.settled.surface {
        Surface::Cylinder(_) => {
            Plane::through(some.iter().map(|p| (1.0, *p))).map(Surface::Plane).into_iter().collect()
        }
        Surface::Plane(_) => patch::surfaces(&some, wanted.radii),
    };
    let possible = surfaces.into_iter().filter(|surface| is_wanted(surface, wanted));
    possible.filter_map(|surface| settled_on(&surface, &score(&surface, points), points, wanted)).collect()
}

/// The surface as a cylinder that can be reported.
fn report(best: &Scored, points: &[Vector3<f64>], wanted: &Wanted) -> Option<Found> {
    let Surface::Cylinder(cylinder) = best.settled.surface else { return None };
    let sigma = best.settled.sigma;
    let reach = robust::TUKEY_C * sigma;
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
    let Radii([least, most]) = wanted.radii;
    let found = arc >= ARC_MIN
        && sigma <= ROUGHNESS_MAX * cylinder.radius
        && (least..=most).contains(&cylinder.radius)
        && on.len() >= POINTS_MIN;
    found.then_some(Found { cylinder, sigma, count: on.len(), extent, arc, evidence: best.score.evidence })
}

/// The shortest interval that holds nearly all values, widened by what the left out ones would take of it.
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

/// The arc that holds nearly all angles, rad.
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
