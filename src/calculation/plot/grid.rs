//! The points of a scan as a grid: x against another coordinate, each cell one value of its points. Profiles come in order of
//! x, so only one column's values are kept at a time, whatever the size of the scan.

use super::about_axis::{Status, status};
use super::spread::quantile;
use super::ticks::Range;
use crate::estimation::Estimate;
use crate::scan::Scan;

/// Most cells along x and across. Their product bounds the file: a cell takes some 15 bytes.
const COLUMNS_MAX: usize = 240;
const ROWS_MAX: usize = 160;
const ROWS_MIN: usize = 12;

/// Values over x (mm) and another coordinate.
pub(super) struct Grid {
    pub(super) x: Range,
    pub(super) across: Range,
    pub(super) columns_count: usize,
    pub(super) rows_count: usize,
    /// Row after row, by growing coordinate; `None` without points.
    pub(super) cells: Vec<Option<f64>>,
    /// What was scanned in each column.
    pub(super) columns: Vec<Column>,
}

/// The profiles of one column.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Column {
    profiles_count: usize,
    rejected_count: usize,
}

impl Column {
    /// Whether more than half of its profiles were rejected.
    pub(super) fn is_rejected(self) -> bool {
        2 * self.rejected_count > self.profiles_count
    }
}

impl Grid {
    /// No cell yet. Columns are no narrower than the profiles lie apart, so that a regular scan leaves no stripes, and a row holds
    /// some points of each column; there are at most `rows_max`.
    pub(super) fn empty(scan: &Scan, across: Range, rows_max: usize) -> Self {
        let stations = scan.stations();
        let mut gaps: Vec<f64> =
            stations.windows(2).filter_map(|pair| Some(pair.last()?.x - pair.first()?.x)).collect();
        let gap = quantile(&mut gaps, 0.5).unwrap_or(0.0).max(1e-6);
        let (first, last) = (stations.first().map_or(0.0, |s| s.x), stations.last().map_or(0.0, |s| s.x));
        let gaps_count = ((last - first) / gap).round().min(1e6);
        let columns_count = (gaps_count as usize + 1).min(COLUMNS_MAX);
        let margin = if gaps_count > 0.0 { (last - first) / gaps_count / 2.0 } else { 0.5 };
        let rows_count = (scan.points().len() / columns_count).min(rows_max) / 2;
        let rows_count = rows_count.clamp(ROWS_MIN, ROWS_MAX);
        Self {
            x: Range::new(first - margin, last + margin),
            across,
            columns_count,
            rows_count,
            cells: vec![None; columns_count * rows_count],
            columns: vec![Column::default(); columns_count],
        }
    }

    /// Fills every cell: `place` gives the coordinate across and the value of a point, `settle` the value of a cell from those of
    /// its points.
    pub(super) fn filled(
        mut self,
        scan: &Scan,
        estimate: &Estimate,
        place: impl Fn([f64; 3]) -> (f64, f64),
        settle: fn(&mut [f64]) -> Option<f64>,
    ) -> Self {
        let mut values = vec![Vec::new(); self.rows_count];
        let mut current = 0;
        for (index, station) in scan.stations().iter().enumerate() {
            let column = cell(station.x, self.x, self.columns_count);
            if column != current {
                self.write(current, &mut values, settle);
                current = column;
            }
            if let Some(column) = self.columns.get_mut(column) {
                column.profiles_count += 1;
                column.rejected_count += usize::from(status(estimate, index) == Status::Rejected);
            }
            for point in scan.points_of(station) {
                let (across, value) = place(point);
                // The range across may have been found on a thinned scan: a few points at its edge may be outside.
                if (self.across.lo..self.across.hi).contains(&across) && value.is_finite() {
                    let row = cell(across, self.across, self.rows_count);
                    values.get_mut(row).into_iter().for_each(|values| values.push(value));
                }
            }
        }
        self.write(current, &mut values, settle);
        self
    }

    /// Writes the cells of a column and forgets the values of its points.
    fn write(&mut self, column: usize, values: &mut [Vec<f64>], settle: fn(&mut [f64]) -> Option<f64>) {
        for (row, values) in values.iter_mut().enumerate() {
            if let Some(cell) = self.cells.get_mut(row * self.columns_count + column) {
                *cell = settle(values);
            }
            values.clear();
        }
    }

    /// The values of the cells in columns that hold a profile that was not rejected.
    pub(super) fn not_rejected(&self) -> impl Iterator<Item = f64> {
        let holds_one = |column: &Column| column.rejected_count < column.profiles_count;
        let is_shown = move |index: usize| self.columns.get(index % self.columns_count).is_some_and(holds_one);
        self.cells.iter().enumerate().filter(move |&(index, _)| is_shown(index)).filter_map(|(_, cell)| *cell)
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
