//! The points of a scan as a grid: x against another coordinate, one value for the points of each cell, unrolled around a cylinder,
//! or viewed from above without one. Profiles come in order of x, so only the values of one column are in memory at a time.
//!
//! [`Seen`] finds which directions around a centre have points: it gives the direction at which the circle is cut for unrolling,
//! and the observed arcs.

use super::about_axis::{Cylinder, Status, status, thinned};
use super::scale::{Range, median, quantile};
use crate::estimation::Estimate;
use crate::scan::Scan;

/// Largest number of cells along x and across. Their product bounds the file: a cell takes some 15 bytes.
const COLUMNS_MAX: usize = 240;
const ROWS_MAX: usize = 160;
const ROWS_MIN: usize = 12;

/// Values over x (mm) and another coordinate.
pub(super) struct Grid {
    pub(super) x: Range,
    pub(super) across: Range,
    pub(super) columns_count: usize,
    pub(super) rows_count: usize,
    /// Row by row, in ascending order of the coordinate; `None` without points.
    pub(super) cells: Vec<Option<f64>>,
    /// The profiles of each column.
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
    /// A grid without cells. Columns are no narrower than the distance of the profiles, so that a regular scan leaves no stripes,
    /// and a row contains some points of each column; there are at most `rows_max`.
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

    /// Fills every cell: `place` returns the coordinate across and the value of a point, `settle` the value of a cell from those of
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
                // The range across may come from a thinned scan: a few points at its edge may be outside.
                if (self.across.lo..self.across.hi).contains(&across) && value.is_finite() {
                    let row = cell(across, self.across, self.rows_count);
                    values.get_mut(row).into_iter().for_each(|values| values.push(value));
                }
            }
        }
        self.write(current, &mut values, settle);
        self
    }

    /// Writes the cells of a column and clears the values of its points.
    fn write(&mut self, column: usize, values: &mut [Vec<f64>], settle: fn(&mut [f64]) -> Option<f64>) {
        for (row, values) in values.iter_mut().enumerate() {
            if let Some(cell) = self.cells.get_mut(row * self.columns_count + column) {
                *cell = settle(values);
            }
            values.clear();
        }
    }

    /// The values of the cells in columns that contain a profile that was not rejected.
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

/// Points that are examined for the range across.
const POINTS_MAX: usize = 50_000;
/// Share of the points of a cell below its height: the picture shows the upper side of a closed part, and a single stray point
/// above it has no effect.
const UPPER: f64 = 0.9;

/// Direction around the axis in degrees against x; each cell is the median signed distance of its points from the cylinder, mm.
///
/// The median, because a single spike would dominate the mean of a cell of ten points.
pub(super) fn unrolled(scan: &Scan, estimate: &Estimate, cylinder: Cylinder) -> Grid {
    let seen = Seen::new(thinned(scan, POINTS_MAX).map(|(_, at)| cylinder.polar(at).angle.to_degrees()));
    let degrees = seen.window();
    // Rows are no finer than the distance of the points of a profile.
    Grid::empty(scan, degrees, seen.bins_count()).filled(
        scan,
        estimate,
        |point| {
            let polar = cylinder.polar(point);
            (turned_into(polar.angle.to_degrees(), degrees.lo), polar.distance - cylinder.radius)
        },
        median,
    )
}

/// y against x in the coordinates of the scan; each cell is the height z of its upper points, mm.
pub(super) fn from_above(scan: &Scan, estimate: &Estimate) -> Grid {
    let mut y: Vec<f64> = thinned(scan, POINTS_MAX).map(|(_, [_, y, _])| y).collect();
    let [lo, hi] = [0.002, 0.998].map(|part| quantile(&mut y, part).unwrap_or(0.0));
    Grid::empty(scan, Range::new(lo, hi).padded(0.01), usize::MAX).filled(
        scan,
        estimate,
        |[_, y, z]| (y, z),
        |heights| quantile(heights, UPPER),
    )
}

/// Half degrees: fine enough for a picture, coarse enough to be counted in one pass over millions of points.
const BINS: usize = 720;
const DEGREES: f64 = 360.0 / BINS as f64;

/// The directions that contain points, in half degrees.
pub(super) struct Seen {
    bins: Vec<bool>,
    points_count: usize,
}

/// A run of directions: first bin and number of bins.
#[derive(Clone, Copy)]
struct Run {
    first: usize,
    length: usize,
}

impl Seen {
    /// From directions in degrees.
    pub(super) fn new(directions: impl Iterator<Item = f64>) -> Self {
        let mut seen = Self { bins: vec![false; BINS], points_count: 0 };
        for degrees in directions {
            let bin = (degrees.rem_euclid(360.0) / DEGREES) as usize % BINS;
            if let Some(bin) = seen.bins.get_mut(bin) {
                *bin = true;
                seen.points_count += 1;
            }
        }
        seen
    }

    /// How many half degrees contain points.
    pub(super) fn bins_count(&self) -> usize {
        self.bins.iter().filter(|bin| **bin).count()
    }

    /// The smallest window of degrees that contains all directions, its middle in (−180°, 180°].
    pub(super) fn window(&self) -> Range {
        let Some(gap) = self.gaps().into_iter().max_by_key(|gap| gap.length) else {
            return Range::new(-180.0, 180.0);
        };
        let lo = (gap.first + gap.length) as f64 * DEGREES;
        let width = (BINS - gap.length) as f64 * DEGREES;
        let turns = ((lo + width / 2.0) / 360.0 - 0.5).ceil() * 360.0;
        Range::new(lo - turns, lo - turns + width)
    }

    /// The arcs that contain points, each as degrees from and to (from < to). Gaps that the spacing of the points explains do not
    /// divide an arc.
    pub(super) fn arcs(&self) -> Vec<[f64; 2]> {
        let gaps = self.gaps();
        let widest = gaps.iter().map(|gap| gap.length).max().unwrap_or(0);
        let spacing = (BINS - widest) as f64 / self.points_count.max(1) as f64;
        let least = (4.0 / DEGREES).max(4.0 * spacing);
        let wide: Vec<Run> = gaps.into_iter().filter(|gap| gap.length as f64 >= least).collect();
        let Some(&first) = wide.first() else {
            return if self.points_count == 0 { Vec::new() } else { vec![[0.0, 360.0]] };
        };
        let next = wide.iter().skip(1).chain([&first]);
        let arcs = wide.iter().zip(next).map(|(gap, next)| {
            let from = gap.first + gap.length;
            let to = if next.first >= from { next.first } else { next.first + BINS };
            [from as f64 * DEGREES, to as f64 * DEGREES]
        });
        arcs.filter(|[from, to]| to > from && self.points_count > 0).collect()
    }

    /// The empty runs around the circle, in order; one of them may extend beyond the last bin.
    fn gaps(&self) -> Vec<Run> {
        let Some(start) = self.bins.iter().position(|&bin| bin) else {
            return vec![Run { first: 0, length: BINS }];
        };
        let mut gaps: Vec<Run> = Vec::new();
        let mut length = 0;
        for (index, &bin) in self.bins.iter().enumerate().cycle().skip(start).take(BINS + 1) {
            match (bin, length) {
                (false, _) => length += 1,
                (true, 0) => {}
                (true, _) => {
                    gaps.push(Run { first: (index + BINS - length) % BINS, length });
                    length = 0;
                }
            }
        }
        gaps
    }
}

/// A direction in degrees, turned into the full circle that begins at `from`.
pub(super) fn turned_into(degrees: f64, from: f64) -> f64 {
    from + (degrees - from).rem_euclid(360.0)
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

#[cfg(test)]
mod seen_tests {
    use super::*;

    fn every_degree(from: i32, to: i32) -> impl Iterator<Item = f64> {
        (from..to).map(|d| f64::from(d) + 0.1)
    }

    #[test]
    fn the_window_contains_only_the_observed_side() {
        let window = Seen::new(every_degree(30, 150)).window();
        assert!((window.lo - 30.0).abs() < 1.0 && (window.hi - 150.0).abs() < 1.0, "{window:?}");
        // Across the direction 180°.
        let window = Seen::new(every_degree(150, 230)).window();
        assert!((window.width() - 79.5).abs() < 1.0 && (window.middle() + 170.0).abs() < 1.0, "{window:?}");
    }

    #[test]
    fn holes_divide_the_observed_arc_and_missing_points_do_not() {
        let arcs = Seen::new(every_degree(30, 80).chain(every_degree(95, 150))).arcs();
        assert_eq!(arcs.len(), 2, "{arcs:?}");
        // Twenty points, six degrees apart.
        assert_eq!(Seen::new((0..20).map(|i| f64::from(i) * 6.0 - 60.0)).arcs().len(), 1);
        assert_eq!(Seen::new(std::iter::empty()).arcs().len(), 0);
        assert_eq!(Seen::new(every_degree(0, 360)).arcs(), [[0.0, 360.0]]);
        assert_eq!(Seen::new([77.0].into_iter()).arcs().len(), 1);
    }
}
