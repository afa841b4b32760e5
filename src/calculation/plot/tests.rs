//! Properties of every picture: well-formed, only numbers, small, drawn for any measurement. Scans and estimates are simulated here
//! from the section of a cylinder with a known axis.

use super::{Picture, Subject, draw};
use crate::estimation::{
    self, Component, Conditioning, EndFace, EndFaceRule, EndFaces, Estimate, Method, Outcome, Pose, Profile, Progress,
    RadiusSource, Reason, Refusal, Section, Settings, Uncertainty,
};
use crate::geometry::{Angle, AxisLine};
use crate::scan::synthetic::{Part, make};
use crate::scan::{Columns, Scan, Station};
use jiff::Timestamp;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const SUBJECT: Subject<'_> = Subject {
    title: "part <7> & \"co\"",
    measured_at: Some(Timestamp::constant(1_767_323_045, 0)),
    recipe: Some("shaft"),
    software: Some("coaxis 1.2.3"),
    epsilon_mm: 0.111,
    profile: None,
    first_profile: 0,
};
const RADIUS: f64 = 200.0;

/// A synthetic part: profiles of a known cylinder, some of them with a clamp that displaces their centre.
struct Simulated {
    axis: AxisLine,
    spacing: f64,
    profiles: usize,
    points: usize,
    /// Every n-th profile has a clamp and is rejected.
    clamp_every: usize,
}

const PART: Simulated = Simulated {
    axis: AxisLine { p: -0.0149, q: 0.0144, y0: -0.114, z0: 0.845 },
    spacing: 2.0,
    profiles: 120,
    points: 320,
    clamp_every: 6,
};

impl Simulated {
    fn scan(&self) -> Scan {
        let mut chance = ChaCha8Rng::seed_from_u64(7);
        let (mut stations, mut y, mut z) = (Vec::new(), Vec::new(), Vec::new());
        for index in 0..self.profiles {
            let (x, start) = (self.spacing * index as f64, y.len());
            let section = self.axis.section(RADIUS, x);
            for i in 0..self.points {
                let part = i as f64 / self.points as f64;
                let clamp = if self.is_clamped(index) && part < 0.3 { 15.0 } else { 0.0 };
                let direction = Angle::from_degrees(30.0 + 120.0 * part).radians() - section.rotation.radians();
                let [py, pz] = section.point(direction);
                y.push(py + chance.random_range(-0.08..0.08));
                z.push(pz + clamp + chance.random_range(-0.08..0.08));
            }
            stations.push(Station { x, start, end: y.len() });
        }
        Scan::new(stations, Columns::F64 { y, z }, "simulated".to_owned()).expect("a valid scan")
    }

    fn is_clamped(&self, index: usize) -> bool {
        index % self.clamp_every == self.clamp_every - 1
    }

    fn profiles(&self) -> Vec<Profile> {
        let mut chance = ChaCha8Rng::seed_from_u64(8);
        let profile = |index: usize| {
            let x = self.spacing * index as f64;
            let rejected = self.is_clamped(index).then_some(Reason::LowInlierRatio);
            let mut ellipse = self.axis.section(RADIUS, x);
            let spoilt = if rejected.is_some() { 30.0 } else { 0.0 };
            ellipse.centre_y += chance.random_range(-0.02..0.02);
            ellipse.centre_z += chance.random_range(-0.1..0.1) + spoilt;
            let arc = Angle::from_degrees(120.0);
            let section = Section { ellipse, sigma: 0.05, inlier_ratio: 0.97, rms: 0.05, arc, iterations_count: 4 };
            Profile { x, points_count: self.points, rejected, section: Some(section), offset: Some(spoilt) }
        };
        (0..self.profiles).map(profile).collect()
    }

    fn estimate(&self) -> Estimate {
        let uncertainty = Uncertainty {
            covariance: [[0.0; 5]; 5],
            budget: Vec::new(),
            effective_freedom: [None; 5],
            effective_freedom_at_origin: [None; 2],
        };
        let (radius_source, end_faces) = (RadiusSource::Fitted, EndFaces::default());
        let pose =
            Pose { axis: self.axis, x_ref: 0.0, cut: None, radius: RADIUS, radius_source, uncertainty, end_faces };
        simulated(Outcome::Accepted(Box::new(pose)), self.profiles())
    }
}

fn simulated(outcome: Outcome, profiles: Vec<Profile>) -> Estimate {
    Estimate { method: Method::SectionLine, outcome, profiles, conditioning: Conditioning::default(), residuals: None }
}

fn refused(profiles: Vec<Profile>) -> Estimate {
    let profiles_count = profiles.len();
    simulated(Outcome::Refused(Refusal::TooFewProfiles { profiles_count, profiles_min: 3 }), profiles)
}

/// Draws a picture and checks the properties of all pictures.
fn drawn(picture: Picture, scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let svg = draw(picture, scan, estimate, subject);
    let name = picture.name();
    assert!(svg.len() < 1_000_000, "{name}: {} bytes", svg.len());
    assert_well_formed(&svg, name);
    for attribute in svg.split('"').skip(1).step_by(2) {
        let spoilt = attribute.contains("NaN") || attribute.contains("inf");
        assert!(!spoilt, "{name}: {attribute}");
    }
    assert!(!svg.contains("NaN"), "{name}");
    assert!(svg.contains("<title>") && svg.contains("<desc>"), "{name}");
    assert!(!svg.contains("href") && !svg.contains("<script"), "{name}");
    svg
}

/// Every tag has its closing tag, and no markup remains in texts and attributes.
fn assert_well_formed(svg: &str, name: &str) {
    let mut open = Vec::new();
    for piece in svg.split('<').skip(1) {
        let (tag, text) = piece.split_once('>').unwrap_or_else(|| panic!("{name}: unclosed <{piece}"));
        assert!(!text.contains('>'), "{name}: {text}");
        assert_eq!(tag.matches('"').count() % 2, 0, "{name}: {tag}");
        let entities = ["&amp;", "&lt;", "&gt;", "&quot;"];
        assert!(text.match_indices('&').all(|(at, _)| entities.iter().any(|e| text[at..].starts_with(e))), "{text}");
        if let Some(closed) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(closed), "{name}");
        } else if !tag.ends_with('/') {
            open.push(tag.split(' ').next().unwrap_or_default());
        }
    }
    assert!(open.is_empty(), "{name}: {open:?}");
    assert!(svg.trim_end().ends_with("</svg>"), "{name}");
}

/// The shape of a profile that was rejected for its inliers.
const RING: &str = "a3.2 3.2 0 1 0 6.4 0";

/// Arrows of values off the scale, including those of the legend.
fn arrows_count(svg: &str) -> usize {
    let paths = svg.lines().filter(|line| line.starts_with("<path") && line.contains("stroke-width=\"1.2\"/>"));
    paths.map(|path| path.matches('M').count() / 2).sum()
}

fn all_drawn(scan: &Scan, estimate: &Estimate) {
    for picture in Picture::ALL {
        drawn(picture, scan, estimate, &SUBJECT);
    }
}

#[test]
fn every_picture_has_a_distinct_name() {
    for picture in Picture::ALL {
        assert_eq!(Picture::from_name(picture.name()), Some(picture));
    }
    assert_eq!(Picture::from_name("roll"), None);
}

#[test]
fn a_simulated_part_is_drawn_and_equal_input_gives_equal_bytes() {
    let (scan, estimate) = (PART.scan(), PART.estimate());
    for picture in Picture::ALL {
        let svg = drawn(picture, &scan, &estimate, &SUBJECT);
        assert_eq!(svg, draw(picture, &scan, &estimate, &SUBJECT));
        assert!(svg.contains("part &lt;7&gt; &amp; &quot;co&quot;"));
    }
}

#[test]
fn every_centre_is_marked_in_the_trend_and_in_the_deviation_of_both_directions() {
    let svg = drawn(Picture::Centres, &PART.scan(), &PART.estimate(), &SUBJECT);
    // 100 valid dots on four panels and one in the legend. The 20 others, displaced by 30 mm in z alone, are rings on the two
    // panels of y, and arrows on the two of z.
    assert_eq!(svg.matches("h0").count(), 4 * 100 + 1);
    assert_eq!(svg.matches(RING).count(), 2 * 20 + 1);
    assert_eq!(arrows_count(&svg), 2 * 20 + 1);
    assert!(svg.contains("valid: 100") && svg.contains("rejected, low_inlier_ratio: 20"));
    assert!(svg.contains("deflection −0.8536°") && svg.contains("z at x = 0: 0.8450 mm"), "{svg}");
}

#[test]
fn the_scale_of_the_deviation_follows_the_valid_centres() {
    let svg = drawn(Picture::Centres, &PART.scan(), &PART.estimate(), &SUBJECT);
    // They scatter by ± 0.1 mm in z, the displaced ones are 30 mm off.
    assert!(svg.contains(">0.10<") && !svg.contains(">30<"), "{svg}");
}

#[test]
fn every_reason_that_occurs_is_in_the_legend_with_its_count() {
    let mut estimate = PART.estimate();
    for (profile, reason) in estimate.profiles.iter_mut().zip(Reason::ALL) {
        profile.rejected = Some(reason);
    }
    estimate.profiles[1].section = None;
    let svg = drawn(Picture::Centres, &PART.scan(), &estimate, &SUBJECT);
    assert!(svg.contains("too_few_points: 1 (1 without centre)"));
    for reason in Reason::ALL {
        assert!(svg.contains(&format!(">rejected, {}: ", reason.name())), "{}", reason.name());
    }
}

#[test]
fn the_map_shows_a_clamp_far_outside_and_the_surface_near_zero() {
    let part = Simulated { clamp_every: 2, ..PART };
    let svg = drawn(Picture::ResidualMap, &part.scan(), &part.estimate(), &SUBJECT);
    let columns_of_clamps = svg.lines().filter(|l| l.contains("fill=\"#a50026\"") && l.contains("<path")).count();
    assert!(columns_of_clamps >= 2, "the cells and the arrow of the colour bar");
    assert!(svg.contains("strip above the map: rejected profiles"));
}

#[test]
fn the_section_is_the_valid_one_nearest_to_the_middle_unless_one_is_named() {
    let (scan, mut estimate) = (PART.scan(), PART.estimate());
    // The middle of 0 … 238 mm is 119 mm; 118 mm is a clamped profile.
    let svg = drawn(Picture::Section, &scan, &estimate, &SUBJECT);
    assert!(svg.contains("Section at x = 120.00 mm"), "{svg}");
    let svg = drawn(Picture::Section, &scan, &estimate, &Subject { profile: Some(5), ..SUBJECT });
    assert!(svg.contains("Section at x = 10.00 mm") && svg.contains("rejected: low_inlier_ratio"));
    let svg = drawn(Picture::Section, &scan, &estimate, &Subject { profile: Some(500), ..SUBJECT });
    assert!(svg.contains("there is no profile 500"));
    for profile in &mut estimate.profiles {
        profile.rejected = Some(Reason::OffAxis);
    }
    let svg = drawn(Picture::Section, &scan, &estimate, &SUBJECT);
    assert!(svg.contains("Section at x = 120.00 mm") && svg.contains("rejected: off_axis"));
}

#[test]
fn every_point_of_the_section_is_marked_once_on_each_panel() {
    let svg = drawn(Picture::Section, &PART.scan(), &PART.estimate(), &SUBJECT);
    let markers: usize =
        ["h0", "l4 4l-4 4l-4-4z", "l5.6 5.6m0-5.6"].map(|shape| svg.matches(shape).count()).iter().sum();
    let in_the_legend = svg.matches("inliers, weight").count() + svg.matches("outliers, w").count();
    assert_eq!(markers, 2 * PART.points + in_the_legend);
}

#[test]
fn a_refused_scan_is_drawn_with_the_text_of_its_refusal() {
    let scan = PART.scan();
    for estimate in [refused(Vec::new()), refused(PART.profiles())] {
        all_drawn(&scan, &estimate);
        for picture in Picture::ALL {
            let svg = drawn(picture, &scan, &estimate, &SUBJECT);
            assert!(svg.contains("Refused (too_few_profiles)") && svg.contains("an axis needs"), "{}", picture.name());
        }
    }
}

#[test]
fn unusual_scans_are_drawn() {
    for part in [
        Simulated { profiles: 1, ..PART },
        Simulated { profiles: 2, points: 1, ..PART },
        Simulated { spacing: 0.0, profiles: 4, ..PART },
        Simulated { clamp_every: 1, profiles: 9, ..PART },
        Simulated { axis: AxisLine { p: 0.3, q: -0.2, y0: 1e9, z0: -1e12 }, ..PART },
        Simulated { axis: AxisLine { p: 0.0, q: 0.0, y0: 1e300, z0: f64::MAX }, ..PART },
        Simulated { spacing: 1e300, ..PART },
    ] {
        all_drawn(&part.scan(), &part.estimate());
        all_drawn(&part.scan(), &refused(part.profiles()));
    }
}

#[test]
fn identical_points_are_drawn() {
    let stations = (0..3).map(|i| Station { x: f64::from(i as i32), start: i * 10, end: i * 10 + 10 }).collect();
    let columns = Columns::F32 { y: vec![3.0; 30], z: vec![4.0; 30] };
    let scan = Scan::new(stations, columns, "simulated".to_owned()).expect("a valid scan");
    let part = Simulated { profiles: 3, ..PART };
    all_drawn(&scan, &part.estimate());
    all_drawn(&scan, &refused(Vec::new()));
}

#[test]
fn broken_numbers_in_an_estimate_do_not_reach_the_picture() {
    let scan = PART.scan();
    for poison in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        let mut estimate = PART.estimate();
        for profile in &mut estimate.profiles {
            if let Some(section) = &mut profile.section {
                (section.sigma, section.ellipse.semi_minor, section.ellipse.centre_y) = (poison, poison, poison);
            }
        }
        if let Outcome::Accepted(pose) = &mut estimate.outcome {
            (pose.radius, pose.axis.p) = (poison, poison);
        }
        for picture in Picture::ALL {
            let subject = Subject { epsilon_mm: poison, ..SUBJECT };
            drawn(picture, &scan, &estimate, &subject);
        }
    }
}

#[test]
fn a_hundred_thousand_profiles_and_a_million_points_make_small_files() {
    let many = Simulated { profiles: 100_000, points: 10, spacing: 0.01, ..PART };
    let (scan, estimate) = (many.scan(), many.estimate());
    all_drawn(&scan, &estimate);
    assert!(drawn(Picture::Centres, &scan, &estimate, &SUBJECT).contains("drawn)"));
    // All points in a single profile.
    let one = Simulated { profiles: 1, points: 1_000_000, ..PART };
    all_drawn(&one.scan(), &one.estimate());
}

#[test]
fn markup_in_titles_is_escaped() {
    let (scan, estimate) = (PART.scan(), PART.estimate());
    let title = format!("</text><script>x</script>\u{0}\u{8}\"'&{}", "長".repeat(500));
    for picture in Picture::ALL {
        drawn(picture, &scan, &estimate, &Subject { title: &title, ..SUBJECT });
    }
}

#[test]
fn estimated_scans_are_drawn_by_every_method() {
    let part = Part { profiles_count: 60, points_count: 160, drop_out_ratio: 0.1, ..Part::with_interference(3) };
    for (scan, method) in [part, Part { profiles_count: 2, ..Part::smooth(4) }]
        .iter()
        .filter_map(|part| make(part).ok())
        .flat_map(|(scan, _)| Method::ALL.map(|method| (scan.clone(), method)))
    {
        let estimate = estimation::estimate(&scan, &Settings { method, ..Settings::default() }, &Progress::default());
        all_drawn(&scan, &estimate);
    }
}

/// Number of points or cells in a picture.
fn shown(picture: Picture, svg: &str) -> usize {
    match picture {
        Picture::ResidualMap => svg.matches("v1h-").count(),
        _ => svg.matches("h0").count(),
    }
}

#[test]
fn the_points_of_a_refused_scan_are_drawn_in_every_picture() {
    let scan = PART.scan();
    let unjudged = |_| Profile { section: None, rejected: Some(Reason::NotConverged), ..PART.profiles().remove(0) };
    let without_sections: Vec<Profile> = (0..PART.profiles).map(unjudged).collect();
    for estimate in [refused(Vec::new()), refused(PART.profiles()), refused(without_sections)] {
        for picture in Picture::ALL {
            let svg = drawn(picture, &scan, &estimate, &SUBJECT);
            assert!(shown(picture, &svg) >= 300, "{}: {}", picture.name(), shown(picture, &svg));
        }
    }
}

#[test]
fn a_refused_scan_is_shown_from_above_by_its_height() {
    let part = Simulated { clamp_every: 2, ..PART };
    let svg = drawn(Picture::ResidualMap, &part.scan(), &refused(part.profiles()), &SUBJECT);
    assert!(svg.contains("Surface from above") && svg.contains(">z (mm)<") && svg.contains(">y (mm)<"));
    // The lowest and the highest colours appear in cells, not only in the colour bar.
    for colour in ["#440154", "#fde725"] {
        let cells = svg.lines().filter(|line| line.contains(colour) && line.contains("v1h-")).count();
        assert_eq!(cells, 1, "{colour}");
    }
}

#[test]
fn a_value_off_the_scale_differs_from_every_profile_and_both_are_in_the_legend() {
    let svg = drawn(Picture::Centres, &PART.scan(), &PART.estimate(), &SUBJECT);
    assert!(svg.contains("off scale") && svg.contains("rejected, low_inlier_ratio"));
    // A point that is drawn as an arrow has no other mark.
    let off = arrows_count(&svg) - 1;
    assert_eq!(off + svg.matches(RING).count() - 1, 4 * 20);
    // Without a value off the scale the legend does not mention any.
    let none = Simulated { clamp_every: usize::MAX, ..PART };
    let mut estimate = none.estimate();
    for profile in &mut estimate.profiles {
        if let Some(section) = &mut profile.section {
            [section.ellipse.centre_y, section.ellipse.centre_z] = none.axis.at(profile.x);
        }
    }
    let svg = drawn(Picture::Centres, &none.scan(), &estimate, &SUBJECT);
    assert!(!svg.contains("off scale") && arrows_count(&svg) == 0);
}

/// Standard uncertainties of 0.001 rad, 0.002 rad, 0.01 mm, 0.02 mm and 0.005 mm, independent at x_ref = 0.
fn with_uncertainty(calibrated: bool) -> Estimate {
    let mut estimate = PART.estimate();
    if let Outcome::Accepted(pose) = &mut estimate.outcome {
        let standard = [1e-3, 2e-3, 0.01, 0.02, 0.005];
        for (index, standard) in standard.into_iter().enumerate() {
            pose.uncertainty.covariance[index][index] = standard * standard;
        }
        let source = if calibrated { "stage_straightness" } else { "repeatability" }.to_owned();
        pose.uncertainty.budget = vec![Component { source, covariance: None, standard, standard_at_origin: None }];
        let face = |x: f64| {
            let [y, z] = PART.axis.at(x);
            Some(EndFace { centre: [x, y, z], x_standard: 0.03 })
        };
        pose.end_faces = EndFaces { asked: EndFaceRule::Both, near: face(21.5), far: face(200.25) };
    }
    estimate
}

#[test]
fn every_picture_states_date_recipe_software_and_the_result_with_its_uncertainty() {
    let (scan, estimate) = (PART.scan(), with_uncertainty(false));
    for picture in Picture::ALL {
        let svg = drawn(picture, &scan, &estimate, &SUBJECT);
        for words in [
            "measured 2026-01-02 03:04:05 UTC",
            "recipe shaft",
            "method section_line",
            "100 of 120 profiles valid",
            "coaxis 1.2.3",
            "deflection (−0.85 ± 0.11)°",
            "pitch (0.83 ± 0.23)°",
            "y at x = 0: (−0.114 ± 0.020) mm",
            "z at x = 0: (0.845 ± 0.040) mm",
            "radius (200.000 ± 0.010) mm",
            "near end face at x = (21.500 ± 0.060) mm",
            "far end face at x = (200.250 ± 0.060) mm",
            "U = k·u with k = 2",
            "the calibration is not stated",
        ] {
            assert!(svg.contains(words), "{}: {words}", picture.name());
        }
    }
    let svg = drawn(Picture::Centres, &scan, &with_uncertainty(true), &SUBJECT);
    assert!(svg.contains("of repeatability and calibration"));
    let unknown = Subject { measured_at: None, recipe: None, software: None, ..SUBJECT };
    let svg = drawn(Picture::Centres, &scan, &estimate, &unknown);
    assert!(!svg.contains("measured") && !svg.contains("recipe") && svg.contains("method section_line"));
}

#[test]
fn the_end_faces_are_drawn_where_a_picture_shows_x() {
    const GREEN: &str = "stroke=\"#009e73\"";
    let scan = PART.scan();
    let count = |picture: Picture, estimate: &Estimate| {
        let svg = drawn(picture, &scan, estimate, &SUBJECT);
        svg.lines().filter(|line| line.contains(GREEN)).count()
    };
    let with = with_uncertainty(false);
    // A line on each of the four panels, or the edge on the map, and an entry in the legend, for both faces.
    assert_eq!(count(Picture::Centres, &with), 2 * 5);
    assert_eq!(count(Picture::ResidualMap, &with), 2 * 2);
    assert_eq!(Picture::ALL.map(|picture| count(picture, &PART.estimate())), [0; 4]);
    let beyond = drawn(Picture::Section, &scan, &with, &Subject { profile: Some(3), ..SUBJECT });
    assert!(beyond.contains("beyond the near end face"));
    let within = drawn(Picture::Section, &scan, &with, &SUBJECT);
    assert!(!within.contains("beyond the"));
}

#[test]
fn labels_state_the_subtracted_base_and_use_the_terms_of_the_ellipse() {
    let (scan, estimate) = (PART.scan(), PART.estimate());
    let svg = drawn(Picture::Centres, &scan, &estimate, &SUBJECT);
    assert!(svg.contains("y of centre − y of axis (mm)") && svg.contains("z of centre − z of axis (mm)"));
    let svg = drawn(Picture::Section, &scan, &estimate, &SUBJECT);
    assert!(svg.contains("semi-axes a = 200.0") && svg.contains(", b = 200.000 mm"), "{svg}");
    assert!(svg.contains("distance from the fitted ellipse, positive outside (mm)"));
}

/// Number of the kind `words` in the legend of a section.
fn in_legend(svg: &str, words: &str) -> usize {
    let found = svg.split(words).nth(1).and_then(|rest| rest.split(['<', ' ']).next());
    found.map_or(0, |number| number.parse().expect("a number"))
}

#[test]
fn a_section_counts_the_inliers_that_the_verdict_counted() {
    // A noise for which 2.22 σ is more than ε, and a tilt that makes the sections of the cylinder ellipses.
    let axis = AxisLine { p: 0.05, q: 0.1, y0: 3.0, z0: -4.0 };
    let part = Part { axis, noise_sigma_mm: 0.12, profiles_count: 40, points_count: 300, ..Part::with_interference(5) };
    let (scan, _) = make(&part).expect("a scan");
    for (method, rule) in [(Method::Cylinder, "2.22 σ, more than ε"), (Method::SectionLine, "(ε)")] {
        let settings = Settings { method, epsilon_mm: 0.2, ..Settings::default() };
        let estimate = estimation::estimate(&scan, &settings, &Progress::default());
        let mut seen = 0;
        for (index, profile) in estimate.profiles.iter().enumerate() {
            let Some(section) = profile.section else { continue };
            let subject = Subject { epsilon_mm: settings.epsilon_mm, profile: Some(index), ..SUBJECT };
            let svg = drawn(Picture::Section, &scan, &estimate, &subject);
            let kinds = ["weight above 0.75: ", "weight 0.25 to 0.75: ", "weight below 0.25: "];
            let inliers: usize = kinds.map(|kind| in_legend(&svg, &format!("inliers, {kind}"))).iter().sum();
            let counted = section.inlier_ratio * profile.points_count as f64;
            assert!((inliers as f64 - counted).abs() < 0.5, "{method:?} {index}: {inliers} {counted}");
            assert!(svg.contains(rule), "{method:?} {index}");
            seen += 1;
        }
        assert!(seen > 20, "{method:?}: {seen}");
    }
}

#[test]
fn least_squares_gives_all_points_equal_weights() {
    let (scan, _) =
        make(&Part { profiles_count: 20, points_count: 100, ..Part::with_interference(5) }).expect("a scan");
    let mut estimate = PART.estimate();
    estimate.method = Method::LeastSquares;
    estimate.profiles = scan
        .stations()
        .iter()
        .map(|station| Profile {
            x: station.x,
            points_count: station.end - station.start,
            rejected: None,
            section: None,
            offset: None,
        })
        .collect();
    let svg = drawn(Picture::Section, &scan, &estimate, &SUBJECT);
    let points_count = scan.stations().first().map_or(0, |station| station.end - station.start);
    assert_eq!(in_legend(&svg, "points, equal weights: "), points_count);
    assert!(!svg.contains("inlier") && !svg.contains("outlier") && svg.contains("section of the fitted cylinder"));
    let svg = drawn(Picture::Centres, &scan, &estimate, &SUBJECT);
    assert!(svg.contains("Points and axis") && shown(Picture::Centres, &svg) > 1000);
}
