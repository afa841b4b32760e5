//! The picture of the surface: direction around the axis against x, coloured by the signed distance of the points from the fitted
//! cylinder, which shows clamps, holes and form deviations. For a refused scan it shows the surface from above, coloured by its
//! height.
//!
//! Cells without points stay blank. The scale of the distances is centred on 0 and saturates at about four robust spreads of the
//! cells.

use super::about_axis::{Cylinder, Names, names};
use super::grid::{Grid, from_above, unrolled};
use super::header::{BODY_TOP, MARGIN, Subject, page};
use super::marks::{Entry, Symbol, legend};
use super::overlays;
use super::palette::{FAINT_INK, LEVELS, height_colour, level, signed_colour};
use super::panel::Panel;
use super::scale::{Range, fixed, quantile, round_up};
use super::svg::{Anchor, Area, Px, Svg, Type};
use crate::estimation::{Estimate, Outcome, Pose};
use crate::scan::Scan;
use std::fmt::Write as _;

const AREA: Area = Area::new(84.0, BODY_TOP + 24.0, 776.0, 440.0);
const LEGEND: Area = Area::new(MARGIN, 650.0, 952.0, 40.0);

/// Values by colour.
struct Scale {
    middle: f64,
    /// Distance from the middle at which the colours saturate.
    limit: f64,
    colour: fn(i32) -> String,
    /// Whether numbers have a sign.
    signed: bool,
    label: &'static str,
}

impl Scale {
    /// The values that are written beside the colours, and their meaning.
    fn numbers(&self) -> (Vec<(f64, String)>, String) {
        if !self.signed {
            let ticks = Range::new(self.middle - self.limit, self.middle + self.limit).ticks(6.0);
            let numbers = ticks.values.iter().map(|value| (*value, ticks.label(*value))).collect();
            return (numbers, ticks.with_base(self.label));
        }
        let decimals = (2.0 - self.limit.log10().floor()).clamp(0.0, 9.0) as usize;
        let number = |part: f64| {
            let sign = if part > 0.0 { "+" } else { "" };
            (part * self.limit, format!("{sign}{}", fixed(part * self.limit, decimals)))
        };
        ([-1.0, -0.5, 0.0, 0.5, 1.0].map(number).to_vec(), self.label.to_owned())
    }
}

/// Draws the surface, unrolled or from above.
pub(super) fn residual_map(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    match &estimate.outcome {
        Outcome::Accepted(pose) => distances(scan, estimate, pose, subject),
        Outcome::Refused(_) => heights(scan, estimate, subject),
    }
}

fn distances(scan: &Scan, estimate: &Estimate, pose: &Pose, subject: &Subject<'_>) -> String {
    let grid = unrolled(scan, estimate, Cylinder::of(pose));
    let caption = format!(
        "median of the points in cells of {} mm × {}°: red outside the cylinder, blue inside, blank without points",
        fixed(grid.x.width() / grid.columns_count as f64, 2),
        fixed(grid.across.width() / grid.rows_count as f64, 2)
    );
    let mut svg = page("Distance from the fitted cylinder", &caption, estimate, subject);
    let limit = limit(&grid, pose.radius);
    let scale = Scale { middle: 0.0, limit, colour: signed_colour, signed: true, label: "mm" };
    let Names { x_label, y, z, .. } = names(estimate);
    let y_label = format!("angle around the axis, 0° = +{}, 90° = +{} (°)", y.to_uppercase(), z.to_uppercase());
    let panel = draw(&mut svg, &grid, &scale, x_label, &y_label);
    svg.clipped("surface", AREA, |svg| overlays::draw_end_faces_around(svg, &panel, pose));
    legend(&mut svg, LEGEND, &entries(&grid).chain(overlays::end_face_entries(pose)).collect::<Vec<_>>());
    svg.finish()
}

fn heights(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let grid = from_above(scan, estimate);
    let caption = format!(
        "no pose, so no cylinder to measure distances from: the height z of the points from above, in cells of {} mm × {} mm",
        fixed(grid.x.width() / grid.columns_count as f64, 2),
        fixed(grid.across.width() / grid.rows_count as f64, 2)
    );
    let mut svg = page("Surface from above", &caption, estimate, subject);
    let mut cells: Vec<f64> = grid.cells.iter().flatten().copied().collect();
    let [lo, hi] = [0.01, 0.99].map(|part| quantile(&mut cells, part).unwrap_or(0.0));
    let range = Range::new(lo, hi);
    let (middle, limit) = (range.middle(), range.width() / 2.0);
    let scale = Scale { middle, limit, colour: height_colour, signed: false, label: "z (mm)" };
    draw(&mut svg, &grid, &scale, "x (mm)", "y (mm)");
    legend(&mut svg, LEGEND, &entries(&grid).collect::<Vec<_>>());
    svg.finish()
}

/// The distance at which the colours saturate, mm: a round number above four robust spreads of the cells, not larger than the
/// largest value requires.
fn limit(grid: &Grid, radius: f64) -> f64 {
    let mut sizes: Vec<f64> = grid.not_rejected().map(f64::abs).collect();
    let spread = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0);
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    // A finer scale would show only the rounding of the coordinates.
    round_up((4.0 * spread).min(largest).max(radius.abs() * 1e-7).clamp(1e-6, 1e12))
}

fn draw(svg: &mut Svg, grid: &Grid, scale: &Scale, x_label: &str, y_label: &str) -> Panel {
    let panel = Panel::new(AREA, grid.x, grid.across);
    panel.draw(svg, x_label, y_label);
    draw_cells(svg, grid, scale);
    panel.frame(svg);
    draw_rejected(svg, grid);
    draw_colour_bar(svg, scale);
    panel
}

/// Draws the cells, one path a colour; neighbours of one colour in a row become one rectangle.
fn draw_cells(svg: &mut Svg, grid: &Grid, scale: &Scale) {
    let mut fields = vec![String::new(); (2 * LEVELS + 1) as usize];
    let colour = |cell: &Option<f64>| cell.map(|value| (level(value - scale.middle, scale.limit) + LEVELS) as usize);
    for (index, row) in grid.cells.chunks(grid.columns_count).enumerate() {
        // The coordinate increases upwards, pixels downwards.
        let top = grid.rows_count - 1 - index;
        let mut column = 0;
        for run in row.chunk_by(|a, b| colour(a) == colour(b)) {
            if let Some(field) = run.first().and_then(colour).and_then(|colour| fields.get_mut(colour)) {
                let length = run.len();
                // Writing to a string cannot fail.
                let _ = write!(field, "M{column} {top}h{length}v1h-{length}z");
            }
            column += run.len();
        }
    }
    let cell = [AREA.width / grid.columns_count as f64, AREA.height / grid.rows_count as f64];
    svg.gridded(AREA, cell, |svg| {
        for (level, field) in (-LEVELS..).zip(&fields) {
            svg.path(field, format_args!("fill=\"{}\"", (scale.colour)(level)));
        }
    });
}

/// Draws a strip above the map at the x where most profiles were rejected.
fn draw_rejected(svg: &mut Svg, grid: &Grid) {
    let strip = Area::new(AREA.left, AREA.top - 11.0, AREA.width, 6.0);
    let mut fields = String::new();
    for (index, _) in grid.columns.iter().enumerate().filter(|(_, column)| column.is_rejected()) {
        // Writing to a string cannot fail.
        let _ = write!(fields, "M{index} 0h1v1h-1z");
    }
    if fields.is_empty() {
        return;
    }
    svg.gridded(strip, [strip.width / grid.columns_count as f64, strip.height], |svg| {
        svg.path(&fields, format_args!("fill=\"{FAINT_INK}\""));
    });
}

fn entries(grid: &Grid) -> impl Iterator<Item = Entry> {
    let rejected = grid.columns.iter().any(|column| column.is_rejected());
    let rejected = rejected.then(|| Entry::new(Symbol::Field, FAINT_INK, "strip above the map: rejected profiles"));
    rejected.into_iter().chain([Entry::remark("tips of the colour bar: off scale")])
}

/// The colours and their meaning, in millimetres.
fn draw_colour_bar(svg: &mut Svg, scale: &Scale) {
    let bar = Area::new(892.0, AREA.top + 20.0, 20.0, AREA.height - 40.0);
    let step = bar.height / f64::from(2 * LEVELS + 1);
    for level in -LEVELS..=LEVELS {
        let top = bar.top + f64::from(LEVELS - level) * step;
        svg.rect(Area { top, height: step + 0.3, ..bar }, format_args!("fill=\"{}\"", (scale.colour)(level)));
    }
    // The outermost colours represent all values beyond them.
    for (y, tip, level) in [(bar.top, -12.0, LEVELS), (bar.bottom() + 0.3, 12.0, -LEVELS)] {
        let data = format!("M{} {}h20l-10 {}z", Px(bar.left), Px(y), Px(tip));
        svg.path(&data, format_args!("fill=\"{}\"", (scale.colour)(level)));
    }
    let look = Type::sized(11.0).colour(FAINT_INK);
    let (numbers, label) = scale.numbers();
    for (value, number) in numbers {
        let [_, middle] = bar.middle();
        let y = middle - (value - scale.middle) / scale.limit * f64::from(LEVELS) * step;
        svg.line([bar.right(), y], [bar.right() + 4.0, y], format_args!("stroke=\"{FAINT_INK}\" stroke-width=\"0.8\""));
        svg.text([bar.right() + 8.0, y + 4.0], look, &number);
    }
    svg.text([bar.left + 10.0, AREA.top - 5.0], Type::sized(11.0).anchor(Anchor::Middle), &label);
}
