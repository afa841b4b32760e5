//! The processing common to all requests and answers: a request id, limits on address and headers, the check of the origin,
//! admission, a line in the log, counters, the rendering of problems with the id, and headers against content sniffing.
//!
//! While all general places are occupied, only stop, health checks and requests of the lease holder are answered.

use std::any::Any;
use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::OwnedSemaphorePermit;

use crate::http::app::App;
use crate::http::wire::problem::{Code, Problem};

use super::connections::Reservation;
use super::same_origin;
use super::shares::ConnectionInfo;

/// The id of a request in answers and in the log.
pub(in crate::http) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Maximum length of an id that is accepted from a client.
const REQUEST_ID_CHARACTERS_MAX: usize = 128;

/// The API has no web pages; a handler that returns one sets its own policy.
const NO_CONTENT: HeaderValue = HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'");

/// The outermost layer.
pub(in crate::http) async fn edge(State(app): State<App>, request: Request, next: Next) -> Response {
    let watch = app.service.start_stopwatch();
    let request_id = sane_id(request.headers()).unwrap_or_else(|| app.service.new_request_id());
    let asked = Asked::of(&request);
    let response = match check(&app, &request) {
        Err(problem) => problem.into_response(),
        Ok(_permit) => next.run(request).await,
    };
    let problem = problem_of(&response);
    let mut response = finish(response, problem.clone(), &request_id);
    if asked.is_reserved {
        // The place is needed for the next urgent request.
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    let seconds = watch.elapsed().as_secs_f64();
    app.metrics.answered(&asked.method, &asked.route, response.status(), seconds);
    asked.log(response.status(), seconds * 1e3, &request_id, problem.as_ref());
    response
}

/// The answer to a request whose handler panicked.
#[expect(clippy::needless_pass_by_value, reason = "the layer requires this signature")]
pub(in crate::http) fn panicked(cause: Box<dyn Any + Send>) -> Response {
    let text = cause.downcast_ref::<&str>().map(ToString::to_string);
    let text = text.or_else(|| cause.downcast_ref::<String>().cloned()).unwrap_or_default();
    Problem::internal(format!("a handler panicked: {text}")).into_response()
}

/// The answer for an unknown address.
pub(in crate::http) async fn route_unknown(uri: Uri) -> Problem {
    let detail =
        format!("there is no resource at {}; the addresses are listed in /openapi.json and at /docs", uri.path());
    Problem::new(Code::RouteUnknown, detail)
}

/// The answer for a method that the address does not support.
pub(in crate::http) async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    let detail = format!("{} does not take {method}; the header Allow says what it takes", uri.path());
    Problem::new(Code::MethodNotAllowed, detail)
}

/// Checks before the address is looked up. The permit is kept until the answer is complete.
fn check(app: &App, request: &Request) -> Result<Option<OwnedSemaphorePermit>, Problem> {
    refuse_size(app, request)?;
    refuse_transfer_coding(request.headers())?;
    same_origin::check(&app.hosts, request)?;
    admit(app, request)
}

/// Only chunked transfer coding is decoded; a body that is also compressed would be stored in compressed form.
fn refuse_transfer_coding(headers: &HeaderMap) -> Result<(), Problem> {
    let chunked = |value: &HeaderValue| value.as_bytes().trim_ascii().eq_ignore_ascii_case(b"chunked");
    let mut codings = headers.get_all(header::TRANSFER_ENCODING).iter();
    let Some(other) = codings.find(|value| !chunked(value)) else { return Ok(()) };
    let coding = String::from_utf8_lossy(other.as_bytes()).into_owned();
    let detail = format!(
        "the header Transfer-Encoding: {coding} names a coding that is not decoded; send the body as it is or in chunks, and \
         name what it is packed with in Content-Encoding: gzip or zstd"
    );
    Err(Problem::new(Code::TransferCodingUnsupported, detail).with("transfer_encoding", coding))
}

fn sane_id(headers: &HeaderMap) -> Option<String> {
    let text = headers.get(&REQUEST_ID)?.to_str().ok()?;
    let sane = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.' | b':');
    (!text.is_empty() && text.len() <= REQUEST_ID_CHARACTERS_MAX && text.bytes().all(sane)).then(|| text.to_owned())
}

fn refuse_size(app: &App, request: &Request) -> Result<(), Problem> {
    let wide = |length: usize| u64::try_from(length).unwrap_or(u64::MAX);
    let url_bytes = wide(request.uri().path_and_query().map_or(0, |part| part.as_str().len()));
    let (url_max, header_max) = (app.limits.url_bytes_max, app.limits.header_bytes_max);
    if url_bytes > url_max {
        let detail = format!("the address has {url_bytes} bytes, at most {url_max} are allowed; shorten the query");
        return Err(Problem::new(Code::UrlTooLong, detail).with("url_bytes", url_bytes).with("url_bytes_max", url_max));
    }
    let header_bytes: u64 =
        request.headers().iter().map(|(name, value)| wide(name.as_str().len() + value.len() + 4)).sum();
    if header_bytes > header_max {
        let detail = format!("the header lines have {header_bytes} bytes, at most {header_max} are allowed");
        return Err(Problem::new(Code::HeadersTooLarge, detail)
            .with("header_bytes", header_bytes)
            .with("header_bytes_max", header_max));
    }
    Ok(())
}

/// The problem of an answer; an error status without a problem is an internal failure.
fn problem_of(response: &Response) -> Option<Problem> {
    let status = response.status();
    let known = response.extensions().get::<Problem>().cloned();
    let is_error = status.is_client_error() || status.is_server_error();
    known.or_else(|| is_error.then(|| Problem::internal(format!("a layer answered {status} without a problem"))))
}

fn finish(response: Response, problem: Option<Problem>, request_id: &str) -> Response {
    let mut response = match problem {
        None => response,
        Some(problem) => {
            let mut rendered = problem.render(request_id);
            if let Some(allow) = response.headers().get(header::ALLOW) {
                rendered.headers_mut().insert(header::ALLOW, allow.clone());
            }
            rendered
        }
    };
    let headers = response.headers_mut();
    if let Ok(id) = HeaderValue::from_str(request_id) {
        headers.insert(REQUEST_ID, id);
    }
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(NO_CONTENT);
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

/// Facts about a request for the log and the counters.
struct Asked {
    method: Method,
    path: String,
    /// The route pattern, not the address, so that each route has one series.
    route: String,
    is_reserved: bool,
}

/// Routes that are polled; their successful requests are logged at debug level only.
const POLLED: [&str; 4] = ["/v1/status", "/health/live", "/health/ready", "/metrics"];

impl Asked {
    fn of(request: &Request) -> Self {
        let route = request.extensions().get::<MatchedPath>().map_or("none", |path| path.as_str()).to_owned();
        let is_reserved = ConnectionInfo::of(request.extensions()).reserved;
        Self { method: request.method().clone(), path: request.uri().path().to_owned(), route, is_reserved }
    }

    /// Writes one line per request: the request, the status, the duration.
    fn log(&self, status: StatusCode, duration_ms: f64, request_id: &str, problem: Option<&Problem>) {
        let Self { method, path, route, .. } = self;
        let status = status.as_u16();
        match problem.map(|problem| (problem.code().name(), problem.log())) {
            Some((code, Some(cause))) => tracing::error!(
                %method, path, status, duration_ms, request_id, code, cause, "{method} {path} {status}: {cause}"
            ),
            // Many refused connections must not fill the log as well.
            Some((code, None)) if self.is_reserved && code == Code::Busy.name() => {
                tracing::debug!(%method, path, status, duration_ms, request_id, code, "{method} {path} {status} {code}");
            }
            Some((code, None)) => {
                tracing::info!(%method, path, status, duration_ms, request_id, code, "{method} {path} {status} {code}");
            }
            None if POLLED.contains(&route.as_str()) => {
                tracing::debug!(%method, path, status, duration_ms, request_id, "{method} {path} {status}");
            }
            None => tracing::info!(%method, path, status, duration_ms, request_id, "{method} {path} {status}"),
        }
    }
}

const LEASE_ID: HeaderName = HeaderName::from_static("lease-id");
const LEASE_PARAMETER: &str = "lease_id=";
/// Seconds until a retry is useful.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Admits a request; a health check on a reserved connection keeps the permit until it is answered, so that health checks
/// cannot take all reserved places from stops.
///
/// # Errors
/// [`Code::Busy`] for a request that is not urgent on a reserved connection.
pub(in crate::http) fn admit(app: &App, request: &Request) -> Result<Option<OwnedSemaphorePermit>, Problem> {
    let Some(reservation) = request.extensions().get::<Reservation>() else { return Ok(None) };
    let permit = match is_stop(request) || holds_lease(app, request) {
        true => None,
        false if request.uri().path().starts_with("/health/") => {
            Some(Arc::clone(&app.health_places).try_acquire_owned().map_err(|_| busy(app))?)
        }
        false => return Err(busy(app)),
    };
    reservation.keep();
    Ok(permit)
}

pub(in crate::http) fn is_stop(request: &Request) -> bool {
    request.method() == Method::POST && request.uri().path() == "/v1/cell/stop"
}

/// Whether the header or the query contains the id of the current lease. The body is not examined: reading it would mean
/// waiting for the client.
pub(in crate::http) fn holds_lease(app: &App, request: &Request) -> bool {
    let in_header = request.headers().get(&LEASE_ID).and_then(|id| id.to_str().ok());
    let mut parameters = request.uri().query().unwrap_or_default().split('&');
    let in_query = parameters.find_map(|parameter| parameter.strip_prefix(LEASE_PARAMETER));
    [in_header, in_query].into_iter().flatten().any(|id| app.service.operating.holds_lease(id))
}

pub(in crate::http) fn busy(app: &App) -> Problem {
    let (connections_max, percent) = (app.limits.connections_max, app.limits.peer_share_percent);
    let detail = format!(
        "all {connections_max} connections are open, or {percent} % of them by this address (limits.connections_max, \
         limits.peer_share_percent); close those that are not needed and send this again. Stop, health checks and requests \
         that name the held lease in the header Lease-Id or the query are answered all the same"
    );
    Problem::new(Code::Busy, detail)
        .with("connections_max_count", connections_max)
        .with("peer_share_percent", percent)
        .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_reported_to_the_client_without_its_message() {
        let response = panicked(Box::new("the secret".to_owned()));
        let problem = problem_of(&response).expect("a problem");
        assert_eq!((problem.code(), problem.log()), (Code::Internal, Some("a handler panicked: the secret")));
        let response = finish(response, Some(problem), "line-7");
        assert_eq!(response.status(), StatusCode::INTERNAL_SERVER_ERROR);
        assert_eq!(response.headers()[&REQUEST_ID], "line-7");
    }

    #[test]
    fn an_error_of_another_layer_becomes_a_problem() {
        let response = StatusCode::SERVICE_UNAVAILABLE.into_response();
        assert_eq!(problem_of(&response).map(|problem| problem.code()), Some(Code::Internal));
        assert_eq!(problem_of(&StatusCode::OK.into_response()), None);
    }
}
