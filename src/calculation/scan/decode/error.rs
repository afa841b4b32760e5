//! Why a file cannot be read: each variant is a reason with its numbers, and its message states what happened and what to do.

use super::format::Format;
use super::hints::{NumberHint, Pitches, json_hint};
use crate::scan::cloud::Unit;
use std::io::{self, ErrorKind};

/// Why a file does not become a cloud.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The file has no bytes.
    #[error("the file is empty; send the bytes of a scan")]
    Empty,
    /// Neither declaration, bytes nor file name show the format.
    #[error("the format of the file is not known; name it: {}", Format::ALL.map(Format::name).join(", "))]
    UnknownFormat,
    /// Two declarations, or a declaration and the bytes, contradict each other.
    #[error("the file is declared as {declared} but is {found}; declare the right format or none")]
    FormatConflict {
        /// The declaration.
        declared: Format,
        /// The format of the bytes, or the other declaration.
        found: Format,
    },
    /// The first bytes do not match the format.
    #[error("the file does not begin as {format} does; declare its true format")]
    NotThisFormat {
        /// The format of the reader.
        format: Format,
    },
    /// The file ends before the announced number of points.
    #[error("the file announces {expected} points and ends after {found}; send the whole file")]
    Truncated {
        /// Points announced.
        expected: u64,
        /// Complete points found.
        found: u64,
    },
    /// A Gocator file ends before the number of frames that a section announces.
    #[error(
        "the section that begins in line {line} announces {expected} frames and the file ends after {found}; send the whole file"
    )]
    FramesMissing {
        /// Line at which the section begins.
        line: u64,
        /// Frames announced.
        expected: u64,
        /// Complete frames found.
        found: u64,
    },
    /// The file ends inside its header or another part before the points.
    #[error("the {format} file ends before its points begin; send the whole file")]
    EndsEarly {
        /// The format of the reader.
        format: Format,
    },
    /// A line of the header does not have the content that its first word announces.
    #[error("line {line} of the {format} header cannot be understood as {field}; write the file again")]
    HeaderLine {
        /// The format of the reader.
        format: Format,
        /// Its number, from 1.
        line: u64,
        /// The expected content of the line.
        field: &'static str,
    },
    /// The header is incomplete.
    #[error("the {format} header does not state {field}; write the file again")]
    HeaderMissing {
        /// The format of the reader.
        format: Format,
        /// The missing statement.
        field: &'static str,
    },
    /// The header does not end.
    #[error("the {format} header is longer than {limit} lines; leave comments out")]
    HeaderTooLong {
        /// The format of the reader.
        format: Format,
        /// Largest number of lines or bytes of a header.
        limit: usize,
    },
    /// Two statements about a size contradict each other.
    #[error("the {format} file states {field} = {stated}, which should be {expected}; write the file again")]
    SizeMismatch {
        /// The format of the reader.
        format: Format,
        /// The statement.
        field: &'static str,
        /// Its value.
        stated: u64,
        /// The value that follows from the rest of the file.
        expected: u64,
    },
    /// Compressed points that cannot be decompressed.
    #[error("the compressed points of the {format} file are damaged; send the file again")]
    DamagedPoints {
        /// The format of the reader.
        format: Format,
    },
    /// A feature of the format that is not supported.
    #[error("{format}: {what}")]
    Unsupported {
        /// The format of the reader.
        format: Format,
        /// The feature, and the alternative.
        what: &'static str,
    },
    /// A numpy array of a shape that is not points.
    #[error(
        "the array has the shape {shape:?}; (N, 3) or (P, M, 3) is read, the last axis being x, y, z, or x, y and z of one shape (x of \
         P and y of M numbers beside z of (P, M))"
    )]
    ArrayShape {
        /// Its shape.
        shape: Vec<u64>,
    },
    /// An archive without the required arrays.
    #[error("the archive must contain the arrays x, y and z of equal shape, or a single array; it contains: {}", found.join(", "))]
    ArraysMissing {
        /// Names of the entries.
        found: Vec<String>,
    },
    /// Not a readable zip archive.
    #[error("the archive is damaged: {what}; send the file again")]
    DamagedArchive {
        /// The check that failed.
        what: &'static str,
    },
    /// Contradictory bytes without a more specific error.
    #[error("the file is damaged or ends early; send it again")]
    DamagedFile,
    /// More entries than allowed.
    #[error("the archive has {found} entries, at most {limit} are allowed; leave out what is not the scan")]
    TooManyEntries {
        /// Entries found.
        found: usize,
        /// Largest number of entries.
        limit: usize,
    },
    /// The file has a byte order mark or NUL bytes, so it is not ASCII-compatible text.
    #[error("line {line} is not text (binary, or UTF-16 without a byte order mark); save the table as UTF-8")]
    NotText {
        /// Number of the line, from 1.
        line: u64,
    },
    /// Text without a row of numbers.
    #[error("line {line} begins text that is not a table of points: {text:?}; send rows of x, y, z")]
    NotATable {
        /// The beginning of the text.
        text: String,
        /// Number of the first line that is neither blank nor comment, from 1.
        line: u64,
    },
    /// A line that is too long.
    #[error("line {line} is longer than {limit} bytes; split it or raise the limit")]
    LineTooLong {
        /// Its number, from 1.
        line: u64,
        /// Largest number of bytes of a line.
        limit: usize,
    },
    /// More columns, properties or fields than allowed.
    #[error("there are more than {limit} columns; leave out what is not a coordinate")]
    TooManyColumns {
        /// Largest number of columns.
        limit: usize,
    },
    /// A required or requested column is missing.
    #[error(
        "there is no column {wanted}; the columns are: {}; {}", found.join(", "),
        if matches!(wanted.as_str(), "x" | "y" | "z") {
            "rename the intended one, e.g. x_mm, y_mm, z_mm, or send three columns x, y, z without a header"
        } else {
            "name one of these"
        }
    )]
    UnknownColumn {
        /// The missing column.
        wanted: String,
        /// The columns of the file.
        found: Vec<String>,
    },
    /// Two columns have names of the same coordinate.
    #[error("the columns {first} and {second} both claim to be {wanted}; rename or leave out one")]
    DoubleColumn {
        /// The coordinate.
        wanted: &'static str,
        /// One of the columns.
        first: String,
        /// The other.
        second: String,
    },
    /// No header, and a number of columns that can be interpreted in several ways.
    #[error(
        "a table of {columns} columns needs a header that names x, y and z, e.g. profile,x_mm,y_mm,z_mm; a matrix of heights \
         needs x_pitch_mm and y_pitch_mm"
    )]
    HeaderNeeded {
        /// Columns found.
        columns: usize,
    },
    /// A row whose length differs from the others.
    #[error("line {line} has {found} columns where {expected} are expected: {text:?}; correct or remove the line")]
    RaggedRow {
        /// The text of the row, shortened.
        text: String,
        /// Its number, from 1.
        line: u64,
        /// Columns of the table.
        expected: usize,
        /// Columns of the row.
        found: usize,
    },
    /// A cell that should be a number and is not.
    #[error("line {line}, column {column}: {text:?} is not a number; {hint}")]
    BadNumber {
        /// Number of the line, from 1.
        line: u64,
        /// Number of the column, from 1.
        column: usize,
        /// The text of the cell, shortened.
        text: String,
        /// The remedy.
        hint: NumberHint,
    },
    /// A number with two possible values.
    #[error(
        "line {line}, column {column}: {text:?} is {as_point} with a decimal point and {as_comma} with a decimal comma; declare \
         which: decimal=point or decimal=comma"
    )]
    AmbiguousNumber {
        /// Number of the line, from 1.
        line: u64,
        /// Number of the column, from 1.
        column: usize,
        /// The text of the cell.
        text: String,
        /// Its value with a decimal point.
        as_point: f64,
        /// Its value with a decimal comma.
        as_comma: f64,
    },
    /// A matrix of heights without positions of its cells.
    #[error("the {format} file contains a matrix of {columns} columns, not x, y, z of points; declare {}", wanted.text())]
    PitchNeeded {
        /// The format of the reader.
        format: Format,
        /// Its columns.
        columns: usize,
        /// The pitches to declare.
        wanted: Pitches,
    },
    /// Pitches for a file that states the positions of its points.
    #[error(
        "x_pitch_mm and y_pitch_mm place the cells of a matrix, and the {format} file holds points with their own places; leave \
         them out (slabs along x are profile_by=x_pitch_mm=...)"
    )]
    PitchUnused {
        /// The format of the reader.
        format: Format,
    },
    /// The first row or column of a matrix does not contain positions.
    #[error(
        "row {row} of the matrix has no number in its first column, which is taken as {axis}; complete it, or declare both x_pitch_mm \
         and y_pitch_mm where the column holds no {axis}"
    )]
    PositionMissing {
        /// Number of the row, from 1.
        row: usize,
        /// The coordinate that the column should contain.
        axis: &'static str,
    },
    /// A text file without line ends.
    #[error("the file has lost its line ends, as curl -d @file removes them; send it with --data-binary @file")]
    LinesStripped,
    /// A zip archive without numpy arrays.
    #[error("the file is a zip archive of {}, not of numpy arrays (NPZ); unpack it and send the file itself, packed by gzip if need be", found.join(", "))]
    ZippedFile {
        /// Names of the entries.
        found: Vec<String>,
    },
    /// The unit of the file differs from the caller's, or the file states two units.
    #[error("the unit is declared as {declared} but the file states {found}; declare {found} or none")]
    UnitConflict {
        /// The unit declared by the caller, or elsewhere in the file.
        declared: Unit,
        /// The unit stated in the file.
        found: Unit,
    },
    /// A Gocator file without points.
    #[error(
        "the Gocator file has none of the sections Profile, RawProfile, Part, Surface, SurfacePointCloud; export one"
    )]
    SectionMissing,
    /// A Gocator section without a known table.
    #[error("line {line} begins a Gocator section whose table is not understood: {field} is missing; export it again")]
    SectionIncomplete {
        /// Number of the section's first line, from 1.
        line: u64,
        /// The missing statement.
        field: &'static str,
    },
    /// A Gocator frame without its position along the travel.
    #[error("line {line}: the frame has no Y (travel); export with encoder or travel speed set, or send x, y, z rows")]
    TravelMissing {
        /// Number of the line, from 1.
        line: u64,
    },
    /// JSON that cannot be parsed.
    #[error("line {line}, column {column}: {found:?} is not valid JSON there; {}", json_hint(found))]
    JsonSyntax {
        /// Number of the line, from 1.
        line: usize,
        /// Number of the byte in the line, from 1.
        column: usize,
        /// The text at this position, shortened.
        found: String,
    },
    /// JSON of another structure.
    #[error(
        "line {line}, column {column}: {found:?} departs from {{\"profiles\": [{{\"x_mm\": 0.0, \"points\": [[y, z], ...]}}]}}; \
         leave out other fields, and write numbers without quotes"
    )]
    JsonShape {
        /// Number of the line, from 1.
        line: usize,
        /// Number of the byte in the line, from 1.
        column: usize,
        /// The text at this position, shortened.
        found: String,
    },
    /// The file has no points, or only missing ones.
    #[error("the file contains no valid point ({missing_count} are marked as missing); check range and exposure")]
    NoPoints {
        /// Points marked as missing.
        missing_count: u64,
    },
    /// More points than allowed.
    #[error(
        "the scan has more than {limit} points; thin it out, or raise scan.points_max and limits.memory_max_mb, the smaller of which decides"
    )]
    TooManyPoints {
        /// Largest number of points.
        limit: usize,
    },
    /// A coordinate beyond the limit.
    #[error(
        "point {index} has the coordinate {value:e} mm, beyond {limit} mm; check the unit and mark bad points as NaN"
    )]
    CoordinateOutOfRange {
        /// Position of the point in the file, from 0.
        index: usize,
        /// The coordinate, mm.
        value: f64,
        /// Largest magnitude, mm.
        limit: f64,
    },
    /// Compressed data with too large a ratio of decompressed to compressed size.
    #[error("the data unpack to more than {limit} times their size; send them less compressed")]
    InflateRatio {
        /// Largest number of bytes out for each byte in.
        limit: u64,
    },
    /// Compressed data that exceed the size limit after decompression.
    #[error("the data unpack to more than {limit} bytes; thin the scan out or raise the limit")]
    InflatedTooLarge {
        /// Largest number of bytes.
        limit: u64,
    },
    /// Compressed data that cannot be decompressed.
    #[error("the compressed data are damaged or end early; send them again")]
    BadCompression,
    /// The source of the bytes failed.
    #[error("reading the file failed: {0}")]
    Io(io::Error),
}

impl From<io::Error> for DecodeError {
    /// Extracts the error that a reader below had to wrap to pass it through `std::io`.
    ///
    /// Errors of these kinds are about the content of the file, never about the store that contains it.
    fn from(error: io::Error) -> Self {
        use ErrorKind as K;
        match error.downcast::<Self>() {
            Ok(error) => error,
            Err(error) => match error.kind() {
                K::InvalidData | K::InvalidInput | K::UnexpectedEof | K::Unsupported => Self::DamagedFile,
                _ => Self::Io(error),
            },
        }
    }
}

impl From<DecodeError> for io::Error {
    fn from(error: DecodeError) -> Self {
        Self::other(error)
    }
}

impl DecodeError {
    /// A stable name of the reason, at most 32 characters.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::Empty => "file_empty",
            Self::UnknownFormat => "format_unknown",
            Self::FormatConflict { .. } => "format_conflict",
            Self::NotThisFormat { .. } => "format_mismatch",
            Self::Truncated { .. } | Self::FramesMissing { .. } | Self::EndsEarly { .. } => "file_truncated",
            Self::HeaderLine { .. } | Self::HeaderMissing { .. } => "header_invalid",
            Self::HeaderTooLong { .. } => "header_too_long",
            Self::SizeMismatch { .. } => "size_mismatch",
            Self::DamagedPoints { .. } | Self::DamagedArchive { .. } | Self::DamagedFile => "file_damaged",
            Self::Unsupported { .. } | Self::ZippedFile { .. } => "format_unsupported",
            Self::ArrayShape { .. } => "array_shape",
            Self::ArraysMissing { .. } => "arrays_missing",
            Self::TooManyEntries { .. } => "too_many_entries",
            Self::NotText { .. } => "not_text",
            Self::NotATable { .. } => "not_a_table",
            Self::LineTooLong { .. } => "line_too_long",
            Self::TooManyColumns { .. } => "too_many_columns",
            Self::UnknownColumn { .. } => "column_unknown",
            Self::DoubleColumn { .. } => "column_ambiguous",
            Self::HeaderNeeded { .. } => "header_needed",
            Self::RaggedRow { .. } => "row_ragged",
            Self::BadNumber { .. } => "number_invalid",
            Self::AmbiguousNumber { .. } => "number_ambiguous",
            Self::PitchNeeded { .. } => "pitch_needed",
            Self::PitchUnused { .. } => "pitch_unused",
            Self::PositionMissing { .. } => "position_missing",
            Self::LinesStripped => "line_ends_missing",
            Self::UnitConflict { .. } => "unit_conflict",
            Self::SectionMissing | Self::SectionIncomplete { .. } => "section_missing",
            Self::TravelMissing { .. } => "travel_missing",
            Self::JsonSyntax { .. } => "json_syntax",
            Self::JsonShape { .. } => "json_shape",
            Self::NoPoints { .. } => "no_points",
            Self::TooManyPoints { .. } => "too_many_points",
            Self::CoordinateOutOfRange { .. } => "coordinate_out_of_range",
            Self::InflateRatio { .. } => "inflate_ratio",
            Self::InflatedTooLarge { .. } => "inflated_too_large",
            Self::BadCompression => "compression_invalid",
            Self::Io(_) => "read_failed",
        }
    }
}

/// The error for a failure to read a part of fixed size.
pub(super) fn ends_early(error: std::io::Error, format: Format) -> DecodeError {
    if error.kind() == std::io::ErrorKind::UnexpectedEof { DecodeError::EndsEarly { format } } else { error.into() }
}
