//! What calibration says goes into the budget as it goes into the pose: made scans are disturbed as the budget assumes, and
//! the poses must scatter as it states.

#![expect(clippy::panic, clippy::expect_used, clippy::indexing_slicing, reason = "a test may fail")]

use coaxis::estimation::{Method, Outcome, Pose, Progress, RadiusRule, Settings, TypeB, estimate};
use coaxis::scan::synthetic::{Part, make};
use coaxis::scan::{Columns, Scan};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const SEEDS: u64 = 150;

/// Half the noise of the disturbance, and many points, so that what is seen is the disturbance.
fn part(seed: u64) -> Part {
    Part { profiles_count: 41, points_count: 80, noise_sigma_mm: 0.01, arc_deg: 150.0, ..Part::smooth(seed) }
}

fn pose(scan: &Scan, settings: &Settings) -> Pose {
    match estimate(scan, settings, &Progress::default()).outcome {
        Outcome::Accepted(pose) => *pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

fn line(pose: &Pose, source: &str) -> [f64; 5] {
    pose.uncertainty.budget.iter().find(|line| line.source == source).expect("a line of the budget").standard
}

/// The scan as a stage takes it that is off by `u` mm, alike over `length` mm as exp(−distance/length).
fn carried_off(scan: &Scan, u: f64, length: f64, seed: u64) -> Scan {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut chance);
    let (mut y, mut z) = (Vec::new(), Vec::new());
    let (mut off, mut before) = ([u * draw(), u * draw()], scan.stations()[0].x);
    for station in scan.stations() {
        let alike = (-(station.x - before) / length).exp();
        off = off.map(|off| off * alike + u * (1.0 - alike * alike).sqrt() * draw());
        before = station.x;
        for point in (station.start..station.end).filter_map(|i| scan.columns().get(i)) {
            y.push(point[0] + off[0]);
            z.push(point[1] + off[1]);
        }
    }
    Scan::new(scan.stations().to_vec(), Columns::F64 { y, z }, "made".to_owned()).expect("valid")
}

#[test]
fn poses_scatter_as_the_straightness_of_the_stage_says() {
    for (method, length) in [(Method::Cylinder, 30.0), (Method::Cylinder, 400.0), (Method::SectionLine, 100.0)] {
        let (u, mut squares, mut stated) = (0.02, [0.0; 4], [0.0; 4]);
        let type_b = TypeB { stage_straightness_mm: u, stage_straightness_length_mm: length, ..TypeB::default() };
        let settings = Settings { method, type_b, ..Settings::default() };
        for seed in 0..SEEDS {
            let (scan, truth) = make(&part(seed)).expect("a part");
            let pose = pose(&carried_off(&scan, u, length, seed), &settings);
            let [y, z] = pose.axis.at(truth.x_ref_mm);
            let errors = [
                pose.axis.deflection().radians() - truth.deflection_deg.to_radians(),
                pose.axis.pitch().radians() - truth.pitch_deg.to_radians(),
                y - truth.y_ref_mm,
                z - truth.z_ref_mm,
            ];
            let line = line(&pose, "stage_straightness");
            for index in 0..4 {
                squares[index] += errors[index].powi(2) / SEEDS as f64;
                stated[index] += line[index] / SEEDS as f64;
            }
        }
        // The root mean square of 150 draws scatters by 1/√300 = 6 %; four of them are granted.
        for (square, stated) in squares.iter().zip(stated) {
            let ratio = square.sqrt() / stated;
            assert!((0.76..1.24).contains(&ratio), "{method:?}, {length} mm: seen over stated {ratio}");
        }
    }
}

#[test]
fn a_nominal_radius_that_is_off_moves_the_pose_by_its_line_of_the_budget() {
    let (scan, _) = make(&Part { arc_deg: 60.0, noise_sigma_mm: 0.05, ..part(3) }).expect("a part");
    for radius in [RadiusRule::Fixed, RadiusRule::Prior] {
        let at = |nominal: f64| Settings {
            radius,
            nominal_radius_mm: Some(nominal),
            radius_sigma_mm: Some(0.02),
            ..Settings::default()
        };
        let (right, off) = (pose(&scan, &at(200.0)), pose(&scan, &at(200.02)));
        let [.., z, r] = line(&right, "nominal_radius");
        let [before, after] = [&right, &off].map(|pose| pose.axis.at(right.x_ref)[1]);
        // Newton's step is linear, the pose is not quite.
        assert!(((after - before).abs() / z - 1.0).abs() < 0.02, "{radius:?}: {} mm, {z} mm", after - before);
        assert!(((off.radius - right.radius).abs() / r - 1.0).abs() < 0.02, "{radius:?}: {r} mm");
    }
}

#[test]
fn the_budget_has_a_line_for_everything_that_was_said_and_none_for_what_was_not() {
    let (scan, _) = make(&part(1)).expect("a part");
    let sources = |settings: &Settings| -> Vec<String> {
        pose(&scan, settings).uncertainty.budget.into_iter().map(|line| line.source).collect()
    };
    assert_eq!(sources(&Settings::default()), ["repeatability"]);
    let type_b = TypeB {
        stage_straightness_mm: 0.01,
        extrinsics_position_mm: 0.01,
        temperature_sigma_k: 2.0,
        ..TypeB::default()
    };
    let all = ["stage_straightness", "sensor_extrinsics", "temperature"];
    assert_eq!(sources(&Settings { type_b, ..Settings::default() })[1..], all);
    let sections = Settings { type_b, method: Method::SectionLine, ..Settings::default() };
    assert_eq!(sources(&sections)[2..], all);
}
