//! Every file of `tests/data`, of the measured files and of the reference sets is decoded with the counts of its header or
//! its truth.

#![expect(clippy::expect_used, clippy::indexing_slicing, reason = "a panic fails the test as intended")]

use coaxis::geometry::Frame;
use coaxis::scan::decode::{FormatClaims, Limits, Request, Unit, decode, find_format};
use coaxis::scan::slice::{Region, SliceRequest, slice};
use coaxis::scan::{Cloud, Columns, Labels, Scan};
use std::fs;
use std::path::{Path, PathBuf};

fn own(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn bytes_of(name: &str) -> Vec<u8> {
    fs::read(own(name)).expect("the file is there")
}

fn cloud_of(name: &str, unit: Option<Unit>) -> Cloud {
    cloud_at(&own(name), unit)
}

fn cloud_at(path: &Path, unit: Option<Unit>) -> Cloud {
    let bytes = fs::read(path).expect("the file is there");
    let name = path.display().to_string();
    let claims = FormatClaims { file_name: Some(&name), ..FormatClaims::default() };
    let format = find_format(&claims, bytes.get(..512).unwrap_or(&bytes)).expect("known");
    let limits = Limits::default();
    decode(format, &mut bytes.as_slice(), &Request { unit, ..Request::new(&limits) }).expect("reads")
}

fn scan_of(cloud: Cloud) -> Scan {
    slice(cloud, &SliceRequest::default(), &Limits::default()).expect("slices")
}

/// (profiles, points including missing ones) of a synthetic scan.
fn truth_of(name: &str) -> (usize, usize) {
    let truth: serde_json::Value = serde_json::from_slice(&bytes_of(name)).expect("JSON");
    let count = |key: &str| usize::try_from(truth[key].as_u64().expect("a count")).expect("small");
    (count("profiles_count"), count("profiles_count") * count("points_per_profile_count"))
}

#[test]
fn synthetic_scans_have_the_profiles_and_points_of_their_truth() {
    for (name, rule) in [
        ("clean-arc110.ply", "x_value"),
        ("interference-arc140.csv", "column=profile"),
        ("clamped-arc90.pcd", "row"),
        ("small-arc120.npy", "row"),
    ] {
        let stem = name.split('.').next().expect("a stem");
        let (profiles, places) = truth_of(&format!("made/{stem}.truth.json"));
        let cloud = cloud_of(&format!("made/{name}"), None);
        let (missing, found) = (cloud.missing_count, cloud.columns.len());
        let scan = scan_of(cloud);
        assert_eq!((scan.stations().len(), scan.rule()), (profiles, rule), "{name}");
        // The table does not contain drop-outs: its rows are its points, without the header and the end.
        let places = if name.ends_with("csv") {
            bytes_of("made/interference-arc140.csv").iter().filter(|byte| **byte == b'\n').count() - 1
        } else {
            places
        };
        assert_eq!(found + usize::try_from(missing).expect("small"), places, "{name}");
        assert!(found * 100 > places * 95, "{name}: a few drop-outs, not more");
    }
}

#[test]
fn the_truth_s_middle_is_the_middle_of_the_stations() {
    for stem in ["clean-arc110.ply", "interference-arc140.csv", "clamped-arc90.pcd", "small-arc120.npy"] {
        let scan = scan_of(cloud_of(&format!("made/{stem}"), None));
        let name = format!("made/{}.truth.json", stem.split('.').next().expect("a stem"));
        let truth: serde_json::Value = serde_json::from_slice(&bytes_of(&name)).expect("JSON");
        let xs: Vec<f64> = scan.stations().iter().map(|station| station.x).collect();
        let middle = f64::midpoint(xs[0], xs[xs.len() - 1]);
        assert!((middle - truth["x_ref_mm"].as_f64().expect("a number")).abs() < 1e-3, "{stem}");
    }
}

#[test]
fn single_and_double_precision_are_preserved() {
    assert!(matches!(cloud_of("made/clean-arc110.ply", None).columns, Columns::F32 { .. }));
    assert!(matches!(cloud_of("made/small-arc120.npy", None).columns, Columns::F64 { .. }));
}

#[test]
fn the_bolt_is_read_without_its_faces_and_with_its_unit() {
    let Some(bolt) = crate::real::outside("real/stud-bolt.ply") else { return };
    let cloud = cloud_at(&bolt, None);
    assert_eq!((cloud.columns.len(), cloud.missing_count), (8565, 0));
    let bytes = fs::read(&bolt).expect("the file is there");
    let limits = Limits::default();
    let format = find_format(&FormatClaims::default(), &bytes).expect("known");
    let request = Request { unit: Some(Unit::Metre), ..Request::new(&limits) };
    let error = decode(format, &mut bytes.as_slice(), &request).expect_err("the file says mm");
    assert_eq!(error.code(), "unit_conflict");
    assert!(scan_of(cloud).rule().ends_with("(chosen)"));
}

#[test]
fn the_mug_is_decompressed_and_cut_out_of_its_scene_in_a_declared_frame() {
    let Some(mug) = crate::real::outside("real/mug-on-table.pcd") else { return };
    let cloud = cloud_at(&mug, Some(Unit::Metre));
    assert_eq!(cloud.columns.len() as u64 + cloud.missing_count, 640 * 480);
    // Some frame across the view; the test is that the window is applied in it.
    let frame = Frame { origin_mm: [0.0, 0.0, 800.0], x_axis: [0.0, -1.0, 0.0], z_axis: [0.0, 0.0, -1.0] };
    let region = Region { x_mm: Some([-300.0, 300.0]), y_mm: Some([-200.0, 200.0]), z_mm: Some([-200.0, 200.0]) };
    let request = SliceRequest { rule: None, frame: Some(frame), region: Some(region) };
    let scan = slice(cloud, &request, &Limits::default()).expect("slices");
    assert!(scan.stations().len() > 10 && scan.rule().ends_with("(chosen)"), "{}", scan.rule());
    for station in scan.stations() {
        assert!(station.x.abs() <= 300.0);
        for index in station.start..station.end {
            assert!(scan.columns().get(index).expect("a point").iter().all(|value| value.abs() <= 200.0));
        }
    }
}

#[test]
fn the_laser_patch_has_its_profiles_along_y() {
    let Some(patch) = crate::real::outside("real/laser-profile-patch.npy") else { return };
    let cloud = cloud_at(&patch, None);
    assert_eq!(cloud.columns.len() as u64 + cloud.missing_count, 87_422);
    let frame = Frame { origin_mm: [0.0; 3], x_axis: [0.0, 1.0, 0.0], z_axis: [0.0, 0.0, 1.0] };
    let request = SliceRequest { frame: Some(frame), ..SliceRequest::default() };
    let scan = slice(cloud, &request, &Limits::default()).expect("slices");
    assert_eq!((scan.stations().len(), scan.rule()), (457, "x_value"));
}

#[test]
fn reference_points_are_read_to_the_last_digit() {
    let Some(folder) = crate::real::outside("reference") else { return };
    let cloud = cloud_at(&folder.join("tracker8.xyz"), None);
    assert_eq!((cloud.columns.len(), cloud.stripes[0].x), (8, -59.57));
    assert_eq!(cloud.columns.get(0), Some([-7.72, 17.57]));
    let cloud = cloud_at(&folder.join("cylinder20.xyz"), Some(Unit::Metre));
    assert_eq!((cloud.columns.len(), cloud.columns.get(0)), (20, Some([2.199_701 * 1000.0, 0.000_008 * 1000.0])));
}

/// The file has 1229 rows `name,x,y,z,` in metres without a header.
#[test]
fn the_tank_is_read_without_its_point_names() {
    let Some(path) = crate::real::outside("real/tank/scan.csv") else { return };
    let bytes = fs::read(&path).expect("the file is there");
    let limits = Limits::default();
    let format = find_format(&FormatClaims::default(), &bytes[..512]).expect("known");
    let request = Request { unit: Some(Unit::Metre), ..Request::new(&limits) };
    let cloud = decode(format, &mut bytes.as_slice(), &request).expect("reads");
    assert_eq!((cloud.columns.len(), cloud.missing_count, cloud.labels), (1229, 0, Labels::None));
    // Each row against its cells.
    let text = String::from_utf8(bytes).expect("text");
    for (index, line) in text.lines().enumerate() {
        let cells: Vec<f64> = line.split(',').skip(1).take(3).map(|cell| cell.parse().expect("a number")).collect();
        let stripe = cloud.stripes.iter().find(|stripe| index < stripe.end).expect("a stripe");
        assert_eq!(stripe.x, cells[0] * 1000.0, "{line}");
        assert_eq!(cloud.columns.get(index), Some([cells[1] * 1000.0, cells[2] * 1000.0]), "{line}");
    }
}
