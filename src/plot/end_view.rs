//! The picture along the axis: a thinned set of all points, each relative to the axis at its own station, with the
//! circle of the fitted radius. Must not know ellipses.

use super::Subject;
use super::about_axis::{Cylinder, is_valid, thinned};
use super::area::Area;
use super::legend::{Entry, legend};
use super::marks::{Marks, Symbol, polyline};
use super::notice::{page, paragraph};
use super::palette::{EXCLUDED, FAINT_INK, FITTED, REJECTED, VALID};
use super::panel::Panel;
use super::seen::Seen;
use super::spread::quantile;
use super::svg::{Svg, Type};
use super::ticks::{Range, fixed};
use crate::estimation::{Estimate, Outcome, Refusal};
use crate::scan::Scan;

/// Most points drawn.
const POINTS_MAX: usize = 8000;
/// Degrees from which a part counts as seen from all sides.
const ALL_AROUND: f64 = 350.0;
const VIEW: Area = Area::new(90.0, 72.0, 560.0, 476.0);
const SIDE: Area = Area::new(676.0, 84.0, 300.0, 440.0);

/// A point of the picture.
struct Point {
    at: [f64; 2],
    valid: bool,
}

/// Draws all profiles as seen along the axis; where there is none, as they lie in the rail frame.
pub(super) fn end_view(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let total = scan.points().len();
    match &estimate.outcome {
        Outcome::Accepted(pose) => {
            let cylinder = Cylinder { axis: pose.axis, radius: pose.radius };
            let caption =
                format!("{total} points relative to the axis at their station · radius {} mm", fixed(pose.radius, 3));
            let mut svg = page("View along the axis", subject.title, &caption);
            draw_about_axis(&mut svg, scan, estimate, cylinder);
            svg.finish()
        }
        Outcome::Refused(refusal) => {
            let caption = format!("no pose: {total} points as they lie in the rail frame");
            let mut svg = page("View along the rail", subject.title, &caption);
            draw_in_rail_frame(&mut svg, scan, estimate, refusal);
            svg.finish()
        }
    }
}

fn draw_about_axis(svg: &mut Svg, scan: &Scan, estimate: &Estimate, cylinder: Cylinder) {
    let points: Vec<Point> = thinned(scan, POINTS_MAX)
        .map(|(index, x, at)| {
            let polar = cylinder.polar(x, at);
            let at = [polar.distance * polar.angle.cos(), polar.distance * polar.angle.sin()];
            Point { at, valid: is_valid(estimate, index) }
        })
        .collect();
    let mut distances: Vec<f64> = points.iter().map(|Point { at: [y, z], .. }| y.hypot(*z)).collect();
    // Room for clamps, but not for a stray point that would shrink the part to a dot.
    let far = quantile(&mut distances, 0.99).unwrap_or(0.0);
    let radius = cylinder.radius;
    let panel = Panel::equal(VIEW, [0.0, 0.0], (1.05 * far).max(1.15 * radius).min(2.0 * radius));
    panel.draw(svg, "y from the axis (mm)", "z from the axis (mm)");

    let near = points.iter().filter(|p| p.valid).map(|Point { at: [y, z], .. }| z.atan2(*y).to_degrees());
    let arc = Seen::new(near).window();
    svg.clipped("end-view", panel.area, |svg| draw_circle(svg, &panel, radius, arc));
    let mut entries = draw_points(svg, &panel, &points, scan.points().len());
    draw_centre(svg, &panel, radius);
    panel.frame(svg);
    entries.push(Entry::new(Symbol::Stroke, FITTED, format!("fitted circle, R = {} mm", fixed(radius, 3))));
    let side = format!("side seen by valid profiles: {}°", fixed(arc.width(), 0));
    if arc.width() < ALL_AROUND {
        entries.push(Entry::new(Symbol::Dashes, FAINT_INK, side));
    }
    let end = legend(svg, SIDE, &entries);
    let area = Area { top: end + 14.0, ..SIDE };
    paragraph(svg, area, Type::sized(12.0).colour(FAINT_INK), &nearness(&points, radius));
}

/// In words what cannot be seen in true proportion.
fn nearness(points: &[Point], radius: f64) -> String {
    let valid = points.iter().filter(|point| point.valid);
    let mut distances: Vec<f64> = valid.map(|Point { at: [y, z], .. }| (y.hypot(*z) - radius).abs()).collect();
    let within = [0.5, 0.95].map(|part| quantile(&mut distances, part));
    let [Some(half), Some(most)] = within else {
        return "No profile is valid.".to_owned();
    };
    format!(
        "Of the drawn points of valid profiles, half lie within ±{} mm of the circle, 95 % within ±{} mm.",
        fixed(half, 3),
        fixed(most, 3)
    )
}

/// The circle below the points, and two radii between which the part was seen.
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

fn draw_in_rail_frame(svg: &mut Svg, scan: &Scan, estimate: &Estimate, refusal: &Refusal) {
    let points: Vec<Point> =
        thinned(scan, POINTS_MAX).map(|(index, _, at)| Point { at, valid: is_valid(estimate, index) }).collect();
    let places: Vec<[f64; 2]> = points.iter().map(|point| point.at).collect();
    let panel = Panel::around(VIEW, &places);
    panel.draw(svg, "y (mm)", "z (mm)");
    let entries = draw_points(svg, &panel, &points, scan.points().len());
    let end = legend(svg, SIDE, &entries);
    let head = Type::sized(14.0).bold().colour(EXCLUDED);
    let area = Area { top: end + 24.0, ..SIDE };
    let end = paragraph(svg, area, head, &format!("Refused: {}", refusal.code()));
    paragraph(svg, Area { top: end + 4.0, ..area }, Type::sized(12.0), &format!("{refusal}."));
}

/// The points, rejected profiles below; returns their entries of the legend.
fn draw_points(svg: &mut Svg, panel: &Panel, points: &[Point], total: usize) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut beyond = 0;
    for (valid, colour, words) in
        [(false, REJECTED, "points of rejected profiles"), (true, VALID, "points of valid profiles")]
    {
        let symbol = if points.len() > 1000 { Symbol::Speck } else { Symbol::Dot };
        let mut marks = Marks::new(symbol, colour);
        for point in points.iter().filter(|point| point.valid == valid) {
            marks.add_inside(panel, point.at);
        }
        beyond += marks.draw(svg);
        if points.iter().any(|point| point.valid == valid) {
            entries.insert(0, Entry::new(Symbol::Dot, colour, words));
        }
    }
    if total > points.len() {
        let words = format!("1 point in {} drawn", total.div_ceil(points.len().max(1)));
        entries.push(Entry::remark(words));
    }
    if beyond > 0 {
        entries.push(Entry::remark(format!("{beyond} of them beyond the frame")));
    }
    entries
}
