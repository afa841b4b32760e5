//! The method `cylinder` on synthetic parts: it reaches the Cramér-Rao bound of the inliers, is not biased by interference on the
//! part, and refuses scans that do not determine the pose. Truth and bound come from the generator of the parts, never from an
//! estimate.

#![expect(clippy::panic, clippy::expect_used, clippy::print_stdout, reason = "a test may fail, and prints its results")]

use crate::made::any_direction::{compared, in_frame};
use crate::made::{count, errors, standard};
use coaxis::estimation::{Estimate, Method, Outcome, Pose, Progress, RadiusRule, Refusal, Settings, estimate};
use coaxis::geometry::AxisLine;
use coaxis::scan::synthetic::{
    Bead, ClampShape, Interference, LaserPlane, Part, Sampling, Surroundings, Travel, Truth, make, placed, random_frame,
};
use rayon::prelude::*;

/// Seeds per scene in continuous integration. All seeds, with the table of docs/benchmarks.md:
/// `COAXIS_SEEDS=200 cargo test --release --test all cylinder:: -- --nocapture --test-threads 1`.
const SEEDS: u64 = 6;
const RMS_MAX: f64 = 1.15;
const WORST_MAX: f64 = 5.0;
/// Maximum error of a single result caused by layers close to the surface.
const LAYER_MAX_DEG: f64 = 0.0005;
const LAYER_MAX_MM: f64 = 0.005;

fn measure(part: &Part, settings: &Settings) -> (Estimate, Truth) {
    let (scan, truth) = make(part).expect("a part");
    (estimate(&scan, settings, &Progress::default()), truth)
}

fn cylinder() -> Settings {
    Settings { method: Method::Cylinder, ..Settings::default() }
}

fn pose(estimate: Estimate) -> Pose {
    match estimate.outcome {
        Outcome::Accepted(pose) => *pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

/// Errors of (deflection, pitch, y, z, radius) at the truth's x_ref in units of their bounds.
fn in_bounds([p, q, y, z, radius]: [f64; 5], truth: &Truth) -> [f64; 5] {
    let bound = truth.bound.expect("noise has a bound");
    let angles = [p / bound.deflection_deg.to_radians(), q / bound.pitch_deg.to_radians()];
    let [p, q] = angles;
    [p, q, y / bound.y_ref_mm, z / bound.z_ref_mm, radius / bound.radius_mm]
}

/// Number of errors within two standard uncertainties.
fn held_count(errors: [f64; 5], standard: [f64; 5]) -> usize {
    errors.iter().zip(standard).filter(|(error, u)| error.abs() <= 2.0 * u).count()
}

/// Compares a scene with the bound, and prints its line of the table.
fn reaches_the_bound(name: &str, settings: &Settings, part: impl Fn(u64) -> Part + Sync) {
    all_reach_the_bound(name, |seed| {
        let (estimate, truth) = measure(&part(seed), settings);
        let pose = pose(estimate);
        let held_count = held_count(errors(&pose, &truth, pose.x_ref), standard(&pose));
        (in_bounds(errors(&pose, &truth, truth.x_ref_mm), &truth), held_count)
    });
}

/// The same for the scan as a cloud with the rail in any direction and the points in random order.
fn reaches_the_bound_in_any_direction(name: &str, settings: &Settings, part: impl Fn(u64) -> Part + Sync) {
    all_reach_the_bound(name, |seed| {
        let (scan, truth) = make(&part(seed)).expect("a part");
        let frame = random_frame(seed, 1000.0);
        let cloud = placed(&scan, &frame, Some(seed)).expect("a frame");
        let pose = pose(estimate(&cloud, settings, &Progress::default()));
        let true_axis = truth.placed(&frame).expect("a frame").axis;
        let (own_errors, own_standard) = compared(&pose, &true_axis, truth.radius_mm);
        let line = in_frame(&frame, &pose.axis_in_scan()).line().expect("along the rail");
        let [y, z] = line.at(truth.x_ref_mm);
        let errors = [
            line.deflection().radians() - truth.deflection_deg.to_radians(),
            line.pitch().radians() - truth.pitch_deg.to_radians(),
            y - truth.y_ref_mm,
            z - truth.z_ref_mm,
            pose.radius - truth.radius_mm,
        ];
        (in_bounds(errors, &truth), held_count(own_errors, own_standard))
    });
}

/// Compares results (errors in bounds, number of errors within U) with the bound, and prints their line of the table.
fn all_reach_the_bound(name: &str, answer: impl Fn(u64) -> ([f64; 5], usize) + Sync) {
    let seeds_count = count("COAXIS_SEEDS", SEEDS);
    let answers: Vec<([f64; 5], usize)> = (0..seeds_count).into_par_iter().map(&answer).collect();
    let mut squares = [0.0; 5];
    for (seed, (errors, _)) in answers.iter().enumerate() {
        assert!(errors.iter().all(|e| e.abs() <= WORST_MAX), "{name}, seed {seed}: {errors:.2?} bounds");
        for (square, error) in squares.iter_mut().zip(errors) {
            *square += error * error / seeds_count as f64;
        }
    }
    let rms = squares.map(f64::sqrt);
    let worst = answers.iter().flat_map(|(errors, _)| errors).fold(0.0_f64, |worst, e| worst.max(e.abs()));
    let held = answers.iter().map(|(_, held)| held).sum::<usize>() as f64 / (5 * answers.len()) as f64;
    let [p, q, y, z, r] = rms;
    println!("| {name} | {p:.2} | {q:.2} | {y:.2} | {z:.2} | {r:.2} | {worst:.1} | {:.1} |", 100.0 * held);
    // The root mean square of n draws has the relative standard deviation 1/√(2n); three of these are allowed for few seeds.
    let granted = RMS_MAX.max(1.03 * (1.0 + 3.0 / (2.0 * seeds_count as f64).sqrt()));
    assert!(rms.iter().all(|rms| *rms <= granted), "{name}: {rms:.2?} bounds");
}

/// 120° of a part of 200 mm radius, less dense than a real scan so that many seeds can be tested.
fn part(seed: u64) -> Part {
    Part { arc_deg: 120.0, profiles_count: 200, points_count: 320, ..Part::smooth(seed) }
}

/// The interference of the publication's complete part.
fn paper() -> Interference {
    Part::with_interference(0).interference
}

fn clamped(clamps: f64, clamp_arc: f64, clamp_height_mm: f64) -> Interference {
    Interference { clamps, clamp_arc, clamp_height_mm, ..Interference::NONE }
}

#[test]
fn interference_does_not_reduce_accuracy() {
    let settings = cylinder();
    reaches_the_bound("clean", &settings, part);
    reaches_the_bound("holes", &settings, |s| {
        let holes = Interference { screw_holes: 0.5, straight_holes: 0.3, ..Interference::NONE };
        Part { interference: holes, ..part(s) }
    });
    reaches_the_bound("holes and clamps of the publication", &settings, |s| Part { interference: paper(), ..part(s) });
    let hard = Interference { screw_holes: 0.2, straight_holes: 0.15, clamps: 0.5, ..paper() };
    reaches_the_bound("15 % smooth profiles", &settings, |s| Part { interference: hard, ..part(s) });
    let none = Interference { screw_holes: 0.3, straight_holes: 0.2, clamps: 0.5, ..paper() };
    reaches_the_bound("no smooth profile", &settings, |s| Part { interference: none, ..part(s) });
    reaches_the_bound("30 % drop-outs", &settings, |s| Part { drop_out_ratio: 0.3, ..part(s) });
    reaches_the_bound("5 % spikes", &settings, |s| Part { spike_ratio: 0.05, ..part(s) });
}

/// A part viewed from the side and sampled evenly across, with clamps and holes away from the middle of the arc.
#[test]
fn clamps_need_not_be_concentric_nor_in_the_middle() {
    let settings = cylinder();
    for shift in [-0.3, 0.2] {
        let shifted = Interference { shift, ..paper() };
        reaches_the_bound("shifted", &settings, |s| Part { interference: shifted, ..part(s) });
    }
    let shapes = [
        ("flat clamps", ClampShape::Flat),
        ("round clamps of 120 mm", ClampShape::Round { radius_mm: 120.0 }),
        ("round clamps of 400 mm", ClampShape::Round { radius_mm: 400.0 }),
    ];
    for (name, clamp_shape) in shapes {
        for (clamps, clamp_arc, shift) in [(0.6, 0.5, 0.0), (0.8, 0.6, 0.15)] {
            let clamp = Interference { clamp_shape, shift, ..clamped(clamps, clamp_arc, 25.0) };
            reaches_the_bound(name, &settings, |s| Part { interference: clamp, ..part(s) });
        }
    }
}

#[test]
fn a_concentric_clamp_on_most_of_most_profiles_is_not_mistaken_for_the_part() {
    for (name, clamps, arc) in [("50 % clamps", 0.9, 0.5), ("70 % clamps", 0.857, 0.7), ("85 % clamps", 0.847, 0.85)] {
        reaches_the_bound(name, &cylinder(), |s| Part { interference: clamped(clamps, arc, 25.0), ..part(s) });
    }
}

#[test]
fn layers_close_to_the_surface_do_not_bias_the_pose() {
    let bead = |arc, place| Interference { bead: Bead { height_mm: 0.3, arc, place }, ..Interference::NONE };
    let scenes = [
        ("weld bead of 0.3 mm", bead(0.05, 0.4)),
        ("weld bead of 0.3 mm, wide", bead(0.1, 0.7)),
        ("tape of 0.4 mm", clamped(0.6, 0.1, 0.4)),
        ("tape of 0.4 mm, wide", clamped(0.6, 0.3, 0.4)),
        ("tape of 1.5 mm", clamped(0.6, 0.3, 1.5)),
    ];
    let seeds_count = count("COAXIS_SEEDS", SEEDS) / 3;
    for (name, interference) in scenes {
        let worst = (0..seeds_count).map(|seed| {
            let made = Part { profiles_count: 400, points_count: 640, interference, ..part(seed) };
            let (estimate, truth) = measure(&made, &cylinder());
            let [p, q, y, z, _] = errors(&pose(estimate), &truth, truth.x_ref_mm).map(f64::abs);
            [p.max(q).to_degrees(), y.max(z)]
        });
        let [deg, mm] = worst.fold([0.0_f64; 2], |[a, b], [c, d]| [a.max(c), b.max(d)]);
        println!("| {name} | at worst {deg:.5}° | {mm:.4} mm |");
        assert!(deg <= LAYER_MAX_DEG && mm <= LAYER_MAX_MM, "{name}: {deg}° and {mm} mm");
    }
}

#[test]
fn the_bound_is_reached_for_any_size_noise_arc_and_tilt() {
    let settings = cylinder();
    let with = |s| Part { interference: paper(), ..part(s) };
    reaches_the_bound("noise of 0.2 mm", &settings, |s| Part { noise_sigma_mm: 0.2, ..with(s) });
    reaches_the_bound("40 sparse profiles", &settings, |s| Part { profiles_count: 40, points_count: 160, ..with(s) });
    reaches_the_bound("50 mm long", &settings, |s| Part { length_mm: 50.0, ..with(s) });
    for (name, arc_deg) in [("arc of 50°", 50.0), ("arc of 70°", 70.0), ("arc of 90°", 90.0)] {
        reaches_the_bound(name, &settings, |s| Part { arc_deg, ..with(s) });
    }
    for (name, radius_mm) in [("radius 50", 50.0), ("radius 1000", 1000.0)] {
        reaches_the_bound(name, &settings, |s| Part { radius_mm, ..with(s) });
    }
    let low = Interference { clamp_height_mm: 5.0, ..paper() };
    reaches_the_bound("radius 20", &settings, |s| Part { radius_mm: 20.0, interference: low, ..part(s) });
    let axis = AxisLine { p: 0.176, q: -0.176, y0: 5.0, z0: 100.0 };
    reaches_the_bound("tilted by 10°", &settings, |s| Part { axis, ..with(s) });
}

#[test]
fn the_bound_is_reached_for_any_sensor_position_and_background() {
    let settings = cylinder();
    let with = |s| Part { interference: paper(), ..part(s) };
    let across = Sampling::EvenAcross;
    reaches_the_bound("sampled evenly across", &settings, |s| Part { sampling: across, ..with(s) });
    reaches_the_bound("half of the part hidden", &settings, |s| Part {
        sampling: across,
        view_deg: 35.0,
        arc_deg: 70.0,
        ..with(s)
    });
    reaches_the_bound("uneven spacing", &settings, |s| Part { spacing_spread: 1.0, ..with(s) });
    let floor = Surroundings { floor: 0.4, floor_depth_mm: 150.0, ..Surroundings::default() };
    reaches_the_bound("floor", &settings, |s| Part { surroundings: floor, ..with(s) });
    let level = Surroundings { support: 0.2, supports: 0.8, ..floor };
    reaches_the_bound("floor and level support", &settings, |s| Part { surroundings: level, ..with(s) });
    let roller = Surroundings { support_radius_mm: 60.0, ..level };
    reaches_the_bound("floor and roller", &settings, |s| Part { surroundings: roller, ..with(s) });
}

#[test]
fn points_are_used_at_their_own_x() {
    let settings = cylinder();
    let with = |s| Part { interference: paper(), ..part(s) };
    for (name, about_y_deg, about_z_deg) in [
        ("laser plane turned by 10° about y", 10.0, 0.0),
        ("laser plane turned by 10° about z", 0.0, 10.0),
        ("laser plane turned by 15° about both", 15.0, 15.0),
    ] {
        let laser_plane = LaserPlane { about_y_deg, about_z_deg };
        reaches_the_bound(name, &settings, |s| Part { laser_plane, ..with(s) });
    }
    let travel = Travel { encoder_sigma_mm: 0.5, ..Travel::default() };
    // An error of x moves a point off the surface by the error times the slope of 1°: 0.01 mm in addition to the noise of 0.05 mm.
    reaches_the_bound("encoder noise of 0.5 mm", &settings, |s| Part { travel, ..with(s) });
}

#[test]
fn the_bound_is_reached_for_any_direction_of_the_axis() {
    let settings = cylinder();
    let with = |s| Part { interference: paper(), ..part(s) };
    reaches_the_bound_in_any_direction("any direction, clean", &settings, part);
    reaches_the_bound_in_any_direction("any direction, holes and clamps", &settings, with);
    reaches_the_bound_in_any_direction("any direction, 70°", &settings, |s| Part { arc_deg: 70.0, ..with(s) });
    reaches_the_bound_in_any_direction("any direction, radius 50", &settings, |s| Part { radius_mm: 50.0, ..part(s) });
    let laser_plane = LaserPlane { about_y_deg: 15.0, about_z_deg: 15.0 };
    reaches_the_bound_in_any_direction("any direction, laser plane turned", &settings, |s| Part {
        laser_plane,
        ..with(s)
    });
}

#[test]
fn if_a_clamp_could_be_the_part_the_nominal_radius_decides_and_without_it_both_are_reported() {
    let both = |seed| Part { interference: clamped(1.0, 0.6, 25.0), ..part(seed) };
    let Outcome::Refused(Refusal::TwoCylinders { radius_a_mm, radius_b_mm, .. }) =
        measure(&both(1), &cylinder()).0.outcome
    else {
        panic!("both are on every profile")
    };
    let mut radii = [radius_a_mm, radius_b_mm];
    radii.sort_by(f64::total_cmp);
    assert!((radii[0] - 200.0).abs() < 0.2 && (radii[1] - 225.0).abs() < 0.2, "{radii:?}");
    let nominal = Settings { nominal_radius_mm: Some(200.0), ..cylinder() };
    reaches_the_bound("nominal radius", &nominal, both);
}

#[test]
fn a_known_radius_determines_the_depth_of_a_short_arc() {
    let short = Part { arc_deg: 30.0, ..part(1) };
    let free = pose(measure(&short, &cylinder()).0);
    let known = Settings { nominal_radius_mm: Some(200.0), radius: RadiusRule::Fixed, ..cylinder() };
    let (estimate, truth) = measure(&short, &known);
    let fixed = pose(estimate);
    let [.., z_free, _] = free.uncertainty.budget[0].standard;
    let [.., z_fixed, r_fixed] = fixed.uncertainty.budget[0].standard;
    assert!(z_fixed < 0.1 * z_free, "{z_fixed} and {z_free} mm");
    assert!(r_fixed == 0.0 && (fixed.radius - 200.0).abs() < 1e-9);
    let [_, z] = fixed.axis.at(truth.x_ref_mm);
    assert!((z - truth.z_ref_mm).abs() < 5.0 * z_fixed);
    // A prior far more accurate than the data constrains the radius, one far less accurate has no effect.
    for (sigma, near) in [(1e-6, fixed.axis.z0), (1e3, free.axis.z0)] {
        let prior = Settings { radius: RadiusRule::Prior, radius_sigma_mm: Some(sigma), ..known };
        assert!((pose(measure(&short, &prior).0).axis.z0 - near).abs() < 0.01 * z_free);
    }
}

#[test]
fn a_pose_that_the_data_cannot_determine_is_refused_with_its_numbers() {
    let sliver = Part { arc_deg: 8.0, points_count: 60, profiles_count: 40, noise_sigma_mm: 0.2, ..part(1) };
    let refusal = match measure(&sliver, &cylinder()).0.outcome {
        Outcome::Refused(refusal) => refusal,
        Outcome::Accepted(pose) => panic!("accepted {pose:?}"),
    };
    assert!(["pose_undetermined", "no_cylinder"].contains(&refusal.code()), "{refusal}");
}

#[test]
fn the_result_is_independent_of_the_number_of_threads_and_passes() {
    let (scan, _) = make(&Part { interference: paper(), ..part(3) }).expect("a part");
    let on = |threads| {
        let progress = Progress::default();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let estimate = pool.install(|| estimate(&scan, &cylinder(), &progress));
        assert_eq!(progress.done_count(), scan.stations().len(), "every profile is done once");
        estimate
    };
    let one = on(1);
    assert!(matches!(one.outcome, Outcome::Accepted(_)));
    assert_eq!(one, on(2));
    assert_eq!(one, on(5));
}

#[test]
fn a_pose_from_profiles_of_which_none_is_valid_has_residuals() {
    // More than half of every profile is covered by a clamp, so none has the required 85 % of inliers.
    let part = Part { interference: clamped(1.0, 0.6, 25.0), ..part(1) };
    let (estimate, _) = measure(&part, &Settings { nominal_radius_mm: Some(200.0), ..cylinder() });
    assert!(matches!(estimate.outcome, Outcome::Accepted(_)));
    assert!(estimate.profiles.iter().all(|profile| profile.rejected.is_some()));
    let residuals = estimate.residuals.expect("of the points used");
    assert!((residuals.sigma - part.noise_sigma_mm).abs() < 0.1 * part.noise_sigma_mm, "{residuals:?}");
    assert!((0.3..0.5).contains(&residuals.inlier_ratio), "{residuals:?}");
}
