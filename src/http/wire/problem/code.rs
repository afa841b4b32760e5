//! The table of problem codes: the name, the HTTP status and whether a retry may help. It is the only source
//! of the enum, of the OpenAPI document and of the table in the documentation.

/// Whether the same request may succeed later.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Retry {
    /// A retry gets the same answer.
    No,
    /// A retry may help.
    Yes,
}

macro_rules! codes {
    ($($variant:ident $name:literal $status:literal $retry:ident $title:literal)+) => {
        /// The code of a problem, for programs: stable, lower_snake, at most 32 characters.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        #[expect(missing_docs, reason = "the title beside each says it")]
        pub enum Code { $($variant),+ }

        impl Code {
            /// All codes, in the order of the table.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// Its name.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            /// Its HTTP status.
            #[must_use]
            pub const fn status(self) -> u16 {
                match self { $(Self::$variant => $status),+ }
            }

            /// Whether the same request may succeed later.
            #[must_use]
            pub const fn retry(self) -> Retry {
                match self { $(Self::$variant => Retry::$retry),+ }
            }

            /// Its meaning, the same for every occurrence.
            #[must_use]
            pub const fn title(self) -> &'static str {
                match self { $(Self::$variant => $title),+ }
            }
        }
    };
}

codes! {
    // Errors of the client's program.
    QueryInvalid          "query_invalid"           400 No  "The query has a parameter that is unknown or cannot be read"
    HeaderInvalid         "request_header_invalid"  400 No  "A header of the request cannot be read"
    HostInvalid           "host_invalid"            400 No  "The header Host is missing, repeated or cannot be read"
    JsonMalformed         "json_malformed"          400 No  "The body is not JSON"
    BodyInterrupted       "body_interrupted"        400 Yes "The body ended before its announced length"
    CursorMalformed       "cursor_malformed"        400 No  "The cursor did not come from a list of this service"
    // Origin and host of the request.
    OriginForeign         "origin_foreign"          403 No  "The request comes from a web page of another site"
    HostUnknown           "host_unknown"            421 No  "The service does not answer for the host that the request names"
    // Unknown resources.
    RouteUnknown          "route_unknown"           404 No  "There is nothing at this address"
    MeasurementUnknown    "measurement_unknown"     404 No  "There is no measurement of this id"
    ScanUnknown           "scan_unknown"            404 No  "There is no scan of this id"
    RecipeUnknown         "recipe_unknown"          404 No  "There is no recipe of this name"
    PartUnknown           "part_unknown"            404 No  "The measurement has no part of this name or number"
    ProfileUnknown        "profile_unknown"         404 No  "The measurement has no profile of this index"
    MoveUnknown           "move_unknown"            404 No  "There is no move of this id"
    PlanUnknown           "plan_unknown"            404 No  "There is no plan of this id"
    ManipulatorUnknown    "manipulator_unknown"     404 No  "There is no manipulator of this id"
    // Method, media type, time.
    MethodNotAllowed      "method_not_allowed"      405 No  "The address does not support this method"
    NotAcceptable         "not_acceptable"          406 No  "The answer is not available in a media type that is accepted"
    BodyTimeout           "body_timeout"            408 Yes "The body came too slowly"
    // Conflicts with the present state.
    CellAbsent            "cell_absent"             409 No  "This service has no cell"
    DeviceAbsent          "device_absent"           409 No  "The cell has no device of this name"
    CellBusy              "cell_busy"               409 Yes "The cell is busy with another command"
    LeaseRequired         "lease_required"          409 No  "The command needs a lease and names none"
    LeaseOver             "lease_over"              409 No  "The lease is over"
    LeaseHeld             "lease_held"              423 Yes "Another client has the lease"
    Faulted               "faulted"                 409 No  "Faults are latched; nothing moves until a reset"
    NotEnabled            "not_enabled"             409 No  "A manipulator is not enabled"
    NotHomed              "not_homed"               409 No  "An axis has no reference"
    NotRemote             "not_remote"              409 No  "A manipulator is not in automatic mode"
    SafetyOpen            "safety_open"             409 No  "A safety function keeps a manipulator from moving"
    DeviceMoves           "device_moves"            409 Yes "A device is moving without a command from coaxis"
    DeviceFault           "device_fault"            409 No  "A device reports a fault"
    StandsOutside         "stands_outside"          409 No  "An axis stands outside its limits"
    PlanStale             "plan_stale"              409 No  "Pose or plan is no longer valid: too old, or something moved"
    MeasurementRunning    "measurement_running"     409 Yes "The measurement is still running"
    MeasurementFailed     "measurement_failed"      409 No  "The measurement by the sensor failed"
    PoseMissing           "pose_missing"            409 No  "The measurement has no pose to plan from, or several"
    // Entity tags.
    RecipeChanged         "recipe_changed"          412 No  "The recipe is not at the revision that the request names"
    PreconditionRequired  "precondition_required"   428 No  "Replacing a recipe needs the revision that is replaced"
    // Size and encoding of the upload.
    BodyTooLarge          "body_too_large"          413 No  "The body is larger than allowed"
    TooManyPoints         "too_many_points"         413 No  "The scan has more points than allowed"
    TooManyProfiles       "too_many_profiles"       413 No  "The scan has more profiles than allowed"
    ProfileTooLong        "profile_too_long"        413 No  "A profile has more points than allowed"
    InflatedTooLarge      "inflated_too_large"      413 No  "The body decompresses to more than allowed"
    InflateRatio          "inflate_ratio"           413 No  "The body decompresses to too many times its size"
    UrlTooLong            "url_too_long"            414 No  "The address is longer than allowed"
    ContentTypeUnsupported "content_type_unsupported" 415 No "The address does not take this content type"
    EncodingUnsupported   "encoding_unsupported"    415 No  "The content encoding is not known"
    FormatUnknown         "format_unknown"          415 No  "The format of the scan is not known"
    FormatConflict        "format_conflict"         415 No  "The scan is declared as one format and is another"
    FormatMismatch        "format_mismatch"         415 No  "The scan does not begin as its format does"
    FormatUnsupported     "format_unsupported"      415 No  "The scan uses a part of its format that is not read"
    HeadersTooLarge       "headers_too_large"       431 No  "The header lines are longer than allowed"
    // Invalid values.
    JsonInvalid           "json_invalid"            422 No  "The body is JSON of another shape"
    OptionInvalid         "option_invalid"          422 No  "A request value is out of range"
    RecipeInvalid         "recipe_invalid"          422 No  "A recipe value is out of range"
    RequestIdReused       "request_id_reused"       422 No  "The request id was used for another request"
    // Motion.
    OutOfLimits           "out_of_limits"           422 No  "An axis would leave its limits"
    StepTooLarge          "step_too_large"          422 No  "An axis would go further than one request may ask for"
    TooFast               "too_fast"                422 No  "An axis would be faster than it may"
    SpansMeet             "spans_meet"              422 No  "The manipulators would come too near to each other"
    StrainTooLarge        "strain_too_large"        422 No  "The part would be stretched or pressed"
    TwistTooLarge         "twist_too_large"         422 No  "The part would be twisted"
    NothingToMove         "nothing_to_move"         422 No  "Every axis is at its target already"
    PathTooLong           "path_too_long"           422 No  "The way has more set-points than are kept"
    ScanOutOfRange        "scan_out_of_range"       422 No  "The scan is beyond the range or the speed of the stage"
    // Content of the scan.
    CalculationTooLong    "calculation_too_long"    422 No  "The calculation took longer than it may"
    FileEmpty             "file_empty"              422 No  "The body contains no scan"
    FileTruncated         "file_truncated"          422 No  "The scan ends before it is whole"
    FileDamaged           "file_damaged"            422 No  "The scan is damaged"
    HeaderInvalidInFile   "header_invalid"          422 No  "The header of the scan cannot be understood"
    HeaderTooLong         "header_too_long"         422 No  "The header of the scan is longer than allowed"
    SizeMismatch          "size_mismatch"           422 No  "Two statements of the scan about its size contradict each other"
    ArrayShape            "array_shape"             422 No  "The array has a shape that is not points"
    ArraysMissing         "arrays_missing"          422 No  "The archive lacks the arrays that are looked for"
    TooManyEntries        "too_many_entries"        422 No  "The archive has more entries than allowed"
    NotText               "not_text"                422 No  "The text is neither UTF-8 nor marked UTF-16"
    NotATable             "not_a_table"             422 No  "The text is not a table of points"
    LineTooLong           "line_too_long"           422 No  "A line of the text is longer than allowed"
    TooManyColumns        "too_many_columns"        422 No  "The table has more columns than allowed"
    ColumnUnknown         "column_unknown"          422 No  "The table lacks a column that is needed"
    ColumnAmbiguous       "column_ambiguous"        422 No  "Two columns claim the same coordinate"
    HeaderNeeded          "header_needed"           422 No  "The table needs a header to be understood"
    RowRagged             "row_ragged"              422 No  "A row of the table has another length than the others"
    NumberInvalid         "number_invalid"          422 No  "A cell of the table is not a number"
    NumberAmbiguous       "number_ambiguous"        422 No  "A number is ambiguous: decimal point or decimal comma"
    LineEndsMissing       "line_ends_missing"       422 No  "The scan has lost its line ends on the way"
    PitchNeeded           "pitch_needed"            422 No  "The scan is a matrix, and its pitches are not declared"
    PitchUnused           "pitch_unused"            422 No  "Pitches are declared for a scan that is no matrix"
    PositionMissing       "position_missing"        422 No  "The first column of a matrix lacks a position"
    UnitConflict          "unit_conflict"           422 No  "The scan states another unit than the request"
    SectionMissing        "section_missing"         422 No  "The Gocator file has no section that is read"
    TravelMissing         "travel_missing"          422 No  "The Gocator frame does not say where it was taken"
    JsonSyntax            "json_syntax"             422 No  "The JSON scan is not valid JSON"
    JsonShape             "json_shape"              422 No  "The JSON scan has another shape"
    NoPoints              "no_points"               422 No  "The scan contains no valid point"
    CoordinateOutOfRange  "coordinate_out_of_range" 422 No  "A coordinate is out of range"
    RegionEmpty           "region_empty"            422 No  "No point of the scan lies in the region"
    NoProfileColumn       "no_profile_column"       422 No  "The scan has no profile column of this name"
    NoRows                "no_rows"                 422 No  "The points are not organised in rows"
    PitchTooSmall         "pitch_too_small"         422 No  "The pitch makes more profiles than allowed"
    CompressionInvalid    "compression_invalid"     422 No  "The body cannot be decompressed"
    // Failures of the service.
    ScanFileMissing       "scan_file_missing"       500 No  "The file of the scan is missing in the data folder"
    ScanFileDamaged       "scan_file_damaged"       500 No  "The file of the scan does not contain the bytes that were recorded"
    RecordUnreadable      "record_unreadable"       500 No  "The stored record cannot be read"
    Internal              "internal"                500 No  "The service failed; the log says why, under the request id"
    TransferCodingUnsupported "transfer_coding_unsupported" 501 No "The transfer coding of the body is not decoded"
    // Temporary refusals.
    Busy                  "busy"                    503 Yes "The limit for requests of this kind is reached"
    NotReady              "not_ready"               503 Yes "The service is not ready"
    DeviceUnavailable     "device_unavailable"      503 Yes "A device does not answer, or its state is old"
    StoreUnavailable      "store_unavailable"       503 Yes "The store cannot be used now"
    StoreFull             "store_full"              507 Yes "The store is full"
}

impl Code {
    /// The table for the documentation, in Markdown.
    #[must_use]
    pub fn table() -> String {
        let mut table = "| code | status | retry | meaning |\n|---|---|---|---|\n".to_owned();
        for code in Self::ALL {
            let retry = match code.retry() {
                Retry::Yes => "yes",
                Retry::No => "no",
            };
            table += &format!("| `{}` | {} | {retry} | {} |\n", code.name(), code.status(), code.title());
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_unique_short_and_lower_snake() {
        let names: BTreeSet<_> = Code::ALL.iter().map(|code| code.name()).collect();
        assert_eq!(names.len(), Code::ALL.len());
        for name in names {
            assert!(name.len() <= 32 && name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_'), "{name}");
        }
    }
}
