//! The declarations of a caller about a file besides its format, and the positions of the cells of a matrix.

use super::error::DecodeError;
use super::format::Format;
use super::inflate::Sent;
use super::limits::Limits;
use super::number::Decimal;
use crate::scan::cloud::Unit;

/// The declarations of a caller about a file besides its format.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The unit of the coordinates; `None` takes the unit that the file states, or millimetres.
    pub unit: Option<Unit>,
    /// The column that separates profiles; `None` takes one with a usual name (profile, frame, line, scan, row, …).
    pub profile_column: Option<&'a str>,
    /// The decimal sign in text; `None` derives it from the cells.
    pub decimal: Option<Decimal>,
    /// Positions of the cells of a matrix; not for a file of points.
    pub grid: Grid,
    /// The limits of the file.
    pub limits: &'a Limits,
    /// The number of bytes sent, if the file was decompressed before.
    pub sent: Option<&'a Sent>,
}

impl<'a> Request<'a> {
    /// A request with the limits only.
    #[must_use]
    pub fn new(limits: &'a Limits) -> Self {
        Self { unit: None, profile_column: None, decimal: None, grid: Grid::default(), limits, sent: None }
    }

    /// The largest number of bytes that were sent for the file.
    pub(super) fn sent_bytes(&self, here: u64) -> u64 {
        self.sent.map_or(here, |sent| sent.bytes_count().min(here))
    }
}

/// The unit of a file from the declarations of the caller and of the file.
pub(super) fn settle_unit(declared: Option<Unit>, stated: Option<Unit>) -> Result<Unit, DecodeError> {
    match (declared, stated) {
        (Some(declared), Some(found)) if declared != found => Err(DecodeError::UnitConflict { declared, found }),
        (declared, stated) => Ok(declared.or(stated).unwrap_or(Unit::Millimetre)),
    }
}

/// Positions of the cells of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Grid {
    /// Distance between profiles, mm.
    pub x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile, mm.
    pub y_pitch_mm: Option<f64>,
    /// With both pitches: whether a column is a profile instead of a row.
    pub columns_are_profiles: bool,
}

impl Grid {
    /// Whether anything is declared, so that the file is treated as a matrix.
    #[must_use]
    pub const fn is_declared(&self) -> bool {
        self.x_pitch_mm.is_some() || self.y_pitch_mm.is_some()
    }

    /// Refuses pitches for a file of points.
    pub(super) fn check_unused(&self, format: Format) -> Result<(), DecodeError> {
        if self.is_declared() { Err(DecodeError::PitchUnused { format }) } else { Ok(()) }
    }

    /// Whether every column, or every column except the first, is a profile.
    pub(super) const fn has_profiles_in_columns(&self) -> bool {
        match (self.x_pitch_mm, self.y_pitch_mm) {
            (Some(_), None) => true,
            (Some(_), Some(_)) => self.columns_are_profiles,
            (None, _) => false,
        }
    }

    /// Largest number of columns of a matrix.
    pub(super) fn columns_max(&self, request: &Request<'_>) -> usize {
        let limits = request.limits;
        1 + if self.has_profiles_in_columns() { limits.profiles_max } else { limits.points_per_profile_max }
    }
}
