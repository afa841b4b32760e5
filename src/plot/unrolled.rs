//! The unrolled surface as a grid: direction around the axis × x, each cell the median signed distance of its points
//! from the cylinder. Must not know colours.
//!
//! The median, because a single spike would colour the mean of a cell of ten points. Profiles come in order of x, so
//! only one column's distances are kept at a time, whatever the size of the scan.

use super::about_axis::{Cylinder, is_valid, thinned};
use super::seen::{Seen, turned_into};
use super::spread::{median, quantile};
use super::ticks::Range;
use crate::estimation::Estimate;
use crate::scan::Scan;

/// Most cells along x and around the axis. Their product bounds the file: a cell takes some 15 bytes.
const COLUMNS_MAX: usize = 240;
const ROWS_MAX: usize = 160;

/// Median distances from a cylinder over a window of x (mm) and direction (degrees).
pub(super) struct Unrolled {
    pub(super) x: Range,
    pub(super) degrees: Range,
    pub(super) columns_count: usize,
    pub(super) rows_count: usize,
    /// Row after row, by growing direction; `None` without points.
    pub(super) cells: Vec<Option<f64>>,
    /// What was scanned in each column.
    pub(super) columns: Vec<Column>,
}

/// The profiles of one column.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Column {
    profiles_count: usize,
    valid_count: usize,
}

impl Column {
    /// Whether more than half of its profiles were rejected.
    pub(super) fn is_rejected(self) -> bool {
        2 * self.valid_count < self.profiles_count
    }
}

impl Unrolled {
    /// Unrolls all points of a scan.
    pub(super) fn new(scan: &Scan, estimate: &Estimate, cylinder: Cylinder) -> Self {
        let mut unrolled = Self::empty(scan, cylinder);
        let (mut y, mut z) = (Vec::new(), Vec::new());
        let mut distances = vec![Vec::new(); unrolled.rows_count];
        let mut current = 0;
        for (index, station) in scan.stations().iter().enumerate() {
            let place = cell(station.x, unrolled.x, unrolled.columns_count);
            if place != current {
                unrolled.settle(current, &mut distances);
                current = place;
            }
            if let Some(column) = unrolled.columns.get_mut(place) {
                column.profiles_count += 1;
                column.valid_count += usize::from(is_valid(estimate, index));
            }
            scan.load(*station, &mut y, &mut z);
            for (&y, &z) in y.iter().zip(&z) {
                let polar = cylinder.polar(station.x, [y, z]);
                let degrees = turned_into(polar.angle.to_degrees(), unrolled.degrees.lo);
                let distance = polar.distance - cylinder.radius;
                // The window was found on a thinned scan: a few directions at its edge may be off the map.
                if degrees < unrolled.degrees.hi && distance.is_finite() {
                    let row = cell(degrees, unrolled.degrees, unrolled.rows_count);
                    distances.get_mut(row).into_iter().for_each(|distances| distances.push(distance));
                }
            }
        }
        unrolled.settle(current, &mut distances);
        unrolled
    }

    /// Cells no finer than the profiles lie apart, so that a regular scan leaves no stripes.
    fn empty(scan: &Scan, cylinder: Cylinder) -> Self {
        let stations = scan.stations();
        let mut gaps: Vec<f64> =
            stations.windows(2).filter_map(|pair| Some(pair.last()?.x - pair.first()?.x)).collect();
        let gap = quantile(&mut gaps, 0.5).unwrap_or(0.0).max(1e-6);
        let (first, last) = (stations.first().map_or(0.0, |s| s.x), stations.last().map_or(0.0, |s| s.x));
        let gaps_count = ((last - first) / gap).round().min(1e6);
        let columns_count = (gaps_count as usize + 1).min(COLUMNS_MAX);
        let margin = if gaps_count > 0.0 { (last - first) / gaps_count / 2.0 } else { 0.5 };

        // Nor finer than the points of a profile lie apart.
        let directions = thinned(scan, 50_000).map(|(_, x, at)| cylinder.polar(x, at).angle.to_degrees());
        let seen = Seen::new(directions);
        let rows_count = (scan.points().len() / columns_count).min(seen.bins_count()) / 2;
        let rows_count = rows_count.clamp(12, ROWS_MAX);
        Self {
            x: Range::new(first - margin, last + margin),
            degrees: seen.window(),
            columns_count,
            rows_count,
            cells: vec![None; columns_count * rows_count],
            columns: vec![Column::default(); columns_count],
        }
    }

    /// Writes a column's medians and forgets its distances.
    fn settle(&mut self, column: usize, distances: &mut [Vec<f64>]) {
        for (row, distances) in distances.iter_mut().enumerate() {
            if let Some(cell) = self.cells.get_mut(row * self.columns_count + column) {
                *cell = median(distances);
            }
            distances.clear();
        }
    }

    /// The distances of the cells in columns that hold a valid profile, without sign.
    pub(super) fn sizes_of_valid(&self) -> Vec<f64> {
        let is_valid = |index: usize| self.columns.get(index % self.columns_count).is_some_and(|c| c.valid_count > 0);
        let cells = self.cells.iter().enumerate().filter(|&(index, _)| is_valid(index));
        cells.filter_map(|(_, cell)| cell.map(f64::abs)).collect()
    }
}

/// The cell of a value in a range of `count` cells.
fn cell(value: f64, range: Range, count: usize) -> usize {
    let place = (value - range.lo) / range.width() * count as f64;
    (place.max(0.0) as usize).min(count.saturating_sub(1))
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
