//! Maps the errors of the decoders and of the division into profiles to problems, variant by variant.

use super::Problem;
use super::code::Code;
use crate::scan::decode::DecodeError;
use crate::scan::slice::SliceError;
use serde_json::Value;

/// Converts without loss of digits.
fn count(value: usize) -> Value {
    Value::from(u64::try_from(value).unwrap_or(u64::MAX))
}

impl From<DecodeError> for Problem {
    fn from(error: DecodeError) -> Self {
        match error {
            // The bytes are read from the store's own file, so this is not an error of the client.
            DecodeError::Io(cause) => {
                Self::new(Code::StoreUnavailable, "the scan cannot be read from the store now; try again")
                    .because(cause.to_string())
            }
            error => with_numbers(Self::new(code_of(&error), error.to_string()), error),
        }
    }
}

/// The code of a decoder's error.
const fn code_of(error: &DecodeError) -> Code {
    use DecodeError as E;
    match error {
        E::Empty => Code::FileEmpty,
        E::UnknownFormat => Code::FormatUnknown,
        E::FormatConflict { .. } => Code::FormatConflict,
        E::NotThisFormat { .. } => Code::FormatMismatch,
        E::Truncated { .. } | E::FramesMissing { .. } | E::EndsEarly { .. } => Code::FileTruncated,
        E::HeaderLine { .. } | E::HeaderMissing { .. } => Code::HeaderInvalidInFile,
        E::HeaderTooLong { .. } => Code::HeaderTooLong,
        E::SizeMismatch { .. } => Code::SizeMismatch,
        E::DamagedPoints { .. } | E::DamagedArchive { .. } | E::DamagedFile => Code::FileDamaged,
        E::Unsupported { .. } | E::ZippedFile { .. } => Code::FormatUnsupported,
        E::ArrayShape { .. } => Code::ArrayShape,
        E::ArraysMissing { .. } => Code::ArraysMissing,
        E::TooManyEntries { .. } => Code::TooManyEntries,
        E::NotText { .. } => Code::NotText,
        E::NotATable { .. } => Code::NotATable,
        E::LineTooLong { .. } => Code::LineTooLong,
        E::TooManyColumns { .. } => Code::TooManyColumns,
        E::UnknownColumn { .. } => Code::ColumnUnknown,
        E::DoubleColumn { .. } => Code::ColumnAmbiguous,
        E::HeaderNeeded { .. } => Code::HeaderNeeded,
        E::RaggedRow { .. } => Code::RowRagged,
        E::BadNumber { .. } => Code::NumberInvalid,
        E::AmbiguousNumber { .. } => Code::NumberAmbiguous,
        E::PitchNeeded { .. } => Code::PitchNeeded,
        E::PitchUnused { .. } => Code::PitchUnused,
        E::PositionMissing { .. } => Code::PositionMissing,
        E::LinesStripped => Code::LineEndsMissing,
        E::UnitConflict { .. } => Code::UnitConflict,
        E::SectionMissing | E::SectionIncomplete { .. } => Code::SectionMissing,
        E::TravelMissing { .. } => Code::TravelMissing,
        E::JsonSyntax { .. } => Code::JsonSyntax,
        E::JsonShape { .. } => Code::JsonShape,
        E::NoPoints { .. } => Code::NoPoints,
        E::TooManyPoints { .. } => Code::TooManyPoints,
        E::CoordinateOutOfRange { .. } => Code::CoordinateOutOfRange,
        E::InflateRatio { .. } => Code::InflateRatio,
        E::InflatedTooLarge { .. } => Code::InflatedTooLarge,
        E::BadCompression => Code::CompressionInvalid,
        E::Io(_) => Code::StoreUnavailable,
    }
}

/// Adds the numbers and words of a decoder's error as members.
fn with_numbers(problem: Problem, error: DecodeError) -> Problem {
    use DecodeError as E;
    match error {
        E::Empty
        | E::UnknownFormat
        | E::DamagedArchive { what: _ }
        | E::DamagedFile
        | E::LinesStripped
        | E::SectionMissing
        | E::BadCompression
        | E::Io(_) => problem,
        E::FormatConflict { declared, found } => problem.with("declared", declared.name()).with("found", found.name()),
        E::NotThisFormat { format }
        | E::EndsEarly { format }
        | E::DamagedPoints { format }
        | E::Unsupported { format, what: _ } => problem.with("format", format.name()),
        E::Truncated { expected, found } => {
            problem.with("points_expected_count", expected).with("points_found_count", found)
        }
        E::FramesMissing { line, expected, found } => {
            problem.with("line", line).with("frames_expected_count", expected).with("frames_found_count", found)
        }
        E::HeaderLine { format, line, field } => {
            problem.with("format", format.name()).with("line", line).with("field", field)
        }
        E::HeaderMissing { format, field } => problem.with("format", format.name()).with("field", field),
        E::HeaderTooLong { format, limit } => problem.with("format", format.name()).with("limit", count(limit)),
        E::SizeMismatch { format, field, stated, expected } => {
            problem.with("format", format.name()).with("field", field).with("stated", stated).with("expected", expected)
        }
        E::ArrayShape { shape } => problem.with("shape", shape),
        E::ArraysMissing { found } | E::ZippedFile { found } => problem.with("found", found),
        E::TooManyEntries { found, limit } => problem.with("found_count", count(found)).with("limit", count(limit)),
        E::NotText { line } | E::TravelMissing { line } => problem.with("line", line),
        E::NotATable { line, text } => problem.with("line", line).with("text", text),
        E::LineTooLong { line, limit } => problem.with("line", line).with("limit", count(limit)),
        E::TooManyColumns { limit } => problem.with("limit", count(limit)),
        E::UnknownColumn { wanted, found } => problem.with("wanted", wanted).with("found", found),
        E::DoubleColumn { wanted, first, second } => {
            problem.with("wanted", wanted).with("first", first).with("second", second)
        }
        E::HeaderNeeded { columns } => problem.with("columns_count", count(columns)),
        E::RaggedRow { line, expected, found, text } => problem
            .with("line", line)
            .with("expected_count", count(expected))
            .with("found_count", count(found))
            .with("text", text),
        E::BadNumber { line, column, text, hint: _ } => {
            problem.with("line", line).with("column", count(column)).with("text", text)
        }
        E::AmbiguousNumber { line, column, text, as_point, as_comma } => problem
            .with("line", line)
            .with("column", count(column))
            .with("text", text)
            .with("with_decimal_point", as_point)
            .with("with_decimal_comma", as_comma),
        E::PitchNeeded { format, columns, wanted } => problem
            .with("format", format.name())
            .with("columns_count", count(columns))
            .with("parameters", wanted.names().to_vec()),
        E::PitchUnused { format } => problem.with("format", format.name()),
        E::PositionMissing { row, axis } => problem.with("row", count(row)).with("axis", axis),
        E::UnitConflict { declared, found } => problem.with("declared", declared.name()).with("found", found.name()),
        E::SectionIncomplete { line, field } => problem.with("line", line).with("field", field),
        E::JsonSyntax { line, column, found } | E::JsonShape { line, column, found } => {
            problem.with("line", count(line)).with("column", count(column)).with("text", found)
        }
        E::NoPoints { missing_count } => problem.with("missing_count", missing_count),
        E::TooManyPoints { limit } => problem.with("points_max", count(limit)),
        E::CoordinateOutOfRange { index, value, limit } => {
            problem.with("index", count(index)).with("value_mm", value).with("limit_mm", limit)
        }
        E::InflateRatio { limit } => problem.with("ratio_max", limit),
        E::InflatedTooLarge { limit } => problem.with("bytes_max", limit),
    }
}

impl From<SliceError> for Problem {
    fn from(error: SliceError) -> Self {
        use SliceError as E;
        let text = error.to_string();
        let problem = |code| Self::new(code, text.clone());
        match error {
            E::Frame(_) => problem(Code::RecipeInvalid).with("field", "frame"),
            E::CoordinateOutOfRange { index, value, limit } => problem(Code::CoordinateOutOfRange)
                .with("index", count(index))
                .with("value_mm", value)
                .with("limit_mm", limit),
            E::PitchInvalid => problem(Code::RecipeInvalid).with("field", "profile_by"),
            E::RegionEmpty { points } => problem(Code::RegionEmpty).with("points_count", count(points)),
            E::NoColumn { wanted, found } => problem(Code::NoProfileColumn).with("wanted", wanted).with("found", found),
            E::NoRows => problem(Code::NoRows),
            E::PitchTooSmall { pitch, slabs, limit, least } => problem(Code::PitchTooSmall)
                .with("pitch_mm", pitch)
                .with("profiles_count", slabs)
                .with("profiles_max", count(limit))
                .with("pitch_min_mm", least),
            E::TooManyProfiles { limit } => problem(Code::TooManyProfiles).with("profiles_max", count(limit)),
            E::ProfileTooLong { x, found, limit } => problem(Code::ProfileTooLong)
                .with("x_mm", x)
                .with("points_count", count(found))
                .with("points_per_profile_max", count(limit)),
            // The decoder guarantees finite points in order.
            E::Scan(cause) => Self::internal(cause.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::wire::problem::code::Retry;
    use crate::scan::decode::{Format, NumberHint, Pitches};
    use std::io;

    /// The offline command prints the decoder's name of a reason, the service the problem's: they must be the same.
    #[test]
    fn a_reason_has_the_same_name_offline_and_over_http() {
        let format = Format::Ply;
        for error in [
            DecodeError::Empty,
            DecodeError::NotThisFormat { format },
            DecodeError::EndsEarly { format },
            DecodeError::HeaderMissing { format, field: "vertex" },
            DecodeError::DamagedArchive { what: "" },
            DecodeError::DamagedFile,
            DecodeError::LinesStripped,
            DecodeError::PitchUnused { format },
            DecodeError::PitchNeeded { format, columns: 9, wanted: Pitches::Both },
            DecodeError::PositionMissing { row: 1, axis: "y" },
            DecodeError::ZippedFile { found: Vec::new() },
            DecodeError::AmbiguousNumber { line: 1, column: 1, text: String::new(), as_point: 1.0, as_comma: 2.0 },
            DecodeError::DoubleColumn { wanted: "x", first: String::new(), second: String::new() },
            DecodeError::RaggedRow { line: 1, expected: 2, found: 3, text: String::new() },
            DecodeError::BadNumber { line: 1, column: 1, text: String::new(), hint: NumberHint::Other },
            DecodeError::SectionMissing,
            DecodeError::JsonSyntax { line: 1, column: 1, found: String::new() },
            DecodeError::TooManyPoints { limit: 1 },
            DecodeError::BadCompression,
        ] {
            assert_eq!(error.code(), code_of(&error).name());
        }
        for error in
            [SliceError::NoRows, SliceError::RegionEmpty { points: 1 }, SliceError::TooManyProfiles { limit: 1 }]
        {
            assert_eq!(error.code(), Problem::from(error).code().name());
        }
    }

    /// An I/O error of a file of the store is an error of the service; a decompressor's error about the bytes is one of the client.
    #[test]
    fn no_error_of_the_bytes_is_retryable() {
        use io::ErrorKind as K;
        for kind in [K::InvalidData, K::InvalidInput, K::UnexpectedEof, K::Unsupported] {
            let code = code_of(&DecodeError::from(io::Error::new(kind, "of the bytes")));
            assert_eq!((code.status(), code.retry()), (422, Retry::No), "{kind}");
        }
        for kind in [K::NotFound, K::PermissionDenied, K::TimedOut] {
            assert_eq!(code_of(&DecodeError::from(io::Error::new(kind, "of the file"))), Code::StoreUnavailable);
        }
    }
}
