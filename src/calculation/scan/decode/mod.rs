//! From the bytes of a file to a cloud: [`decode`] calls one function per format, each of which accepts any bytes.
//!
//! No reader panics, aborts, or reserves memory for a length that the input has not yet backed with bytes; [`Limits`] bounds the
//! cost of a file.
//!
//! ```text
//! head ---find_format--> Format
//! bytes --(inflate)----> decode --> csv, gocator_csv | ply, pcd, npy, npz | json
//!                                       lines             records            serde
//!                                         \------------- gather -------------/ --> Cloud
//! ```
//!
//! Points that are not finite are missing: they are counted and left out. Coordinates are converted to millimetres while they are
//! read, from the unit that the request or the file declares, or from millimetres by default; two different declarations are
//! refused.

mod csv;
mod error;
mod fields;
mod find_format;
mod format;
mod gather;
mod gocator_csv;
mod hints;
mod inflate;
mod json;
mod limits;
mod lines;
mod matrix;
mod names;
mod npy;
mod npz;
mod number;
mod pcd;
mod ply;
mod records;
mod request;
mod table;

pub use super::cloud::Unit;
pub use error::DecodeError;
pub use find_format::{FormatClaims, find_format};
pub use format::Format;
pub use hints::{NumberHint, Pitches};
pub use inflate::{Encoding, Sent, inflate};
pub use limits::Limits;
pub use number::Decimal;
pub use request::{Grid, Request};

use super::cloud::Cloud;
use std::io::BufRead;

/// Reads a file of a known format, up to its last relevant point.
///
/// # Errors
/// [`DecodeError`] states the fault of the file and the remedy.
pub fn decode(format: Format, reader: &mut dyn BufRead, request: &Request<'_>) -> Result<Cloud, DecodeError> {
    if reader.fill_buf()?.is_empty() {
        return Err(DecodeError::Empty);
    }
    let is_text = matches!(format, Format::Csv | Format::GocatorCsv | Format::Json);
    if is_text && lines::has_mark(reader.fill_buf()?) {
        return decode_bytes(format, &mut lines::Utf8::new(reader)?, request);
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
