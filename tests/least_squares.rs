//! The least-squares cylinder on reference sets with published results, its covariance compared with simulations, and
//! points that do not determine a cylinder.

#![expect(
    clippy::expect_used,
    clippy::indexing_slicing,
    clippy::panic,
    clippy::print_stdout,
    reason = "a panic fails the test as intended, and a skipped test is reported"
)]

use coaxis::estimation::{GaussianCylinder, LeastSquaresError, basis, least_squares_cylinder};
use coaxis::scan::Cloud;
use coaxis::scan::decode::{FormatClaims, Limits, Request, decode, find_format};
use nalgebra::{Matrix5, Rotation3, Unit, UnitQuaternion, Vector3, Vector5};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::fs;
use std::path::Path;

/// NIST states its results with 20 digits, calculated in more than double precision from coordinates of 5 decimals.
const DIRECTION_MAX_RAD: f64 = 1e-8;
/// Relative to the size of the set, the distance of its farthest point from the centroid.
const LENGTH_MAX: f64 = 1e-7;
const MOTIONS: usize = 20;

/// The points of a file, read through the interface of the library.
fn points_of(path: &Path) -> Vec<[f64; 3]> {
    let bytes = fs::read(path).expect("the file is there");
    let name = path.display().to_string();
    let claims = FormatClaims { file_name: Some(&name), ..FormatClaims::default() };
    let format = find_format(&claims, bytes.get(..512).unwrap_or(&bytes)).expect("known");
    let limits = Limits::default();
    let cloud = decode(format, &mut bytes.as_slice(), &Request::new(&limits));
    points_in(&cloud.unwrap_or_else(|error| panic!("{name}: {error}")))
}

fn points_in(cloud: &Cloud) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for stripe in &cloud.stripes {
        for index in points.len()..stripe.end {
            let [y, z] = cloud.columns.get(index).expect("a point");
            points.push([stripe.x, y, z]);
        }
    }
    points
}

fn centroid(points: &[[f64; 3]]) -> Vector3<f64> {
    points.iter().map(|point| Vector3::from(*point)).sum::<Vector3<f64>>() / points.len() as f64
}

/// A published result: any point of the axis, direction of length one, radius.
#[derive(Clone, Copy)]
struct Published {
    point: Vector3<f64>,
    direction: Vector3<f64>,
    radius: f64,
}

impl Published {
    /// Errors of direction (rad), of the point nearest to the centroid and of the radius (both over the size of the set).
    fn errors(&self, points: &[[f64; 3]], found: &GaussianCylinder) -> [f64; 3] {
        let centroid = centroid(points);
        let size = points.iter().map(|point| (Vector3::from(*point) - centroid).norm()).fold(0.0, f64::max);
        let nearest = self.point + self.direction * self.direction.dot(&(centroid - self.point));
        [
            self.direction.cross(&Vector3::from(found.direction)).norm(),
            (nearest - Vector3::from(found.point)).norm() / size,
            (self.radius - found.radius).abs() / size,
        ]
    }
}

fn written(errors: &[f64; 3]) -> String {
    errors.map(|error| format!("{error:.1e}")).join(", ")
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

fn random_direction(random: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(random)).normalize()
}

fn random_rotation(random: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let axis = Unit::new_normalize(random_direction(random));
    UnitQuaternion::from_axis_angle(&axis, random.random_range(0.0..std::f64::consts::PI))
}

/// (points, published result) of one of NIST's sets.
fn nist(folder: &Path, number: usize) -> (Vec<[f64; 3]>, Published) {
    let fit = fs::read_to_string(folder.join(format!("cyl{number}.fit"))).expect("a result");
    let fit: Vec<f64> = fit.split_whitespace().map(|word| word.parse().expect("a number")).collect();
    let published = Published {
        point: Vector3::new(fit[0], fit[1], fit[2]),
        direction: Vector3::new(fit[3], fit[4], fit[5]).normalize(),
        radius: fit[6] / 2.0,
    };
    (points_of(&folder.join(format!("cyl{number}.ds"))), published)
}

#[test]
fn the_reference_sets_of_nist_give_the_published_cylinders_after_any_motion() {
    let Some(folder) = crate::real::outside("real/nist-cylinders") else { return };
    let mut worst = [[0.0_f64; 3]; 2];
    for number in 1..=30 {
        let (points, published) = nist(&folder, number);
        let mut random = ChaCha8Rng::seed_from_u64(number as u64);
        for motion in 0..=MOTIONS {
            // The first motion is the identity; the sizes are from a hundredth to a hundredfold, the shifts
            // some sizes of the set.
            let (turn, shift, scale) = if motion == 0 {
                (UnitQuaternion::identity(), Vector3::zeros(), 1.0)
            } else {
                let scale = 10.0_f64.powf(random.random_range(-2.0..2.0));
                let shift = Vector3::from_fn(|_, _| random.random_range(-1000.0..1000.0));
                (random_rotation(&mut random), shift, scale)
            };
            let moved = |point: Vector3<f64>| turn * point * scale + shift;
            let points: Vec<[f64; 3]> = points.iter().map(|point| moved(Vector3::from(*point)).into()).collect();
            let published = Published {
                point: moved(published.point),
                direction: turn * published.direction,
                radius: published.radius * scale,
            };
            let found = least_squares_cylinder(&points).unwrap_or_else(|error| panic!("cyl{number}: {error}"));
            let errors = published.errors(&points, &found);
            let limits = [DIRECTION_MAX_RAD, LENGTH_MAX, LENGTH_MAX];
            assert!(errors.iter().zip(limits).all(|(error, limit)| *error < limit), "cyl{number}: {errors:?}");
            for (most, error) in worst[usize::from(motion > 0)].iter_mut().zip(errors) {
                *most = most.max(error);
            }
        }
    }
    let [still, moved] = worst;
    println!("worst errors of 30 sets, direction rad, position and radius over the size of the set:");
    println!("as published {}, moved {}", written(&still), written(&moved));
}

#[test]
fn other_programs_find_the_same_cylinders() {
    let Some(folder) = crate::real::outside("reference") else { return };
    let expected: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.join("expected.json")).expect("results")).expect("JSON");
    for (name, point, radius, sigma) in
        [("tracker8.xyz", "point_mm", "radius_mm", "sigma_mm"), ("cylinder20.xyz", "point", "radius", "sigma")]
    {
        let points = points_of(&folder.join(name));
        let found = least_squares_cylinder(&points).expect("a cylinder");
        let second = &expected[name]["second_opinion"];
        let vector =
            |value: &serde_json::Value| Vector3::from_fn(|index, _| value[index].as_f64().expect("a component"));
        let published = Published {
            point: vector(&second[point]),
            direction: vector(&second["direction"]).normalize(),
            radius: second[radius].as_f64().expect("a radius"),
        };
        let errors = published.errors(&points, &found);
        println!("{name}: {}", written(&errors));
        // The results are given with 9 to 12 digits.
        assert!(errors.iter().all(|error| *error < 1e-9), "{name}: {errors:?}");
        assert!((found.sigma / second[sigma].as_f64().expect("sigma") - 1.0).abs() < 1e-6, "{name}: {}", found.sigma);
        let [value, tolerance] = [0, 1].map(|index| expected[name][radius][index].as_f64().expect("a number"));
        assert!((found.radius - value).abs() <= tolerance, "{name}: {}", found.radius);
    }
}

#[test]
fn files_that_begin_with_their_number_of_points_are_measured() {
    for name in ["csv_count_first.xyz", "csv_pts.pts"] {
        let points = points_of(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/field").join(name));
        assert_eq!(points.len(), 1600, "{name}");
        let found = least_squares_cylinder(&points).expect("a cylinder");
        let direction = Vector3::new(1.0, 0.8_f64.to_radians().tan(), 1.1_f64.to_radians().tan()).normalize();
        let truth = Published { point: Vector3::new(0.0, 3.0, -7.0), direction, radius: 50.0 };
        let errors = deviation(&found, &points, &truth);
        for (error, variance) in errors.iter().zip(Matrix5::from(found.covariance).diagonal().iter()) {
            // 5 standard uncertainties are exceeded once in two million times.
            assert!(error.abs() < 5.0 * variance.sqrt(), "{name}: {errors}");
        }
    }
}

/// Deviation of a cylinder from the truth, in the parameters of its covariance.
fn deviation(found: &GaussianCylinder, points: &[[f64; 3]], truth: &Published) -> Vector5<f64> {
    let [first, second] = basis(found.direction).map(Vector3::from);
    let direction = Vector3::from(found.direction);
    let sense = direction.dot(&truth.direction).signum();
    let nearest = truth.point + truth.direction * truth.direction.dot(&(centroid(points) - truth.point));
    let shift = Vector3::from(found.point) - nearest;
    // The direction found is perpendicular to both vectors, so the difference from the truth has the components of −truth.
    let tilt = -truth.direction * sense;
    Vector5::new(
        tilt.dot(&first),
        tilt.dot(&second),
        shift.dot(&first),
        shift.dot(&second),
        found.radius - truth.radius,
    )
}

#[test]
fn the_covariance_is_that_of_repeated_measurements() {
    const REPEATS: usize = 2000;
    const COUNT: usize = 60;
    const NOISE: f64 = 0.02;
    let mut random = ChaCha8Rng::seed_from_u64(20);
    let truth = Published {
        point: Vector3::from_fn(|_, _| random.random_range(-200.0..200.0)),
        direction: random_direction(&mut random),
        radius: 25.0,
    };
    let [first, second] = basis(truth.direction.into()).map(Vector3::from);
    // The same positions in every repetition: half of the circumference, 80 mm long.
    let exact: Vec<(Vector3<f64>, Vector3<f64>)> = (0..COUNT)
        .map(|_| {
            let (sin, cos) = random.random_range(0.0..std::f64::consts::PI).sin_cos();
            let out = first * cos + second * sin;
            (truth.point + truth.direction * random.random_range(-40.0..40.0) + out * truth.radius, out)
        })
        .collect();
    let (mut empirical, mut stated) = (Matrix5::<f64>::zeros(), Matrix5::<f64>::zeros());
    let (mut variance, mut mahalanobis) = (0.0, 0.0);
    for _ in 0..REPEATS {
        // In all directions: noise along the surface does not change the distance.
        let shake = |random: &mut ChaCha8Rng| Vector3::from_fn(|_, _| NOISE * normal(random));
        let points: Vec<[f64; 3]> = exact.iter().map(|(point, _)| (point + shake(&mut random)).into()).collect();
        let found = least_squares_cylinder(&points).expect("a cylinder");
        let error = deviation(&found, &points, &truth);
        let covariance = Matrix5::from(found.covariance);
        empirical += error * error.transpose() / REPEATS as f64;
        stated += covariance / REPEATS as f64;
        variance += found.sigma.powi(2) / REPEATS as f64;
        mahalanobis += error.dot(&covariance.cholesky().expect("definite").solve(&error)) / REPEATS as f64;
    }
    // A variance from 2000 values varies by √(2/2000) = 3.2 %, a covariance, relative to the root of the product of the variances,
    // by √((1 + ρ²)/2000); 4.5 of these standard deviations are exceeded once in ten thousand runs of these 15 numbers.
    let allowed = |correlation: f64| 4.5 * ((1.0 + correlation.powi(2)) / REPEATS as f64).sqrt();
    let mut worst = 0.0_f64;
    for row in 0..5 {
        for column in 0..=row {
            let unit = (stated[(row, row)] * stated[(column, column)]).sqrt();
            let difference = (empirical[(row, column)] - stated[(row, column)]) / unit;
            assert!(difference.abs() < allowed(stated[(row, column)] / unit), "{row}, {column}: {difference}");
            worst = worst.max(difference.abs());
        }
    }
    // σ² of 55 degrees of freedom varies by √(2/55/2000) = 0.43 %, and σ²/R² of it, 6e-7, is bias.
    assert!((variance / NOISE.powi(2) - 1.0).abs() < 4.5 * 0.0043, "{}", variance.sqrt());
    // Five squares divided by a variance of 55 degrees of freedom: 5 F(5, 55), with mean 5 · 55/53 and standard deviation 3.5.
    assert!((mahalanobis - 5.0 * 55.0 / 53.0).abs() < 4.5 * 3.5 / (REPEATS as f64).sqrt(), "{mahalanobis}");
    println!("largest difference of 15 covariances {:.1} % of the standard uncertainties", worst * 100.0);
}

/// Points at (angle, position along the axis, distance from it) of a cylinder with an arbitrary pose.
fn somewhere(places: &[(f64, f64, f64)]) -> Vec<[f64; 3]> {
    let direction = Vector3::new(0.3, -0.5, 0.8).normalize();
    let [first, second] = basis(direction.into()).map(Vector3::from);
    let origin = Vector3::new(120.0, -30.0, 900.0);
    let place = |&(angle, along, radius): &(f64, f64, f64)| {
        (origin + direction * along + (first * angle.cos() + second * angle.sin()) * radius).into()
    };
    places.iter().map(place).collect()
}

#[test]
fn points_that_determine_no_cylinder_are_refused_with_the_reason() {
    let error = |places: &[(f64, f64, f64)]| least_squares_cylinder(&somewhere(places)).expect_err("degenerate");
    let turn = |index: usize| index as f64 * 0.6;
    assert!(matches!(least_squares_cylinder(&[]), Err(LeastSquaresError::TooFewPoints { distinct_count: 0, .. })));
    assert!(matches!(error(&[(0.0, 0.0, 1.0); 50]), LeastSquaresError::TooFewPoints { distinct_count: 1, .. }));
    let five: Vec<_> = (0..50).map(|index| (turn(index % 5), (index % 5 % 2) as f64, 5.0)).collect();
    assert!(matches!(error(&five), LeastSquaresError::TooFewPoints { distinct_count: 5, points_count: 50 }));
    for count in [20, 5000] {
        let line: Vec<_> = (0..count).map(|index| (0.4, turn(index), 5.0)).collect();
        assert!(matches!(error(&line), LeastSquaresError::Collinear { .. }), "{}", error(&line));
        let circle: Vec<_> = (0..count).map(|index| (turn(index), 7.0, 5.0)).collect();
        assert!(matches!(error(&circle), LeastSquaresError::Coplanar { .. }), "{}", error(&circle));
        // A plane along the axis.
        let plane: Vec<_> = (0..count).map(|index| (0.4, turn(index * index % 17), index as f64)).collect();
        assert!(matches!(error(&plane), LeastSquaresError::Coplanar { .. }), "{}", error(&plane));
        // Two lines along the axis: every circle through two points fits.
        let lines: Vec<_> = (0..count).map(|index| (turn(index % 2), turn(index), 5.0)).collect();
        assert!(matches!(error(&lines), LeastSquaresError::Coplanar { .. }), "{}", error(&lines));
        // On this curve z cos φ equals 2 sin φ: a tilt towards one side and a shift towards the other cancel each other.
        let angle = |index: usize| (index as f64 / count as f64 - 0.5) * 2.0;
        let curve: Vec<_> = (0..count).map(|index| (angle(index), 2.0 * angle(index).tan(), 5.0)).collect();
        assert!(matches!(error(&curve), LeastSquaresError::Undetermined { .. }), "{}", error(&curve));
    }
    // The corners of a cube lie on three cylinders.
    let quarter = std::f64::consts::FRAC_PI_2;
    let cube: Vec<_> =
        (0..8).map(|index| ((index % 4) as f64 * quarter, (index / 4) as f64 * 2.0_f64.sqrt(), 1.0)).collect();
    assert!(matches!(error(&cube), LeastSquaresError::Ambiguous { cylinders_count: 3, .. }), "{}", error(&cube));
    let mut points = somewhere(&[(0.0, 1.0, 2.0), (1.0, 2.0, 2.0), (2.0, 1.0, 2.0)]);
    for bad in [f64::NAN, f64::INFINITY, -1e200] {
        points[1][2] = bad;
        assert_eq!(least_squares_cylinder(&points), Err(LeastSquaresError::Coordinate { index: 1 }));
    }
    for (error, advice) in [
        (error(&five), "5 different points among 50, a cylinder with its uncertainty needs 6; measure more"),
        (error(&cube), "3 different cylinders fit the 8 points equally well; measure more points"),
    ] {
        assert!(error.to_string().contains(advice), "{error}");
    }
}

#[test]
fn any_size_and_any_place_that_numbers_can_express_is_measured() {
    let mut random = ChaCha8Rng::seed_from_u64(60);
    let places: Vec<(f64, f64, f64)> = (0..30)
        .map(|_| (random.random_range(0.0..6.0), random.random_range(-2.0..2.0), random.random_range(0.99..1.01)))
        .collect();
    let unit = somewhere(&places);
    let expected = least_squares_cylinder(&unit).expect("a cylinder");
    for scale in [1e-290, 1e-9, 1e9, 1e96] {
        let scaled: Vec<[f64; 3]> = unit.iter().map(|point| point.map(|value| value * scale)).collect();
        let found = least_squares_cylinder(&scaled).expect("a cylinder");
        assert!((found.radius / (expected.radius * scale) - 1.0).abs() < 1e-9, "{scale}: {}", found.radius);
        assert!((found.sigma / (expected.sigma * scale) - 1.0).abs() < 1e-9, "{scale}: {}", found.sigma);
    }
    // If coordinates are rounded to a hundredth of the radius, this is the remaining accuracy; for coarser rounding, an error.
    for far in [1e13, 1e15, 1e17, 1e99] {
        let shifted: Vec<[f64; 3]> = unit.iter().map(|point| point.map(|value| value + far)).collect();
        if let Ok(found) = least_squares_cylinder(&shifted) {
            let numbers = [found.radius, found.sigma].into_iter().chain(found.point).chain(found.direction);
            assert!(numbers.chain(found.covariance.into_iter().flatten()).all(f64::is_finite), "{far}: {found:?}");
        }
    }
}

#[test]
fn few_random_points_give_the_same_cylinder_after_every_rotation() {
    // Such points have several minima. The initial directions of the search are fixed while the points are rotated, so that
    // a search which misses the global minimum misses it for some rotations only.
    let mut random = ChaCha8Rng::seed_from_u64(50);
    for count in [6, 7, 9, 15] {
        for set in 0..10 {
            let points: Vec<Vector3<f64>> =
                (0..count).map(|_| Vector3::from_fn(|_, _| random.random_range(-1.0..1.0))).collect();
            let sigma = |turn: &UnitQuaternion<f64>| {
                let turned: Vec<[f64; 3]> = points.iter().map(|point| (turn * point).into()).collect();
                least_squares_cylinder(&turned).expect("a cylinder").sigma
            };
            let first = sigma(&UnitQuaternion::identity());
            for _ in 0..5 {
                let other = sigma(&random_rotation(&mut random));
                // The sum of squares is flat at a minimum, so only its rounding remains.
                assert!((other - first).abs() < 1e-9, "set {set} of {count}: {first} and {other}");
            }
        }
    }
}

#[test]
fn exact_points_give_the_exact_cylinder_whatever_its_shape() {
    let mut random = ChaCha8Rng::seed_from_u64(30);
    // (radius, length, arc rad): a wire, a ring, a flat patch, a long patch, a complete cylinder; mm.
    for (radius, length, arc) in
        [(0.1_f64, 1000.0_f64, 6.2_f64), (100.0, 0.5, 6.2), (1000.0, 50.0, 0.1), (50.0, 2000.0, 0.8), (5.0, 10.0, 6.2)]
    {
        for _ in 0..20 {
            let truth = Published {
                point: Vector3::from_fn(|_, _| random.random_range(-10.0..10.0)) * length,
                direction: random_direction(&mut random),
                radius,
            };
            let [first, second] = basis(truth.direction.into()).map(Vector3::from);
            let points: Vec<[f64; 3]> = (0..200)
                .map(|_| {
                    let (sin, cos) = random.random_range(0.0..arc).sin_cos();
                    let along = random.random_range(-0.5..0.5) * length;
                    (truth.point + truth.direction * along + (first * cos + second * sin) * radius).into()
                })
                .collect();
            let found = least_squares_cylinder(&points).expect("a cylinder");
            // Only the rounding of the coordinates remains, 2⁻⁵³ of up to 17 lengths or radii in each.
            let rounding = f64::EPSILON * 17.0 * (length + radius);
            let stated = Matrix5::from(found.covariance) / found.sigma.powi(2);
            let errors = deviation(&found, &points, &truth);
            for (error, variance) in errors.iter().zip(stated.diagonal().iter()) {
                assert!(error.abs() < 5.0 * rounding * variance.sqrt(), "{radius} {length} {arc}: {errors}");
            }
            assert!(found.sigma < rounding, "{radius} {length} {arc}: {}", found.sigma);
        }
    }
}

#[test]
fn a_large_set_has_the_same_bits_with_any_number_of_threads_and_its_order_does_not_bias_the_sample() {
    let mut random = ChaCha8Rng::seed_from_u64(40);
    // 300 profiles of 1000 points: a sample with a constant stride would take a single column.
    let turn = Rotation3::from_axis_angle(&Unit::new_normalize(Vector3::new(1.0, 2.0, 3.0)), 0.7);
    let points: Vec<[f64; 3]> = (0..300_000)
        .map(|index| {
            let (sin, cos) = ((index % 1000) as f64 * 0.002).sin_cos();
            let radius = 80.0 + 0.05 * normal(&mut random);
            (turn * Vector3::new((index / 1000) as f64, radius * cos, radius * sin)).into()
        })
        .collect();
    let measure = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| least_squares_cylinder(&points)).expect("a cylinder")
    };
    let one = measure(1);
    assert_eq!(one, measure(3));
    let truth = Published { point: Vector3::zeros(), direction: turn * Vector3::x(), radius: 80.0 };
    let errors = deviation(&one, &points, &truth);
    for (error, variance) in errors.iter().zip(Matrix5::from(one.covariance).diagonal().iter()) {
        assert!(error.abs() < 5.0 * variance.sqrt(), "{errors}");
    }
}
