//! Detects cylinders in clouds of real instruments, in any direction, and compares them with independent data.

#![expect(clippy::expect_used, reason = "a test may fail")]

use coaxis::estimation::{DetectRequest, Detected, detect};
use coaxis::scan::decode::{FormatClaims, Limits, Request, Unit, decode, find_format};
use nalgebra::{Rotation3, Vector3};
use std::fs;
use std::path::Path;

type V = Vector3<f64>;

fn cloud(path: &Path, unit: Unit) -> Vec<[f64; 3]> {
    let bytes = fs::read(path).expect("the file is there");
    let name = path.display().to_string();
    let claims = FormatClaims { file_name: Some(&name), ..FormatClaims::default() };
    let format = find_format(&claims, bytes.get(..512).unwrap_or(&bytes)).expect("known");
    let limits = Limits::default();
    let request = Request { unit: Some(unit), ..Request::new(&limits) };
    let cloud = decode(format, &mut bytes.as_slice(), &request).expect("reads");
    let mut points = Vec::new();
    for stripe in &cloud.stripes {
        points.extend((points.len()..stripe.end).filter_map(|i| cloud.columns.get(i)).map(|[y, z]| [stripe.x, y, z]));
    }
    points
}

/// The last three numbers of every line that has at least three.
fn rows(path: &Path, scale: f64) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(path).expect("the file is there");
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split([',', '\t', ' ']).filter_map(|cell| cell.trim().parse().ok()).collect();
        numbers.last_chunk::<3>().map(|last| last.map(|v| v * scale))
    };
    text.lines().filter_map(row).collect()
}

/// Angle between the detected axis and a direction, degrees, and distance of a point from the detected axis.
fn off(found: &Detected, point: V, direction: V) -> (f64, f64) {
    let axis = V::from(found.direction);
    (axis.cross(&direction.normalize()).norm().asin().to_degrees(), (point - V::from(found.point)).cross(&axis).norm())
}

/// An axis given by its point at a height z, and its slopes there.
fn upright(point: [f64; 3], dx: f64, dy: f64) -> (V, V) {
    (V::from(point), V::new(dx, dy, 1.0))
}

/// The result lies within a tenth of the spread of a sector bootstrap of a fit of all points, i.e. within its noise of 7.7 mm.
#[test]
fn a_tank_is_detected_in_any_orientation() {
    let Some(folder) = crate::real::outside("real") else { return };
    let points = rows(&folder.join("tank/scan.csv"), 1000.0);
    let (point, direction) = upright([37342.45, 25701.58, 7000.0], -0.001_169_5, -0.001_670_6);
    for turn in 0..40 {
        let turn = f64::from(turn);
        let turn = Rotation3::from_scaled_axis(V::new(turn.sin(), (1.7 * turn).cos(), (0.6 * turn).sin()) * 3.0);
        let turned: Vec<[f64; 3]> = points.iter().map(|point| (turn * V::from(*point)).into()).collect();
        let found = detect(&turned, &DetectRequest::default());
        let (angle, distance) = off(&found[0], turn * point, turn * direction);
        assert!(angle < 0.02 && distance < 7.7 && (found[0].radius - 7585.42).abs() < 7.7, "{found:?}");
    }
}

/// A tapered post on a grid of 15.6 and 31 mm: the nominal radius is accurate to 8 mm.
#[test]
fn a_lamp_post_is_found_by_its_radius() {
    let Some(folder) = crate::real::outside("real") else { return };
    let points = cloud(&folder.join("lamppost/lamppost.pcd"), Unit::Metre);
    let request = DetectRequest { nominal_radius_mm: Some(51.0), nominal_reach: 0.16, ..DetectRequest::default() };
    let found = detect(&points, &request);
    let tilt = V::from(found[0].direction).z.acos().to_degrees();
    assert!((tilt - 2.3).abs() < 1.0 && (found[0].radius - 51.0).abs() < 8.0, "{tilt}° {found:?}");
}

/// 6 % of the points belong to the mug, half of them to the table. The table's normal is the mug's axis.
#[test]
fn a_mug_is_found_on_its_table() {
    let Some(folder) = crate::real::outside("real") else { return };
    let points = cloud(&folder.join("mug-on-table.pcd"), Unit::Metre);
    for nominal_radius_mm in [None, Some(39.0)] {
        let found = detect(&points, &DetectRequest { nominal_radius_mm, ..DetectRequest::default() });
        let (angle, distance) = off(&found[0], V::new(54.2, 113.8, 795.6), V::new(0.0162, -0.8377, -0.5459));
        assert!(angle < 2.0 && distance < 3.0 && (found[0].radius - 39.0).abs() < 1.0, "{angle} {distance} {found:?}");
    }
}

/// The inside of pipes with artefacts at up to 65 m. Two of the three scans of the first pipe contain more of these.
#[test]
fn sewer_pipes_are_found_from_inside() {
    let Some(folder) = crate::real::outside("real") else { return };
    let slope = |degrees: f64| degrees.to_radians().tan();
    for (name, nominal, (point, direction), angle_max, distance_max) in [
        ("200mm-pvc-13", None, upright([7.40, -40.47, -300.0], slope(2.470), slope(13.917)), 0.1, 0.66),
        ("200mm-pvc-15", None, upright([7.40, -40.47, -300.0], slope(2.470), slope(13.917)), 0.3, 2.0),
        ("200mm-pvc-16", Some(94.3), upright([7.40, -40.47, -300.0], slope(2.470), slope(13.917)), 0.3, 2.0),
        ("195mm-concrete-22", Some(100.45), upright([21.9, 8.1, -275.0], 0.0, 0.0), 3.0, 2.0),
    ] {
        let points = cloud(&folder.join(format!("sewer-pipes/{name}.ply")), Unit::Metre);
        let found = detect(&points, &DetectRequest { nominal_radius_mm: nominal, ..DetectRequest::default() });
        let (angle, distance) = off(&found[0], point, direction);
        assert!(angle < angle_max && distance < distance_max, "{name}: {angle}° {distance} mm {found:?}");
    }
}

/// An arc of 25° with a scatter of 1.6 µm.
#[test]
fn the_land_of_a_bullet_is_detected() {
    let Some(folder) = crate::real::outside("real") else { return };
    let found = detect(&cloud(&folder.join("bullet-land/land.npy"), Unit::Millimetre), &DetectRequest::default());
    let axis = V::from(found[0].direction);
    let [deflection, pitch] = [axis.y / axis.x, axis.z / axis.x].map(|slope| slope.atan().to_degrees());
    assert!((deflection - 3.9).abs() < 0.1 && (pitch + 1.5).abs() < 0.1, "{deflection}° {pitch}°");
    assert!((found[0].radius - 4.45).abs() < 0.01 && (found[0].arc.to_degrees() - 25.0).abs() < 2.0, "{found:?}");
}

#[test]
fn noise_without_a_surface_has_no_cylinder() {
    let Some(folder) = crate::real::outside("real") else { return };
    let points = cloud(&folder.join("laser-profile-patch.npy"), Unit::Millimetre);
    assert_eq!(detect(&points, &DetectRequest::default()), Vec::new());
}

/// From 6 points on. The robust initial value differs from the published least squares by a fraction of the points' scatter.
#[test]
fn published_cylinders_are_found() {
    let Some(folder) = crate::real::outside("real") else { return };
    for set in 1..=30 {
        let points = rows(&folder.join(format!("nist-cylinders/cyl{set}.ds")), 1.0);
        let fit = fs::read_to_string(folder.join(format!("nist-cylinders/cyl{set}.fit"))).expect("the fit is there");
        let fit: Vec<f64> = fit.split_whitespace().filter_map(|number| number.parse().ok()).collect();
        let (point, direction, radius) =
            (V::from_column_slice(&fit[..3]), V::from_column_slice(&fit[3..6]), fit[6] / 2.0);
        let distance = |p: &[f64; 3]| (V::from(*p) - point).cross(&direction).norm() - radius;
        let rms = (points.iter().map(|p| distance(p).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
        let found = detect(&points, &DetectRequest::default());
        assert!(!found.is_empty(), "set {set}: {} points", points.len());
        let (angle, off_axis) = off(&found[0], point, direction);
        let off_radius = (found[0].radius - radius).abs();
        assert!(
            angle < 0.3 && off_axis.max(off_radius) < 2.0 * rms + 1e-6 * radius,
            "set {set}: {angle}° {off_axis} {found:?}"
        );
    }
}
