//! Query, path and JSON body as typed values, and the media type that the client prefers. An invalid request gets a problem,
//! never the plain text of the framework.

use super::body::{header_text, media_type};
pub(in crate::http) use crate::service::without_mark;

use axum::body::Body;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use crate::http::app::App;
use crate::service::in_words;

use super::body::Pieces;
use super::problem::{Code, Problem};

/// The query; unknown and repeated parameters are refused.
#[derive(Debug)]
pub(in crate::http) struct Query<T>(pub(in crate::http) T);

/// The variable parts of the path.
#[derive(Debug)]
pub(in crate::http) struct Path<T>(pub(in crate::http) T);

/// The query of an operation without parameters, so that a mistyped parameter is not ignored.
#[derive(Debug)]
pub(in crate::http) struct NoQuery;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NoParameters {}

/// A JSON body of at most `limits.json_bytes_max` bytes; unknown fields are refused.
#[derive(Debug)]
pub(in crate::http) struct Json<T>(pub(in crate::http) T);

/// The same for an optional body.
#[derive(Debug)]
pub(in crate::http) struct OptionalJson<T>(pub(in crate::http) T);

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
pub(in crate::http) fn query<T: DeserializeOwned>(parts: &Parts) -> Result<T, Problem> {
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
        // A path that is not valid text cannot name a resource.
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

/// The body of a request as a value, or the default if there is no body.
pub(in crate::http) async fn optional_json<T: DeserializeOwned + Default>(
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
pub(in crate::http) fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    let bytes = without_mark(bytes);
    if let Err(error) = serde_json::from_slice::<IgnoredAny>(bytes) {
        let reason = in_words(&error.to_string());
        return Err(Problem::new(Code::JsonMalformed, format!("the body is not a JSON document: {reason}")));
    }
    // serde would accept a list as the fields of an object in their order.
    if bytes.trim_ascii_start().first() != Some(&b'{') {
        return Err(Problem::new(Code::JsonInvalid, "the body is not a JSON object: send {\"name\": value, …}"));
    }
    serde_json::from_slice(bytes).map_err(|error| {
        Problem::new(Code::JsonInvalid, format!("the body has another shape: {}", in_words(&error.to_string())))
    })
}

/// Whether the body is declared as JSON.
pub(in crate::http) fn is_json(headers: &HeaderMap) -> bool {
    media_type(headers).is_some_and(|kind| {
        let essence = kind.split(';').next().unwrap_or_default().trim();
        essence.eq_ignore_ascii_case("application/json")
    })
}

/// Refuses a body that is not declared as JSON, or is compressed.
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

/// The offered media type that the client prefers; the first of equals, and the first if it states no preference.
///
/// # Errors
/// [`Code::NotAcceptable`] if it accepts none.
pub(in crate::http) fn choose<T: Copy>(headers: &HeaderMap, offered: &[(&'static str, T)]) -> Result<T, Problem> {
    let accept: Vec<&str> = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    let ranges: Vec<Range<'_>> = accept.iter().flat_map(|line| line.split(',')).filter_map(Range::parse).collect();
    let mut best: Option<(f32, T)> = None;
    for &(media_type, value) in offered {
        let quality = if ranges.is_empty() { 1.0 } else { quality(&ranges, media_type) };
        if quality > best.map_or(0.0, |(quality, _)| quality) {
            best = Some((quality, value));
        }
    }
    best.map(|(_, value)| value).ok_or_else(|| {
        let names: Vec<_> = offered.iter().map(|(name, _)| *name).collect();
        Problem::new(
            Code::NotAcceptable,
            format!("the answer is available as {}; accept one of them", names.join(", ")),
        )
        .with("offered", names)
    })
}

struct Range<'a> {
    kind: &'a str,
    subtype: &'a str,
    quality: f32,
}

impl<'a> Range<'a> {
    fn parse(text: &'a str) -> Option<Self> {
        let mut parts = text.split(';');
        let (kind, subtype) = parts.next()?.trim().split_once('/')?;
        let quality = parts.find_map(|part| part.trim().strip_prefix("q=")?.parse().ok()).unwrap_or(1.0);
        Some(Self { kind, subtype, quality })
    }

    /// How specifically it matches a media type; `None` if it does not match.
    fn closeness(&self, media_type: &str) -> Option<u8> {
        let (kind, subtype) = media_type.split_once('/')?;
        match (self.kind, self.subtype) {
            ("*", "*") => Some(0),
            (k, "*") if k.eq_ignore_ascii_case(kind) => Some(1),
            (k, s) if k.eq_ignore_ascii_case(kind) && s.eq_ignore_ascii_case(subtype) => Some(2),
            _ => None,
        }
    }
}

/// The quality of the range that matches the type most specifically; 0 if none does.
fn quality(ranges: &[Range<'_>], media_type: &str) -> f32 {
    let named = ranges.iter().filter_map(|range| Some((range.closeness(media_type)?, range.quality)));
    named.max_by_key(|(closeness, _)| *closeness).map_or(0.0, |(_, quality)| quality)
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn chosen(accept: Option<&'static str>) -> Result<u8, Code> {
        let mut headers = HeaderMap::new();
        headers.extend(accept.map(|text| (header::ACCEPT, HeaderValue::from_static(text))));
        choose(&headers, &[("application/json", 1), ("text/csv", 2)]).map_err(|problem| problem.code())
    }

    #[test]
    fn the_most_specific_range_applies_and_its_quality_ranks() {
        assert_eq!(chosen(None), Ok(1));
        assert_eq!(chosen(Some("*/*")), Ok(1));
        assert_eq!(chosen(Some("text/csv")), Ok(2));
        assert_eq!(chosen(Some("text/*;q=0.9, application/json;q=0.1")), Ok(2));
        assert_eq!(chosen(Some("*/*, application/json;q=0")), Ok(2));
        assert_eq!(chosen(Some("image/png")), Err(Code::NotAcceptable));
    }
}
