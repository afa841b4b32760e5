//! The picture of one profile: its points with the fitted ellipse in true proportion (left), and, since a noise of
//! hundredths cannot be seen on a radius of hundreds, their residuals against direction with the band of ±ε (right).
//! Must not know how the ellipse was fitted.

use super::Subject;
use super::about_axis::is_valid;
use super::area::Area;
use super::legend::{Entry, legend};
use super::marks::{Marks, Symbol, polyline, stride};
use super::notice::{MARGIN, page, paragraph};
use super::palette::{BAND, EXCLUDED, FAINT_INK, FITTED, GRID, VALID};
use super::panel::Panel;
use super::section_points::{Judged, Kind, judge};
use super::seen::{Seen, turned_into};
use super::svg::{Svg, Type};
use super::ticks::{Range, fixed};
use crate::estimation::{Estimate, Profile, Section};
use crate::geometry::SectionEllipse;
use crate::scan::{Scan, Station};

/// Most markers of one kind on one panel.
const MARKS_MAX: usize = 2000;
const SHAPE: Area = Area::new(84.0, 92.0, 400.0, 404.0);
const RESIDUALS: Area = Area::new(580.0, 92.0, 396.0, 404.0);

/// Draws one profile: the one that the subject names, else the valid one nearest to the middle, else the middle one.
pub(super) fn section(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let index = subject.profile.unwrap_or_else(|| middle_profile(scan, estimate));
    let Some(&station) = scan.stations().get(index) else {
        let count = scan.stations().len();
        let mut svg = page("Section", subject.title, &format!("no profile {index}"));
        let words = format!("The scan has {count} profiles, numbered from 0; there is no profile {index}.");
        paragraph(&mut svg, Area::new(120.0, 240.0, 760.0, 100.0), Type::sized(16.0), &words);
        return svg.finish();
    };
    let (mut y, mut z) = (Vec::new(), Vec::new());
    scan.load(station, &mut y, &mut z);
    let profile = estimate.profiles.get(index);
    let what = format!("Section at x = {} mm, {}", fixed(station.x, 2), verdict(profile));
    let mut svg = page(&what, subject.title, &caption(scan, index, subject.first_profile, profile));
    match profile.and_then(|profile| profile.section).filter(|section| drawable(&section.ellipse)) {
        Some(section) => {
            let points = judge(&y, &z, &section, subject.epsilon_mm, estimate.method);
            let beyond = draw_shape(&mut svg, &section, &points)
                + draw_residuals(&mut svg, &section, &points, subject.epsilon_mm);
            legend(&mut svg, Area::new(MARGIN, 546.0, 952.0, 40.0), &entries(&points, subject.epsilon_mm, beyond));
        }
        None => draw_points(&mut svg, station, &y, &z, profile),
    }
    svg.finish()
}

fn middle_profile(scan: &Scan, estimate: &Estimate) -> usize {
    let stations = scan.stations();
    let ends = stations.first().zip(stations.last()).map(|(first, last)| (first.x + last.x) / 2.0);
    let middle = ends.unwrap_or(0.0);
    let from_middle = |index: &usize| stations.get(*index).map_or(f64::MAX, |station| (station.x - middle).abs());
    (0..stations.len())
        .filter(|&index| is_valid(estimate, index))
        .min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))
        .unwrap_or(stations.len() / 2)
}

fn drawable(ellipse: &SectionEllipse) -> bool {
    let SectionEllipse { centre_y, centre_z, semi_major, semi_minor, rotation } = *ellipse;
    let lengths = [centre_y, centre_z, semi_major, semi_minor];
    lengths.iter().all(|v| v.abs() < 1e100) && rotation.radians().is_finite() && semi_minor > 0.0 && semi_major > 0.0
}

fn verdict(profile: Option<&Profile>) -> String {
    match profile.map(|profile| profile.rejected) {
        Some(Some(reason)) => format!("rejected: {}", reason.name()),
        Some(None) => "valid".to_owned(),
        None => "not looked at".to_owned(),
    }
}

fn caption(scan: &Scan, index: usize, first: usize, profile: Option<&Profile>) -> String {
    let last = first + scan.stations().len().saturating_sub(1);
    let place = format!("profile {} ({first} to {last})", first + index);
    let Some(profile) = profile else {
        return place;
    };
    let Some(Section { ellipse, sigma, inlier_ratio, arc, .. }) = profile.section else {
        return format!("{place} · {} points", profile.points_count);
    };
    format!(
        "{place} · {} points · centre ({}, {}) mm · axes {} × {} mm · σ {} mm · inner {} % · arc {}°",
        profile.points_count,
        fixed(ellipse.centre_y, 3),
        fixed(ellipse.centre_z, 3),
        fixed(ellipse.semi_major, 3),
        fixed(ellipse.semi_minor, 3),
        fixed(sigma, 4),
        fixed(100.0 * inlier_ratio, 1),
        fixed(arc.degrees(), 1)
    )
}

/// The points and their ellipse in true proportion.
fn draw_shape(svg: &mut Svg, section: &Section, points: &[Judged]) -> usize {
    let panel = shape_panel(&section.ellipse, points);
    panel.draw(svg, "y (mm)", "z (mm)");
    let seen = Seen::new(points.iter().filter(|p| p.kind != Kind::Excluded).map(|p| p.degrees));
    let beyond = draw_marks(svg, &panel, points, |point| point.at);
    svg.clipped("section-shape", panel.area, |svg| {
        let arc = |from: f64, to: f64| ellipse_arc(&panel, &section.ellipse, from, to);
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
    let centre = [section.ellipse.centre_y, section.ellipse.centre_z];
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

/// The residuals against direction, in millimetres, with the band of the inner points.
fn draw_residuals(svg: &mut Svg, section: &Section, points: &[Judged], epsilon: f64) -> usize {
    let window = Seen::new(points.iter().map(|point| point.degrees)).window();
    let half = (2.2 * epsilon).max(5.0 * section.sigma);
    let panel = Panel::new(RESIDUALS, window.padded(0.03), Range::about_zero(half));
    let [left, top] = panel.place([panel.x.lo, epsilon]);
    let [_, bottom] = panel.place([panel.x.lo, -epsilon]);
    svg.rect(Area::new(left, top, panel.area.width, bottom - top), format_args!("fill=\"{BAND}\""));
    panel.draw(svg, "direction from the centre, 0° = +Y, 90° = +Z (°)", "distance from the ellipse, outside + (mm)");
    let beyond = draw_marks(svg, &panel, points, |point| [turned_into(point.degrees, window.lo), point.residual]);
    let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1\"");
    svg.line(panel.place([panel.x.lo, 0.0]), panel.place([panel.x.hi, 0.0]), paint);
    for side in [epsilon, -epsilon] {
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

fn entries(points: &[Judged], epsilon: f64, beyond: usize) -> Vec<Entry> {
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
    entries.push(Entry::new(Symbol::Stroke, FITTED, "ellipse, where seen"));
    entries.push(Entry::new(Symbol::Dashes, FAINT_INK, "where not"));
    entries.push(Entry::new(Symbol::Field, BAND, format!("inner: nearer than ε = {} mm", fixed(epsilon, 3))));
    if beyond > 0 {
        entries.push(Entry::new(Symbol::Arrow, FAINT_INK, "off the scale"));
    }
    entries
}

/// The points alone, and why there is no ellipse.
fn draw_points(svg: &mut Svg, station: Station, y: &[f64], z: &[f64], profile: Option<&Profile>) {
    let points: Vec<[f64; 2]> = y.iter().copied().zip(z.iter().copied()).map(|(y, z)| [y, z]).collect();
    let panel = Panel::around(SHAPE, &points);
    panel.draw(svg, "y (mm)", "z (mm)");
    let mut marks = Marks::new(Symbol::Dot, VALID);
    for point in points.iter().step_by(stride(points.len(), MARKS_MAX)) {
        marks.add(&panel, *point);
    }
    marks.draw(svg);
    svg.rect(RESIDUALS, format_args!("fill=\"none\" stroke=\"{GRID}\""));
    let area = Area::new(RESIDUALS.left + 30.0, 220.0, RESIDUALS.width - 60.0, 200.0);
    let end = paragraph(svg, area, Type::sized(16.0).bold().colour(EXCLUDED), "No ellipse");
    let reason = profile.and_then(|profile| profile.rejected).map_or("this profile was not looked at", |r| r.name());
    let words = format!("{} points at x = {} mm: {reason}.", station.end - station.start, fixed(station.x, 3));
    paragraph(svg, Area { top: end + 6.0, ..area }, Type::sized(13.0), &words);
    legend(svg, Area::new(MARGIN, 546.0, 952.0, 40.0), &[Entry::new(Symbol::Dot, VALID, "points of the profile")]);
}
