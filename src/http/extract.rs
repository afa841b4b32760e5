//! Query, path and JSON body as typed values; what does not fit is a problem, never the framework's plain text.

use super::app::App;
use super::body::Pieces;
use super::problem::{Code, Problem};
use crate::service::in_words;
pub(super) use crate::service::without_mark;
use axum::body::Body;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, header};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};

/// The query; unknown and repeated parameters are refused.
#[derive(Debug)]
pub(super) struct Query<T>(pub(super) T);

/// The variable parts of the path.
#[derive(Debug)]
pub(super) struct Path<T>(pub(super) T);

/// The query of what takes no parameter, so that a mistyped one is not ignored.
#[derive(Debug)]
pub(super) struct NoQuery;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoParameters {}

/// A JSON body of at most `limits.json_bytes_max` bytes; unknown fields are refused.
#[derive(Debug)]
pub(super) struct Json<T>(pub(super) T);

/// The same where the body may be left out.
#[derive(Debug)]
pub(super) struct OptionalJson<T>(pub(super) T);

impl<T: DeserializeOwned, S: Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        query(parts).map(Self)
    }
}

impl<S: Sync> FromRequestParts<S> for NoQuery {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        query::<NoParameters>(parts).map(|NoParameters {}| Self)
    }
}

/// The query as a value.
pub(super) fn query<T: DeserializeOwned>(parts: &Parts) -> Result<T, Problem> {
    match axum::extract::Query::<T>::try_from_uri(&parts.uri) {
        Ok(axum::extract::Query(value)) => Ok(value),
        Err(rejection) => {
            let text = rejection.body_text();
            let reason = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
            Err(Problem::new(Code::QueryInvalid, format!("the query cannot be read: {}", in_words(reason))))
        }
    }
}

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        // What cannot be read as text names nothing that we have.
        match axum::extract::Path::<T>::from_request_parts(parts, state).await {
            Ok(axum::extract::Path(value)) => Ok(Self(value)),
            Err(_) => Err(Problem::new(Code::RouteUnknown, "the address cannot be read as text")),
        }
    }
}

impl<T: DeserializeOwned> FromRequest<App> for Json<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        let mut pieces = Pieces::new(&parts, body, app, app.limits.json_bytes_max)?;
        check_declared(&parts.headers, "send JSON with the header Content-Type: application/json")?;
        json(&pieces.all().await?).map(Self)
    }
}

impl<T: DeserializeOwned + Default> FromRequest<App> for OptionalJson<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        optional_json(&parts, body, app).await.map(Self)
    }
}

/// The body of a request as a value, the default where there is none.
pub(super) async fn optional_json<T: DeserializeOwned + Default>(
    parts: &Parts,
    body: Body,
    app: &App,
) -> Result<T, Problem> {
    let bytes = Pieces::new(parts, body, app, app.limits.json_bytes_max)?.all().await?;
    if bytes.trim_ascii().is_empty() {
        return Ok(T::default());
    }
    check_declared(&parts.headers, "send JSON with the header Content-Type: application/json, or no body")?;
    json(&bytes)
}

/// A value from the bytes of a JSON document that is an object.
pub(super) fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let bytes = without_mark(bytes);
    if let Err(error) = serde_json::from_slice::<IgnoredAny>(bytes) {
        let reason = in_words(&error.to_string());
        return Err(Problem::new(Code::JsonMalformed, format!("the body is not a JSON document: {reason}")));
    }
    // A list would be taken for the fields of an object in their order.
    if bytes.trim_ascii_start().first() != Some(&b'{') {
        return Err(Problem::new(Code::JsonInvalid, "the body is not a JSON object: send {\"name\": value, …}"));
    }
    serde_json::from_slice(bytes).map_err(|error| {
        Problem::new(Code::JsonInvalid, format!("the body has another shape: {}", in_words(&error.to_string())))
    })
}

/// Whether the body is declared as JSON.
pub(super) fn is_json(headers: &HeaderMap) -> bool {
    media_type(headers).is_some_and(|kind| {
        let essence = kind.split(';').next().unwrap_or_default().trim();
        essence.eq_ignore_ascii_case("application/json")
    })
}

/// The declared media type.
pub(super) fn media_type(headers: &HeaderMap) -> Option<&str> {
    headers.get(header::CONTENT_TYPE)?.to_str().ok()
}

/// A header's text; `None` where it is absent.
///
/// # Errors
/// [`Code::HeaderInvalid`] where it is no text.
pub(super) fn header_text(headers: &HeaderMap, name: &HeaderName) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get(name) else { return Ok(None) };
    match value.to_str() {
        Ok(text) => Ok(Some(text.to_owned())),
        Err(_) => Err(Problem::new(Code::HeaderInvalid, format!("the header {name} is not plain text"))),
    }
}

/// Refuses a body that is not declared as JSON, or is packed.
fn check_declared(headers: &HeaderMap, what_to_send: &str) -> Result<(), Problem> {
    if !is_json(headers) {
        return Err(Problem::new(Code::ContentTypeUnsupported, what_to_send));
    }
    refuse_encoding(headers)
}

fn refuse_encoding(headers: &HeaderMap) -> Result<(), Problem> {
    match header_text(headers, &header::CONTENT_ENCODING)? {
        Some(encoding) if !encoding.eq_ignore_ascii_case("identity") => {
            Err(Problem::new(Code::EncodingUnsupported, "send this JSON without Content-Encoding"))
        }
        _ => Ok(()),
    }
}
