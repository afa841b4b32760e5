//! The picture along the axis: a thinned set of all points relative to the axis, with the circle of the fitted radius. Without a
//! pose it shows the points in the coordinates of the scan.

use super::about_axis::{Cylinder, Status, names};
use super::grid::Seen;
use super::header::{self, BODY_TOP, Subject, page, paragraph};
use super::marks::{Entry, Symbol, legend, polyline};
use super::overlays::{self, Point};
use super::palette::{FAINT_INK, FITTED};
use super::panel::Panel;
use super::scale::{Range, fixed, quantile};
use super::svg::{Area, Svg, Type};
use crate::estimation::{Estimate, Method, Outcome, Pose};
use crate::scan::Scan;

/// Largest number of points.
const POINTS_MAX: usize = 8000;
/// Arc in degrees from which a part counts as scanned from all sides.
const ALL_AROUND: f64 = 350.0;
const VIEW: Area = Area::new(90.0, BODY_TOP + 8.0, 560.0, 496.0);
const SIDE: Area = Area::new(676.0, BODY_TOP + 20.0, 300.0, 440.0);

/// Draws all profiles as viewed along the axis; without a pose, in the coordinates of the scan.
pub(super) fn end_view(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let total = scan.points().len();
    let points = overlays::points(scan, estimate, POINTS_MAX);
    match &estimate.outcome {
        Outcome::Accepted(pose) => {
            let caption = format!("{total} points, each relative to the axis in the plane perpendicular to it");
            let mut svg = page("View along the axis", &caption, estimate, subject);
            draw_about_axis(&mut svg, &points, estimate, pose, total);
            svg.finish()
        }
        Outcome::Refused(_) => {
            let caption = format!("no pose: {total} points as they lie in the coordinates of the scan");
            let mut svg = page("View along X", &caption, estimate, subject);
            draw_along_x(&mut svg, &points, total);
            svg.finish()
        }
    }
}

fn draw_about_axis(svg: &mut Svg, points: &[Point], estimate: &Estimate, pose: &Pose, total: usize) {
    let (cylinder, names) = (Cylinder::of(pose), names(estimate));
    let place = |point: &Point| {
        let polar = cylinder.polar(point.at);
        [polar.distance * polar.angle.cos(), polar.distance * polar.angle.sin()]
    };
    let mut distances: Vec<f64> = points.iter().map(|point| cylinder.polar(point.at).distance).collect();
    // The range includes clamps, but not a stray point that would shrink the part to a dot.
    let far = quantile(&mut distances, 0.99).unwrap_or(0.0);
    let radius = cylinder.radius;
    let panel = Panel::equal(VIEW, [0.0, 0.0], (1.05 * far).max(1.15 * radius).min(2.0 * radius));
    let label = |name: &str| format!("offset from the axis towards +{} (mm)", name.to_uppercase());
    panel.draw(svg, &label(names.y), &label(names.z));

    let near = points.iter().filter(|point| point.status != Status::Rejected);
    let arc = Seen::new(near.map(|point| cylinder.polar(point.at).angle.to_degrees())).window();
    svg.clipped("end-view", panel.area, |svg| draw_circle(svg, &panel, radius, arc));
    let beyond = overlays::draw_points(svg, &panel, points, place);
    draw_centre(svg, &panel, radius);
    panel.frame(svg);
    let mut entries = overlays::point_entries(points, total);
    entries.push(Entry::new(Symbol::Stroke, FITTED, format!("fitted circle, R = {}", header::radius(pose))));
    if arc.width() < ALL_AROUND {
        let of = if estimate.method == Method::LeastSquares { "" } else { " (valid profiles)" };
        let side = format!("observed arc{of}: {}°", fixed(arc.width(), 0));
        entries.push(Entry::new(Symbol::Dashes, FAINT_INK, side));
    }
    entries.extend(overlays::off_scale_entry(beyond));
    let end = legend(svg, SIDE, &entries);
    let area = Area { top: end + 14.0, ..SIDE };
    paragraph(svg, area, Type::sized(12.0).colour(FAINT_INK), &nearness(points, cylinder, estimate.method));
}

/// A text for details that are too small for true proportion.
fn nearness(points: &[Point], cylinder: Cylinder, method: Method) -> String {
    let used = points.iter().filter(|point| point.status != Status::Rejected);
    let mut distances: Vec<f64> =
        used.map(|point| (cylinder.polar(point.at).distance - cylinder.radius).abs()).collect();
    let within = [0.5, 0.95].map(|part| quantile(&mut distances, part));
    let [Some(half), Some(most)] = within else {
        return "No profile is valid.".to_owned();
    };
    let of = if method == Method::LeastSquares { "" } else { " of valid profiles" };
    format!(
        "Of the drawn points{of}, half lie within ±{} mm of the circle, 95 % within ±{} mm.",
        fixed(half, 3),
        fixed(most, 3)
    )
}

/// The circle below the points, and two radii that bound the observed arc.
fn draw_circle(svg: &mut Svg, panel: &Panel, radius: f64, arc: Range) {
    let on_circle = |degrees: f64, distance: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        panel.place([distance * cos, distance * sin])
    };
    let circle = polyline((0..=360).map(|degrees| on_circle(f64::from(degrees), radius)));
    svg.path(&circle, format_args!("fill=\"none\" stroke=\"{FITTED}\" stroke-width=\"0.9\""));
    if arc.width() < ALL_AROUND {
        let steps = 0..=60;
        let bow = polyline(steps.map(|i| on_circle(arc.lo + arc.width() * f64::from(i) / 60.0, 0.25 * radius)));
        let sides = [arc.lo, arc.hi].map(|side| polyline([on_circle(side, 0.0), on_circle(side, radius)].into_iter()));
        let paint = format!("fill=\"none\" stroke=\"{FAINT_INK}\" stroke-width=\"0.9\" stroke-dasharray=\"4 3\"");
        svg.path(&(bow + &sides.concat()), paint);
    }
}

fn draw_centre(svg: &mut Svg, panel: &Panel, radius: f64) {
    let arm = 0.06 * radius;
    let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1\"");
    svg.line(panel.place([-arm, 0.0]), panel.place([arm, 0.0]), &paint);
    svg.line(panel.place([0.0, -arm]), panel.place([0.0, arm]), &paint);
}

fn draw_along_x(svg: &mut Svg, points: &[Point], total: usize) {
    let place = |point: &Point| {
        let [_, y, z] = point.at;
        [y, z]
    };
    let panel = Panel::around(VIEW, &points.iter().map(place).collect::<Vec<_>>());
    panel.draw(svg, "y (mm)", "z (mm)");
    let beyond = overlays::draw_points(svg, &panel, points, place);
    let mut entries = overlays::point_entries(points, total);
    entries.extend(overlays::off_scale_entry(beyond));
    legend(svg, SIDE, &entries);
}
