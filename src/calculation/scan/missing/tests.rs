//! Field files and simulated scans with missing values in every position are cleaned; scans without any remain unchanged.

#![expect(clippy::print_stdout, reason = "a test reports the files that it skips")]

use super::*;
use crate::scan::decode::{Format, FormatClaims, Limits, Request, Unit, decode, find_format};
use crate::scan::synthetic::{Part, Sampling, Surroundings, make};
use crate::scan::{Columns, Labels, Scan, Stripe};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::{Path, PathBuf};

fn read(bytes: &[u8], name: &str, unit: Option<Unit>) -> Cloud {
    let claims = FormatClaims { file_name: Some(name), ..FormatClaims::default() };
    let format = find_format(&claims, bytes.get(..512).unwrap_or(bytes)).unwrap_or(Format::Csv);
    decode(format, &mut &*bytes, &Request { unit, ..Request::new(&Limits::default()) }).expect("it reads")
}

macro_rules! field {
    ($name:literal) => {
        read(include_bytes!(concat!("../../../../tests/data/field/", $name)), $name, None)
    };
}

/// A simulated scan as stored in a file: coordinates rounded to `step` (0 keeps them).
fn cloud_of(scan: &Scan, labels: Labels, step: f64) -> Cloud {
    let (mut y, mut z) = (Vec::new(), Vec::new());
    for index in 0..scan.columns().len() {
        let round = |value: f64| if step > 0.0 { (value / step).round() / (1.0 / step).round() } else { value };
        let [a, b] = scan.columns().get(index).expect("a point").map(round);
        y.push(a);
        z.push(b);
    }
    let label = |index: u32| if labels == Labels::None { 0.0 } else { f64::from(index) };
    let stripes = (0..).zip(scan.stations()).map(|(i, s)| Stripe { label: label(i), x: s.x, end: s.end }).collect();
    let columns = Columns::F64 { y, z };
    Cloud { stripes, columns, labels, unit: Unit::Millimetre, blanks: Vec::new(), missing_count: 0 }
}

fn frames() -> Labels {
    Labels::Column("frame".to_owned())
}

/// 100 profiles of 200 points.
fn part(seed: u64) -> Part {
    Part { profiles_count: 100, points_count: 200, ..Part::smooth(seed) }
}

/// Which points of each profile are written as missing.
#[derive(Debug, Clone, Copy)]
enum Place {
    Random,
    Edges,
}

/// Overwrites a share of the points; returns the cloud and their number.
fn damaged(mut cloud: Cloud, share: f64, place: Place, code: MissingKind, seed: u64) -> (Cloud, u64) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let Columns::F64 { y, z } = &mut cloud.columns else { panic!("double precision") };
    let (mut start, mut count) = (0, 0);
    for stripe in &cloud.stripes {
        let len = stripe.end - start;
        let edge = ((share * len as f64 / 2.0).round() as usize).max(1);
        for k in 0..len {
            let hit = match place {
                Place::Random => chance.random_bool(share),
                Place::Edges => k < edge || len - 1 - k < edge,
            };
            if hit {
                count += 1;
                match code {
                    MissingKind::Point { y: a, z: b, .. } => (y[start + k], z[start + k]) = (a, b),
                    MissingKind::Z(b) | MissingKind::Declared(b) => z[start + k] = b,
                }
            }
        }
        start = stripe.end;
    }
    (cloud, count)
}

fn texts(removed: &Removed) -> Vec<String> {
    removed.missing.iter().map(|value| format!("{value}: {}", value.count)).collect()
}

#[test]
fn values_for_no_return_are_removed_from_field_files() {
    // Counted in the text of the file with another tool.
    for (cloud, expected) in [
        (field!("zero3_edge_5.csv"), "(x, y, z) = (0, 0, 0): 134"),
        (field!("zero3_edge_20.csv"), "(x, y, z) = (0, 0, 0): 536"),
        (field!("zero3_rand_10.csv"), "(x, y, z) = (0, 0, 0): 260"),
        (field!("sentinel_9999_1of40.csv"), "z = -9999: 67"),
        (field!("sentinel_999_4of40.csv"), "z = -999: 268"),
        (field!("sent_-99999_edges20.csv"), "z = -99999: 536"),
    ] {
        let (points, blanks) = (cloud.columns.len() as u64, cloud.blanks.clone());
        let (cleaned, removed) = clean(cloud, None);
        assert_eq!(texts(&removed), [expected]);
        assert_eq!((removed.repeated_profiles, removed.profiles, &cleaned.blanks), (0, 67, &blanks));
        assert_eq!(cleaned.columns.len() as u64 + cleaned.missing_count, points);
        assert_eq!(cleaned.stripes.last().map(|stripe| stripe.end), Some(cleaned.columns.len()));
    }
}

#[test]
fn profiles_that_were_delivered_twice_count_once() {
    for cloud in [field!("dup_x2_label.csv"), field!("stale_x2.csv")] {
        let unlabelled = Cloud { labels: Labels::None, ..cloud.clone() };
        for cloud in [cloud, unlabelled] {
            let (cleaned, removed) = clean(cloud, None);
            assert_eq!((removed.repeated_profiles, removed.profiles, removed.missing.len()), (25, 50, 0));
            assert_eq!((cleaned.columns.len(), cleaned.missing_count, cleaned.blanks.len()), (1000, 0, 0));
            assert_eq!(cleaned.stripes.last().map(|stripe| stripe.end), Some(1000));
        }
    }
}

/// A file that is delivered twice, two profiles merged under one x, and a sensor that stops half-way.
#[test]
fn repeats_are_found_at_every_position() {
    let (scan, _) = make(&part(1)).expect("points");
    let cloud = cloud_of(&scan, frames(), 0.001);
    let twice = |order: &[usize], labels: Labels| {
        let (mut y, mut z, mut stripes): (Vec<f64>, Vec<f64>, Vec<Stripe>) = Default::default();
        for (place, index) in order.iter().enumerate() {
            let station = scan.stations()[*index];
            for point in (station.start..station.end).filter_map(|index| cloud.columns.get(index)) {
                y.push(point[0]);
                z.push(point[1]);
            }
            stripes.push(Stripe { label: place as f64, x: place as f64, end: y.len() });
        }
        Cloud { stripes, columns: Columns::F64 { y, z }, labels, ..cloud.clone() }
    };
    let whole: Vec<usize> = (0..100).chain(0..100).collect();
    let frozen: Vec<usize> = (0..100).map(|i: usize| i.min(60)).collect();
    assert_eq!(clean(twice(&whole, frames()), None).1.repeated_profiles, 100);
    assert_eq!(clean(twice(&frozen, Labels::None), None).1.repeated_profiles, 39);
    let mut merged = twice(&[0, 0, 1, 2, 2, 3], Labels::None);
    merged.stripes = [2, 3, 5, 6].map(|n| Stripe { label: 0.0, x: n as f64, end: n * 200 }).to_vec();
    let (cleaned, removed) = clean(merged, None);
    assert_eq!((removed.repeated_profiles, removed.profiles), (2, 6));
    assert_eq!(cleaned.stripes.iter().map(|stripe| stripe.end).collect::<Vec<_>>(), [200, 400, 600, 800]);
}

#[test]
fn a_scan_without_noise_has_equal_profiles_and_keeps_them() {
    let straight = crate::geometry::AxisLine { p: 0.0, q: 0.0, y0: 1.0, z0: 2.0 };
    for step in [0.0, 1e-6, 1e-3, 0.1] {
        for base in [Part::smooth(1), Part::with_interference(1)] {
            let part = Part { noise_sigma_mm: 0.0, axis: straight, profiles_count: 100, points_count: 200, ..base };
            let (scan, _) = make(&part).expect("points");
            let cloud = cloud_of(&scan, frames(), step);
            assert_eq!(
                clean(cloud.clone(), None),
                (cloud, Removed { points: 20_000, profiles: 100, ..Removed::default() })
            );
        }
    }
}

/// Simulated scans of every kind without missing values.
fn scenes() -> Vec<(String, Part)> {
    let floor =
        Surroundings { floor: 0.3, floor_depth_mm: 250.0, support: 0.2, supports: 0.5, ..Surroundings::default() };
    let mut scenes = Vec::new();
    for noise_sigma_mm in [0.0, 0.005, 0.02, 0.05, 0.3] {
        for (name, surroundings) in [("bare", Surroundings::default()), ("floor", floor)] {
            for sampling in [Sampling::EvenAngle, Sampling::EvenAcross] {
                for (kind, base) in [("smooth", Part::smooth(1)), ("interference", Part::with_interference(2))] {
                    for level in [false, true] {
                        let mut part = Part {
                            noise_sigma_mm,
                            surroundings,
                            sampling,
                            profiles_count: 100,
                            points_count: 200,
                            spike_ratio: if level { 0.0 } else { 0.02 },
                            noise_correlation: if level { 0.7 } else { 0.0 },
                            ..base.clone()
                        };
                        if level {
                            (part.axis.p, part.axis.q) = (0.0, 0.0);
                        }
                        let name = format!("{kind} {name} {sampling:?} level {level} noise {noise_sigma_mm}");
                        scenes.push((name, part));
                    }
                }
            }
        }
    }
    scenes
}

#[test]
fn nothing_is_missing_in_simulated_scans() {
    let mut count = 0;
    for (name, part) in scenes() {
        let (scan, _) = make(&part).expect("points");
        for step in [0.0, 0.001, 0.01, 0.1] {
            for labels in [frames(), Labels::None] {
                let cloud = cloud_of(&scan, labels, step);
                let points = cloud.columns.len();
                let (cleaned, removed) = clean(cloud, None);
                assert_eq!((texts(&removed), removed.repeated_profiles), (vec![], 0), "{name}, step {step}");
                assert_eq!(cleaned.columns.len(), points);
                count += 1;
            }
        }
    }
    println!("{count} scans");
}

/// The order of the points in the file has no meaning here, so there are no neighbours and no noise.
#[test]
fn nothing_is_missing_in_shuffled_scans() {
    for (name, part) in scenes() {
        let (scan, _) = make(&part).expect("points");
        for step in [0.001, 0.01, 0.1] {
            let cloud = shuffled(&cloud_of(&scan, Labels::None, step));
            assert_eq!(texts(&clean(cloud, None).1), Vec::<String>::new(), "{name}, step {step}");
        }
    }
}

fn shuffled(cloud: &Cloud) -> Cloud {
    let mut chance = ChaCha8Rng::seed_from_u64(7);
    let mut points = Vec::new();
    let mut start = 0;
    for stripe in &cloud.stripes {
        points.extend((start..stripe.end).map(|i| (stripe.x, cloud.columns.get(i).expect("a point"))));
        start = stripe.end;
    }
    for index in (1..points.len()).rev() {
        points.swap(index, chance.random_range(0..=index));
    }
    let stripes = (1..).zip(&points).map(|(end, (x, _))| Stripe { label: 0.0, x: *x, end }).collect();
    let (y, z) = points.iter().map(|(_, [y, z])| (*y, *z)).unzip();
    Cloud { stripes, columns: Columns::F64 { y, z }, labels: Labels::None, ..cloud.clone() }
}

#[test]
fn missing_values_are_found_at_every_position() {
    let floor = Surroundings { floor: 0.3, floor_depth_mm: 250.0, ..Surroundings::default() };
    let (mut count, mut wrong) = (0, Vec::new());
    for (noise, step) in [(0.02, 0.001), (0.05, 0.001), (0.05, 0.01), (0.02, 0.0)] {
        for surroundings in [Surroundings::default(), floor] {
            let part = Part { noise_sigma_mm: noise, surroundings, spike_ratio: 0.01, ..part(3) };
            let (scan, _) = make(&part).expect("points");
            let cloud = cloud_of(&scan, frames(), step);
            for share in [0.005, 0.01, 0.03, 0.1, 0.3] {
                for place in [Place::Random, Place::Edges] {
                    for code in [0.0, 9999.0, -99999.0, 65.535, 100.0].map(MissingKind::Z).into_iter().chain([
                        MissingKind::Point { x: None, y: 0.0, z: 0.0 },
                        MissingKind::Point { x: None, y: 12.5, z: 190.0 },
                    ]) {
                        // Within the range of the part's own points a coarse lattice hides 1/200 of them, which the robust fit
                        // rejects.
                        let amid = matches!(code, MissingKind::Point { z: 190.0, .. });
                        if amid && step == 0.01 && share == 0.005 {
                            continue;
                        }
                        let (cloud, hits) = damaged(cloud.clone(), share, place, code, 9);
                        let (_, removed) = clean(cloud, None);
                        count += 1;
                        // Points that have that z by chance are removed as well: at most the step's share of the noise.
                        let extra = removed.missing_count() as f64 - hits as f64;
                        if removed.missing.len() != 1 || !(0.0..=100.0).contains(&extra) {
                            wrong.push(format!(
                                "noise {noise} step {step} floor {} {share} {place:?} {code:?} {hits}: {:?}",
                                surroundings.floor,
                                texts(&removed)
                            ));
                        }
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{} of {count}\n{}", wrong.len(), wrong.join("\n"));
    println!("{count} scans");
}

fn real(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("COAXIS_REAL_DATA").map_or_else(beside, PathBuf::from).join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {name} is not there");
    None
}

#[test]
fn nothing_is_missing_in_measured_files() {
    for (folder, unit) in [
        ("real", None),
        ("real/lamppost", Some(Unit::Metre)),
        ("real/tank", Some(Unit::Metre)),
        ("real/sewer-pipes", Some(Unit::Metre)),
        ("real/bullet-land", None),
        ("made", None),
        ("reference", None),
    ] {
        let Some(path) = real(folder) else { continue };
        for path in fs::read_dir(path).expect("a folder").map(|entry| entry.expect("an entry").path()) {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            let kind = path.extension().and_then(|kind| kind.to_str()).unwrap_or_default();
            if ["ply", "pcd", "npy", "csv", "xyz"].contains(&kind) {
                let cloud = read(&fs::read(&path).expect("readable"), &name, unit);
                let (points, missing) = (cloud.columns.len() as u64, cloud.missing_count);
                let (cleaned, removed) = clean(cloud, None);
                assert_eq!((texts(&removed), removed.repeated_profiles), (vec![], 0), "{name}");
                assert_eq!((cleaned.columns.len() as u64, cleaned.missing_count), (points, missing), "{name}");
            }
        }
    }
}

#[test]
fn measured_and_simulated_files_without_missing_values_remain_unchanged() {
    for cloud in [field!("frame_plain.csv"), field!("wild_x.csv")] {
        let (cleaned, removed) = clean(cloud.clone(), None);
        assert_eq!((cleaned, removed.missing.len(), removed.repeated_profiles), (cloud, 0, 0));
    }
}

#[test]
fn declared_values_are_removed_in_the_unit_and_the_precision_of_the_file() {
    let text = "frame,x,y,z\n0,1,0.5,65.535\n0,1,0.25,0.75\n1,2,-9,0.5\n1,2,0.5,65.535\n2,-9,1,1\n";
    for unit in [Unit::Millimetre, Unit::Metre, Unit::Inch] {
        let cloud = read(text.as_bytes(), "a.csv", Some(unit));
        let mm = |value: f64| value * unit.in_mm();
        let (cleaned, removed) = clean(cloud.clone(), Some(&[65.535, -9.0, 7.0, f64::NAN]));
        assert_eq!(texts(&removed), ["x, y or z = 65.535: 2", "x, y or z = -9: 2"]);
        // Profile 1 keeps its plane without points; the plane of profile 2 is unknown.
        assert_eq!((cleaned.blanks, cleaned.missing_count), (vec![mm(2.0)], 4));
        assert_eq!(cleaned.columns, Columns::F64 { y: vec![mm(0.25)], z: vec![mm(0.75)] });
        assert_eq!(cleaned.stripes, [Stripe { label: 0.0, x: mm(1.0), end: 1 }]);
        assert!(clean(cloud, Some(&[65.535, -9.0, 0.75])).0.columns.is_empty());
    }
    let single = Cloud {
        stripes: vec![Stripe { label: 0.0, x: f64::from(0.1_f32), end: 2 }, Stripe { label: 1.0, x: 1.0, end: 3 }],
        columns: Columns::F32 { y: vec![1.0, 2.0, 3.0], z: vec![1.0, 2.0, 65.535] },
        labels: frames(),
        unit: Unit::Millimetre,
        blanks: Vec::new(),
        missing_count: 0,
    };
    let (cleaned, removed) = clean(single, Some(&[0.1, 65.535]));
    assert_eq!(
        (texts(&removed), cleaned.columns.len()),
        (vec!["x, y or z = 0.1: 2".into(), "x, y or z = 65.535: 1".into()], 0)
    );
}

#[test]
fn profiles_that_lose_all_their_points_become_blanks_unless_their_plane_is_a_code_too() {
    let (scan, _) = make(&part(4)).expect("points");
    let at = |x_too: bool| {
        let mut cloud = cloud_of(&scan, frames(), 0.001);
        let Columns::F64 { y, z } = &mut cloud.columns else { panic!("double precision") };
        y[..2000].fill(0.0);
        z[..2000].fill(0.0);
        if x_too {
            cloud.stripes[..10].iter_mut().for_each(|stripe| stripe.x = 0.0);
        }
        let planes: Vec<f64> = cloud.stripes[..10].iter().map(|stripe| stripe.x).collect();
        (clean(cloud, None), planes)
    };
    let ((cleaned, removed), planes) = at(false);
    assert_eq!((texts(&removed), cleaned.blanks), (vec!["(y, z) = (0, 0): 2000".to_owned()], planes));
    let ((cleaned, removed), _) = at(true);
    assert_eq!((texts(&removed), cleaned.blanks), (vec!["(x, y, z) = (0, 0, 0): 2000".to_owned()], vec![]));
}

#[test]
fn two_different_values_are_found() {
    let (scan, _) = make(&part(5)).expect("points");
    let cloud = cloud_of(&scan, frames(), 0.001);
    let (cloud, first) = damaged(cloud, 0.05, Place::Random, MissingKind::Z(-99999.0), 1);
    let (cloud, second) = damaged(cloud, 0.02, Place::Edges, MissingKind::Z(0.0), 2);
    let (_, removed) = clean(cloud, None);
    assert!(removed.missing.len() == 2 && removed.missing_count() <= first + second, "{:?}", texts(&removed));
    assert!(removed.missing.iter().any(|value| value.kind == MissingKind::Z(0.0) && value.count == second));
}

/// The cleaned cloud of any content is valid and not larger.
#[test]
fn degenerate_clouds_are_accepted() {
    let cloud = |y: Vec<f64>, z: Vec<f64>| Cloud {
        stripes: vec![Stripe { label: 0.0, x: 0.0, end: y.len() }],
        columns: Columns::F64 { y, z },
        labels: Labels::Row,
        unit: Unit::Millimetre,
        blanks: Vec::new(),
        missing_count: 0,
    };
    for count in [0_usize, 1, 2, 7, 8, 100, 20_000] {
        let line = (0..count).map(|i| i as f64).collect::<Vec<_>>();
        for cloud in [
            cloud(vec![0.0; count], vec![0.0; count]),
            cloud(line.clone(), vec![1.0; count]),
            cloud(line.clone(), line),
        ] {
            let (cleaned, removed) = clean(cloud, None);
            assert_eq!(cleaned.columns.len() as u64 + removed.missing_count(), count as u64);
        }
    }
}
