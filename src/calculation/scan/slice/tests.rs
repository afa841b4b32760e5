//! The rules and their refusals.

use super::*;
use crate::scan::decode::Unit;
use crate::scan::{Columns, Labels, Stripe};

/// A cloud of points (label, x, y), z = −y.
fn cloud(labels: Labels, points: &[(f64, f64, f64)]) -> Cloud {
    let stripes = (1..).zip(points).map(|(end, (label, x, _))| Stripe { label: *label, x: *x, end }).collect();
    let y: Vec<f64> = points.iter().map(|(_, _, y)| *y).collect();
    let z = y.iter().map(|y| -y).collect();
    Cloud {
        stripes,
        columns: Columns::F64 { y, z },
        labels,
        unit: Unit::Millimetre,
        blanks: Vec::new(),
        missing_count: 0,
    }
}

/// `profiles` at steps of `step`, ten points each; x within a profile varies by up to `spread`.
fn regular(labels: Labels, profiles: u32, step: f64, spread: f64) -> Cloud {
    let points: Vec<_> = (0..profiles * 10)
        .map(|i| (f64::from(i / 10), f64::from(i / 10) * step + f64::from(i % 10) / 9.0 * spread, f64::from(i)))
        .collect();
    cloud(labels, &points)
}

fn sliced(cloud: Cloud, rule: Option<&str>) -> Result<Scan, SliceError> {
    let rule = rule.map(|rule| ProfileRule::parse(rule).expect("a rule"));
    slice(cloud, &SliceRequest { rule, ..SliceRequest::default() }, &Limits::default())
}

fn column() -> Labels {
    Labels::Column("frame".to_owned())
}

/// (x, y of the points) of each profile.
fn profiles(scan: &Scan) -> Vec<(f64, Vec<f64>)> {
    let y = |index| scan.columns().get(index).expect("a point")[0];
    scan.stations().iter().map(|station| (station.x, (station.start..station.end).map(y).collect())).collect()
}

#[test]
fn the_rule_is_chosen_from_the_properties_of_the_cloud() {
    for (cloud, rule) in [
        (regular(column(), 5, 1.0, 3.0), "column=frame"),
        (regular(Labels::Row, 5, 1.0, 0.05), "row"),
        (regular(Labels::Row, 5, 1.0, 0.0), "row"),
        (regular(Labels::None, 5, 1.0, 0.0), "x_value"),
        (regular(Labels::None, 20, 0.5, 0.5), "x_value (chosen)"),
        (regular(Labels::None, 100, 0.5, 0.5), "x_pitch_mm=5 (chosen)"),
        (regular(Labels::Row, 100, 0.5, 0.5), "x_pitch_mm=5 (chosen)"),
    ] {
        assert_eq!(sliced(cloud, None).expect("slices").rule(), rule);
    }
}

/// Labels of tiles of five lines, a constant, the number of a laser beam, and an angle of rotation.
#[test]
fn a_column_that_does_not_separate_profiles_is_ignored_and_named() {
    let points = |label: &dyn Fn(u32) -> u32, x: &dyn Fn(u32) -> f64| -> Vec<_> {
        (0..1600).map(|i| (f64::from(label(i)), x(i), f64::from(i % 40))).collect()
    };
    let lines = |i: u32| f64::from(i / 40) * 2.5;
    let anywhere = |i: u32| f64::from(i * 7919 % 1600) * 0.0625;
    for (points, rule, profiles) in [
        (points(&|i| i / 200, &lines), "x_value (the column frame does not separate profiles)", 40),
        (points(&|_| 1, &lines), "x_value (the column frame does not separate profiles)", 40),
        (points(&|i| i % 4, &anywhere), "x_pitch_mm=5 (chosen; the column frame does not separate profiles)", 21),
        (points(&|i| i / 40, &|i| f64::from(i % 40)), "x_value (the column frame does not separate profiles)", 40),
    ] {
        let scan = sliced(cloud(column(), &points), None).expect("slices");
        assert_eq!((scan.rule(), scan.stations().len()), (rule, profiles));
        assert_eq!(sliced(cloud(column(), &points), Some("column")).expect("slices").rule(), "column=frame");
    }
}

/// Profiles whose points have individual x, outliers, profiles out of order, and a stage that stands still.
#[test]
fn a_column_that_separates_profiles_is_used_for_any_x_within_them() {
    let points = |x: &dyn Fn(u32, u32) -> f64| -> Vec<_> {
        (0..1600).map(|i| (f64::from(i / 40), x(i / 40, i % 40), f64::from(i % 40))).collect()
    };
    for points in [
        points(&|profile, point| f64::from(profile) * 2.0 + f64::from(point) * 0.351),
        points(&|profile, point| if point == 0 { 9999.0 } else { f64::from(profile) }),
        points(&|profile, point| if point % 4 == 0 { 0.0 } else { f64::from(profile) + 50.0 }),
        points(&|profile, _| f64::from(profile * 7 % 40)),
        points(&|_, _| 1.0),
    ] {
        let scan = sliced(cloud(column(), &points), None).expect("slices");
        assert_eq!((scan.rule(), scan.stations().len()), ("column=frame", 40));
    }
}

#[test]
fn a_requested_rule_is_used_and_named() {
    for (rule, name) in [
        ("column", "column=frame"),
        ("column:FRAME", "column=frame"),
        ("x_value", "x_value"),
        ("x_pitch_mm=0.5", "x_pitch_mm=0.5"),
        ("x_pitch_mm", "x_pitch_mm=5 (chosen)"),
    ] {
        assert_eq!(sliced(regular(column(), 5, 1.0, 0.0), Some(rule)).expect("slices").rule(), name);
    }
    assert_eq!(sliced(regular(Labels::Row, 5, 1.0, 3.0), Some("row")).expect("slices").stations().len(), 5);
}

#[test]
fn profiles_are_sorted_by_x_and_their_points_keep_the_order_of_the_file() {
    let points = [(2.0, 9.0, 0.0), (1.0, 3.0, 1.0), (2.0, 9.0, 2.0), (1.0, 4.0, 3.0), (3.0, 1.0, 4.0), (1.0, 5.0, 5.0)];
    let expected = [(1.0, vec![4.0]), (4.0, vec![1.0, 3.0, 5.0]), (9.0, vec![0.0, 2.0])];
    let scan = sliced(cloud(column(), &points), None).expect("slices");
    assert_eq!(profiles(&scan), expected);
    // Already in order, the same points give the same scan.
    let sorted = [points[4], points[1], points[3], points[5], points[0], points[2]];
    let rising: Vec<_> =
        (0..).zip([0, 1, 1, 1, 2, 2]).map(|(i, label)| (f64::from(label), sorted[i].1, sorted[i].2)).collect();
    assert_eq!(profiles(&sliced(cloud(column(), &rising), None).expect("slices")), expected);
}

#[test]
fn equal_x_under_two_labels_are_two_profiles_and_x_is_the_exact_common_value() {
    let points: Vec<_> = (0..20).map(|i| (f64::from(i / 7), 0.1, f64::from(i))).collect();
    let scan = sliced(cloud(column(), &points), None).expect("slices");
    assert_eq!(
        scan.stations().iter().map(|s| (s.x, s.end - s.start)).collect::<Vec<_>>(),
        [(0.1, 7), (0.1, 7), (0.1, 6)]
    );
    assert_eq!(sliced(cloud(column(), &points), Some("x_value")).expect("slices").stations().len(), 1);
}

#[test]
fn discrete_x_are_found_in_any_order() {
    let points: Vec<_> = (0..40).map(|i| (0.0, f64::from(i * 7 % 4) - 0.0, f64::from(i))).collect();
    let scan = sliced(cloud(Labels::None, &points), None).expect("slices");
    assert_eq!((scan.rule(), scan.stations().len()), ("x_value", 4));
    assert!(profiles(&scan).iter().all(|(_, ys)| ys.len() == 10 && ys.is_sorted()));
}

#[test]
fn rules_that_do_not_fit_the_cloud_are_refused() {
    for (labels, rule, code) in [
        (Labels::None, "row", "no_rows"),
        (Labels::Row, "column", "no_profile_column"),
        (column(), "column=line", "no_profile_column"),
        (Labels::None, "x_pitch_mm=0.0000001", "pitch_too_small"),
        (Labels::None, "x_pitch_mm=1e-300", "pitch_too_small"),
    ] {
        assert_eq!(sliced(regular(labels, 5, 1.0, 0.0), Some(rule)).expect_err("refused").code(), code, "{rule}");
    }
    let request = SliceRequest { rule: Some(ProfileRule::XPitch(Some(-1.0))), ..SliceRequest::default() };
    let error = slice(regular(Labels::None, 5, 1.0, 0.0), &request, &Limits::default());
    assert_eq!(error, Err(SliceError::PitchInvalid));
}

#[test]
fn limits_apply_to_ordered_and_unordered_clouds() {
    let few = Limits { profiles_max: 4, ..Limits::default() };
    let short = Limits { points_per_profile_max: 9, ..Limits::default() };
    for step in [1.0, -1.0] {
        let cloud = || regular(column(), 5, step, 0.0);
        let refused = |limits| slice(cloud(), &SliceRequest::default(), limits).expect_err("beyond").code();
        assert_eq!((refused(&few), refused(&short)), ("too_many_profiles", "profile_too_long"));
    }
    // An automatically chosen pitch respects the limit.
    let scan = slice(regular(Labels::None, 100, 0.5, 0.5), &SliceRequest::default(), &few).expect("slices");
    assert_eq!(scan.rule(), "x_pitch_mm=20 (chosen)");
}

#[test]
fn a_region_keeps_its_bounds_and_an_empty_one_is_refused() {
    let request = |region| SliceRequest { region: Some(region), ..SliceRequest::default() };
    let region = Region { x_mm: Some([1.0, 3.0]), y_mm: Some([15.0, 32.0]), z_mm: None };
    let scan = slice(regular(Labels::Row, 5, 1.0, 0.0), &request(region), &Limits::default()).expect("slices");
    let counts: Vec<_> = scan.stations().iter().map(|s| (s.x, s.end - s.start)).collect();
    assert_eq!(counts, [(1.0, 5), (2.0, 10), (3.0, 3)]);
    let nowhere = Region { z_mm: Some([1.0, 2.0]), ..Region::default() };
    let error = slice(regular(Labels::Row, 5, 1.0, 0.0), &request(nowhere), &Limits::default());
    assert_eq!(error, Err(SliceError::RegionEmpty { points: 50 }));
    for bound in [[2.0, 1.0], [f64::NAN, 1.0]] {
        let wrong = Region { y_mm: Some(bound), ..Region::default() };
        assert_eq!(wrong.check(), Err(RegionError { axis: "y_mm" }));
    }
}

#[test]
fn a_frame_is_applied_before_the_region() {
    // The rail along the cloud's −y, its Z along the cloud's x.
    let frame = Frame { origin_mm: [1.0, 2.0, 3.0], x_axis: [0.0, -1.0, 0.0], z_axis: [1.0, 0.0, 0.0] };
    let request = SliceRequest { rule: Some(ProfileRule::XValue), frame: Some(frame), region: None };
    let points = cloud(Labels::None, &[(0.0, 10.0, 20.0), (0.0, 11.0, 30.0)]);
    let scan = slice(points, &request, &Limits::default()).expect("slices");
    // y' = z' × x' = (1,0,0) × (0,−1,0) = (0,0,−1): −(z − 3), with z = −20 and −30.
    assert_eq!(scan.stations().iter().map(|s| s.x).collect::<Vec<_>>(), [-28.0, -18.0]);
    assert_eq!((scan.columns().get(0), scan.columns().get(1)), (Some([33.0, 10.0]), Some([23.0, 9.0])));
}

/// A rail along the cloud's −x keeps the planes; along its y they have no common x.
#[test]
fn planes_without_points_remain_if_the_frame_leaves_them_at_one_x() {
    let blanks = |x_axis: [f64; 3]| {
        let frame = Frame { origin_mm: [1.0, 0.0, 0.0], x_axis, z_axis: [0.0, 0.0, 1.0] };
        let request = SliceRequest { rule: Some(ProfileRule::XValue), frame: Some(frame), region: None };
        let points = Cloud { blanks: vec![12.0, 13.0], ..cloud(Labels::None, &[(0.0, 10.0, 20.0), (0.0, 11.0, 30.0)]) };
        slice(points, &request, &Limits::default()).expect("slices").blanks().to_vec()
    };
    assert_eq!(blanks([-2.0, 0.0, 0.0]), [-12.0, -11.0]);
    assert!(blanks([0.0, 1.0, 0.0]).is_empty());
}

#[test]
fn a_frame_must_not_move_points_beyond_the_limit_of_coordinates() {
    let frame = |origin| Frame { origin_mm: [origin, 0.0, 0.0], x_axis: [1e200, 0.0, 0.0], z_axis: [0.0, 0.0, 1.0] };
    let request = |origin| SliceRequest { frame: Some(frame(origin)), ..SliceRequest::default() };
    let limits = Limits { coordinate_max_mm: 1000.0, ..Limits::default() };
    let cloud = || regular(Labels::Row, 5, 1.0, 0.0);
    slice(cloud(), &request(1000.0), &limits).expect("at x from -1000 on");
    let error = slice(cloud(), &request(1000.5), &limits).expect_err("beyond");
    assert_eq!(error, SliceError::CoordinateOutOfRange { index: 0, value: -1000.5, limit: 1000.0 });
    assert!(error.to_string().contains("coordinate_max_mm"), "{error}");
    let error = slice(cloud(), &request(1e300), &Limits::default()).expect_err("beyond");
    assert_eq!(error.code(), "coordinate_out_of_range");
}

#[test]
fn requested_slabs_are_not_profiles_of_the_sensor() {
    let grouping = |cloud, rule| sliced(cloud, rule).expect("slices").grouping();
    let unordered = || regular(Labels::None, 100, 0.5, 0.5);
    assert_eq!(grouping(unordered(), None), Grouping::Chosen);
    for rule in ["x_pitch_mm", "x_pitch_mm=5"] {
        assert_eq!(grouping(unordered(), Some(rule)), Grouping::Slabs, "{rule}");
        assert_eq!(grouping(regular(Labels::None, 5, 1.0, 0.0), Some(rule)), Grouping::Slabs, "{rule}");
        assert_eq!(grouping(regular(column(), 5, 1.0, 0.0), Some(rule)), Grouping::Given, "{rule}");
        assert_eq!(grouping(regular(Labels::Row, 5, 1.0, 0.0), Some(rule)), Grouping::Given, "{rule}");
    }
    assert_eq!(grouping(unordered(), Some("x_value")), Grouping::Given);
}
