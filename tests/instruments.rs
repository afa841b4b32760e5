//! Scans of real instruments, compared with independent fits (the README beside the data). Skipped if the data are not present.

#![expect(clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "a test may fail")]

use crate::measured::{Ask, apart, cloud, measure, pose, scan};
use crate::real::outside;
use coaxis::estimation::{Estimate, Orientation, Outcome, Pose, Progress, Settings, estimate, least_squares_cylinder};
use coaxis::geometry::{Axis, Frame};
use coaxis::scan::decode::Unit;
use coaxis::scan::slice::{Region, SliceRequest, slice};
use coaxis::scan::{Cloud, Columns, Labels, ProfileRule, Stripe};
use nalgebra::{Rotation3, Unit as UnitVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

fn accepted<'a>(name: &str, estimate: &'a Estimate) -> &'a Pose {
    pose(estimate).unwrap_or_else(|| panic!("{name}: {:?}", estimate.outcome))
}

/// The points of a cloud.
fn points_of(cloud: &Cloud) -> Vec<[f64; 3]> {
    let mut start = 0;
    let of_stripe = |stripe: &Stripe| {
        let range = std::mem::replace(&mut start, stripe.end)..stripe.end;
        let x = stripe.x;
        range.map(move |index| (index, x)).collect::<Vec<_>>()
    };
    let places: Vec<(usize, f64)> = cloud.stripes.iter().flat_map(of_stripe).collect();
    let point = |(index, x): (usize, f64)| {
        let [y, z] = cloud.columns.get(index).expect("a point");
        [x, y, z]
    };
    places.into_iter().map(point).collect()
}

/// A cloud without profiles.
fn cloud_of(points: &[[f64; 3]]) -> Cloud {
    let columns =
        Columns::F64 { y: points.iter().map(|[_, y, _]| *y).collect(), z: points.iter().map(|[.., z]| *z).collect() };
    let stripes = points.iter().enumerate().map(|(i, [x, ..])| Stripe { label: 0.0, x: *x, end: i + 1 }).collect();
    let (labels, unit) = (Labels::None, Unit::Millimetre);
    Cloud { stripes, columns, labels, unit, blanks: Vec::new(), missing_count: 0 }
}

fn tank(folder: &Path) -> Cloud {
    cloud(&folder.join("tank/scan.csv"), Some(Unit::Metre))
}

/// The independent robust fit of the tank, mm.
fn tank_axis() -> Axis {
    let direction = Vector3::new(-0.001_169_5, -0.001_670_6, 1.0).normalize();
    Axis { point_mm: [37_342.45, 25_701.58, 7000.0], direction: direction.into() }
}

/// Sector bootstrap of the tank: centre and radius mm, direction degrees.
const TANK_BOOTSTRAP: [f64; 3] = [1.5, 1.0, 0.02];

#[test]
fn the_tank_is_measured_from_its_file_and_its_unit_alone() {
    let Some(folder) = outside("real") else { return };
    let (scan, ..) = scan(tank(&folder), &SliceRequest::default());
    let estimate = estimate(&scan, &Settings::default(), &Progress::default());
    let found = accepted("tank", &estimate);
    let [angle, distance] = apart(&found.axis_in_scan(), &tank_axis());
    assert!(angle.to_degrees() < 0.02 && distance < 1.5, "{} deg, {distance} mm", angle.to_degrees());
    assert!((found.radius - 7585.42).abs() < 1.5, "{}", found.radius);
    let expanded: Vec<f64> = (0..5).map(|i| 2.0 * found.uncertainty.covariance[i][i].sqrt()).collect();
    println!("tank: U of the angles (rad), position and radius (mm): {expanded:.5?}");
    let [centre, radius, angle] = TANK_BOOTSTRAP;
    let angle = angle.to_radians();
    for (expanded, bootstrap) in expanded.into_iter().zip([angle, angle, centre, centre, radius]) {
        assert!(expanded >= bootstrap && expanded <= 4.0 * bootstrap, "{expanded} where {bootstrap}");
    }
}

#[test]
fn the_result_for_the_tank_is_the_same_in_every_orientation() {
    let Some(folder) = outside("real") else { return };
    let points = points_of(&tank(&folder));
    let mut chance = ChaCha8Rng::seed_from_u64(15);
    for turn in 0..40 {
        let mut normal = || chance.random_range(-1.0..1.0_f64);
        let axis = UnitVector::new_normalize(Vector3::new(normal(), normal(), normal()));
        let rotation = Rotation3::from_axis_angle(&axis, chance.random_range(0.0..std::f64::consts::TAU));
        let shift = Vector3::new(chance.random_range(-1e4..1e4), chance.random_range(-1e4..1e4), 0.0);
        let moved: Vec<[f64; 3]> = points.iter().map(|p| (rotation * Vector3::from(*p) + shift).into()).collect();
        let (scan, ..) = scan(cloud_of(&moved), &SliceRequest::default());
        let settings = Settings { orientation: Orientation::Any, ..Settings::default() };
        let estimate = estimate(&scan, &settings, &Progress::default());
        let found = accepted(&format!("tank turned, {turn}"), &estimate);
        let there = tank_axis();
        let truth = Axis {
            point_mm: (rotation * Vector3::from(there.point_mm) + shift).into(),
            direction: (rotation * Vector3::from(there.direction)).into(),
        };
        let [angle, distance] = apart(&found.axis_in_scan(), &truth);
        assert!(angle.to_degrees() < 0.02 && distance < 1.5, "{turn}: {} deg, {distance} mm", angle.to_degrees());
    }
}

#[test]
fn the_lamp_post_is_measured_correctly_or_refused() {
    let Some(folder) = outside("real") else { return };
    let path = folder.join("lamppost/lamppost.pcd");
    let upright = Frame { origin_mm: [-9900.0, 0.0, 0.0], x_axis: [0.0, 0.0, 1.0], z_axis: [1.0, 0.0, 0.0] };
    let with = |rule: Option<&str>, frame: Option<Frame>| Ask {
        unit: Some(Unit::Metre),
        slicing: SliceRequest { rule: rule.map(|rule| ProfileRule::parse(rule).expect("a rule")), frame, region: None },
        ..Ask::default()
    };
    let asked = [None, Some("x_pitch_mm=25"), Some("x_pitch_mm=50"), Some("x_pitch_mm=100"), Some("x_pitch_mm=200")];
    for ask in asked.into_iter().map(|rule| with(rule, Some(upright))).chain([with(None, None)]) {
        let estimate = measure(&path, &ask);
        let Some(found) = pose(&estimate) else { continue };
        let axis = found.axis_in_scan();
        let tilt = match ask.slicing.frame {
            Some(_) => axis.tilt().degrees(),
            None => axis.direction[0].hypot(axis.direction[1]).asin().to_degrees(),
        };
        assert!((found.radius - 51.0).abs() < 8.0 && (tilt - 2.3).abs() < 0.5, "{} mm, {tilt} deg", found.radius);
    }
}

#[test]
fn sewer_pipes_have_their_diameter() {
    let Some(folder) = outside("real") else { return };
    let frame = Frame { origin_mm: [0.0; 3], x_axis: [0.0, 0.0, 1.0], z_axis: [0.0, 1.0, 0.0] };
    for (name, diameter, nominal, pitch, region) in [
        ("200mm-pvc-13", 188.6, 94.1, 2.0, [[-600.0, -150.0], [-250.0, 250.0], [-250.0, 250.0]]),
        ("200mm-pvc-15", 188.6, 94.1, 2.0, [[-600.0, -150.0], [-250.0, 250.0], [-250.0, 250.0]]),
        ("200mm-pvc-16", 188.6, 94.1, 2.0, [[-600.0, -150.0], [-250.0, 250.0], [-250.0, 250.0]]),
        ("195mm-concrete-22", 200.9, 100.0, 5.0, [[-400.0, -150.0], [-200.0, 200.0], [-150.0, 150.0]]),
    ] {
        let [x_mm, y_mm, z_mm] = region.map(Some);
        let ask = Ask {
            settings: Settings {
                epsilon_mm: 2.0,
                points_min: 10,
                nominal_radius_mm: Some(nominal),
                position_uncertainty_max_mm: Some(2.0),
                angle_uncertainty_max_deg: 1.0,
                ..Settings::default()
            },
            unit: Some(Unit::Metre),
            slicing: SliceRequest {
                rule: Some(ProfileRule::XPitch(Some(pitch))),
                frame: Some(frame),
                region: Some(Region { x_mm, y_mm, z_mm }),
            },
        };
        let estimate = measure(&folder.join(format!("sewer-pipes/{name}.ply")), &ask);
        let found = accepted(name, &estimate);
        let expanded = 4.0 * found.uncertainty.covariance[4][4].sqrt();
        println!("{name}: D {:.2} ± {expanded:.2} mm, {diameter} expected", 2.0 * found.radius);
        assert!((2.0 * found.radius - diameter).abs() <= expanded, "{name}: {} ± {expanded}", 2.0 * found.radius);
        assert!(expanded <= 4.0, "{name}: ± {expanded} mm");
    }
}

#[test]
fn the_bullet_is_within_its_limits_and_thinning_does_not_change_the_verdict() {
    let Some(folder) = outside("real") else { return };
    let all = points_of(&cloud(&folder.join("bullet-land/land.npy"), None));
    let settings = Settings {
        arc_min_deg: 10.0,
        epsilon_mm: 0.005,
        angle_uncertainty_max_deg: 5.0,
        axial_length_min_mm: Some(0.1),
        ..Settings::default()
    };
    let mut rows: Vec<f64> = all.iter().map(|[x, ..]| *x).collect();
    rows.dedup();
    let thinned = |every: usize, row: bool| -> Vec<[f64; 3]> {
        let mut index = 0;
        let (mut last, mut in_row) = (f64::NAN, 0);
        let keep = |[x, ..]: &[f64; 3]| {
            in_row = if *x == last { in_row + 1 } else { 0 };
            index += usize::from(*x != last);
            last = *x;
            if row { index % every == 0 } else { in_row % every == 0 }
        };
        all.iter().copied().filter(keep).collect()
    };
    let mut verdicts = Vec::new();
    for points in [all.clone(), thinned(2, true), thinned(2, false)] {
        let scan = slice(cloud_of(&points), &SliceRequest::default(), &Default::default()).expect("profiles");
        let estimate = estimate(&scan, &settings, &Progress::default());
        if let Some(found) = pose(&estimate) {
            let covariance = found.uncertainty.covariance;
            let angle = covariance[0][0].max(covariance[1][1]).sqrt().to_degrees();
            assert!(angle <= 5.0, "{angle}");
        }
        verdicts.push(matches!(estimate.outcome, Outcome::Accepted(_)));
    }
    assert!(verdicts.iter().all(|verdict| *verdict == verdicts[0]), "{verdicts:?}");
}

#[test]
fn the_mug_is_measured_with_only_its_nominal_radius_given() {
    let Some(folder) = outside("real") else { return };
    let ask = Ask {
        settings: Settings {
            nominal_radius_mm: Some(39.0),
            angle_uncertainty_max_deg: 5.0,
            position_uncertainty_max_mm: Some(2.0),
            ..Settings::default()
        },
        unit: Some(Unit::Metre),
        ..Ask::default()
    };
    let estimate = measure(&folder.join("mug-on-table.pcd"), &ask);
    let found = accepted("mug", &estimate);
    assert!((found.radius - 39.0).abs() <= 2.0 * found.uncertainty.covariance[4][4].sqrt(), "{}", found.radius);
}

#[test]
fn the_laser_patch_that_is_no_cylinder_is_refused() {
    let Some(folder) = outside("real") else { return };
    let estimate = measure(&folder.join("laser-profile-patch.npy"), &Ask::default());
    assert!(pose(&estimate).is_none());
}

/// Every accepted result of the robust method is close to least squares, which is equivalent on these points without outliers.
#[test]
fn an_accepted_result_of_the_robust_method_agrees_with_the_nist_sets() {
    let Some(folder) = outside("real") else { return };
    let mut answered = 0;
    for set in 1..=30 {
        let cloud = cloud(&folder.join(format!("nist-cylinders/cyl{set}.ds")), None);
        let points = points_of(&cloud);
        let gaussian = least_squares_cylinder(&points).expect("a cylinder");
        let (scan, ..) = scan(cloud, &SliceRequest::default());
        let estimate =
            estimate(&scan, &Settings { orientation: Orientation::Any, ..Settings::default() }, &Progress::default());
        let Some(found) = pose(&estimate) else { continue };
        answered += 1;
        let truth = Axis { point_mm: gaussian.point, direction: gaussian.direction };
        let [angle, distance] = apart(&found.axis_in_scan(), &truth);
        let [direction, position] = found.axis_standard();
        let radius = found.uncertainty.covariance[4][4].sqrt();
        // Both have their own share of the noise.
        let own = |index: usize| gaussian.covariance[index][index];
        let off = [
            angle / direction.hypot(own(0).max(own(1)).sqrt()),
            distance / position.hypot(own(2).max(own(3)).sqrt()),
            (found.radius - gaussian.radius).abs() / radius.hypot(own(4).sqrt()),
        ];
        println!("cyl{set}: {off:.2?}");
        assert!(off.iter().all(|off| *off <= 5.0), "cyl{set}: {off:?}");
    }
    println!("{answered} of 30 answered");
}
