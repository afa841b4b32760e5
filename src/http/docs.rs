//! The OpenAPI document as it is committed, and a page to read and try it that loads nothing from outside.

use super::extract::Path;
use super::openapi::COMMITTED;
use super::problem::{Code, Problem};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use utoipa_swagger_ui::{Config, SwaggerFile};

/// The page: every script and style comes from this service, none stands in the page.
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

/// Swagger UI sets styles on its elements and draws its icons from data URLs; nothing else is let in.
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
pub(super) async fn get_openapi() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], COMMITTED)
}

/// Read the API in a browser
///
/// A page that shows this document and tries its requests; works without the internet.
#[utoipa::path(
    get, path = "/docs", tag = "documentation",
    responses((status = 200, description = "The page", content((String = "text/html"))))
)]
pub(super) async fn get_docs() -> Response {
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static("text/html; charset=utf-8")),
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY),
    ];
    (headers, PAGE).into_response()
}

/// What the page is made of; no resource of the API, hence not in its document.
pub(super) async fn get_docs_file(Path(file): Path<String>) -> Result<Response, Problem> {
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
    // They stand in the binary compressed, and every browser takes them so.
    if gzipped {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    }
    Ok((headers, bytes.into_owned()).into_response())
}
