//! Synthetic clouds with known truth, and invariance under unit, position, direction and threads.

use super::*;
use nalgebra::{Rotation3, Unit};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

type V = Vector3<f64>;

fn direction(chance: &mut ChaCha8Rng) -> V {
    V::from_fn(|_, _| StandardNormal.sample(chance)).normalize()
}

/// A piece of a cylinder with noise in all directions.
struct Part {
    middle: V,
    direction: V,
    radius: f64,
    length: f64,
    arc: f64,
    sigma: f64,
}

impl Part {
    /// Radius 1 to 1000, arc 40° to 360°, length 0.3 to 20 radii, noise up to 2 % of the radius.
    fn random(chance: &mut ChaCha8Rng) -> Self {
        let radius = 10_f64.powf(chance.random_range(0.0..3.0));
        Self {
            middle: direction(chance) * radius * chance.random_range(0.0..5.0),
            direction: direction(chance),
            radius,
            length: radius * 0.3 * (20.0 / 0.3_f64).powf(chance.random_range(0.0..1.0)),
            arc: chance.random_range(40.0..360.0_f64).to_radians(),
            sigma: radius * 10_f64.powf(chance.random_range(-5.0..-1.7)),
        }
    }

    fn size(&self) -> f64 {
        self.length.max(2.0 * self.radius)
    }

    /// The point of the surface at these shares of the arc and the length.
    fn at(&self, turn: f64, along: f64) -> V {
        let [e, f] = surface::basis(&self.direction);
        let (sin, cos) = (turn * self.arc).sin_cos();
        self.middle + (e * cos + f * sin) * self.radius + self.direction * (self.length * (along - 0.5))
    }

    fn points(&self, count: usize, chance: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
        let point = |_| {
            let noise = V::from_fn(|_, _| StandardNormal.sample(chance)) * self.sigma;
            (self.at(chance.random_range(0.0..1.0), chance.random_range(0.0..1.0)) + noise).into()
        };
        (0..count).map(point).collect()
    }

    /// The largest deviation of the detected surface from the true one at the points, in standard deviations of their noise.
    fn off(&self, found: &Detected) -> f64 {
        let found =
            surface::Cylinder { point: found.point.into(), direction: found.direction.into(), radius: found.radius };
        let squared = |i: i32| {
            let (turn, along) = (f64::from(i % 10) / 9.0, f64::from(i / 10) / 9.0);
            found.distance(&self.at(turn, along)).powi(2)
        };
        ((0..100).map(squared).sum::<f64>() / 100.0).sqrt() / self.sigma
    }
}

/// A plane that cuts the part, and points all over its background.
fn foreign(part: &Part, count: usize, chance: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    let normal = direction(chance);
    let [e, f] = surface::basis(&normal);
    let through = part.middle + normal * part.radius * chance.random_range(-1.5..1.5);
    let mut coordinate = || part.size() * chance.random_range(-0.7..0.7);
    let on_plane = |_| (through + e * coordinate() + f * coordinate()).into();
    let mut points: Vec<[f64; 3]> = (0..count / 2).map(on_plane).collect();
    points.extend((0..count / 2).map(|_| <[f64; 3]>::from(part.middle + V::from_fn(|_, _| coordinate()))));
    points
}

fn one() -> Request {
    Request::default()
}

/// Half of the points lie on a plane through the part and scattered around it. The standard deviation of a surface fitted to 1500
/// points is 0.06 of theirs; a start is good within 1.
#[test]
fn a_cylinder_in_any_direction_is_found_among_as_many_background_points() {
    for seed in 0..60 {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let part = Part::random(&mut chance);
        let mut points = part.points(1500, &mut chance);
        points.extend(foreign(&part, 1500, &mut chance));
        let found = detect(&points, &one());
        let off = found.first().map(|found| part.off(found));
        assert!(off.is_some_and(|off| off < 1.0), "seed {seed}: {off:?} {found:?}");
    }
}

#[test]
fn few_points_are_enough_if_all_of_them_lie_on_the_cylinder() {
    for seed in 0..40 {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let part = Part { arc: TAU, length: 40.0, radius: 10.0, sigma: 0.01, ..Part::random(&mut chance) };
        let found = detect(&part.points(14, &mut chance), &one());
        // 14 points determine 5 parameters: away from the points the surface is accurate to a few standard deviations.
        let off = found.first().map(|found| part.off(found));
        assert!(off.is_some_and(|off| off < 4.0), "seed {seed}: {off:?} {found:?}");
    }
}

fn scene(seed: u64) -> (Part, Vec<[f64; 3]>) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let part = Part::random(&mut chance);
    let mut points = part.points(1500, &mut chance);
    points.extend(foreign(&part, 500, &mut chance));
    (part, points)
}

#[test]
fn the_result_does_not_depend_on_the_unit() {
    for (seed, scale) in [(1, 1e3), (2, 1e-3), (3, 1e-3), (4, 25.4)] {
        let (_, points) = scene(seed);
        let scaled: Vec<[f64; 3]> = points.iter().map(|point| point.map(|v| v * scale)).collect();
        let (plain, scaled) = (detect(&points, &one()), detect(&scaled, &one()));
        assert_eq!((plain.len(), scaled.len()), (1, 1));
        let (plain, scaled) = (plain[0], scaled[0]);
        let near = |a: f64, b: f64| (a * scale - b).abs() < 1e-9 * (plain.radius * scale);
        assert!(near(plain.radius, scaled.radius) && near(plain.sigma, scaled.sigma), "{plain:?} {scaled:?}");
        assert!(plain.point.iter().zip(scaled.point).all(|(a, b)| near(*a, b)), "{plain:?} {scaled:?}");
        assert!(plain.direction.iter().zip(scaled.direction).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}

/// The sample of a rotated and moved cloud is the same, so the results differ by less than the steps at which settling ends.
#[test]
fn the_result_is_independent_of_direction_and_position() {
    for seed in 1..9 {
        let (part, points) = scene(seed);
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(direction(&mut chance)), 2.0);
        let shift = direction(&mut chance) * 10.0 * part.size();
        let turned: Vec<[f64; 3]> = points.iter().map(|point| (turn * V::from(*point) + shift).into()).collect();
        let (plain, turned) = (detect(&points, &one())[0], detect(&turned, &one())[0]);
        let back = Detected {
            point: (turn.inverse() * (V::from(turned.point) - shift)).into(),
            direction: (turn.inverse() * V::from(turned.direction)).into(),
            ..turned
        };
        let difference = part.off(&plain) - part.off(&back);
        assert!(difference.abs() < 0.02 && (plain.radius - back.radius).abs() < 0.05 * part.sigma, "seed {seed}");
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let (_, points) = scene(5);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| detect(&points, &one()))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn planes_and_bent_planes_are_not_reported_as_cylinders() {
    for bend in [0.0, 0.01, 0.02] {
        let mut chance = ChaCha8Rng::seed_from_u64(7);
        let floor = (0..4000).map(|_| {
            let [x, y] = [0, 1].map(|_| chance.random_range(-100.0..100.0_f64));
            let noise: f64 = StandardNormal.sample(&mut chance);
            // Sagitta of an arc of 200 mm that is bent by `bend` times its length, at most 9° of a circle.
            [x, y, 200.0 * bend * (x / 100.0).powi(2) + 0.3 * noise]
        });
        let mut points: Vec<[f64; 3]> = floor.collect();
        let wall: Vec<[f64; 3]> = points.iter().map(|[x, y, z]| [*x, 100.0 + z, y + 100.0]).collect();
        points.extend(wall);
        let found = detect(&points, &Request { most: 3, ..one() });
        assert!(found.is_empty(), "bend {bend}: {found:?}");
    }
}

#[test]
fn a_nominal_radius_chooses_among_cylinders() {
    let mut chance = ChaCha8Rng::seed_from_u64(11);
    let base = Part { radius: 20.0, length: 150.0, arc: 2.5, sigma: 0.05, ..Part::random(&mut chance) };
    let other = Part { radius: 26.0, middle: base.middle + V::new(60.0, 0.0, 0.0), ..Part::random(&mut chance) };
    let other = Part { length: 150.0, arc: 3.0, sigma: 0.05, ..other };
    let mut points = base.points(600, &mut chance);
    points.extend(other.points(5000, &mut chance));
    let both = detect(&points, &Request { most: 2, ..one() });
    assert!(other.off(&both[0]) < 1.0 && base.off(&both[1]) < 1.0, "{both:?}");
    let chosen = detect(&points, &Request { nominal_radius_mm: Some(20.2), ..one() });
    assert!(chosen.len() == 1 && base.off(&chosen[0]) < 1.0, "{chosen:?}");
    assert!(detect(&points, &Request { nominal_radius_mm: Some(23.0), ..one() }).is_empty());
}

#[test]
fn a_cone_of_directions_chooses_among_cylinders() {
    let mut chance = ChaCha8Rng::seed_from_u64(12);
    let along =
        |direction: V, middle: V| Part { middle, direction, radius: 10.0, length: 100.0, arc: 3.0, sigma: 0.05 };
    let (upright, lying) = (along(V::z(), V::zeros()), along(V::x(), V::new(0.0, 40.0, 0.0)));
    let mut points = upright.points(800, &mut chance);
    points.extend(lying.points(2000, &mut chance));
    let found = detect(&points, &Request { along: Some(([0.1, 0.0, -1.0], 0.2)), ..one() });
    assert!(found.len() == 1 && upright.off(&found[0]) < 1.0, "{found:?}");
}

#[test]
fn a_continued_detection_finds_the_same_cylinders_as_a_new_one() {
    let mut chance = ChaCha8Rng::seed_from_u64(13);
    let along =
        |direction: V, middle: V| Part { middle, direction, radius: 10.0, length: 100.0, arc: 3.0, sigma: 0.05 };
    let mut points = along(V::x(), V::zeros()).points(2000, &mut chance);
    points.extend(along(V::z(), V::new(0.0, 40.0, 0.0)).points(1200, &mut chance));
    points.extend(along(V::y(), V::new(0.0, -80.0, 60.0)).points(800, &mut chance));
    let mut detection = Detection::of(points.len(), |place| points.get(place).copied(), None, 0.02).expect("points");
    for (direction, most) in [(None, 1), (Some(([0.0, 0.0, 1.0], 0.2)), 1), (None, 3), (None, 2), (None, 8)] {
        let found = detection.cylinders(direction, most);
        assert_eq!(found, detect(&points, &Request { along: direction, most, ..one() }));
        assert_eq!(found.len(), most.min(3));
    }
}

#[test]
fn any_points_give_finite_results() {
    let line: Vec<[f64; 3]> = (0..50).map(|i| [f64::from(i), 2.0 * f64::from(i), 0.0]).collect();
    let lattice: Vec<[f64; 3]> = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30), 0.0]).collect();
    let mut twice = vec![[1.0, 2.0, 3.0]; 400];
    twice.extend(vec![[4.0, 5.0, 6.0]; 400]);
    let extreme: Vec<[f64; 3]> = lattice.iter().map(|point| point.map(|v| v * 1e306)).collect();
    let tiny: Vec<[f64; 3]> = lattice.iter().map(|point| point.map(|v| v * 1e-310)).collect();
    let mixed: Vec<[f64; 3]> = lattice.iter().map(|[x, y, _]| [*x, y / (x - 3.0), f64::NAN.max(*y)]).collect();
    let few = lattice.get(..5).unwrap_or_default().to_vec();
    for points in [line, lattice, twice, extreme, tiny, mixed, few, Vec::new()] {
        for request in [
            one(),
            Request { most: 0, ..one() },
            Request { nominal_radius_mm: Some(f64::NAN), most: usize::MAX, ..one() },
            Request { nominal_radius_mm: Some(-1.0), along: Some(([0.0; 3], f64::NAN)), ..one() },
        ] {
            let found = detect(&points, &request);
            assert!(found.iter().all(|found| found.radius.is_finite() && found.sigma.is_finite()), "{found:?}");
        }
    }
}
