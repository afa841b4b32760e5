//! From the bytes of a file to a cloud: one function per format behind [`decode`], total on any bytes.
//!
//! No reader panics, aborts, or reserves memory on the word of a length that the input has not backed with bytes; what a file
//! may cost stands in [`Limits`].
//!
//! ```text
//! head ---find_format--> Format
//! bytes --(inflate)----> decode --> csv, gocator_csv | ply, pcd, npy, npz | json
//!                                       lines             records            serde
//!                                         \------------- gather -------------/ --> Cloud
//! ```
//!
//! Points that are not finite are "no point": counted, and left out. Coordinates become millimetres on the way in: in the
//! unit that the request or the file declares, in millimetres already where neither does; two declarations that differ
//! are refused.

mod csv;
mod error;
mod fields;
mod format;
mod gather;
mod gocator_csv;
mod hints;
mod inflate;
mod json;
mod limits;
mod lines;
mod lzf;
mod matrix;
mod named;
mod names;
mod npy;
mod npy_header;
mod npz;
mod number;
mod packed;
mod pcd;
mod pcd_header;
mod ply;
mod ply_header;
mod records;
mod scalar;
mod table;
mod unit;
mod utf16;

pub use error::DecodeError;
pub use format::{Format, FormatClaims, find_format};
pub use hints::{NumberHint, Pitches};
pub use inflate::{Encoding, Sent, inflate};
pub use limits::Limits;
pub use matrix::Grid;
pub use number::Decimal;
pub use unit::Unit;

use super::cloud::Cloud;
use gather::Precision;
use std::io::BufRead;

/// What a caller says about a file besides its format.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The unit of the coordinates; `None` takes the file's word for it, and millimetres where it says nothing.
    pub unit: Option<Unit>,
    /// The column that tells profiles apart; `None` takes one with a usual name (profile, frame, line, scan, row, …).
    pub profile_column: Option<&'a str>,
    /// The sign before decimals in text; `None` takes what the cells show.
    pub decimal: Option<Decimal>,
    /// Where the cells of a matrix lie; a file of points has none.
    pub grid: Grid,
    /// What the file may cost.
    pub limits: &'a Limits,
    /// The file as it was sent, where it was unpacked on the way.
    pub sent: Option<&'a Sent>,
}

impl<'a> Request<'a> {
    /// Nothing but the limits.
    #[must_use]
    pub fn new(limits: &'a Limits) -> Self {
        Self { unit: None, profile_column: None, decimal: None, grid: Grid::default(), limits, sent: None }
    }

    /// Of the bytes of a file, how many were sent at most.
    fn sent_bytes(&self, here: u64) -> u64 {
        self.sent.map_or(here, |sent| sent.bytes_count().min(here))
    }
}

/// Reads a file of a known format, up to the last point that matters.
///
/// # Errors
/// [`DecodeError`] says what is wrong with the file and what to do about it.
pub fn decode(format: Format, reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    if reader.fill_buf()?.is_empty() {
        return Err(DecodeError::Empty);
    }
    let is_text = matches!(format, Format::Csv | Format::GocatorCsv | Format::Json);
    if is_text && utf16::has_mark(reader.fill_buf()?) {
        return decode_bytes(format, &mut utf16::Utf8::new(reader)?, request);
    }
    decode_bytes(format, reader, request)
}

fn decode_bytes(format: Format, reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    if !matches!(format, Format::Csv | Format::Npy | Format::Npz) {
        request.grid.check_unused(format)?;
    }
    match format {
        Format::Csv => csv::decode(reader, request),
        Format::Npy => npy::decode(reader, request),
        Format::Npz => npz::decode(reader, request),
        Format::GocatorCsv => gocator_csv::decode(reader, request),
        Format::Ply => ply::decode(reader, request),
        Format::Pcd => pcd::decode(reader, request),
        Format::Json => json::decode(reader, request),
    }
}

/// The unit of a file from what the caller declares and what the file states.
fn settle_unit(declared: Option<Unit>, stated: Option<Unit>) -> Result<Unit, DecodeError> {
    match (declared, stated) {
        (Some(declared), Some(found)) if declared != found => Err(DecodeError::UnitConflict { declared, found }),
        (declared, stated) => Ok(declared.or(stated).unwrap_or(Unit::Millimetre)),
    }
}

/// What a failure to read a part of fixed size means.
fn ends_early(error: std::io::Error, format: Format) -> DecodeError {
    if error.kind() == std::io::ErrorKind::UnexpectedEof { DecodeError::EndsEarly { format } } else { error.into() }
}
