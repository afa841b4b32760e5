//! What is wrong with an upload, as problems: the variants of the reader's and the slicer's errors, one by one.

use super::{Code, Problem};
use crate::scan::decode::DecodeError;
use crate::scan::slice::SliceError;
use serde_json::Value;

/// Large counts keep every digit.
fn count(value: usize) -> Value {
    Value::from(u64::try_from(value).unwrap_or(u64::MAX))
}

impl From<DecodeError> for Problem {
    fn from(error: DecodeError) -> Self {
        use DecodeError as E;
        let text = error.to_string();
        let problem = |code| Self::new(code, text.clone());
        match error {
            E::Empty => problem(Code::FileEmpty),
            E::UnknownFormat => problem(Code::FormatUnknown),
            E::FormatConflict { declared, found } => {
                problem(Code::FormatConflict).with("declared", declared.name()).with("found", found.name())
            }
            E::NotThisFormat { format } => problem(Code::FormatMismatch).with("format", format.name()),
            E::Truncated { expected, found } => problem(Code::FileTruncated)
                .with("points_expected_count", expected)
                .with("points_found_count", found),
            E::EndsEarly { format } => problem(Code::FileTruncated).with("format", format.name()),
            E::HeaderLine { format, line, field } => problem(Code::HeaderInvalidInFile)
                .with("format", format.name())
                .with("line", line)
                .with("field", field),
            E::HeaderMissing { format, field } => {
                problem(Code::HeaderInvalidInFile).with("format", format.name()).with("field", field)
            }
            E::HeaderTooLong { format, limit } => {
                problem(Code::HeaderTooLong).with("format", format.name()).with("limit", count(limit))
            }
            E::SizeMismatch { format, field, stated, expected } => problem(Code::SizeMismatch)
                .with("format", format.name())
                .with("field", field)
                .with("stated", stated)
                .with("expected", expected),
            E::DamagedPoints { format } => problem(Code::FileDamaged).with("format", format.name()),
            E::Unsupported { format, what: _ } => problem(Code::FormatUnsupported).with("format", format.name()),
            E::ArrayShape { shape } => problem(Code::ArrayShape).with("shape", shape),
            E::ArraysMissing { found } => problem(Code::ArraysMissing).with("found", found),
            E::DamagedArchive => problem(Code::FileDamaged),
            E::TooManyEntries { found, limit } => {
                problem(Code::TooManyEntries).with("found_count", count(found)).with("limit", count(limit))
            }
            E::NotText { line } => problem(Code::NotText).with("line", line),
            E::NotATable { line } => problem(Code::NotATable).with("line", line),
            E::LineTooLong { line, limit } => {
                problem(Code::LineTooLong).with("line", line).with("limit", count(limit))
            }
            E::TooManyColumns { limit } => problem(Code::TooManyColumns).with("limit", count(limit)),
            E::UnknownColumn { wanted, found } => {
                problem(Code::ColumnUnknown).with("wanted", wanted).with("found", found)
            }
            E::DoubleColumn { wanted, first, second } => problem(Code::ColumnAmbiguous)
                .with("wanted", wanted)
                .with("first", first)
                .with("second", second),
            E::HeaderNeeded { columns } => problem(Code::HeaderNeeded).with("columns_count", count(columns)),
            E::RaggedRow { line, expected, found } => problem(Code::RowRagged)
                .with("line", line)
                .with("expected_count", count(expected))
                .with("found_count", count(found)),
            E::BadNumber { line, column } => {
                problem(Code::NumberInvalid).with("line", line).with("column", count(column))
            }
            E::UnitConflict { declared, found } => {
                problem(Code::UnitConflict).with("declared", declared.name()).with("found", found.name())
            }
            E::SectionMissing => problem(Code::SectionMissing),
            E::SectionIncomplete { line, field } => {
                problem(Code::SectionMissing).with("line", line).with("field", field)
            }
            E::TravelMissing { line } => problem(Code::TravelMissing).with("line", line),
            E::JsonSyntax { line, column } => {
                problem(Code::JsonSyntax).with("line", count(line)).with("column", count(column))
            }
            E::JsonShape { line, column } => {
                problem(Code::JsonShape).with("line", count(line)).with("column", count(column))
            }
            E::NoPoints { missing_count } => problem(Code::NoPoints).with("missing_count", missing_count),
            E::TooManyPoints { limit } => problem(Code::TooManyPoints).with("points_max", count(limit)),
            E::CoordinateOutOfRange { index, value, limit } => problem(Code::CoordinateOutOfRange)
                .with("index", count(index))
                .with("value_mm", value)
                .with("limit_mm", limit),
            E::InflateRatio { limit } => problem(Code::InflateRatio).with("ratio_max", limit),
            E::InflatedTooLarge { limit } => problem(Code::InflatedTooLarge).with("bytes_max", limit),
            E::BadCompression => problem(Code::CompressionInvalid),
            // The bytes are read from the store's own file, so this is no fault of the client.
            E::Io(cause) => Self::new(Code::StoreUnavailable, "the scan cannot be read from the store now; try again")
                .because(cause.to_string()),
        }
    }
}

impl From<SliceError> for Problem {
    fn from(error: SliceError) -> Self {
        use SliceError as E;
        let text = error.to_string();
        let problem = |code| Self::new(code, text.clone());
        match error {
            E::Frame(_) => problem(Code::RecipeInvalid).with("field", "frame"),
            E::RegionInvalid { axis } => problem(Code::RecipeInvalid).with("field", format!("region.{axis}")),
            E::PitchInvalid => problem(Code::RecipeInvalid).with("field", "profile_by"),
            E::RegionEmpty { points } => problem(Code::RegionEmpty).with("points_count", count(points)),
            E::NoColumn { wanted, found } => {
                problem(Code::NoProfileColumn).with("wanted", wanted).with("found", found)
            }
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
            // The reader promised finite points in order.
            E::Scan(cause) => Self::internal(cause.to_string()),
        }
    }
}
