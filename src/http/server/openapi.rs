//! The OpenAPI document: its head, the refusals common to groups of operations, which no handler repeats, and the committed
//! document, with a page to read and try it that loads nothing from other hosts.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response as HttpResponse};
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::schema::{Object, Type};
use utoipa::openapi::{Content, ContentBuilder, HeaderBuilder, OpenApi, Ref, RefOr, Response, ResponseBuilder};
use utoipa::{OpenApi as _, ToSchema};
use utoipa_swagger_ui::{Config, SwaggerFile};

use crate::http::wire::extract::Path;
use crate::http::wire::problem::{Code, MEDIA_TYPE, Problem, ProblemDocument};

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "coaxis",
        description = "Measures the pose of the axis of a cylindrical part from laser profile scans, and moves it where it is \
            wanted.\n\nStop is an operational stop of category 2, not an emergency stop; nothing here is a safety function.\n\n\
            Every refusal is `application/problem+json` with a stable `code`; units stand in every name; times are UTC.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    components(schemas(ProblemDocument)),
    tags(
        (name = "measurements", description = "A scan in, a pose and its diagnostics out"),
        (name = "scans", description = "Raw scans, known by their content"),
        (name = "recipes", description = "How a kind of part is measured"),
        (name = "cell", description = "How the cell is, who may move, stop and reset"),
        (name = "manipulators", description = "The two manipulators that carry the part"),
        (name = "motion", description = "Plans, which move nothing, and moves"),
        (name = "events", description = "What has happened"),
        (name = "status", description = "How the service is"),
        (name = "documentation", description = "What you are reading"),
    )
)]
struct Head;

/// The document without operations.
pub(in crate::http) fn head() -> OpenApi {
    Head::openapi()
}

/// The document of all operations with their refusals, as text.
///
/// # Errors
/// If it cannot be serialised as JSON.
pub(in crate::http) fn with_refusals(mut document: OpenApi) -> Result<String, serde_json::Error> {
    for item in document.paths.paths.values_mut() {
        operations(item).for_each(add_refusals);
    }
    Ok(document.to_pretty_json()? + "\n")
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = &mut Operation> {
    [&mut item.get, &mut item.put, &mut item.post, &mut item.delete].into_iter().filter_map(Option::as_mut)
}

/// Refusals of every operation.
const EVERYWHERE: &[Code] = &[
    Code::QueryInvalid,
    Code::HostInvalid,
    Code::OriginForeign,
    Code::MethodNotAllowed,
    Code::UrlTooLong,
    Code::HostUnknown,
    Code::HeadersTooLarge,
    Code::Internal,
    Code::TransferCodingUnsupported,
];

/// Additional refusals of all operations except stop: they are not answered while all connections are in use.
const NOT_URGENT: &[Code] = &[Code::Busy];

/// Additional refusals of operations that use the store.
const STORE: &[Code] = &[Code::StoreUnavailable];

/// Additional refusals of operations with a body.
const BODY: &[Code] = &[
    Code::HeaderInvalid,
    Code::BodyInterrupted,
    Code::BodyTimeout,
    Code::BodyTooLarge,
    Code::EncodingUnsupported,
    Code::StoreFull,
];

/// Additional refusals of operations that read a scan.
const SCAN: &[Code] = &[
    Code::TooManyPoints,
    Code::CalculationTooLong,
    Code::InflatedTooLarge,
    Code::InflateRatio,
    Code::FormatUnknown,
    Code::FormatConflict,
    Code::FormatMismatch,
    Code::FormatUnsupported,
    Code::FileEmpty,
    Code::FileTruncated,
    Code::FileDamaged,
    Code::HeaderInvalidInFile,
    Code::HeaderTooLong,
    Code::SizeMismatch,
    Code::ArrayShape,
    Code::ArraysMissing,
    Code::TooManyEntries,
    Code::NotText,
    Code::NotATable,
    Code::LineTooLong,
    Code::TooManyColumns,
    Code::ColumnUnknown,
    Code::ColumnAmbiguous,
    Code::HeaderNeeded,
    Code::RowRagged,
    Code::NumberInvalid,
    Code::UnitConflict,
    Code::SectionMissing,
    Code::TravelMissing,
    Code::JsonSyntax,
    Code::JsonShape,
    Code::NoPoints,
    Code::CoordinateOutOfRange,
    Code::CompressionInvalid,
    Code::Busy,
];

/// Additional refusals of operations that measure.
const MEASURING: &[Code] = &[
    Code::JsonMalformed,
    Code::JsonInvalid,
    Code::OptionInvalid,
    Code::RecipeInvalid,
    Code::RecipeUnknown,
    Code::ScanUnknown,
    Code::RequestIdReused,
    Code::TooManyProfiles,
    Code::ProfileTooLong,
    Code::RegionEmpty,
    Code::NoProfileColumn,
    Code::NoRows,
    Code::PitchTooSmall,
];

/// Additional refusals of operations that query the cell.
const CELL: &[Code] = &[Code::CellAbsent, Code::NotReady];

/// Additional refusals of operations that command the cell.
const COMMAND: &[Code] = &[
    Code::HeaderInvalid,
    Code::BodyInterrupted,
    Code::BodyTimeout,
    Code::BodyTooLarge,
    Code::ContentTypeUnsupported,
    Code::JsonMalformed,
    Code::JsonInvalid,
    Code::OptionInvalid,
    Code::LeaseRequired,
    Code::LeaseOver,
    Code::LeaseHeld,
    Code::CellAbsent,
    Code::NotReady,
    Code::StoreUnavailable,
    Code::StoreFull,
];

/// Additional refusals of operations that move devices.
const MOVING: &[Code] = &[
    Code::CellBusy,
    Code::DeviceAbsent,
    Code::Faulted,
    Code::NotEnabled,
    Code::NotHomed,
    Code::NotRemote,
    Code::SafetyOpen,
    Code::DeviceMoves,
    Code::DeviceFault,
    Code::DeviceUnavailable,
];

/// Additional refusals of operations that plan or execute a path.
const PATH: &[Code] = &[
    Code::OutOfLimits,
    Code::StandsOutside,
    Code::StepTooLarge,
    Code::TooFast,
    Code::SpansMeet,
    Code::StrainTooLarge,
    Code::TwistTooLarge,
    Code::NothingToMove,
    Code::PathTooLong,
    Code::PlanStale,
];

/// Additional refusals of operations that need a completed measurement.
const NOT_MEASURED: &[Code] = &[Code::MeasurementUnknown, Code::MeasurementRunning, Code::MeasurementFailed];

/// The possible refusals of an operation, by its name.
fn refusals(operation_id: &str) -> Vec<&'static [Code]> {
    const NOTHING: &[Code] = &[];
    match operation_id {
        "create_measurement" => {
            let by_the_sensor = &[
                Code::LeaseRequired,
                Code::LeaseOver,
                Code::LeaseHeld,
                Code::CellAbsent,
                Code::NotReady,
                Code::ScanOutOfRange,
            ];
            vec![STORE, BODY, SCAN, MEASURING, MOVING, by_the_sensor]
        }
        "get_cell" | "get_lease" | "list_manipulators" => vec![CELL],
        "stop_cell" => vec![&[Code::CellAbsent]],
        "get_manipulator" => vec![CELL, &[Code::ManipulatorUnknown, Code::RouteUnknown]],
        "take_lease" | "release_lease" => vec![COMMAND],
        "reset_cell" => vec![COMMAND, MOVING],
        "enable_manipulator" | "disable_manipulator" | "home_manipulator" => {
            vec![COMMAND, MOVING, &[Code::ManipulatorUnknown, Code::RouteUnknown]]
        }
        "create_move" => vec![COMMAND, MOVING, PATH, &[Code::RequestIdReused]],
        "create_plan" => {
            vec![
                STORE,
                BODY,
                PATH,
                CELL,
                NOT_MEASURED,
                &[
                    Code::ContentTypeUnsupported,
                    Code::JsonMalformed,
                    Code::JsonInvalid,
                    Code::OptionInvalid,
                    Code::PartUnknown,
                    Code::PoseMissing,
                    Code::RequestIdReused,
                    Code::DeviceUnavailable,
                ],
            ]
        }
        "execute_plan" => vec![COMMAND, MOVING, PATH, &[Code::PlanUnknown, Code::RouteUnknown]],
        "get_plan" => vec![STORE, &[Code::PlanUnknown, Code::RouteUnknown]],
        "get_move" => vec![STORE, &[Code::MoveUnknown, Code::RouteUnknown, Code::Busy]],
        "list_moves" | "list_plans" => vec![STORE, &[Code::CursorMalformed]],
        "list_events" => vec![&[Code::HeaderInvalid, Code::NotAcceptable, Code::Busy]],
        "create_scan" => vec![STORE, BODY, SCAN],
        "put_recipe" => vec![
            STORE,
            BODY,
            &[
                Code::ContentTypeUnsupported,
                Code::JsonMalformed,
                Code::JsonInvalid,
                Code::OptionInvalid,
                Code::RecipeInvalid,
                Code::RecipeChanged,
                Code::PreconditionRequired,
                Code::RouteUnknown,
            ],
        ],
        "list_measurements" | "list_scans" | "list_recipes" => vec![STORE, &[Code::CursorMalformed]],
        "get_measurement" => {
            vec![STORE, &[Code::MeasurementUnknown, Code::PartUnknown, Code::RouteUnknown, Code::Busy]]
        }
        "list_profiles" => {
            vec![STORE, NOT_MEASURED, &[Code::PartUnknown, Code::NotAcceptable, Code::RouteUnknown]]
        }
        "get_plot" => {
            vec![
                STORE,
                NOT_MEASURED,
                &[Code::PartUnknown, Code::ProfileUnknown, Code::RouteUnknown, Code::Busy, Code::CalculationTooLong],
            ]
        }
        "get_scan" | "get_scan_content" => vec![STORE, &[Code::ScanUnknown, Code::RouteUnknown]],
        "get_recipe" => vec![STORE, &[Code::RecipeUnknown, Code::RouteUnknown]],
        "get_readiness" => vec![&[Code::NotReady]],
        _ => vec![NOTHING],
    }
}

fn add_refusals(operation: &mut Operation) {
    let id = operation.operation_id.clone().unwrap_or_default();
    let mut by_status: BTreeMap<u16, Vec<&'static str>> = BTreeMap::new();
    let is_stop = id == "stop_cell";
    let not_urgent = if is_stop { &[] } else { NOT_URGENT };
    for code in refusals(&id).into_iter().chain([EVERYWHERE, not_urgent]).flatten() {
        let names = by_status.entry(code.status()).or_default();
        if !names.contains(&code.name()) {
            names.push(code.name());
        }
    }
    for (status, names) in by_status {
        let response = RefOr::T(problem(status, &names));
        operation.responses.responses.insert(status.to_string(), response);
    }
}

fn problem(status: u16, names: &[&str]) -> Response {
    let schema = Ref::from_schema_name(ProblemDocument::name());
    let content: Content = ContentBuilder::new().schema(Some(schema)).build();
    let response = ResponseBuilder::new().description(names.join(", ")).content(MEDIA_TYPE, content);
    let text = |description: &str| {
        let schema = Object::builder().schema_type(Type::String).build();
        HeaderBuilder::new().schema(Some(schema)).description(Some(description)).build()
    };
    match status {
        405 => response.header("Allow", text("The methods of this address")).build(),
        503 => response.header("Retry-After", text("Seconds until another try is worth it")).build(),
        _ => response.build(),
    }
}

/// The OpenAPI document as it is committed and served.
pub const COMMITTED: &str = include_str!("../../../openapi/coaxis.json");

/// The page: every script and style is a file of this service, none is inline.
const PAGE: &str = r#"<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>coaxis API</title>
<link rel="stylesheet" href="/docs/swagger-ui.css">
<link rel="icon" type="image/png" href="/docs/favicon-32x32.png">
</head>
<body>
<div id="swagger-ui"></div>
<script src="/docs/swagger-ui-bundle.js"></script>
<script src="/docs/swagger-ui-standalone-preset.js"></script>
<script src="/docs/swagger-initializer.js"></script>
</body>
</html>
"#;

/// Swagger UI sets styles on its elements and draws its icons from data URLs; everything else is blocked.
const CONTENT_SECURITY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
     connect-src 'self'; frame-ancestors 'none'",
);

/// Get the OpenAPI document
///
/// This document, as it is committed.
#[utoipa::path(
    get, path = "/openapi.json", tag = "documentation",
    responses((status = 200, description = "The OpenAPI document", content((serde_json::Value = "application/json"))))
)]
pub(in crate::http) async fn get_openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], COMMITTED)
}

/// Read the API in a browser
///
/// A page that shows this document and tries its requests; works without the internet.
#[utoipa::path(
    get, path = "/docs", tag = "documentation",
    responses((status = 200, description = "The page", content((String = "text/html"))))
)]
pub(in crate::http) async fn get_docs() -> HttpResponse {
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8")),
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY),
    ];
    (headers, PAGE).into_response()
}

/// The files of the page; they are not resources of the API and therefore not in its document.
pub(in crate::http) async fn get_docs_file(Path(file): Path<String>) -> Result<HttpResponse, Problem> {
    let unknown = || Problem::new(Code::RouteUnknown, format!("there is nothing at /docs/{file}"));
    if file.is_empty() || file == "index.html" {
        return Err(unknown());
    }
    let found = utoipa_swagger_ui::serve(&file, Arc::new(Config::from("/openapi.json")));
    let SwaggerFile { bytes, content_type, gzpipped: gzipped, .. } =
        found.map_err(|error| Problem::internal(error.to_string()))?.ok_or_else(unknown)?;
    let content_type = HeaderValue::from_str(&content_type).map_err(|error| Problem::internal(error.to_string()))?;
    let mut headers = HeaderMap::from_iter([
        (header::CONTENT_TYPE, content_type),
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY),
        (header::CACHE_CONTROL, HeaderValue::from_static("max-age=3600")),
    ]);
    // The files are stored compressed in the binary, and every browser accepts them in this form.
    if gzipped {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    Ok((headers, bytes.into_owned()).into_response())
}
