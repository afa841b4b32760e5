//! Invariants of every estimation method: exact data give exact results, and moving, rotating, scaling or shuffling the input
//! transforms the output accordingly. The truth is the synthetic part; no value is taken from the output of the program.

#![expect(clippy::expect_used, clippy::panic, reason = "a test may fail")]

use coaxis::estimation::{Estimate, Method, Outcome, Pose, Progress, Reason, Refusal, Settings, estimate};
use coaxis::geometry::AxisLine;
use coaxis::scan::synthetic::{Part, make};
use coaxis::scan::{Columns, Scan, Station};
use proptest::prelude::*;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_distr::Distribution;

const ROBUST: [Method; 2] = [Method::Cylinder, Method::SectionLine];

fn any_of(methods: &'static [Method]) -> impl Strategy<Value = Method> {
    proptest::sample::select(methods)
}

fn by(method: Method) -> Settings {
    Settings { method, ..Settings::default() }
}

fn small(seed: u64) -> Part {
    Part { profiles_count: 24, points_count: 160, length_mm: 300.0, ..Part::with_interference(seed) }
}

fn run(scan: &Scan, settings: &Settings) -> Estimate {
    estimate(scan, settings, &Progress::default())
}

fn pose(scan: &Scan, settings: &Settings) -> Pose {
    match run(scan, settings).outcome {
        Outcome::Accepted(pose) => *pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

/// The scan with every point (x, y, z) replaced by `change` of it; the new x must depend only on x.
fn changed(scan: &Scan, change: impl Fn([f64; 3]) -> [f64; 3]) -> Scan {
    let (mut y, mut z, mut stations) = (Vec::new(), Vec::new(), Vec::new());
    for station in scan.stations() {
        for index in station.start..station.end {
            let [py, pz] = scan.columns().get(index).expect("in range");
            let [_, cy, cz] = change([station.x, py, pz]);
            y.push(cy);
            z.push(cz);
        }
        stations.push(Station { x: change([station.x, 0.0, 0.0])[0], ..*station });
    }
    Scan::new(stations, Columns::F64 { y, z }, "changed".to_owned()).expect("valid")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, rng_seed: proptest::test_runner::RngSeed::Fixed(7), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn exact_data_give_exact_answers(
        radius_mm in 10.0..1000.0, arc_deg in 15.0..300.0, p in -0.17..0.17, q in -0.17..0.17,
        y0 in -500.0..500.0, z0 in -500.0..500.0, x_start_mm in -2000.0..2000.0, method in any_of(&Method::ALL),
    ) {
        let part = Part {
            radius_mm, arc_deg, x_start_mm, length_mm: 400.0, noise_sigma_mm: 0.0, profiles_count: 12, points_count: 200,
            axis: AxisLine { p, q, y0, z0 }, ..Part::smooth(0)
        };
        let (scan, truth) = make(&part).expect("valid");
        let found = pose(&scan, &Settings { method, arc_min_deg: 5.0, ..Settings::default() });
        // Relative to the radius, the smallest length of the input.
        let tolerance = 1e-9 * radius_mm;
        let axis = found.on_rail().expect("near X").axis;
        let [y_ref, z_ref] = axis.at(truth.x_ref_mm);
        prop_assert!((found.radius - radius_mm).abs() < tolerance, "radius {}", found.radius - radius_mm);
        prop_assert!((y_ref - truth.y_ref_mm).abs() < tolerance, "y_ref {}", y_ref - truth.y_ref_mm);
        prop_assert!((z_ref - truth.z_ref_mm).abs() < tolerance, "z_ref {}", z_ref - truth.z_ref_mm);
        prop_assert!((axis.p - p).abs() < 1e-9 && (axis.q - q).abs() < 1e-9);
    }

    #[test]
    fn moving_the_part_moves_the_pose(seed in 0_u64..1000, dx in -3000.0..3000.0_f64, dy in -300.0..300.0_f64, dz in -300.0..300.0_f64, method in any_of(&ROBUST)) {
        let (scan, _) = make(&small(seed)).expect("valid");
        let before = pose(&scan, &by(method));
        let after = pose(&changed(&scan, |[x, y, z]| [x + dx, y + dy, z + dz]), &by(method));
        let [y, z] = before.axis.at(before.x_ref);
        let [moved_y, moved_z] = after.axis.at(before.x_ref + dx);
        prop_assert!((moved_y - y - dy).abs() < 1e-6 && (moved_z - z - dz).abs() < 1e-6);
        prop_assert!((after.axis.p - before.axis.p).abs() < 1e-9 && (after.axis.q - before.axis.q).abs() < 1e-9);
    }

    #[test]
    fn turning_the_part_about_x_turns_the_pose(seed in 0_u64..1000, angle in 0.0..std::f64::consts::TAU, method in any_of(&ROBUST)) {
        let (scan, _) = make(&small(seed)).expect("valid");
        let (sin, cos) = angle.sin_cos();
        let turn = |[y, z]: [f64; 2]| [y * cos - z * sin, y * sin + z * cos];
        let before = pose(&scan, &by(method));
        let turned = changed(&scan, |[x, y, z]| { let [y, z] = turn([y, z]); [x, y, z] });
        let after = pose(&turned, &by(method));
        let [p, q] = turn([before.axis.p, before.axis.q]);
        let [y0, z0] = turn([before.axis.y0, before.axis.z0]);
        prop_assert!((after.axis.p - p).abs() < 1e-8 && (after.axis.q - q).abs() < 1e-8);
        prop_assert!((after.axis.y0 - y0).abs() < 1e-6 && (after.axis.z0 - z0).abs() < 1e-6);
        prop_assert!((after.radius - before.radius).abs() < 1e-6);
    }

    #[test]
    fn scaling_the_part_scales_the_pose_and_its_uncertainty(seed in 0_u64..1000, scale in 0.05..20.0_f64, method in any_of(&ROBUST)) {
        let (scan, _) = make(&small(seed)).expect("valid");
        let unscaled = Settings {
            axial_length_min_mm: Some(1.0),
            angle_uncertainty_max_deg: 1.0,
            position_uncertainty_max_mm: Some(100.0),
            ..by(method)
        };
        let settings = Settings { epsilon_mm: unscaled.epsilon_mm * scale, ..unscaled };
        let before = pose(&scan, &unscaled);
        let after = pose(&changed(&scan, |point| point.map(|v| v * scale)), &settings);
        prop_assert!((after.axis.p - before.axis.p).abs() < 1e-9 && (after.axis.q - before.axis.q).abs() < 1e-9);
        prop_assert!((after.axis.z0 / scale - before.axis.z0).abs() < 1e-6);
        let variance = |pose: &Pose| pose.uncertainty.covariance[3][3];
        prop_assert!((variance(&after) / (scale * scale * variance(&before)) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn shuffling_the_points_of_a_profile_changes_nothing(seed in 0_u64..1000) {
        let (scan, _) = make(&small(seed)).expect("valid");
        let mut order: Vec<usize> = (0..scan.columns().len()).collect();
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        for station in scan.stations() {
            order[station.start..station.end].shuffle(&mut chance);
        }
        let (y, z) = order.iter().map(|&i| scan.columns().get(i).expect("in range")).map(|[y, z]| (y, z)).unzip();
        let shuffled = Scan::new(scan.stations().to_vec(), Columns::F64 { y, z }, "shuffled".to_owned()).expect("valid");
        let (before, after) = (pose(&scan, &by(Method::SectionLine)), pose(&shuffled, &by(Method::SectionLine)));
        prop_assert!((after.axis.z0 - before.axis.z0).abs() < 1e-6 && (after.axis.q - before.axis.q).abs() < 1e-9);
        // The initial value uses every n-th point, so the scale of the weights may differ in its third digit.
        let (before, after) = (pose(&scan, &by(Method::Cylinder)), pose(&shuffled, &by(Method::Cylinder)));
        let (at_before, at_after) = (before.axis.at(before.x_ref), after.axis.at(before.x_ref));
        let [_, _, y, z, _] = before.uncertainty.budget[0].standard;
        prop_assert!((at_after[0] - at_before[0]).abs() < 0.2 * y && (at_after[1] - at_before[1]).abs() < 0.2 * z);
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let (scan, _) = make(&small(3)).expect("valid");
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| Method::ALL.map(|method| run(&scan, &by(method))))
    };
    assert_eq!(on(1), on(2));
}

fn scan_of(profiles: &[Vec<[f64; 2]>]) -> Scan {
    let (mut y, mut z, mut stations) = (Vec::new(), Vec::new(), Vec::new());
    for (index, profile) in profiles.iter().enumerate() {
        let start = y.len();
        y.extend(profile.iter().map(|p| p[0]));
        z.extend(profile.iter().map(|p| p[1]));
        stations.push(Station { x: index as f64 * 5.0, start, end: y.len() });
    }
    Scan::new(stations, Columns::F64 { y, z }, "made".to_owned()).expect("valid")
}

/// Why profiles 5 mm apart are refused.
fn refusal(profiles: &[Vec<[f64; 2]>], method: Method) -> Refusal {
    match run(&scan_of(profiles), &by(method)).outcome {
        Outcome::Refused(refusal) => refusal,
        Outcome::Accepted(pose) => panic!("accepted {pose:?}"),
    }
}

#[test]
fn points_that_do_not_determine_an_axis_are_refused_by_name() {
    let line: Vec<[f64; 2]> = (0..100).map(|i| [f64::from(i), 3.0 + 0.5 * f64::from(i)]).collect();
    let circle = |radius: f64| (0..100).map(|i| [radius * f64::from(i).sin(), radius * f64::from(i).cos()]).collect();
    for method in ROBUST {
        let code = |profiles: &[Vec<[f64; 2]>]| refusal(profiles, method).code();
        assert_eq!(code(&vec![line.clone(); 9]), "points_collinear");
        assert_eq!(code(&vec![vec![[1.0, 2.0]; 50]; 9]), "points_identical");
        assert_eq!(code(&[circle(50.0)]), "too_few_profiles");
        assert_eq!(code(&vec![vec![[1.0, 2.0], [2.0, 2.5], [3.0, 2.0]]; 9]), "too_few_valid_profiles");
        let close = Settings { axial_length_min_mm: Some(50.0), ..by(method) };
        let refused = run(&scan_of(&vec![circle(50.0); 9]), &close).outcome;
        assert_eq!(
            refused,
            Outcome::Refused(Refusal::AxialLengthTooShort { axial_length_mm: 40.0, axial_length_min_mm: 50.0 })
        );
    }
    let of_sections = |profiles: &[Vec<[f64; 2]>]| refusal(profiles, Method::SectionLine).code();
    assert_eq!(of_sections(&[circle(50.0), circle(50.0), line]), "too_few_valid_profiles");
    let cone: Vec<_> = [50.0, 60.0, 70.0, 80.0, 90.0].map(circle).to_vec();
    assert_eq!(of_sections(&cone), "sections_disagree");
    assert_eq!(refusal(&cone, Method::Cylinder).code(), "no_cylinder");
}

#[test]
fn a_profile_whose_centre_lies_beside_the_axis_is_rejected_as_off_axis() {
    let (scan, _) = make(&Part { profiles_count: 40, ..Part::smooth(1) }).expect("valid");
    let beside = scan.stations()[20];
    // The offset is large enough to be detected by the centre, and for `cylinder` small enough that the points are within ε.
    for (method, by_mm) in [(Method::SectionLine, 2.0), (Method::Cylinder, 0.065)] {
        let moved = changed(&scan, |[x, y, z]| if x == beside.x { [x, y + by_mm, z] } else { [x, y, z] });
        let profiles = run(&moved, &by(method)).profiles;
        let rejected: Vec<_> = profiles.iter().enumerate().filter_map(|(i, p)| Some((i, p.rejected?))).collect();
        assert_eq!(rejected, [(20, Reason::OffAxis)], "{method:?}");
    }
}

#[test]
fn extreme_numbers_cause_neither_a_panic_nor_a_pose_that_is_not_finite() {
    let huge =
        |scale: f64| (0..60).map(|i| [scale * f64::from(i).sin(), scale * f64::from(i).cos()]).collect::<Vec<_>>();
    for (scale, method) in
        [1e-300, 1e-12, 1e6, 1e30, 1e200, 1e308].into_iter().flat_map(|s| Method::ALL.map(|m| (s, m)))
    {
        let estimate = run(&scan_of(&vec![huge(scale); 8]), &by(method));
        if let Outcome::Accepted(pose) = estimate.outcome {
            assert!(pose.radius.is_finite() && pose.axis.direction().iter().all(|v| v.is_finite()), "{scale}");
        }
    }
}

/// (y, z) at a position (0 to 1) along a profile.
type Point<'a> = &'a mut dyn FnMut(usize, f64) -> [f64; 2];

#[test]
fn a_scan_without_a_cylinder_is_refused_by_every_robust_method() {
    let mut chance = ChaCha8Rng::seed_from_u64(5);
    let mut noise = |sigma: f64| rand_distr::Normal::new(0.0, sigma).expect("valid").sample(&mut chance);
    let profiles = |point: Point<'_>| -> Vec<Vec<[f64; 2]>> {
        (0..60).map(|i| (0..300).map(|j| point(i, f64::from(j) / 300.0)).collect()).collect()
    };
    let arc = |place: f64| ((0.1 + 0.8 * place) * std::f64::consts::PI).sin_cos();
    let scenes: [(&str, Point<'_>); 6] = [
        ("a ledge", &mut |_, s| [200.0 * s, if s > 0.9 { 5.0 } else { 0.0 } + (s * 7919.0).sin() * 0.03]),
        ("a plane and one outlier", &mut |i, s| {
            [200.0 * s, if i == 20 && s == 0.5 { 40.0 } else { (s * 7919.0 + i as f64).sin() * 0.03 }]
        }),
        ("a step", &mut |i, s| {
            [200.0 * s, if (0.2..0.8).contains(&s) { 50.0 } else { (s * 7919.0 + i as f64).sin() * 0.04 }]
        }),
        ("a tube twice as wide as high", &mut |_, s| [100.0 * arc(s).1 + noise(0.05), 50.0 * arc(s).0]),
        ("a cone", &mut |i, s| {
            let radius = 100.0 - 0.5 * i as f64;
            [radius * arc(s).1, radius * arc(s).0]
        }),
        ("a patch smaller than the resolution", &mut |i, s| [0.06 * s, 0.03 * (s * 7919.0 + i as f64).sin()]),
    ];
    for (name, point) in scenes {
        let scan = scan_of(&profiles(point));
        for method in ROBUST {
            let outcome = run(&scan, &by(method)).outcome;
            assert!(matches!(outcome, Outcome::Refused(_)), "{name} by {method:?}: {outcome:?}");
        }
    }
}
