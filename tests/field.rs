//! Typical faults of users' files: each was reported for scanners and point clouds, and has a known true pose. A result is correct
//! if its error is within 2.5 of the stated standard uncertainties in every number. Each file has a single draw of its noise, so
//! one row in thirty would fail by chance if the uncertainty were exact; none does.

#![expect(clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "a test may fail")]

use crate::measured::{Ask, apart, cloud, codes, measure, pose};
use coaxis::estimation::{Orientation, Outcome, Progress, Settings, estimate};
use coaxis::geometry::{Axis, AxisLine, Frame};
use coaxis::scan::decode::{Limits, Unit};
use coaxis::scan::slice::{SliceRequest, slice};
use coaxis::scan::synthetic::{LaserPlane, Part, make};
use coaxis::scan::{Cloud, Grouping, Labels, ProfileRule, Stripe};
use std::path::{Path, PathBuf};

/// Maximum error in standard uncertainties.
const STANDARD_MAX: f64 = 2.5;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/field").join(name)
}

/// Radius, deflection and pitch in degrees, y_c0 and z_c0.
type Truth = [f64; 5];

/// The part in most files.
const USUAL: Truth = [50.0, 0.8, 1.1, 3.0, -7.0];

/// Largest error of (deflection, pitch, y_ref, z_ref, radius) in standard uncertainties.
fn off(name: &str, ask: &Ask, [radius, deflection, pitch, y_c0, z_c0]: Truth) -> (f64, Vec<&'static str>) {
    let estimate = measure(&file(name), ask);
    let found = pose(&estimate).unwrap_or_else(|| panic!("{name}: {:?}", estimate.outcome));
    let on_rail = found.on_rail().expect("near X");
    let slopes = [deflection, pitch].map(|angle: f64| angle.to_radians().tan());
    let [y, z] = on_rail.axis.at(on_rail.x_ref);
    let errors = [
        on_rail.axis.deflection().radians() - deflection.to_radians(),
        on_rail.axis.pitch().radians() - pitch.to_radians(),
        y - (y_c0 + slopes[0] * on_rail.x_ref),
        z - (z_c0 + slopes[1] * on_rail.x_ref),
        found.radius - radius,
    ];
    let covariance = on_rail.uncertainty.covariance;
    let worst = (0..5).map(|i| errors[i].abs() / covariance[i][i].sqrt()).fold(0.0, f64::max);
    (worst, codes(&estimate))
}

#[test]
fn every_reported_fault_is_measured_correctly() {
    for name in [
        "zero3_edge_5.csv",
        "zero3_edge_20.csv",
        "zero3_rand_10.csv",
        "wild_x.csv",
        "tilt_y3.csv",
        "tilt_z3.csv",
        "tilt_z10.csv",
        "sentinel_9999_1of40.csv",
        "sentinel_999_4of40.csv",
        "sent_-99999_edges20.csv",
        "dup_x2_label.csv",
        "stale_x2.csv",
        "csv_count_first.xyz",
        "csv_pts.pts",
        "livox_line_all.pcd",
        "ply_prop_line_const.ply",
        "label_tiles_5.csv",
        "rotational_label.csv",
        "ply_comment_um.ply",
    ] {
        let (worst, warnings) = off(name, &Ask::default(), USUAL);
        assert!(worst <= STANDARD_MAX, "{name}: {worst:.2} standard uncertainties");
        assert_eq!(warnings, ["calibration_not_stated"], "{name}");
    }
}

#[test]
fn a_rotated_frame_transforms_every_point() {
    let text = std::fs::read(file("frame2.json")).expect("the file is there");
    let recipe: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
    let frame: Frame = serde_json::from_value(recipe["frame"].clone()).expect("a frame");
    let mut ask = Ask::default();
    ask.slicing.frame = Some(frame);
    let estimate = measure(&file("frame_plain.csv"), &ask);
    let found = pose(&estimate).expect("accepted");
    // The truth is stated in the frame of the file and transformed to the frame of the recipe.
    let rotation = frame.rotation().expect("a frame");
    let slopes = [USUAL[1], USUAL[2]].map(|angle: f64| angle.to_radians().tan());
    let point = rotation * (nalgebra::Vector3::new(0.0, USUAL[3], USUAL[4]) - nalgebra::Vector3::from(frame.origin_mm));
    let direction = (rotation * nalgebra::Vector3::new(1.0, slopes[0], slopes[1])).normalize();
    let truth = Axis { point_mm: point.into(), direction: direction.into() };
    let [angle, distance] = apart(&found.axis_in_scan(), &truth);
    let [of_direction, of_position] = found.axis_standard();
    assert!(angle <= STANDARD_MAX * of_direction && distance <= STANDARD_MAX * of_position, "{angle} {distance}");
}

#[test]
fn missing_values_are_reported_and_counted() {
    for (name, value, count) in [
        ("zero3_edge_5.csv", "(x, y, z) = (0, 0, 0)", 134),
        ("zero3_edge_20.csv", "(x, y, z) = (0, 0, 0)", 536),
        ("zero3_rand_10.csv", "(x, y, z) = (0, 0, 0)", 260),
        ("sentinel_9999_1of40.csv", "z = -9999", 67),
        ("sentinel_999_4of40.csv", "z = -999", 268),
        ("sent_-99999_edges20.csv", "z = -99999", 536),
    ] {
        let (_, removed) = coaxis::scan::missing::clean(cloud(&file(name), None), None);
        let found: Vec<(String, u64)> = removed.missing.iter().map(|value| (value.to_string(), value.count)).collect();
        assert_eq!(found, [(value.to_owned(), count)], "{name}");
    }
    for name in ["dup_x2_label.csv", "stale_x2.csv"] {
        let (_, removed) = coaxis::scan::missing::clean(cloud(&file(name), None), None);
        assert_eq!((removed.repeated_profiles, removed.profiles), (25, 50), "{name}");
    }
}

#[test]
fn an_axis_in_any_direction_is_measured_in_the_frame_of_the_file() {
    let diagonal = std::f64::consts::FRAC_1_SQRT_2;
    let tilted = 20f64.to_radians();
    for (name, direction) in [
        ("axis_along_z.npy", [0.0, 0.0, 1.0]),
        ("axis_along_y_arc.npy", [0.0, 1.0, 0.0]),
        ("axis_pitch45.npy", [diagonal, 0.0, diagonal]),
        ("axis_pitch20_arc.npy", [tilted.cos(), 0.0, tilted.sin()]),
    ] {
        let ask = Ask { settings: Settings { orientation: Orientation::Any, ..Settings::default() }, ..Ask::default() };
        let estimate = measure(&file(name), &ask);
        let found = pose(&estimate).unwrap_or_else(|| panic!("{name}: {:?}", estimate.outcome));
        let [angle, distance] = apart(&found.axis_in_scan(), &Axis { point_mm: [0.0; 3], direction });
        let [of_direction, of_position] = found.axis_standard();
        assert!(angle <= STANDARD_MAX * of_direction, "{name}: {angle} {of_direction}");
        assert!(distance <= STANDARD_MAX * of_position, "{name}: {distance} {of_position}");
        let of_radius = found.uncertainty.covariance[4][4].sqrt();
        assert!((found.radius - 20.0).abs() <= STANDARD_MAX * of_radius, "{name}: {}", found.radius);
        assert_eq!(codes(&estimate), ["calibration_not_stated"], "{name}");
    }
}

#[test]
fn an_axis_not_along_the_rail_is_refused_with_its_angle_or_gives_a_warning() {
    for (name, least) in [("axis_along_z.npy", 89.9), ("axis_pitch45.npy", 44.9)] {
        let with = |orientation| Ask { settings: Settings { orientation, ..Settings::default() }, ..Ask::default() };
        let refused = measure(&file(name), &with(Orientation::Rail));
        match refused.outcome {
            coaxis::estimation::Outcome::Refused(coaxis::estimation::Refusal::AxisNotAlongRail {
                angle_deg, ..
            }) => {
                assert!((angle_deg - least - 0.1).abs() < 0.2, "{name}: {angle_deg}");
            }
            other => panic!("{name}: {other:?}"),
        }
        let warned = measure(&file(name), &with(Orientation::Auto));
        assert_eq!(codes(&warned), ["calibration_not_stated", "axis_not_along_rail"], "{name}");
    }
}

#[test]
fn an_arc_that_is_concave_towards_the_sensor_gives_a_warning() {
    let estimate = measure(&file("flip_z.csv"), &Ask::default());
    assert_eq!(codes(&estimate), ["calibration_not_stated", "concave_towards_sensor"]);
}

#[test]
fn the_radius_is_within_its_uncertainty_with_noise_of_a_twentieth_of_the_radius() {
    let ask =
        Ask { settings: Settings { position_uncertainty_max_mm: Some(1.0), ..Settings::default() }, ..Ask::default() };
    let estimate = measure(&file("noise_full_1.0.csv"), &ask);
    let found = pose(&estimate).unwrap_or_else(|| panic!("{:?}", estimate.outcome));
    let error = (found.radius - 20.0).abs();
    assert!(error <= STANDARD_MAX * found.uncertainty.covariance[4][4].sqrt(), "{error}");
}

#[test]
fn profiles_without_travel_are_refused_by_name() {
    let estimate = measure(&file("gocator_profile_y0.csv"), &Ask::default());
    match estimate.outcome {
        coaxis::estimation::Outcome::Refused(refusal) => assert_eq!(refusal.code(), "travel_missing"),
        other => panic!("{other:?}"),
    }
}

/// The points of profiles in a tilted laser plane, whose profiles share errors, without the assignment of points to profiles.
fn tilted_cloud(seed: u64, axis: AxisLine, about_z_deg: f64) -> Cloud {
    let part = Part {
        axis,
        radius_mm: 50.0,
        length_mm: 200.0,
        profiles_count: 60,
        points_count: 80,
        laser_plane: LaserPlane { about_y_deg: 0.0, about_z_deg },
        noise_sigma_mm: 0.01,
        jitter_sigma_mm: 0.03,
        ..Part::smooth(seed)
    };
    let (scan, _) = make(&part).expect("a scan");
    let own_x = scan.stations().iter().flat_map(|station| scan.own_x(station).expect("a tilted plane").to_vec());
    let stripes = (1..).zip(own_x).map(|(end, x)| Stripe { label: 0.0, x, end }).collect();
    let (columns, labels, unit) = (scan.columns().clone(), Labels::None, Unit::Millimetre);
    Cloud { stripes, columns, labels, unit, blanks: Vec::new(), missing_count: 0 }
}

/// Root mean square of the errors of slabs in standard uncertainties: as slabs, and when treated as profiles of the sensor.
fn slabs_off(about_z_deg: f64, seeds: u64) -> [f64; 2] {
    let axis = AxisLine { p: 0.01, q: 0.02, y0: 3.0, z0: -7.0 };
    let rule = Some(ProfileRule::XPitch(Some(3.0)));
    let request = SliceRequest { rule, ..SliceRequest::default() };
    let mut sums = [0.0; 2];
    for seed in 0..seeds {
        let scan = slice(tilted_cloud(seed, axis, about_z_deg), &request, &Limits::default()).expect("slabs");
        assert_eq!(scan.grouping(), Grouping::Slabs);
        for (sum, grouping) in sums.iter_mut().zip([Grouping::Slabs, Grouping::Given]) {
            let estimate = estimate(&scan.clone().with_grouping(grouping), &Settings::default(), &Progress::default());
            let Outcome::Accepted(pose) = &estimate.outcome else { panic!("{:?}", estimate.outcome) };
            let on_rail = pose.on_rail().expect("near X");
            let [y, z] = on_rail.axis.at(on_rail.x_ref);
            let errors = [
                on_rail.axis.deflection().radians() - axis.p.atan(),
                on_rail.axis.pitch().radians() - axis.q.atan(),
                y - (axis.y0 + axis.p * on_rail.x_ref),
                z - (axis.z0 + axis.q * on_rail.x_ref),
            ];
            let covariance = on_rail.uncertainty.covariance;
            *sum += (0..4).map(|i| errors[i] * errors[i] / covariance[i][i]).sum::<f64>() / (4 * seeds) as f64;
        }
    }
    sums.map(f64::sqrt)
}

#[test]
fn slabs_through_tilted_profiles_state_more_uncertainty_than_profiles_of_the_sensor() {
    let [slabs, given] = slabs_off(5.0, 12);
    assert!(slabs < 1.3 && given > 1.1 * slabs, "{slabs} {given}");
}
