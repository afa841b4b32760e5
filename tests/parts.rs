//! Two parts in one scan: each is detected and measured like a single part, whatever lies between them. Truth and bound
//! come from the generator of the parts, never from an estimate.

#![expect(clippy::panic, clippy::expect_used, reason = "a test may fail")]

use coaxis::estimation::{
    ByGap, Estimate, Method, Outcome, PartRule, Parts, Pose, Progress, RadiusRule, Reason, Refusal, ScanEstimate,
    Settings, Warning, Window, estimate, estimate_parts,
};
use coaxis::geometry::AxisLine;
use coaxis::scan::synthetic::{Interference, Part, Truth, make, make_several};
use coaxis::scan::{Columns, Scan, Station};

/// An error of a normal estimator that reaches its bound exceeds this many bounds once in 10⁶ times.
const BOUNDS_MAX: f64 = 5.0;

fn moving() -> Part {
    Part { arc_deg: 120.0, length_mm: 380.0, profiles_count: 190, points_count: 320, ..Part::smooth(1) }
}

/// After the moving part, 60 mm from it, thinner, with another tilt and with clamps.
fn fixed() -> Part {
    let clamps = Interference { clamps: 0.4, clamp_arc: 0.5, clamp_height_mm: 20.0, ..Interference::default() };
    Part {
        radius_mm: 150.0,
        axis: AxisLine { p: -0.02, q: 0.01, y0: 12.0, z0: -45.0 },
        x_start_mm: 440.0,
        interference: clamps,
        seed: 2,
        ..moving()
    }
}

fn both() -> (Scan, [Truth; 2]) {
    let (scan, truths) = make_several(&[moving(), fixed()]).expect("parts in order");
    (scan, truths.try_into().expect("two"))
}

fn settings() -> Settings {
    Settings { method: Method::Cylinder, ..Settings::default() }
}

fn window(name: &str, x_min_mm: f64, x_max_mm: f64) -> Window {
    Window { name: name.to_owned(), x_min_mm, x_max_mm, nominal_radius_mm: None }
}

fn gap(gap_min_mm: f64) -> PartRule {
    PartRule::ByGap(ByGap { gap_min_mm, count: None })
}

fn parts(scan: &Scan, settings: &Settings, rule: &PartRule) -> Parts {
    rule.check(settings).expect("a rule that can be used");
    match estimate_parts(scan, settings, rule, &Progress::default()) {
        ScanEstimate::Parts(parts) => parts,
        ScanEstimate::Whole(_) => panic!("parts were asked for"),
    }
}

fn pose(estimate: &Estimate) -> &Pose {
    match &estimate.outcome {
        Outcome::Accepted(pose) => pose,
        Outcome::Refused(refusal) => panic!("refused: {refusal}"),
    }
}

fn refusal(estimate: &Estimate) -> &Refusal {
    match &estimate.outcome {
        Outcome::Accepted(pose) => panic!("accepted: {pose:?}"),
        Outcome::Refused(refusal) => refusal,
    }
}

/// Asserts that the error of the pose is within the bound.
fn assert_within_bounds(estimate: &Estimate, truth: &Truth) {
    let (pose, bound) = (pose(estimate), truth.bound.expect("noise has a bound"));
    let [y, z] = pose.axis.at(truth.x_ref_mm);
    let errors = [
        (pose.axis.deflection().degrees() - truth.deflection_deg) / bound.deflection_deg,
        (pose.axis.pitch().degrees() - truth.pitch_deg) / bound.pitch_deg,
        (y - truth.y_ref_mm) / bound.y_ref_mm,
        (z - truth.z_ref_mm) / bound.z_ref_mm,
        (pose.radius - truth.radius_mm) / bound.radius_mm,
    ];
    assert!(errors.iter().all(|error| error.abs() < BOUNDS_MAX), "{errors:.2?} bounds");
}

/// Profiles with their points.
type Profiles = Vec<(f64, Vec<[f64; 2]>)>;

fn profiles_of(scan: &Scan) -> Profiles {
    let points =
        |range: std::ops::Range<usize>| range.map(|index| scan.columns().get(index).expect("a point")).collect();
    scan.stations().iter().map(|station| (station.x, points(station.start..station.end))).collect()
}

fn scan_of(mut profiles: Profiles) -> Scan {
    profiles.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (mut y, mut z, mut stations) = (Vec::new(), Vec::new(), Vec::new());
    for (x, points) in profiles {
        let start = y.len();
        y.extend(points.iter().map(|point| point[0]));
        z.extend(points.iter().map(|point| point[1]));
        stations.push(Station { x, start, end: y.len() });
    }
    Scan::new(stations, Columns::F64 { y, z }, "made".to_owned()).expect("in order")
}

/// The scan with further profiles of these points after `x`, 1.5 mm apart.
fn with_between(scan: &Scan, x: f64, count: usize, points: impl Fn(usize) -> Vec<[f64; 2]>) -> Scan {
    let between = (0..count).map(|index| (x + 1.5 * (index + 1) as f64, points(index)));
    scan_of(profiles_of(scan).into_iter().chain(between).collect())
}

/// The support below the rail, slightly uneven.
fn floor(index: usize) -> Vec<[f64; 2]> {
    let uneven = |i: usize| 0.05 * ((i * 37 + index * 11) % 13) as f64 / 13.0;
    (0..320).map(|i| [i as f64 * 1.25 - 200.0, -160.0 + uneven(i)]).collect()
}

#[test]
fn both_parts_are_found_by_windows_and_by_gap_as_exactly_as_the_data_allow() {
    let (scan, truths) = both();
    let windows = PartRule::Windows(vec![window("fixed", 400.0, 900.0), window("moving", -10.0, 400.0)]);
    let by_window = parts(&scan, &settings(), &windows);
    let by_gap = parts(&scan, &settings(), &gap(20.0));
    for (found, names) in [(&by_window, ["moving", "fixed"]), (&by_gap, ["part_1", "part_2"])] {
        assert_eq!(found.parts.iter().map(|part| part.name.as_str()).collect::<Vec<_>>(), names);
        assert_eq!((found.refusal.as_ref(), found.outside.len()), (None, 0));
        for (part, truth) in found.parts.iter().zip(&truths) {
            assert_within_bounds(&part.estimate, truth);
        }
    }
    assert_eq!(by_window.parts[0].x_mm, [-10.0, 400.0]);
    assert_eq!([by_gap.parts[0].x_mm, by_gap.parts[1].x_mm], [[0.0, 380.0], [440.0, 820.0]]);
}

#[test]
fn a_piece_of_a_scan_shares_its_points() {
    let (scan, _) = both();
    let piece = scan.part(190..380).expect("profiles");
    assert!(std::ptr::eq(piece.columns(), scan.columns()), "nothing is copied");
    assert_eq!((piece.stations(), piece.points()), (&scan.stations()[190..380], 60_800..121_600));
    assert!(scan.part(5..5).is_none() && scan.part(370..381).is_none());
}

#[test]
fn a_part_gives_the_same_bits_alone_and_with_others() {
    let (scan, _) = both();
    for method in Method::ALL {
        let settings = Settings { method, ..Settings::default() };
        let alone =
            [moving(), fixed()].map(|part| estimate(&make(&part).expect("a part").0, &settings, &Progress::default()));
        let windows = PartRule::Windows(vec![window("moving", 0.0, 380.0), window("fixed", 440.0, 820.0)]);
        for rule in [windows, gap(20.0)] {
            let found = parts(&scan, &settings, &rule);
            for (part, alone) in found.parts.iter().zip(&alone) {
                assert_eq!(&part.estimate, alone, "{} by {}", part.name, method.name());
            }
        }
    }
}

#[test]
fn objects_between_the_parts_neither_join_them_nor_form_a_third_part() {
    let (scan, truths) = both();
    let few = |_| (0..12).map(|i| [f64::from(i), 180.0]).collect();
    // A single profile that shows an arc, e.g. of an upright screw.
    let lonely = |index: usize| {
        if index != 18 {
            return floor(index);
        }
        (0..320).map(|i| (f64::from(i) / 320.0 * 2.0).sin_cos()).map(|(s, c)| [30.0 * c, 30.0 * s]).collect()
    };
    for between in [&few as &dyn Fn(usize) -> Vec<[f64; 2]>, &floor, &lonely] {
        let scan = with_between(&scan, 380.0, 38, between);
        let found = parts(&scan, &settings(), &gap(20.0));
        assert_eq!(found.parts.len(), 2);
        assert_eq!(found.outside.len(), 38);
        for (part, truth) in found.parts.iter().zip(&truths) {
            assert_within_bounds(&part.estimate, truth);
        }
        let profiles = found.profiles();
        assert_eq!(profiles.len(), scan.stations().len());
        assert!(profiles.iter().zip(scan.stations()).all(|(profile, station)| profile.x.total_cmp(&station.x).is_eq()));
        let outside = profiles.iter().filter(|profile| profile.rejected == Some(Reason::OutsideParts));
        assert!(outside.clone().count() == 38 && outside.clone().all(|profile| profile.x > 380.0 && profile.x < 440.0));
    }
}

#[test]
fn profiles_without_the_part_form_a_gap_only_over_a_sufficient_length() {
    let (scan, _) = make(&moving()).expect("a part");
    let floors_to = |x_max: f64, count: usize| {
        let rest = profiles_of(&scan).into_iter().filter(|(x, _)| *x < 200.0 || *x > x_max);
        with_between(&scan_of(rest.collect()), 199.0, count, floor)
    };
    assert_eq!(parts(&floors_to(212.0, 8), &settings(), &gap(20.0)).parts.len(), 1, "hidden for 16 mm");
    // If an object hides the part completely, this is a gap like any other.
    assert_eq!(parts(&floors_to(230.0, 20), &settings(), &gap(20.0)).parts.len(), 2, "hidden for 34 mm");
    // The profiles are 2 mm apart; a gap of 1 mm would separate all of them.
    assert_eq!(parts(&scan, &settings(), &gap(1.0)).parts.len(), 1);
    assert_eq!(parts(&both().0, &settings(), &gap(70.0)).parts.len(), 1, "60 mm are less than 70");
}

#[test]
fn an_empty_window_is_refused_with_its_bounds_and_the_others_are_measured() {
    let (scan, truths) = both();
    let windows = PartRule::Windows(vec![
        window("before", -100.0, -1.0),
        window("moving", 0.0, 400.0),
        window("between", 400.0, 439.0),
        window("fixed", 440.0, 820.0),
    ]);
    let found = parts(&scan, &settings(), &windows);
    for (part, x_mm) in [(&found.parts[0], [-100.0, -1.0]), (&found.parts[2], [400.0, 439.0])] {
        let [x_min_mm, x_max_mm] = x_mm;
        assert_eq!(*refusal(&part.estimate), Refusal::WindowEmpty { x_min_mm, x_max_mm });
    }
    assert_within_bounds(&found.parts[1].estimate, &truths[0]);
    assert_within_bounds(&found.parts[3].estimate, &truths[1]);
}

#[test]
fn a_profile_on_the_border_of_two_windows_belongs_to_the_first_only() {
    let (scan, _) = make(&moving()).expect("a part");
    let x = scan.stations()[95].x;
    let found = parts(&scan, &settings(), &PartRule::Windows(vec![window("a", 10.0, x), window("b", x, 300.0)]));
    assert_eq!((found.parts[0].stations.end, found.parts[1].stations.start), (96, 96));
    let inside: usize = found.parts.iter().map(|part| part.stations.len()).sum();
    assert_eq!(inside + found.outside.len(), 190);
}

#[test]
fn each_window_has_its_own_nominal_radius() {
    let (scan, truths) = both();
    let settings = Settings { radius: RadiusRule::Fixed, ..settings() };
    let with = |window: Window, radius| Window { nominal_radius_mm: Some(radius), ..window };
    let windows = vec![with(window("moving", 0.0, 400.0), 200.0), with(window("fixed", 400.0, 900.0), 150.0)];
    let found = parts(&scan, &settings, &PartRule::Windows(windows));
    for (part, truth) in found.parts.iter().zip(&truths) {
        assert!((pose(&part.estimate).radius - truth.radius_mm).abs() < 1e-9);
    }
}

#[test]
fn an_unexpected_number_of_parts_is_refused_with_the_numbers_and_without_a_pose() {
    let (scan, _) = both();
    let rule = PartRule::ByGap(ByGap { gap_min_mm: 20.0, count: Some(3) });
    let found = parts(&scan, &settings(), &rule);
    let expected =
        Refusal::PartsCountDiffers { parts_count: 2, parts_min_count: 3, parts_max_count: 3, gap_min_mm: 20.0 };
    assert_eq!(found.refusal.as_ref(), Some(&expected));
    assert!(found.parts.iter().all(|part| *refusal(&part.estimate) == expected));
    let right = PartRule::ByGap(ByGap { gap_min_mm: 20.0, count: Some(2) });
    assert_eq!(parts(&scan, &settings(), &right).refusal, None);
}

#[test]
fn a_scan_without_any_part_is_refused() {
    let scan = scan_of((0..50).map(|index| (index as f64, floor(index))).collect());
    let found = parts(&scan, &settings(), &gap(20.0));
    // The same refusal as without parts: a straight profile has no curvature.
    assert!(matches!(found.refusal, Some(Refusal::PointsCollinear { .. })), "{:?}", found.refusal);
    assert_eq!((found.parts.len(), found.profiles().len()), (0, 50));
}

#[test]
fn too_many_parts_are_refused_without_a_measurement() {
    let short = |i: u32| Part {
        x_start_mm: f64::from(i) * 100.0,
        length_mm: 40.0,
        profiles_count: 20,
        points_count: 60,
        seed: i.into(),
        ..moving()
    };
    let (scan, _) = make_several(&(0..17).map(short).collect::<Vec<_>>()).expect("parts in order");
    let found = parts(&scan, &settings(), &gap(20.0));
    assert!(matches!(found.refusal, Some(Refusal::PartsCountDiffers { parts_count: 17, parts_max_count: 16, .. })));
    assert_eq!((found.parts.len(), found.outside.len()), (0, 340));
}

#[test]
fn two_parts_that_are_measured_as_one_give_a_warning() {
    let first = Part { arc_deg: 120.0, profiles_count: 60, points_count: 120, length_mm: 300.0, ..Part::smooth(1) };
    let second = Part { radius_mm: 150.0, x_start_mm: 340.0, profiles_count: 40, seed: 2, ..first };
    let (scan, _) = make_several(&[first, second]).expect("parts");
    let found = estimate(&scan, &Settings::default(), &Progress::default());
    let warned =
        |warning: &Warning| matches!(warning, Warning::OnSomeProfiles { elsewhere_count: 40, profiles_count: 100 });
    assert!(found.conditioning.warnings.iter().any(warned), "{:?}", found.conditioning.warnings);
}
