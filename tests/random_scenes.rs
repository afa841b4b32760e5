//! Thousands of random scenes: every accepted result must be correct within five of its own stated standard
//! uncertainties in every parameter. A refusal is allowed, a wrong result with a small uncertainty is not.
//!
//! `COAXIS_SCENES=10000 cargo test --release --test all random_scenes:: -- --nocapture` runs all of them and prints the counts
//! of results; `COAXIS_FIRST_SCENE=10000` in addition runs the next ones. From number 1 000 000 on the scenes are drawn from
//! everything that can be simulated (`wide.rs`), are processed like an uploaded file, and are reported by kind.

#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    clippy::indexing_slicing,
    reason = "a test may fail, and prints its results"
)]

mod wide;

use crate::made::{count, errors, standard};
use coaxis::estimation::{Method, Outcome, Progress, RadiusRule, Settings, estimate};
use coaxis::geometry::AxisLine;
use coaxis::scan::synthetic::{Bead, ClampShape, Interference, Part, Sampling, Surroundings, make};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Scenes in continuous integration.
const SCENES: u64 = 400;
/// Allowed number of wrong results, scenes in a thousand, rounded down (docs/accuracy.md). To be lowered, never raised.
const WRONG_PER_THOUSAND: f64 = 0.1;
/// Scenes of every kind in continuous integration.
const WIDE_SCENES: u64 = 200;
/// Scenes in a thousand that may be wrong without a systematic error of the sensor. In the first run, 15 of 2000 were wrong
/// and 161 were refused; the few of one run vary by chance. To be lowered, never raised.
const WIDE_WRONG_PER_THOUSAND: f64 = 15.0;
/// Share of these that may be refused.
const WIDE_REFUSED_MAX: f64 = 0.12;
/// A result is wrong if its error exceeds this many of its own standard uncertainties,
const UNCERTAINTIES_MAX: f64 = 5.0;
/// and exceeds rounding, mm and radians.
const ROUNDING: f64 = 1e-9;

/// Share of the scenes that may be refused; in most of these a layer or clamp is on every profile.
const REFUSED_MAX: f64 = 0.08;

struct Chance(ChaCha8Rng);

impl Chance {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    /// Log-uniform between the bounds.
    fn scaled(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    fn happens(&mut self, share: f64) -> bool {
        self.0.random_bool(share)
    }

    /// Between the bounds in a share of the scenes, otherwise zero.
    fn sometimes(&mut self, share: f64, low: f64, high: f64) -> f64 {
        if self.happens(share) { self.between(low, high) } else { 0.0 }
    }
}

fn interference(chance: &mut Chance, radius_mm: f64) -> Interference {
    if chance.happens(0.25) {
        return Interference::default();
    }
    // Holes are up to 30 mm deep, which is too deep for a thin part.
    let holes = if radius_mm > 40.0 { 1.0 } else { 0.0 };
    let shares = [
        chance.sometimes(0.4 * holes, 0.0, 1.0),
        chance.sometimes(0.4 * holes, 0.0, 1.0),
        chance.sometimes(0.6, 0.0, 1.5),
        chance.between(0.05, 1.0),
    ];
    let [screw_holes, straight_holes, clamps, _] = shares.map(|share| share / shares.iter().sum::<f64>());
    let clamp_shape = match chance.between(0.0, 3.0) {
        kind if kind < 1.0 => ClampShape::Concentric,
        kind if kind < 2.0 => ClampShape::Flat,
        _ => ClampShape::Round { radius_mm: radius_mm * chance.scaled(0.4, 3.0) },
    };
    let bead = if chance.happens(0.2) {
        let (arc, place) = (chance.between(0.02, 0.1), chance.between(0.1, 0.9));
        Bead { height_mm: chance.scaled(0.1, 2.0), arc, place }
    } else {
        Bead::default()
    };
    Interference {
        screw_holes,
        straight_holes,
        clamps,
        clamp_arc: chance.between(0.1, 0.85),
        clamp_height_mm: chance.scaled(0.2, 0.3 * radius_mm),
        clamp_shape,
        shift: chance.sometimes(0.5, -0.3, 0.3),
        bead,
    }
}

fn surroundings(chance: &mut Chance, radius_mm: f64) -> Surroundings {
    let floor = chance.sometimes(0.25, 0.05, 0.6);
    let floor_depth_mm = radius_mm * chance.between(0.2, 1.0);
    let support = chance.sometimes(0.2, 0.05, 0.3);
    let support_radius_mm = if chance.happens(0.5) { radius_mm * chance.between(0.1, 0.5) } else { 0.0 };
    Surroundings { floor, floor_depth_mm, support, supports: chance.between(0.1, 1.0), support_radius_mm }
}

/// The scene with this number.
fn scene(seed: u64) -> (Part, Settings) {
    let mut chance = Chance(ChaCha8Rng::seed_from_u64(seed));
    let chance = &mut chance;
    let radius_mm = chance.scaled(10.0, 1000.0);
    let mut slope = || chance.between(-10.0, 10.0).to_radians().tan();
    let (p, q) = (slope(), slope());
    let axis = AxisLine { p, q, y0: chance.between(-300.0, 300.0), z0: chance.between(-300.0, 300.0) };
    let part = Part {
        radius_mm,
        axis,
        x_start_mm: chance.between(-500.0, 500.0),
        length_mm: (radius_mm * chance.scaled(0.3, 8.0)).clamp(15.0, 3000.0),
        profiles_count: chance.scaled(5.0, 200.0).round() as usize,
        points_count: chance.scaled(40.0, 400.0).round() as usize,
        arc_deg: chance.between(40.0, 170.0),
        view_deg: chance.sometimes(0.5, -30.0, 30.0),
        sampling: if chance.happens(0.5) { Sampling::EvenAcross } else { Sampling::EvenAngle },
        spacing_spread: chance.sometimes(0.5, 0.0, 1.0),
        noise_sigma_mm: chance.scaled(0.01, 0.3).min(0.005 * radius_mm),
        noise_correlation: chance.sometimes(0.5, 0.0, 0.95),
        jitter_sigma_mm: if chance.happens(0.5) { chance.scaled(0.005, 0.2).min(0.005 * radius_mm) } else { 0.0 },
        interference: interference(chance, radius_mm),
        surroundings: surroundings(chance, radius_mm),
        drop_out_ratio: chance.sometimes(0.5, 0.0, 0.4),
        spike_ratio: chance.sometimes(0.5, 0.0, 0.08),
        ..Part::smooth(seed)
    };
    let nominal_radius_mm = chance.happens(0.5).then_some(radius_mm);
    let radius = match chance.between(0.0, 4.0) {
        rule if rule < 1.0 && nominal_radius_mm.is_some() => RadiusRule::Fixed,
        _ => RadiusRule::Free,
    };
    (part, Settings { method: Method::Cylinder, nominal_radius_mm, radius, ..Settings::default() })
}

enum Fate {
    Right,
    Wrong([f64; 5]),
    Refused(&'static str),
}

fn wrong_or_right(errors: [f64; 5], standard: [f64; 5]) -> Fate {
    let off = std::array::from_fn(|i| errors[i] / standard[i].max(ROUNDING));
    if off.iter().all(|off: &f64| off.abs() <= UNCERTAINTIES_MAX) { Fate::Right } else { Fate::Wrong(off) }
}

fn fate(seed: u64) -> Fate {
    if seed >= wide::FIRST {
        return wide::scene_wide(seed).fate();
    }
    let (part, settings) = scene(seed);
    let (scan, truth) = make(&part).expect("a part");
    match estimate(&scan, &settings, &Progress::default()).outcome {
        Outcome::Refused(refusal) => Fate::Refused(refusal.code()),
        Outcome::Accepted(pose) => wrong_or_right(errors(&pose, &truth, pose.x_ref), standard(&pose)),
    }
}

/// Counts of the results of scenes.
struct Fates {
    first: u64,
    fates: Vec<Fate>,
    refused: BTreeMap<&'static str, usize>,
    wrong: Vec<(u64, [f64; 5])>,
}

impl Fates {
    fn of(first: u64, scenes_count: u64) -> Self {
        let fates: Vec<Fate> = (first..first + scenes_count).into_par_iter().map(fate).collect();
        let mut refused: BTreeMap<&str, usize> = BTreeMap::new();
        let mut wrong = Vec::new();
        for (seed, fate) in (first..).zip(&fates) {
            match fate {
                Fate::Right => {}
                Fate::Wrong(off) => wrong.push((seed, *off)),
                Fate::Refused(code) => *refused.entry(code).or_default() += 1,
            }
        }
        Self { first, fates, refused, wrong }
    }

    fn refused_count(&self) -> usize {
        self.refused.values().sum()
    }

    fn print(&self) {
        println!("{} scenes, {} answered", self.fates.len(), self.fates.len() - self.refused_count());
        for (code, count) in &self.refused {
            println!("  refused as {code}: {count}");
        }
        for (seed, off) in &self.wrong {
            println!("  scene {seed}: {off:.1?} of its standard uncertainties");
            if std::env::var("COAXIS_SHOW").is_ok() {
                match *seed {
                    seed if seed >= wide::FIRST => println!("    {:?}", wide::scene_wide(seed)),
                    seed => println!("    {:?}", scene(seed)),
                }
            }
        }
    }

    /// By the kinds from which the wider scenes were drawn; a scene counts for each of its kinds.
    fn print_kinds(&self) {
        let mut kinds: BTreeMap<&str, [usize; 4]> = BTreeMap::new();
        for (seed, fate) in (self.first..).zip(&self.fates) {
            let scene = wide::scene_wide(seed);
            let sort = if scene.is_systematic() { "ALL SYSTEMATIC" } else { "ALL OTHERS" };
            for kind in scene.kinds.iter().copied().chain([sort]) {
                let [all, refused, wrong, systematic] = kinds.entry(kind).or_default();
                *all += 1;
                *refused += usize::from(matches!(fate, Fate::Refused(_)));
                let is_wrong = matches!(fate, Fate::Wrong(_));
                *wrong += usize::from(is_wrong && !scene.is_systematic());
                *systematic += usize::from(is_wrong && scene.is_systematic());
            }
        }
        println!("{:>16} {:>7} {:>8} {:>6} wrong, with a systematic error", "kind", "scenes", "refused", "wrong");
        for (kind, [all, refused, wrong, systematic]) in kinds {
            println!("{kind:>16} {all:>7} {refused:>8} {wrong:>6} {systematic:>6}");
        }
        for (seed, off) in &self.wrong {
            let scene = wide::scene_wide(*seed);
            if !scene.is_systematic() {
                println!("  scene {seed}: {off:.1?}, {:?}, decisive: {:?}", scene.kinds, scene.decisive_kinds());
            }
        }
    }
}

/// Scenes whose result is wrong if one step of the estimation is disabled, each verified on 30 November 2026.
const STEPS: [(&str, &[u64]); 7] = [
    ("only the connected arc determines the radius", &[603_714, 709_635]),
    ("a surface beneath the fit is searched", &[812_304, 812_779]),
    ("few profiles have to agree", &[1234]),
    ("few profiles are judged together", &[1358]),
    ("a smooth form is no layer", &[704_675]),
    ("what neighbouring parts of the surface share is a field", &[521, 1271, 403_903]),
    ("position and slopes follow a fixed radius", &[604_525, 605_229]),
];

#[test]
fn scenes_that_depend_on_one_step_are_not_wrong() {
    for (step, scenes) in STEPS {
        for scene in scenes {
            if let Fate::Wrong(off) = fate(*scene) {
                panic!("{step}: scene {scene} is off by {off:.1?} of its standard uncertainties");
            }
        }
    }
}

#[test]
fn no_result_is_wrong_by_more_than_its_uncertainty() {
    let first = count("COAXIS_FIRST_SCENE", 0);
    if first >= wide::FIRST {
        return;
    }
    let scenes_count = count("COAXIS_SCENES", SCENES);
    let fates = Fates::of(first, scenes_count);
    fates.print();
    let allowed = (WRONG_PER_THOUSAND * scenes_count as f64 / 1000.0) as usize;
    assert!(fates.wrong.len() <= allowed, "{} answers are wrong", fates.wrong.len());
    // The number of refusals is limited as well.
    let refused_count = fates.refused_count();
    assert!(refused_count as f64 <= REFUSED_MAX * scenes_count as f64, "{refused_count} refused");
}

#[test]
fn few_results_are_wrong_in_scenes_of_every_kind() {
    let first = count("COAXIS_FIRST_SCENE", wide::FIRST);
    if first < wide::FIRST {
        return;
    }
    let scenes_count = count("COAXIS_SCENES", WIDE_SCENES);
    let fates = Fates::of(first, scenes_count);
    fates.print();
    fates.print_kinds();
    let is_expected = |seed: u64| !wide::scene_wide(seed).is_systematic();
    let wrong_count = fates.wrong.iter().filter(|(seed, _)| is_expected(*seed)).count();
    assert!(wrong_count as f64 <= WIDE_WRONG_PER_THOUSAND * scenes_count as f64 / 1000.0, "{wrong_count} are wrong");
    let refused_count = fates.refused_count();
    assert!(refused_count as f64 <= WIDE_REFUSED_MAX * scenes_count as f64, "{refused_count} refused");
}
