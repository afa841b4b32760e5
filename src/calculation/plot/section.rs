//! The picture of one profile: its points with the fitted section in true proportion (left), and, since a noise of
//! hundredths cannot be seen on a radius of hundreds, their distances from it against direction with the band of the inliers
//! (right). Without a section the right side shows the points, each coordinate at its own scale.
//!
//! The points are compared with what decided on the profile: the section of the one cylinder of all profiles, or the ellipse of
//! the profile, and with the limit of the inliers that the verdict used.

use super::Subject;
use super::about_axis::{Cylinder, Names, Status, names, pose, status};
use super::area::Area;
use super::header::{BODY_TOP, page};
use super::legend::{Entry, legend};
use super::marks::{Marks, Symbol, polyline, stride};
use super::notice::{MARGIN, paragraph};
use super::palette::{BAND, FAINT_INK, FITTED, VALID};
use super::panel::Panel;
use super::points::off_scale;
use super::result::end_faces;
use super::section_points::{Judged, Kind, Reference, judge};
use super::seen::{Seen, turned_into};
use super::spread::quantile;
use super::svg::{Svg, Type};
use super::ticks::{Range, fixed};
use crate::estimation::{Estimate, Method, Profile, Section};
use crate::geometry::SectionEllipse;
use crate::scan::{Scan, Station};

/// Most markers of one kind on one panel.
const MARKS_MAX: usize = 2000;
const SHAPE: Area = Area::new(84.0, BODY_TOP + 10.0, 400.0, 440.0);
const RESIDUALS: Area = Area::new(580.0, BODY_TOP + 10.0, 396.0, 440.0);
const LEGEND: Area = Area::new(MARGIN, 634.0, 952.0, 60.0);

/// Draws one profile: the one that the subject names, else the valid one nearest to the middle, else the middle one.
pub(super) fn section(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let index = subject.profile.unwrap_or_else(|| middle_profile(scan, estimate));
    let Some(&station) = scan.stations().get(index) else {
        let count = scan.stations().len();
        let mut svg = page("Section", &format!("no profile {index}"), estimate, subject);
        let words = format!("The scan has {count} profiles, numbered from 0; there is no profile {index}.");
        paragraph(&mut svg, Area::new(120.0, 280.0, 760.0, 100.0), Type::sized(16.0), &words);
        return svg.finish();
    };
    let points: Vec<[f64; 3]> = scan.points_of(&station).collect();
    let profile = estimate.profiles.get(index);
    let reference = reference(estimate, profile, station, subject.epsilon_mm);
    let names = names(estimate);
    let what = format!("Section at {} = {} mm, {}", names.x, fixed(station.x, 2), verdict(estimate, profile));
    let place = place(scan, index, subject.first_profile, points.len());
    let caption = [place, about(profile, reference.as_ref()), beyond_end(estimate, station.x)].concat();
    let mut svg = page(&what, &caption, estimate, subject);
    match reference {
        Some(reference) => {
            let points = judge(&points, station.x, &reference, estimate.method);
            let beyond = draw_shape(&mut svg, names, &reference.ellipse, &points)
                + draw_residuals(&mut svg, names, &reference, &points);
            legend(&mut svg, LEGEND, &entries(&points, &reference, subject.epsilon_mm, beyond));
        }
        None => draw_points(&mut svg, names, &points),
    }
    svg.finish()
}

fn middle_profile(scan: &Scan, estimate: &Estimate) -> usize {
    let stations = scan.stations();
    let ends = stations.first().zip(stations.last()).map(|(first, last)| (first.x + last.x) / 2.0);
    let middle = ends.unwrap_or(0.0);
    let from_middle = |index: &usize| stations.get(*index).map_or(f64::MAX, |station| (station.x - middle).abs());
    (0..stations.len())
        .filter(|&index| status(estimate, index) != Status::Rejected)
        .min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))
        .unwrap_or(stations.len() / 2)
}

/// What decided on the profile; `None` where it has no section that could be drawn.
fn reference(estimate: &Estimate, profile: Option<&Profile>, station: Station, epsilon_mm: f64) -> Option<Reference> {
    let own = profile.and_then(|profile| profile.section);
    let cylinder = match estimate.method {
        Method::Cylinder | Method::LeastSquares => pose(estimate).map(Cylinder::of),
        Method::SectionLine | Method::SectionLinePlain => None,
    };
    let ellipse = match cylinder {
        Some(Cylinder { axis, radius }) => axis.section(radius, station.x),
        None => own?.ellipse,
    };
    let sigma = own.map(|section| section.sigma).or_else(|| Some(estimate.residuals?.sigma)).unwrap_or(0.0);
    let limit = estimate.method.inlier_limit_mm(epsilon_mm, sigma);
    drawable(&ellipse).then_some(Reference { ellipse, cylinder, sigma, limit })
}

fn drawable(ellipse: &SectionEllipse) -> bool {
    let SectionEllipse { centre_y, centre_z, semi_major, semi_minor, rotation } = *ellipse;
    let lengths = [centre_y, centre_z, semi_major, semi_minor];
    lengths.iter().all(|v| v.abs() < 1e100) && rotation.radians().is_finite() && semi_minor > 0.0 && semi_major > 0.0
}

fn verdict(estimate: &Estimate, profile: Option<&Profile>) -> String {
    match profile.map(|profile| profile.rejected) {
        Some(Some(reason)) => format!("rejected: {}", reason.name()),
        Some(None) if estimate.method == Method::LeastSquares => "used without a verdict".to_owned(),
        Some(None) => "valid".to_owned(),
        None => "not evaluated".to_owned(),
    }
}

fn place(scan: &Scan, index: usize, first: usize, points_count: usize) -> String {
    let last = first + scan.stations().len().saturating_sub(1);
    format!("profile {} ({first} to {last}) · {points_count} points", first + index)
}

/// The section in numbers.
fn about(profile: Option<&Profile>, reference: Option<&Reference>) -> String {
    let own = profile.and_then(|profile| profile.section);
    let Some(Reference { ellipse, cylinder, sigma, .. }) = reference else {
        return " · without a section that they could be compared with".to_owned();
    };
    let what = if cylinder.is_some() { "section of the fitted cylinder" } else { "fitted ellipse" };
    let share = own.map_or_else(String::new, |Section { inlier_ratio, arc, .. }| {
        format!(" · inliers {} % over {}°", fixed(100.0 * inlier_ratio, 1), fixed(arc.degrees(), 1))
    });
    format!(
        " · {what}: centre ({}, {}) mm, semi-axes a = {} mm, b = {} mm · robust σ {} mm{share}",
        fixed(ellipse.centre_y, 3),
        fixed(ellipse.centre_z, 3),
        fixed(ellipse.semi_major, 3),
        fixed(ellipse.semi_minor, 3),
        fixed(*sigma, 4),
    )
}

/// Where the axis has already left the part in this plane.
fn beyond_end(estimate: &Estimate, x: f64) -> String {
    let Some(pose) = pose(estimate) else { return String::new() };
    let is_beyond = |centre_x: f64, near: bool| if near { x < centre_x } else { x > centre_x };
    let faces = end_faces(pose).into_iter();
    let beyond = faces.filter(|(name, face)| is_beyond(face.centre[0], name.starts_with("near")));
    beyond.map(|(name, _)| format!(" · beyond the {name}")).collect()
}

/// The points and their section in true proportion.
fn draw_shape(svg: &mut Svg, names: Names, ellipse: &SectionEllipse, points: &[Judged]) -> usize {
    let panel = shape_panel(ellipse, points);
    panel.draw(svg, &format!("{} (mm)", names.y), &format!("{} (mm)", names.z));
    let seen = Seen::new(points.iter().filter(|p| p.kind != Kind::Excluded).map(|p| p.degrees));
    let beyond = draw_marks(svg, &panel, points, |point| point.at);
    svg.clipped("section-shape", panel.area, |svg| {
        let arc = |from: f64, to: f64| ellipse_arc(&panel, ellipse, from, to);
        let arcs = seen.arcs();
        let after = arcs.iter().skip(1).map(|[from, _]| *from).chain(arcs.first().map(|[from, _]| from + 360.0));
        for ([from, to], next) in arcs.iter().zip(after) {
            svg.path(&arc(*from, *to), format_args!("fill=\"none\" stroke=\"{FITTED}\" stroke-width=\"0.8\""));
            let paint = format!("fill=\"none\" stroke=\"{FAINT_INK}\" stroke-width=\"1\" stroke-dasharray=\"5 4\"");
            if next - to > 0.0 && to - from < 360.0 {
                svg.path(&arc(*to, if next < *to { next + 360.0 } else { next }), paint);
            }
        }
    });
    let centre = [ellipse.centre_y, ellipse.centre_z];
    if panel.x.contains(centre[0]) && panel.y.contains(centre[1]) {
        Symbol::Plus.draw(svg, panel.place(centre), FITTED);
    }
    panel.frame(svg);
    beyond
}

/// The whole ellipse; where it dwarfs the points (a line that passed for an arc), the points.
fn shape_panel(ellipse: &SectionEllipse, points: &[Judged]) -> Panel {
    let y = Range::around(points.iter().map(|point| point.at[0]));
    let z = Range::around(points.iter().map(|point| point.at[1]));
    let extent = y.width().max(z.width());
    if points.len() > 1 && ellipse.semi_major > 5.0 * extent {
        return Panel::equal(SHAPE, [y.middle(), z.middle()], 0.6 * extent);
    }
    Panel::equal(SHAPE, [ellipse.centre_y, ellipse.centre_z], 1.15 * ellipse.semi_major)
}

/// The ellipse between two directions from its centre, degrees.
fn ellipse_arc(panel: &Panel, ellipse: &SectionEllipse, from: f64, to: f64) -> String {
    let steps = ((to - from).abs().ceil() as i32).clamp(2, 360);
    let direction = |step: i32| (from + (to - from) * f64::from(step) / f64::from(steps)).to_radians();
    polyline((0..=steps).map(|step| {
        // The parameter angle whose point lies in this direction.
        let (sin, cos) = (direction(step) - ellipse.rotation.radians()).sin_cos();
        let parameter = (sin * ellipse.semi_major).atan2(cos * ellipse.semi_minor);
        panel.place(ellipse.point(parameter))
    }))
}

/// The distances against direction, in millimetres, with the band of the inliers.
fn draw_residuals(svg: &mut Svg, names: Names, reference: &Reference, points: &[Judged]) -> usize {
    let Reference { cylinder, sigma, limit, .. } = *reference;
    let window = Seen::new(points.iter().map(|point| point.degrees)).window();
    let band = Some(limit).filter(|limit| limit.is_finite() && *limit > 0.0);
    let half = band.map_or(0.0, |limit| 2.2 * limit).max(5.0 * sigma);
    let panel = Panel::new(RESIDUALS, window.padded(0.03), Range::about_zero(half));
    if let Some(limit) = band {
        let [left, top] = panel.place([panel.x.lo, limit]);
        let [_, bottom] = panel.place([panel.x.lo, -limit]);
        svg.rect(Area::new(left, top, panel.area.width, bottom - top), format_args!("fill=\"{BAND}\""));
    }
    let x_label =
        format!("direction from the centre, 0° = +{}, 90° = +{} (°)", names.y.to_uppercase(), names.z.to_uppercase());
    let surface = if cylinder.is_some() { "fitted cylinder" } else { "fitted ellipse" };
    panel.draw(svg, &x_label, &format!("distance from the {surface}, positive outside (mm)"));
    let beyond = draw_marks(svg, &panel, points, |point| [turned_into(point.degrees, window.lo), point.residual]);
    let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1\"");
    svg.line(panel.place([panel.x.lo, 0.0]), panel.place([panel.x.hi, 0.0]), paint);
    for side in band.into_iter().flat_map(|limit| [limit, -limit]) {
        let paint = format!("stroke=\"{VALID}\" stroke-width=\"0.8\" stroke-dasharray=\"5 4\"");
        svg.line(panel.place([panel.x.lo, side]), panel.place([panel.x.hi, side]), paint);
    }
    beyond
}

/// The points by kind, the rare ones on top; returns how many lie beyond the border.
fn draw_marks(svg: &mut Svg, panel: &Panel, points: &[Judged], values: impl Fn(&Judged) -> [f64; 2]) -> usize {
    let mut beyond = 0;
    for kind in Kind::ALL {
        let (symbol, colour) = kind.look();
        let of_kind = || points.iter().filter(|point| point.kind == kind);
        let mut marks = Marks::new(symbol, colour);
        for point in of_kind().step_by(stride(of_kind().count(), MARKS_MAX)) {
            marks.add(panel, values(point));
        }
        beyond += marks.draw(svg);
    }
    beyond
}

fn entries(points: &[Judged], reference: &Reference, epsilon: f64, beyond: usize) -> Vec<Entry> {
    let mut entries = Vec::new();
    for kind in Kind::ALL {
        let count = points.iter().filter(|point| point.kind == kind).count();
        if count > 0 {
            let every = stride(count, MARKS_MAX);
            let drawn = if every > 1 { format!(" (1 in {every} drawn)") } else { String::new() };
            let (symbol, colour) = kind.look();
            entries.push(Entry::new(symbol, colour, format!("{}: {count}{drawn}", kind.words())));
        }
    }
    entries.push(Entry::new(Symbol::Stroke, FITTED, "section, observed arc"));
    entries.push(Entry::new(Symbol::Dashes, FAINT_INK, "section, not observed"));
    entries.push(Entry::new(Symbol::Plus, FITTED, "its centre"));
    let Reference { limit, sigma, .. } = *reference;
    if limit.is_finite() {
        let why = if limit > epsilon {
            format!("{} σ, more than ε = {} mm", fixed(limit / sigma, 2), fixed(epsilon, 4))
        } else {
            "ε".to_owned()
        };
        entries.push(Entry::new(Symbol::Field, BAND, format!("inliers: nearer than {} mm ({why})", fixed(limit, 4))));
    }
    entries.extend(off_scale(beyond));
    entries
}

/// The points alone: in true proportion, and each coordinate at its own scale.
fn draw_points(svg: &mut Svg, names: Names, points: &[[f64; 3]]) {
    let points: Vec<[f64; 2]> = points.iter().map(|[_, y, z]| [*y, *z]).collect();
    let own_scale = |coordinate: fn(&[f64; 2]) -> f64| {
        let mut values: Vec<f64> = points.iter().map(coordinate).collect();
        let [lo, hi] = [0.005, 0.995].map(|part| quantile(&mut values, part).unwrap_or(0.0));
        Range::new(lo, hi).padded(0.08)
    };
    let stretched = Panel::new(RESIDUALS, own_scale(|[y, _]| *y), own_scale(|[_, z]| *z));
    let mut beyond = 0;
    for panel in [Panel::around(SHAPE, &points), stretched] {
        panel.draw(svg, &format!("{} (mm)", names.y), &format!("{} (mm)", names.z));
        let mut marks = Marks::new(Symbol::Dot, VALID);
        for point in points.iter().step_by(stride(points.len(), MARKS_MAX)) {
            marks.add(&panel, *point);
        }
        beyond += marks.draw(svg);
    }
    let words = "points of the profile: left in true proportion, right each coordinate at its own scale";
    let entries: Vec<Entry> = [Entry::new(Symbol::Dot, VALID, words)].into_iter().chain(off_scale(beyond)).collect();
    legend(svg, LEGEND, &entries);
}
