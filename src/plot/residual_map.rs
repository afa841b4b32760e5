//! The picture of the unrolled surface: direction around the axis against x, coloured by the signed distance of the
//! points from the fitted cylinder. Clamps, holes and wrong shapes are seen here at once. Must not know ellipses.
//!
//! A cell shows the median of its points and stays blank without points. The colour scale is centred on 0 and saturates
//! at about four robust spreads of the cells.

use super::Subject;
use super::about_axis::Cylinder;
use super::area::Area;
use super::marks::Symbol;
use super::notice::{MARGIN, page, paragraph};
use super::palette::{EXCLUDED, FAINT_INK, LEVELS, level, level_colour};
use super::panel::Panel;
use super::spread::{quantile, round_up};
use super::svg::{Anchor, Px, Svg, Type};
use super::ticks::fixed;
use super::unrolled::Unrolled;
use crate::estimation::{Estimate, Outcome, Pose, Refusal};
use crate::scan::Scan;
use std::fmt::Write as _;

const WHAT: &str = "Distance from the fitted cylinder";
const AREA: Area = Area::new(84.0, 96.0, 776.0, 432.0);

/// Draws the unrolled surface, or why there is no cylinder to compare it with.
pub(super) fn residual_map(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    match &estimate.outcome {
        Outcome::Accepted(pose) => map(scan, estimate, pose, subject),
        Outcome::Refused(refusal) => words(refusal, subject),
    }
}

fn words(refusal: &Refusal, subject: &Subject<'_>) -> String {
    let mut svg = page(WHAT, subject.title, "no pose, so there is no cylinder to measure distances from");
    let area = Area::new(120.0, 220.0, 760.0, 200.0);
    let head = Type::sized(20.0).bold().colour(EXCLUDED);
    let end = paragraph(&mut svg, area, head, &format!("Refused: {}", refusal.code()));
    paragraph(&mut svg, Area { top: end, ..area }, Type::sized(16.0), &format!("{refusal}."));
    svg.finish()
}

fn map(scan: &Scan, estimate: &Estimate, pose: &Pose, subject: &Subject<'_>) -> String {
    let unrolled = Unrolled::new(scan, estimate, Cylinder { axis: pose.axis, radius: pose.radius });
    let caption = format!(
        "median over cells of {} mm × {}° · red outside, blue inside, blank without points · radius {} mm",
        fixed(unrolled.x.width() / unrolled.columns_count as f64, 2),
        fixed(unrolled.degrees.width() / unrolled.rows_count as f64, 2),
        fixed(pose.radius, 3)
    );
    let mut svg = page(WHAT, subject.title, &caption);
    let panel = Panel::new(AREA, unrolled.x, unrolled.degrees);
    panel.draw(&mut svg, "x (mm)", "direction around the axis, 0° = +Y, 90° = +Z (°)");
    let limit = limit(&unrolled, pose.radius);
    draw_cells(&mut svg, &unrolled, limit);
    panel.frame(&mut svg);
    draw_rejected(&mut svg, &unrolled);
    draw_colour_bar(&mut svg, limit);
    svg.finish()
}

/// Where the colours saturate, mm: a round number above four robust spreads of the cells, no more than the largest
/// needs.
fn limit(unrolled: &Unrolled, radius: f64) -> f64 {
    let mut sizes = unrolled.sizes_of_valid();
    let spread = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0);
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    // Below this one would look at the rounding of the coordinates.
    round_up((4.0 * spread).min(largest).max(radius.abs() * 1e-7).clamp(1e-6, 1e12))
}

/// The cells, one path a colour; neighbours of one colour in a row are one field.
fn draw_cells(svg: &mut Svg, unrolled: &Unrolled, limit: f64) {
    let mut fields = vec![String::new(); (2 * LEVELS + 1) as usize];
    let colour = |cell: &Option<f64>| cell.map(|distance| (level(distance, limit) + LEVELS) as usize);
    for (index, row) in unrolled.cells.chunks(unrolled.columns_count).enumerate() {
        // Directions grow upwards, pixels downwards.
        let top = unrolled.rows_count - 1 - index;
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
    let cell = [AREA.width / unrolled.columns_count as f64, AREA.height / unrolled.rows_count as f64];
    svg.gridded(AREA, cell, |svg| {
        for (level, field) in (-LEVELS..).zip(&fields) {
            svg.path(field, format_args!("fill=\"{}\"", level_colour(level)));
        }
    });
}

/// A strip above the map: where most profiles were rejected.
fn draw_rejected(svg: &mut Svg, unrolled: &Unrolled) {
    let strip = Area::new(AREA.left, AREA.top - 11.0, AREA.width, 6.0);
    let mut fields = String::new();
    for (index, _) in unrolled.columns.iter().enumerate().filter(|(_, column)| column.is_rejected()) {
        // Writing to a string cannot fail.
        let _ = write!(fields, "M{index} 0h1v1h-1z");
    }
    if fields.is_empty() {
        return;
    }
    svg.gridded(strip, [strip.width / unrolled.columns_count as f64, strip.height], |svg| {
        svg.path(&fields, format_args!("fill=\"{FAINT_INK}\""));
    });
    Symbol::Field.draw(svg, [MARGIN + 9.0, 580.0], FAINT_INK);
    svg.text([MARGIN + 26.0, 584.0], Type::sized(12.0), "above the map: profiles that were rejected");
}

/// The colours and what they mean, in millimetres.
fn draw_colour_bar(svg: &mut Svg, limit: f64) {
    let bar = Area::new(892.0, AREA.top + 20.0, 20.0, AREA.height - 40.0);
    let step = bar.height / f64::from(2 * LEVELS + 1);
    for level in -LEVELS..=LEVELS {
        let top = bar.top + f64::from(LEVELS - level) * step;
        svg.rect(Area { top, height: step + 0.3, ..bar }, format_args!("fill=\"{}\"", level_colour(level)));
    }
    // The outermost colours go on for ever.
    for (y, tip, level) in [(bar.top, -12.0, LEVELS), (bar.bottom() + 0.3, 12.0, -LEVELS)] {
        let data = format!("M{} {}h20l-10 {}z", Px(bar.left), Px(y), Px(tip));
        svg.path(&data, format_args!("fill=\"{}\"", level_colour(level)));
    }
    let decimals = (2.0 - limit.log10().floor()).clamp(0.0, 9.0) as usize;
    let look = Type::sized(11.0).colour(FAINT_INK);
    for part in [-1.0, -0.5, 0.0, 0.5, 1.0] {
        let [_, middle] = bar.middle();
        let y = middle - part * f64::from(LEVELS) * step;
        svg.line([bar.right(), y], [bar.right() + 4.0, y], format_args!("stroke=\"{FAINT_INK}\" stroke-width=\"0.8\""));
        let sign = if part > 0.0 { "+" } else { "" };
        svg.text([bar.right() + 8.0, y + 4.0], look, &format!("{sign}{}", fixed(part * limit, decimals)));
    }
    svg.text([bar.left + 10.0, AREA.top - 5.0], Type::sized(11.0).anchor(Anchor::Middle), "mm");
}
