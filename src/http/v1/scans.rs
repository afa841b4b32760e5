//! Raw scans: stored under the hash of their content, listed, returned byte for byte.

use crate::http::app::App;
use crate::http::wire::body::{Pieces, content_encoding, origin, receive};
use crate::http::wire::extract::{NoQuery, Path, Query, query};
use crate::http::wire::names::{DecimalName, FormatName};
use crate::http::wire::paging::{PageQuery, listed};
use crate::http::wire::problem::Problem;
use crate::scan::decode::Format;
use crate::service::{Content, Kept, MeasurementOrder, Recipe};
use crate::store::ScanRow;
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use http_body_util::channel::Channel;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::io;
use tokio::io::AsyncReadExt;
use utoipa::{IntoParams, ToSchema};

/// A raw scan, known by its content.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Scan)]
pub(in crate::http) struct ScanDocument {
    /// `s-` and the SHA-256 of the bytes: the same bytes have the same id.
    #[schema(pattern = "^s-[0-9a-f]{64}$")]
    id: String,
    /// When it was first seen, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    created_at: Timestamp,
    /// Length of the file.
    bytes_count: u64,
    /// The format in which it was read.
    #[schema(example = "ply")]
    format: String,
    /// Points in it.
    points_count: Option<u64>,
}

/// A page of scans, newest first.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct ScanList {
    /// The scans.
    scans: Vec<ScanDocument>,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

/// What is said about a scan.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct CreateQuery {
    /// Format of the scan; found by Content-Type and first bytes by default.
    #[param(inline)]
    format: Option<FormatName>,
    /// Sign before the decimals of a text file's numbers, where its cells do not show it.
    #[param(inline)]
    decimal: Option<DecimalName>,
    /// Distance between the profiles of a scan that is a matrix of heights.
    #[param(exclusive_minimum = 0.0, maximum = 100000.0)]
    x_pitch_mm: Option<f64>,
    /// Distance between the points of a profile in such a matrix.
    #[param(exclusive_minimum = 0.0, maximum = 100000.0)]
    y_pitch_mm: Option<f64>,
}

/// Keep a scan
///
/// The bytes are kept under their SHA-256 after they were read once; gzip and zstd are decompressed, by Content-Encoding or by their first bytes.
#[utoipa::path(
    post, path = "/v1/scans", tag = "scans", params(CreateQuery),
    request_body(description = "A scan file", content((Vec<u8> = "application/octet-stream"))),
    responses(
        (status = 201, description = "Kept", body = ScanDocument,
            headers(("Location" = String, description = "Address of the scan"))),
        (status = 200, description = "Kept before: the same bytes", body = ScanDocument,
            headers(("Location" = String, description = "Address of the scan"))),
    )
)]
pub(in crate::http) async fn create_scan(State(app): State<App>, request: Request) -> Result<Response, Problem> {
    let (parts, body) = request.into_parts();
    let mut pieces = Pieces::new(&parts, body, &app, app.limits.body_bytes_max)?;
    let query: CreateQuery = query(&parts)?;
    let encoding = content_encoding(&parts.headers)?;
    let origin = origin(query.format, &parts.headers)?;
    let overrides = Recipe {
        decimal: query.decimal.map(Into::into),
        x_pitch_mm: query.x_pitch_mm,
        y_pitch_mm: query.y_pitch_mm,
        ..Recipe::default()
    };
    let accepted = app.service.accept(MeasurementOrder { overrides, ..MeasurementOrder::default() }).await?;
    let arrived = receive(&app, &mut pieces, encoding, origin, accepted).await?;
    let (status, row) = match app.service.measuring.store_scan(arrived).await? {
        Kept::New(row) => (StatusCode::CREATED, row),
        Kept::Known(row) => (StatusCode::OK, row),
    };
    let location = HeaderValue::from_str(&format!("/v1/scans/{}", row.id));
    let location = location.map_err(|error| Problem::internal(error.to_string()))?;
    Ok((status, [(header::LOCATION, location)], Json(ScanDocument::from(row))).into_response())
}

/// List scans
///
/// Newest first, by the page. The header `Link` names the next page.
#[utoipa::path(
    get, path = "/v1/scans", tag = "scans", params(PageQuery),
    responses((status = 200, description = "A page of scans", body = ScanList,
        headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end"))))
)]
pub(in crate::http) async fn list_scans(
    State(app): State<App>,
    Query(query): Query<PageQuery>,
    uri: Uri,
) -> Result<Response, Problem> {
    let page = app.service.measuring.scans(&query.page()?).await?;
    let document = |rows: Vec<ScanRow>, next_cursor| ScanList {
        scans: rows.into_iter().map(ScanDocument::from).collect(),
        next_cursor,
    };
    listed(&uri, page, document).await
}

/// Get a scan
///
/// Its record; the bytes are at `/content`.
#[utoipa::path(
    get, path = "/v1/scans/{id}", tag = "scans",
    params(("id" = String, Path, description = "Id of the scan")),
    responses((status = 200, description = "The scan", body = ScanDocument))
)]
pub(in crate::http) async fn get_scan(
    State(app): State<App>,
    Path(id): Path<String>,
    _: NoQuery,
) -> Result<Json<ScanDocument>, Problem> {
    Ok(Json(app.service.measuring.scan(&id).await?.into()))
}

/// Get the bytes of a scan
///
/// Exactly as they were sent, after gzip or zstd was decompressed: they are compared with the id first.
#[utoipa::path(
    get, path = "/v1/scans/{id}/content", tag = "scans",
    params(("id" = String, Path, description = "Id of the scan")),
    responses((status = 200, description = "The bytes", content((Vec<u8> = "application/octet-stream"))))
)]
pub(in crate::http) async fn get_scan_content(
    State(app): State<App>,
    Path(id): Path<String>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let Content { row, file } = app.service.measuring.scan_content(&id).await?;
    let extension = Format::from_name(&row.format).map_or("bin", |format| match format {
        Format::Csv | Format::GocatorCsv => "csv",
        Format::Ply => "ply",
        Format::Pcd => "pcd",
        Format::Npy => "npy",
        Format::Npz => "npz",
        Format::Json => "json",
    });
    let disposition = format!("attachment; filename=\"{}.{extension}\"", row.id);
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::CONTENT_LENGTH, row.bytes_count.to_string()),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    Ok((headers, file_body(file)).into_response())
}

/// Bytes of a file that are read at once.
const BLOCK_BYTES: usize = 256 << 10;

/// The file as a body, read one block ahead of the client.
fn file_body(file: std::fs::File) -> Body {
    let (mut sender, body) = Channel::<Bytes, io::Error>::new(1);
    tokio::spawn(async move {
        let mut file = tokio::fs::File::from_std(file);
        loop {
            let mut block = vec![0; BLOCK_BYTES];
            match file.read(&mut block).await {
                Ok(0) => break,
                Ok(count) => block.truncate(count),
                // The announced length is not reached, so the client detects that data are missing.
                Err(error) => return sender.abort(error),
            }
            if sender.send_data(block.into()).await.is_err() {
                break;
            }
        }
    });
    Body::new(body)
}

impl From<ScanRow> for ScanDocument {
    fn from(row: ScanRow) -> Self {
        let ScanRow { id, created_at, bytes_count, format, points_count, .. } = row;
        Self { id, created_at, bytes_count, format, points_count }
    }
}
