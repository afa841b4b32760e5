//! What pictures show: all points of a refused scan, the result with its uncertainty, end faces, labels and the counts of the
//! verdict.

use super::*;

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
