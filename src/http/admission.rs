//! Which requests are answered while all general places are taken: stop, health checks, and requests of the lease holder.

use super::app::App;
use super::connections::Reservation;
use super::problem::{Code, Problem};
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, Method, header};
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

const LEASE_ID: HeaderName = HeaderName::from_static("lease-id");
const LEASE_PARAMETER: &str = "lease_id=";

/// After this another try may be worth it, seconds.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Lets a request in; a health check on a reserved connection holds the permit until it is answered, so that health checks
/// cannot take all reserved places from stops.
///
/// # Errors
/// [`Code::Busy`] for what is not urgent on a reserved connection.
pub(super) fn admit(app: &App, request: &Request) -> Result<Option<OwnedSemaphorePermit>, Problem> {
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

fn is_stop(request: &Request) -> bool {
    request.method() == Method::POST && request.uri().path() == "/v1/cell/stop"
}

/// Whether the header or the query names the lease that is held. The body is not looked at: reading it would mean waiting
/// for the client.
fn holds_lease(app: &App, request: &Request) -> bool {
    let in_header = request.headers().get(&LEASE_ID).and_then(|id| id.to_str().ok());
    let mut parameters = request.uri().query().unwrap_or_default().split('&');
    let in_query = parameters.find_map(|parameter| parameter.strip_prefix(LEASE_PARAMETER));
    [in_header, in_query].into_iter().flatten().any(|id| app.service.holds_lease(id))
}

fn busy(app: &App) -> Problem {
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
