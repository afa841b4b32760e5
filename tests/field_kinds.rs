//! Faults that users of scanners and point-cloud tools have reported in public, simulated and measured like an uploaded file:
//! the expanded uncertainty must contain the error of every number as often as it claims, and an accepted result must not be wrong
//! by many of its own uncertainties. The truth is that of the generator.
//!
//! `COAXIS_SEEDS=300 cargo test --release --test all field_kinds:: -- --nocapture` prints the table of docs/accuracy.md;
//! `COAXIS_DENSITY=4` simulates four times as many profiles and points, which shows errors that do not average out.

#![expect(clippy::indexing_slicing, clippy::print_stdout, reason = "a test may fail, and prints its results")]

use crate::made::any_direction::Compared;
use crate::made::count;
use crate::made::uploaded::Upload;
use coaxis::estimation::{Settings, TypeB};
use coaxis::geometry::{AxisLine, Frame};
use coaxis::scan::synthetic::{
    Bend, Coordinates, Curl, Export, LaserPlane, Part, Reflections, RepeatedX, Ripple, SensorErrors, Sentinel,
    SentinelPlace, Side, Steps, Travel, random_frame,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF};
use std::f64::consts::TAU;

/// Seeds per kind in continuous integration.
const SEEDS: u64 = 4;
/// Maximum error of an accepted result in its own standard uncertainties,
const UNCERTAINTIES_MAX: f64 = 5.0;
/// if it exceeds rounding, mm and radians.
const ROUNDING: f64 = 1e-9;
/// Range of the share of the numbers that ± U contains over many seeds; U claims 95.45 %.
const HELD: [f64; 2] = [0.90, 0.99];
/// A share outside of these bounds is a fault if its probability by chance is below this per kind.
const CHANCE: f64 = 1e-3;
/// Independent numbers of one result: z and the radius of an arc are correlated, so that the shares of five numbers vary like
/// those of 25/7 independent ones (the variance of the sum of five indicators is 7 pq if two are equal).
const INDEPENDENT: f64 = 25.0 / 7.0;
/// Minimum share of the scans that have to be accepted.
const ANSWERED_MIN: f64 = 0.9;
const SIGMA_MM: f64 = 0.02;
const RADIUS_MM: f64 = 50.0;

/// Expected relation of a kind to the stated uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Due {
    /// U contains as many errors as it claims.
    Held,
    /// The same, but the share may be higher: limits of a data sheet are wider than the error of one sensor, and coarse steps are
    /// contained both in the scatter of the points and in the line `resolution`.
    AtLeast,
    /// The scan does not show the error and no calibration declares it. For comparison with the kind that declares it.
    Undeclared,
}

/// One scan of a kind.
struct Scene {
    part: Part,
    upload: Upload,
    type_b: TypeB,
    nominal_radius_mm: Option<f64>,
}

/// A change of a scan, random or not.
type Change = Box<dyn Fn(&mut Scene, &mut ChaCha8Rng) + Sync>;

struct Kind {
    name: &'static str,
    due: Due,
    change: Change,
}

fn kind(name: &'static str, change: impl Fn(&mut Scene) + Sync + 'static) -> Kind {
    Kind { name, due: Due::Held, change: Box::new(move |scene, _| change(scene)) }
}

fn wide(name: &'static str, change: impl Fn(&mut Scene) + Sync + 'static) -> Kind {
    Kind { due: Due::AtLeast, ..kind(name, change) }
}

fn drawn(name: &'static str, due: Due, change: impl Fn(&mut Scene, &mut ChaCha8Rng) + Sync + 'static) -> Kind {
    Kind { name, due, change: Box::new(change) }
}

/// The scan from which the files of `field` were made: radius 50 mm, 120°, noise 0.02 mm.
fn scene(seed: u64) -> Scene {
    let density = count("COAXIS_DENSITY", 1) as usize;
    let axis = AxisLine { p: 0.8_f64.to_radians().tan(), q: 1.1_f64.to_radians().tan(), y0: 3.0, z0: -7.0 };
    let part = Part {
        radius_mm: RADIUS_MM,
        axis,
        length_mm: 245.0,
        profiles_count: 50 * density,
        points_count: 60 * density,
        arc_deg: 120.0,
        noise_sigma_mm: SIGMA_MM,
        ..Part::smooth(seed)
    };
    Scene { part, upload: Upload::default(), type_b: TypeB::default(), nominal_radius_mm: None }
}

fn sentinel(value_mm: f64, ratio: f64, place: SentinelPlace, coordinates: Coordinates) -> impl Fn(&mut Scene) + Sync {
    move |scene| scene.upload.export.sentinel = Some(Sentinel { value_mm, ratio, place, coordinates })
}

fn plane(about_y_deg: f64, about_z_deg: f64) -> impl Fn(&mut Scene) + Sync {
    move |scene| scene.part.laser_plane = LaserPlane { about_y_deg, about_z_deg }
}

fn travel(travel: Travel) -> impl Fn(&mut Scene) + Sync {
    move |scene| scene.part.travel = travel
}

fn steps(x_mm: f64, y_mm: f64, z_mm: f64) -> impl Fn(&mut Scene) + Sync {
    move |scene| scene.upload.export = Export { steps: Steps { x_mm, y_mm, z_mm }, ..Export::default() }
}

fn reflections(ratio: f64, offset_mm: f64) -> impl Fn(&mut Scene) + Sync {
    move |scene| scene.part.sensor.reflections = Reflections { ratio, offset_mm }
}

/// The rail has this direction in the file; the points are in random order.
fn along(x_axis: [f64; 3], z_axis: [f64; 3]) -> impl Fn(&mut Scene) + Sync {
    move |scene| {
        let frame = Frame { origin_mm: [10.0, -20.0, 30.0], x_axis, z_axis };
        scene.upload = Upload { placed_at: Some(frame), is_shuffled: true, ..scene.upload };
    }
}

/// A bent scale of z with the limits ± `limit_mm` at the ends of the range. It is declared by its total change over
/// the depth of the part, as docs/estimation.md says.
fn bend(limit_mm: f64, is_declared: bool) -> impl Fn(&mut Scene, &mut ChaCha8Rng) + Sync {
    move |scene, chance| {
        let size_mm = chance.random_range(-limit_mm..limit_mm);
        scene.part.sensor.bend = Bend { size_mm, middle_mm: scene.part.axis.at(122.5)[1], range_mm: RADIUS_MM };
        if is_declared {
            // The arc of 120° covers between half and all of the range, so the change is three quarters of the limit.
            scene.type_b.sensor_linearity_mm = 0.75 * limit_mm;
        }
    }
}

/// A wave along the laser line, declared with the standard deviation and correlation of a wave of random phase, whose correlation
/// cos(2πd/period) starts like exp(−d²/2L²) with L = period/2π.
fn ripple(amplitude_mm: f64, period_mm: f64, is_declared: bool) -> impl Fn(&mut Scene, &mut ChaCha8Rng) + Sync {
    move |scene, chance| {
        scene.part.sensor = SensorErrors { ripple: Ripple { amplitude_mm, period_mm }, ..SensorErrors::default() };
        // Any position of the part in the field of the sensor, and so any phase.
        scene.part.axis.y0 = chance.random_range(-0.5 * period_mm..0.5 * period_mm);
        if is_declared {
            scene.type_b.sensor_linearity_mm = amplitude_mm / 2f64.sqrt();
            scene.type_b.sensor_linearity_length_mm = Some(period_mm / TAU);
        }
    }
}

/// Points beyond 40° of incidence deviate; the arc ends at 60°. Declared like a limit ± a of a data sheet: a/√3.
fn curl(limit_mm: f64, is_declared: bool) -> impl Fn(&mut Scene, &mut ChaCha8Rng) + Sync {
    move |scene, chance| {
        let mm_per_rad = chance.random_range(-limit_mm..limit_mm) / 20f64.to_radians();
        scene.part.sensor.curl = Curl { mm_per_rad, from_deg: 40.0 };
        if is_declared {
            scene.type_b.sensor_linearity_mm = limit_mm / 3f64.sqrt();
        }
    }
}

fn kinds() -> Vec<Kind> {
    use Coordinates::{XYZ, YZ, Z};
    use SentinelPlace::{Edges, Random};
    let pitch_mm = 5.0;
    let turn = |degrees: f64| [degrees.to_radians().cos(), degrees.to_radians().sin(), 0.0];
    let up = |degrees: f64| [degrees.to_radians().cos(), 0.0, degrees.to_radians().sin()];
    let normal = |degrees: f64| [-degrees.to_radians().sin(), 0.0, degrees.to_radians().cos()];
    let frame = Frame { origin_mm: [0.0; 3], x_axis: turn(3.0), z_axis: [0.0, 0.0, 1.0] };
    vec![
        kind("nothing off", |_| {}),
        kind("(0, 0, 0) for 5 % at the edges", sentinel(0.0, 0.05, Edges, XYZ)),
        kind("(0, 0, 0) for 20 % at the edges", sentinel(0.0, 0.2, Edges, XYZ)),
        kind("(0, 0, 0) for 10 % anywhere", sentinel(0.0, 0.1, Random, XYZ)),
        kind("y = z = 0 for 10 % anywhere", sentinel(0.0, 0.1, Random, YZ)),
        kind("z = 9999 for 2.5 % anywhere", sentinel(9999.0, 0.025, Random, Z)),
        kind("z = 999 for 10 % anywhere", sentinel(999.0, 0.1, Random, Z)),
        kind("z = −99999 for 20 % at the edges", sentinel(-99_999.0, 0.2, Edges, Z)),
        kind("laser plane turned by 3° about y", plane(3.0, 0.0)),
        kind("laser plane turned by 3° about z", plane(0.0, 3.0)),
        kind("laser plane turned by 10° about z", plane(0.0, 10.0)),
        kind("laser plane turned by 10° about both", plane(10.0, 10.0)),
        kind("frame of the recipe turned by 3°", move |scene| scene.upload.declared = Some(frame)),
        kind("all profiles twice", travel(Travel { repeated_ratio: 1.0, ..Travel::default() })),
        kind("30 % of the profiles twice", travel(Travel { repeated_ratio: 0.3, ..Travel::default() })),
        kind(
            "10 % stale profiles under a new x",
            travel(Travel { repeated_ratio: 0.1, repeated_x: RepeatedX::New, ..Travel::default() }),
        ),
        kind("30 % of the profiles lost", travel(Travel { lost_ratio: 0.3, ..Travel::default() })),
        kind("stick-slip over two pitches", travel(Travel { stick_mm: 2.0 * pitch_mm, ..Travel::default() })),
        kind("encoder noise of 5 σ", travel(Travel { encoder_sigma_mm: 5.0 * SIGMA_MM, ..Travel::default() })),
        kind("z on steps of σ", steps(0.0, 0.0, SIGMA_MM)),
        wide("y and z on steps of 5 σ", steps(0.0, 5.0 * SIGMA_MM, 5.0 * SIGMA_MM)),
        wide("y on steps of 0.5 mm, z of 10 σ", steps(0.0, 0.5, 10.0 * SIGMA_MM)),
        kind("heavy tails (Student t, 3)", |scene| scene.part.noise_freedom = Some(3.0)),
        kind("heavy tails (Student t, 2.3)", |scene| scene.part.noise_freedom = Some(2.3)),
        kind("neighbours correlated by 0.9", |scene| scene.part.noise_correlation = 0.9),
        kind("profiles shaken by 2 σ", |scene| scene.part.jitter_sigma_mm = 2.0 * SIGMA_MM),
        kind("10 % double reflections at 3 σ", reflections(0.1, 3.0 * SIGMA_MM)),
        kind("5 % double reflections at 25 σ", reflections(0.05, 25.0 * SIGMA_MM)),
        kind("5 % double reflections at 5 mm", reflections(0.05, 5.0)),
        kind("10 % double reflections at −5 mm", reflections(0.1, -5.0)),
        kind("15 % double reflections at −5 mm, nominal radius", |scene| {
            reflections(0.15, -5.0)(scene);
            scene.nominal_radius_mm = Some(RADIUS_MM);
        }),
        kind("inside of a pipe", |scene| scene.part.side = Side::Inside),
        kind("axis along Z", along([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])),
        kind("axis along Y", along([0.0, 1.0, 0.0], [0.0, 0.0, 1.0])),
        kind("axis 45° off X", along(up(45.0), normal(45.0))),
        kind("axis 20° off X", along(up(20.0), normal(20.0))),
        drawn("axis in any direction", Due::Held, |scene, chance| {
            let frame = random_frame(chance.random(), 500.0);
            scene.upload = Upload { placed_at: Some(frame), is_shuffled: true, ..scene.upload };
        }),
        kind("full circle", |scene| scene.part.arc_deg = 360.0),
        kind("full circle, noise 5 % of R = 20 mm", |scene| {
            scene.part.arc_deg = 360.0;
            (scene.part.radius_mm, scene.part.noise_sigma_mm) = (20.0, 1.0);
        }),
        drawn("bent scale of z, within 3 σ, declared", Due::AtLeast, bend(3.0 * SIGMA_MM, true)),
        drawn("the same, not declared", Due::Undeclared, bend(3.0 * SIGMA_MM, false)),
        drawn("ripple of σ over 10 mm, declared", Due::AtLeast, ripple(SIGMA_MM, 10.0, true)),
        drawn("the same, not declared", Due::Undeclared, ripple(SIGMA_MM, 10.0, false)),
        drawn("ripple of σ over 60 mm, declared", Due::AtLeast, ripple(SIGMA_MM, 60.0, true)),
        drawn("the same, not declared", Due::Undeclared, ripple(SIGMA_MM, 60.0, false)),
        drawn("curled flanks, within 3 σ, declared", Due::AtLeast, curl(3.0 * SIGMA_MM, true)),
        drawn("the same, not declared", Due::Undeclared, curl(3.0 * SIGMA_MM, false)),
    ]
}

/// Results of the scans of a kind.
#[derive(Debug, Default)]
struct Tally {
    scans_count: usize,
    refused: Vec<&'static str>,
    /// Errors divided by standard uncertainties.
    answers: Vec<[f64; 5]>,
}

impl Tally {
    fn of(kind: &Kind, seeds_count: u64) -> Self {
        let measured: Vec<Result<Compared, &str>> =
            (0..seeds_count).into_par_iter().map(|seed| kind.measured(seed)).collect();
        let mut tally = Self { scans_count: measured.len(), ..Self::default() };
        for one in measured {
            match one {
                Err(code) => tally.refused.push(code),
                Ok((errors, standard)) => {
                    tally.answers.push(std::array::from_fn(|i| errors[i].abs() / standard[i].max(ROUNDING)));
                }
            }
        }
        tally
    }

    fn held_count(&self) -> usize {
        self.answers.iter().flatten().filter(|off| **off <= 2.0).count()
    }

    /// The number that U contains least often: its name, and how often, %.
    fn least(&self) -> (&'static str, f64) {
        let count = self.answers.len().max(1) as f64;
        let share = |i: usize| self.answers.iter().filter(|off| off[i] <= 2.0).count() as f64 / count;
        let names = ["deflection", "pitch", "y", "z", "radius"];
        let shares = names.into_iter().enumerate().map(|(i, name)| (name, 100.0 * share(i)));
        shares.min_by(|(_, a), (_, b)| a.total_cmp(b)).unwrap_or(("", 0.0))
    }

    fn share(&self) -> f64 {
        self.held_count() as f64 / (5 * self.answers.len()).max(1) as f64
    }

    fn worst(&self) -> f64 {
        self.answers.iter().flatten().copied().fold(0.0, f64::max)
    }

    fn worst_seed(&self) -> usize {
        let largest = |off: &[f64; 5]| off.iter().copied().fold(0.0, f64::max);
        let worst = self.answers.iter().enumerate().max_by(|(_, a), (_, b)| largest(a).total_cmp(&largest(b)));
        worst.map_or(0, |(index, _)| index)
    }

    /// The fault of the kind, if it has one.
    fn fault(&self, due: Due) -> Option<String> {
        if (self.answers.len() as f64) < ANSWERED_MIN * self.scans_count as f64 {
            return Some(format!("refused: {:?}", self.refused));
        }
        if due == Due::Undeclared {
            return None;
        }
        if self.worst() > UNCERTAINTIES_MAX {
            return Some(format!("off by {:.1} u (answer {})", self.worst(), self.worst_seed()));
        }
        let trials = (INDEPENDENT * self.answers.len() as f64).round() as u64;
        let held = (self.share() * trials as f64).round() as u64;
        let below = |share: f64, held: u64| Binomial::new(share, trials).map_or(1.0, |held_by| held_by.cdf(held));
        let [low, high] = HELD;
        let too_many = held > 0 && due == Due::Held && 1.0 - below(high, held - 1) < CHANCE;
        (below(low, held) < CHANCE || too_many).then(|| format!("{:.1} % within U", 100.0 * self.share()))
    }
}

impl Kind {
    fn measured(&self, seed: u64) -> Result<Compared, &'static str> {
        let mut scene = scene(seed);
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        chance.set_stream(200);
        (self.change)(&mut scene, &mut chance);
        let Scene { part, upload, type_b, nominal_radius_mm } = scene;
        upload.measured(&part, &Settings { type_b, nominal_radius_mm, ..Settings::default() })
    }
}

#[test]
fn reported_faults_are_within_the_stated_uncertainty() {
    let seeds_count = count("COAXIS_SEEDS", SEEDS);
    println!("| kind | answered | within U | % | least often, % | worst, u |");
    let mut faults = Vec::new();
    for kind in kinds() {
        let tally = Tally::of(&kind, seeds_count);
        let (answered, held) = (tally.answers.len(), tally.held_count());
        let (numbers, share, worst) = (5 * answered, 100.0 * tally.share(), tally.worst());
        let (name, least) = tally.least();
        println!(
            "| {} | {answered} of {seeds_count} | {held} of {numbers} | {share:.1} | {name} {least:.1} | {worst:.1} |",
            kind.name
        );
        if !tally.refused.is_empty() {
            println!("refused as {:?}", tally.refused);
        }
        faults.extend(tally.fault(kind.due).map(|fault| format!("{}: {fault}", kind.name)));
    }
    assert!(faults.is_empty(), "{faults:#?}");
}
