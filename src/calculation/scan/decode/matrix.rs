//! A matrix of heights: its cells contain only z, its first column may contain y or x. From values in rows and the pitches
//! that a caller declares to a cloud.
//!
//! | declared | a profile is | x | y |
//! |---|---|---|---|
//! | both pitches | a row | number of the row · `x_pitch_mm` | number of the column · `y_pitch_mm` |
//! | both, columns are profiles | a column | number of the column · `x_pitch_mm` | number of the row · `y_pitch_mm` |
//! | `x_pitch_mm` | every column except the first | number of the column · `x_pitch_mm` | the first column |
//! | `y_pitch_mm` | a row | the first column | number of the column · `y_pitch_mm` |
//!
//! Numbers count from 0. Pitches are in millimetres, cells in the unit of the file.

use super::error::DecodeError;
use super::format::Format;
use super::gather::{Gather, Precision};
use super::hints::Pitches;
use super::request::{Request, settle_unit};
use crate::scan::cloud::{Cloud, Labels, Unit};

/// Number of columns from which numbers without a header are taken for a matrix: points have x, y, z and a few attributes.
pub(super) const COLUMNS_MIN: usize = 9;
/// Largest deviation of the steps of an evenly increasing column, in steps.
const STEP_DEVIATION_MAX: f64 = 0.02;
/// The label of profiles that are columns.
const COLUMN_LABEL: &str = "column";

/// The pitches to declare for a matrix that begins with these rows.
pub(super) fn pitches_wanted(first_column: &[f64]) -> Pitches {
    if rises_evenly(first_column) { Pitches::OfProfiles } else { Pitches::Both }
}

fn rises_evenly(values: &[f64]) -> bool {
    let (Some(first), Some(last)) = (values.first(), values.last()) else { return false };
    let step = (last - first) / (values.len().max(2) - 1) as f64;
    let is_even = |pair: &[f64]| {
        let deviation = pair.last().zip(pair.first()).map_or(f64::NAN, |(next, value)| next - value - step);
        deviation.abs() <= STEP_DEVIATION_MAX * step.abs()
    };
    values.len() >= 3 && step != 0.0 && values.windows(2).all(is_even)
}

/// The cells of a matrix, row after row.
pub(super) struct Matrix {
    pub(super) format: Format,
    pub(super) columns: usize,
    pub(super) cells: Vec<f64>,
    /// The unit that the file states.
    pub(super) unit: Option<Unit>,
}

impl Matrix {
    /// The points of the cells.
    ///
    /// # Errors
    /// [`DecodeError::PitchNeeded`] if nothing is declared, [`DecodeError::PositionMissing`] if the first column should contain
    /// positions and does not, and the errors of single points.
    pub(super) fn into_cloud(self, request: &Request<'_>) -> Result<Cloud, DecodeError> {
        let unit = settle_unit(request.unit, self.unit)?;
        let in_unit = |pitch: f64| pitch / unit.in_mm();
        let grid = request.grid;
        let columns = self.columns.max(1);
        let rows = || self.cells.chunks_exact(columns).enumerate();
        let mut gather = Gather::new(unit, Precision::Double, request.limits);
        gather.reserve(self.cells.len());
        match (grid.x_pitch_mm.map(in_unit), grid.y_pitch_mm.map(in_unit)) {
            (None, None) => Err(self.refuse()),
            (Some(x_pitch), Some(y_pitch)) if !grid.columns_are_profiles => {
                for (row, cells) in rows() {
                    push_row(&mut gather, row, row as f64 * x_pitch, y_pitch, cells)?;
                }
                gather.finish(Labels::Row)
            }
            (None, Some(y_pitch)) => {
                for (row, cells) in rows() {
                    let Some((x, cells)) = cells.split_first().filter(|(x, _)| x.is_finite()) else {
                        return Err(no_position(row, "x"));
                    };
                    push_row(&mut gather, row, *x, y_pitch, cells)?;
                }
                gather.finish(Labels::Row)
            }
            (Some(x_pitch), y_pitch) => {
                let first = usize::from(y_pitch.is_none());
                for column in first..columns {
                    let profile = (column - first) as f64;
                    for (row, cells) in rows() {
                        let y = match (y_pitch, cells.first()) {
                            (Some(pitch), _) => row as f64 * pitch,
                            (None, Some(y)) if y.is_finite() => *y,
                            (None, _) => return Err(no_position(row, "y")),
                        };
                        let z = cells.get(column).copied().unwrap_or(f64::NAN);
                        gather.push(profile, [profile * x_pitch, y, z])?;
                    }
                }
                gather.finish(Labels::Column(COLUMN_LABEL.to_owned()))
            }
        }
    }

    fn refuse(&self) -> DecodeError {
        let first_column: Vec<f64> = self.cells.iter().step_by(self.columns.max(1)).copied().collect();
        let wanted = pitches_wanted(&first_column);
        DecodeError::PitchNeeded { format: self.format, columns: self.columns, wanted }
    }
}

fn no_position(row: usize, axis: &'static str) -> DecodeError {
    DecodeError::PositionMissing { row: row + 1, axis }
}

fn push_row(gather: &mut Gather<'_>, row: usize, x: f64, y_pitch: f64, cells: &[f64]) -> Result<(), DecodeError> {
    cells.iter().enumerate().try_for_each(|(column, z)| gather.push(row as f64, [x, column as f64 * y_pitch, *z]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::{Grid, Limits};

    fn read(grid: Grid, unit: Option<Unit>) -> Result<Vec<[f64; 3]>, DecodeError> {
        let cells = vec![-1.0, 5.0, 6.0, 0.0, 7.0, f64::NAN];
        let matrix = Matrix { format: Format::Csv, columns: 3, cells, unit: None };
        let limits = Limits::default();
        let cloud = matrix.into_cloud(&Request { grid, unit, ..Request::new(&limits) })?;
        Ok(cloud.points().collect())
    }

    #[test]
    fn every_declaration_determines_the_positions_of_the_cells() {
        let grid = Grid { x_pitch_mm: Some(10.0), y_pitch_mm: Some(2.0), columns_are_profiles: false };
        let rows = [[0.0, 0.0, -1.0], [0.0, 2.0, 5.0], [0.0, 4.0, 6.0], [10.0, 0.0, 0.0], [10.0, 2.0, 7.0]];
        assert_eq!(read(grid, None).expect("rows"), rows);
        let columns = [[0.0, 0.0, -1.0], [0.0, 2.0, 0.0], [10.0, 0.0, 5.0], [10.0, 2.0, 7.0], [20.0, 0.0, 6.0]];
        assert_eq!(read(Grid { columns_are_profiles: true, ..grid }, None).expect("columns"), columns);
        let y_first = [[0.0, -1.0, 5.0], [0.0, 0.0, 7.0], [10.0, -1.0, 6.0]];
        assert_eq!(read(Grid { y_pitch_mm: None, ..grid }, None).expect("y first"), y_first);
        let x_first = [[-1.0, 0.0, 5.0], [-1.0, 2.0, 6.0], [0.0, 0.0, 7.0]];
        assert_eq!(read(Grid { x_pitch_mm: None, ..grid }, None).expect("x first"), x_first);
    }

    #[test]
    fn the_unit_is_of_the_cells_and_the_pitches_are_millimetres() {
        let grid = Grid { x_pitch_mm: Some(10.0), ..Grid::default() };
        let points = read(grid, Some(Unit::Metre)).expect("metres");
        assert_eq!(points, [[0.0, -1000.0, 5000.0], [0.0, 0.0, 7000.0], [10.0, -1000.0, 6000.0]]);
    }

    #[test]
    fn without_pitches_the_error_names_the_required_ones() {
        let error = read(Grid::default(), None).expect_err("undeclared");
        assert!(matches!(error, DecodeError::PitchNeeded { columns: 3, wanted: Pitches::Both, .. }), "{error}");
        assert_eq!(pitches_wanted(&[-38.0, -37.5, -37.0, -36.5]), Pitches::OfProfiles);
        assert_eq!(pitches_wanted(&[21.6, 21.5, 21.6, 21.7]), Pitches::Both);
    }
}
