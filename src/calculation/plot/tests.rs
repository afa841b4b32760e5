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

mod contents;

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
