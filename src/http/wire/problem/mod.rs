//! Every refusal in one form: RFC 9457, `application/problem+json`. `reasons` and `decoding` map errors to a status, a code,
//! text for people and numbers for programs. There is no catch-all: a new error variant does not compile until it is
//! mapped.

pub(in crate::http) mod code;
pub(in crate::http) mod decoding;
pub(in crate::http) mod reasons;

pub use code::Code;
use code::Retry;

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// The media type of a problem.
pub(in crate::http) const MEDIA_TYPE: &str = "application/problem+json";

/// A refusal. It is rendered as a body at the edge, where the request's id is known.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::http) struct Problem {
    code: Code,
    detail: String,
    members: Map<String, Value>,
    headers: Vec<(HeaderName, HeaderValue)>,
    /// Written to the log, but not sent to the client.
    log: Option<String>,
}

/// The body of every 4xx and 5xx. Further members have the numbers of the detail.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Problem, example = json!({
    "type": "urn:coaxis:problem:scan_unknown", "title": "There is no scan of this id", "status": 404,
    "detail": "there is no scan s-00; list them with GET /v1/scans", "code": "scan_unknown",
    "request_id": "0199f0c8-0000-7000-8000-000000000000", "retryable": false
}))]
pub(in crate::http) struct ProblemDocument {
    /// `urn:coaxis:problem:` and the code.
    #[serde(rename = "type")]
    #[schema(pattern = "^urn:coaxis:problem:[a-z_]{1,32}$")]
    kind: String,
    /// The meaning of the code; the same for every occurrence.
    title: &'static str,
    /// The HTTP status.
    #[schema(minimum = 400, maximum = 599)]
    status: u16,
    /// What happened, and what to do about it.
    detail: String,
    /// Stable name for programs.
    #[schema(pattern = "^[a-z_]{1,32}$")]
    code: &'static str,
    /// Names this request in the log.
    request_id: String,
    /// Whether the same request may succeed later.
    retryable: bool,
    /// The numbers behind the detail.
    #[serde(flatten)]
    #[schema(ignore)]
    members: Map<String, Value>,
}

impl Problem {
    /// A problem; `detail` says what happened and what to do.
    #[must_use]
    pub(in crate::http) fn new(code: Code, detail: impl Into<String>) -> Self {
        Self { code, detail: detail.into(), members: Map::new(), headers: Vec::new(), log: None }
    }

    /// An internal failure: the client receives only the request's id, the log gets `cause`.
    #[must_use]
    pub(in crate::http) fn internal(cause: impl Into<String>) -> Self {
        let detail = "the service failed; nothing is lost that was acknowledged. Report the request id";
        Self { log: Some(cause.into()), ..Self::new(Code::Internal, detail) }
    }

    /// Adds a number or word besides the detail.
    #[must_use]
    pub(in crate::http) fn with(mut self, member: &'static str, value: impl Into<Value>) -> Self {
        self.members.insert(member.to_owned(), value.into());
        self
    }

    /// Adds a header.
    #[must_use]
    pub(in crate::http) fn with_header(mut self, name: HeaderName, value: HeaderValue) -> Self {
        self.headers.push((name, value));
        self
    }

    /// Adds a cause that is written only to the log.
    #[must_use]
    pub(in crate::http) fn because(mut self, cause: impl Into<String>) -> Self {
        self.log = Some(cause.into());
        self
    }

    /// Its code.
    #[must_use]
    pub(in crate::http) const fn code(&self) -> Code {
        self.code
    }

    /// The cause that is written only to the log.
    #[must_use]
    pub(in crate::http) fn log(&self) -> Option<&str> {
        self.log.as_deref()
    }

    /// Its HTTP status.
    #[must_use]
    pub(in crate::http) fn status(&self) -> StatusCode {
        StatusCode::from_u16(self.code.status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }

    /// The answer, for the request of this id.
    #[must_use]
    pub(in crate::http) fn render(self, request_id: &str) -> Response {
        let status = self.status();
        let document = ProblemDocument {
            kind: format!("urn:coaxis:problem:{}", self.code.name()),
            title: self.code.title(),
            status: self.code.status(),
            detail: self.detail,
            code: self.code.name(),
            request_id: request_id.to_owned(),
            retryable: self.code.retry() == Retry::Yes,
            members: self.members,
        };
        // Text and JSON values can always be serialised.
        let body = serde_json::to_vec(&document).unwrap_or_default();
        let mut response = (status, [(header::CONTENT_TYPE, MEDIA_TYPE)], body).into_response();
        response.headers_mut().extend(self.headers.into_iter().map(|(name, value)| (Some(name), value)));
        response
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = Response::new(Body::empty());
        *response.status_mut() = self.status();
        response.extensions_mut().insert(self);
        response
    }
}
