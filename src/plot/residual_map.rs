//! The picture of the unrolled surface: direction around the axis against x, coloured by the signed distance of the
//! points from the fitted cylinder. Clamps, holes and wrong shapes are seen here at once. Must not know ellipses.
//!
//! Points are averaged (mean) over cells, so one pass over any number of points needs memory for the cells only; cells
//! without points stay blank. The colour scale is centred on 0 and saturates at about four robust spreads of the cells.

use super::Subject;
use super::about_axis::{Cylinder, is_valid, thinned};
use super::area::Area;
use super::marks::Symbol;
use super::notice::{MARGIN, page, paragraph};
use super::palette::{EXCLUDED, FAINT_INK, LEVELS, level, level_colour};
use super::panel::Panel;
use super::seen::{Seen, turned_into};
use super::spread::{quantile, round_up};
use super::svg::{Anchor, Svg, Type};
use super::ticks::{Range, fixed};
use crate::estimation::{Estimate, Outcome};
use crate::scan::Scan;
use std::fmt::Write as _;

/// Most cells along x and around the axis. Their product bounds the file: a cell takes some 15 bytes.
const CELLS_MAX: [usize; 2] = [240, 160];
const AREA: Area = Area::new(84.0, 96.0, 776.0, 432.0);

/// Mean distances over the cells of a window of x and direction.
struct Grid {
    x: Range,
    degrees: Range,
    columns: usize,
    rows: usize,
    /// Sum and number of the distances, row after row.
    cells: Vec<(f64, u32)>,
    /// Profiles and valid profiles in each column.
    profiles: Vec<(u32, u32)>,
}

/// Draws the unrolled surface, or why there is no cylinder to compare it with.
pub(super) fn residual_map(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let what = "Distance from the fitted cylinder";
    let cylinder = match &estimate.outcome {
        Outcome::Refused(refusal) => {
            let mut svg = page(what, subject.title, "no pose, so there is no cylinder to measure distances from");
            let area = Area::new(120.0, 220.0, 760.0, 200.0);
            let head = Type::sized(20.0).bold().colour(EXCLUDED);
            let end = paragraph(&mut svg, area, head, &format!("Refused: {}", refusal.code()));
            let words = format!("{refusal}.");
            paragraph(&mut svg, Area { top: end + 8.0, ..area }, Type::sized(16.0), &words);
            return svg.finish();
        }
        Outcome::Accepted(pose) => Cylinder { axis: pose.axis, radius: pose.radius },
    };
    let grid = Grid::new(scan, estimate, cylinder);
    let limit = grid.limit(cylinder.radius);
    let caption = format!(
        "mean over cells of {} mm × {}° · red outside, blue inside, blank without points · radius {} mm",
        fixed(grid.x.width() / grid.columns as f64, 2),
        fixed(grid.degrees.width() / grid.rows as f64, 2),
        fixed(cylinder.radius, 3)
    );
    let mut svg = page(what, subject.title, &caption);
    let panel = Panel::new(AREA, grid.x, grid.degrees);
    panel.draw(&mut svg, "x (mm)", "direction around the axis, 0° = +Y, 90° = +Z (°)");
    grid.draw(&mut svg, limit);
    panel.frame(&mut svg);
    grid.draw_rejected(&mut svg);
    colour_bar(&mut svg, limit);
    svg.finish()
}

impl Grid {
    fn new(scan: &Scan, estimate: &Estimate, cylinder: Cylinder) -> Self {
        let mut grid = Self::empty(scan, cylinder);
        let (mut y, mut z) = (Vec::new(), Vec::new());
        for (index, station) in scan.stations().iter().enumerate() {
            let column = cell(station.x, grid.x, grid.columns);
            if let Some((all, valid)) = grid.profiles.get_mut(column) {
                *all += 1;
                *valid += u32::from(is_valid(estimate, index));
            }
            scan.load(*station, &mut y, &mut z);
            for (&y, &z) in y.iter().zip(&z) {
                let polar = cylinder.polar(station.x, [y, z]);
                let degrees = turned_into(polar.angle.to_degrees(), grid.degrees.lo);
                // Thinning may have missed a few directions at the edge; they are off the map.
                if degrees < grid.degrees.hi {
                    grid.add(column, cell(degrees, grid.degrees, grid.rows), polar.distance - cylinder.radius);
                }
            }
        }
        grid
    }

    /// Cells no finer than the profiles lie apart, so that a regular scan leaves no stripes.
    fn empty(scan: &Scan, cylinder: Cylinder) -> Self {
        let stations = scan.stations();
        let mut gaps: Vec<f64> =
            stations.windows(2).filter_map(|pair| Some(pair.last()?.x - pair.first()?.x)).collect();
        let gap = quantile(&mut gaps, 0.5).unwrap_or(0.0).max(1e-6);
        let (first, last) = (stations.first().map_or(0.0, |s| s.x), stations.last().map_or(0.0, |s| s.x));
        let apart = ((last - first) / gap).round().min(1e6) as usize + 1;
        let columns = apart.clamp(1, CELLS_MAX[0]);
        let margin = if apart > 1 { (last - first) / (apart - 1) as f64 / 2.0 } else { 0.5 };

        let directions = thinned(scan, 50_000).map(|(_, x, at)| cylinder.polar(x, at).angle.to_degrees());
        let degrees = Seen::new(directions).window();
        let per_column = scan.columns().len() / columns;
        let rows = (per_column / 2).clamp(12, CELLS_MAX[1]);
        Self {
            x: Range::new(first - margin, last + margin),
            degrees,
            columns,
            rows,
            cells: vec![(0.0, 0); columns * rows],
            profiles: vec![(0, 0); columns],
        }
    }

    fn add(&mut self, column: usize, row: usize, distance: f64) {
        if let Some((sum, count)) = self.cells.get_mut(row * self.columns + column) {
            *sum += distance;
            *count += 1;
        }
    }

    /// Where the colours saturate, mm: about four robust spreads of the cells of valid profiles, a round number.
    fn limit(&self, radius: f64) -> f64 {
        let valid = |index: usize| self.profiles.get(index % self.columns).is_some_and(|&(_, valid)| valid > 0);
        let mut sizes: Vec<f64> = (self.cells.iter().enumerate())
            .filter(|&(index, _)| valid(index))
            .filter_map(|(_, cell)| mean(cell).map(f64::abs))
            .collect();
        let spread = 1.4826 * quantile(&mut sizes, 0.5).unwrap_or(0.0);
        // Below this one would look at the rounding of the coordinates.
        round_up((4.0 * spread).max(radius.abs() * 1e-7).clamp(1e-6, 1e12))
    }

    /// The cells, one path a colour; neighbours of one colour in a row are one field.
    fn draw(&self, svg: &mut Svg, limit: f64) {
        let mut fields = vec![String::new(); (2 * LEVELS + 1) as usize];
        for (index, row) in self.cells.chunks(self.columns).enumerate() {
            // Directions grow upwards, pixels downwards.
            let top = self.rows - 1 - index;
            let mut column = 0;
            for run in row.chunk_by(|a, b| mean(a).map(|v| level(v, limit)) == mean(b).map(|v| level(v, limit))) {
                let of_level = run.first().and_then(mean).map(|v| (level(v, limit) + LEVELS) as usize);
                if let Some(field) = of_level.and_then(|level| fields.get_mut(level)) {
                    let length = run.len();
                    // Writing to a string cannot fail.
                    let _ = write!(field, "M{column} {top}h{length}v1h-{length}z");
                }
                column += run.len();
            }
        }
        let cell = [AREA.width / self.columns as f64, AREA.height / self.rows as f64];
        svg.gridded(AREA, cell, |svg| {
            for (level, field) in (-LEVELS..).zip(&fields) {
                svg.path(field, format_args!("fill=\"{}\"", level_colour(level)));
            }
        });
    }

    /// A strip above the map: where most profiles were rejected.
    fn draw_rejected(&self, svg: &mut Svg) {
        let strip = Area::new(AREA.left, AREA.top - 11.0, AREA.width, 6.0);
        let mut fields = String::new();
        for (column, &(all, valid)) in self.profiles.iter().enumerate() {
            if all > 0 && 2 * valid < all {
                // Writing to a string cannot fail.
                let _ = write!(fields, "M{column} 0h1v1h-1z");
            }
        }
        svg.gridded(strip, [strip.width / self.columns as f64, strip.height], |svg| {
            svg.path(&fields, format_args!("fill=\"{FAINT_INK}\""));
        });
        if !fields.is_empty() {
            Symbol::Field.draw(svg, [MARGIN + 9.0, 578.0], FAINT_INK);
            svg.text([MARGIN + 26.0, 582.0], Type::sized(12.0), "above the map: profiles that were rejected");
        }
    }
}

/// The cell of a value in a range of `count` cells.
fn cell(value: f64, range: Range, count: usize) -> usize {
    let place = (value - range.lo) / range.width() * count as f64;
    (place.max(0.0) as usize).min(count.saturating_sub(1))
}

fn mean(&(sum, count): &(f64, u32)) -> Option<f64> {
    (count > 0 && sum.is_finite()).then(|| sum / f64::from(count))
}

/// The colours and what they mean, in millimetres.
fn colour_bar(svg: &mut Svg, limit: f64) {
    let bar = Area::new(892.0, AREA.top + 20.0, 20.0, AREA.height - 40.0);
    let step = bar.height / f64::from(2 * LEVELS + 1);
    for level in -LEVELS..=LEVELS {
        let top = bar.top + f64::from(LEVELS - level) * step;
        svg.rect(Area { top, height: step + 0.3, ..bar }, format_args!("fill=\"{}\"", level_colour(level)));
    }
    // The outermost colours go on for ever.
    for (y, tip, level) in [(bar.top, -12.0, LEVELS), (bar.bottom() + 0.3, 12.0, -LEVELS)] {
        let data = format!("M892 {}h20l-10 {tip}z", super::svg::Px(y));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_on_the_upper_edge_is_in_the_last_cell() {
        let range = Range::new(0.0, 10.0);
        assert_eq!([-1.0, 0.0, 4.99, 10.0, 11.0].map(|v| cell(v, range, 5)), [0, 0, 2, 4, 4]);
    }
}
