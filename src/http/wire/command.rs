//! Common parts of requests to the cell: the lease id in header, query or body, a bounded wait, and the answer for a new resource.

use super::body::header_text;
use super::extract::{optional_json, query};
use super::problem::{Code, Problem};
use crate::http::app::App;
use axum::extract::{FromRequest, Request};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use std::time::Duration;
use utoipa::{IntoParams, ToSchema};

const LEASE_ID: HeaderName = HeaderName::from_static("lease-id");
pub(in crate::http) const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");

/// Maximum wait, seconds.
const WAIT_MAX_S: u8 = 60;

/// The lease id of a command that has no other parameters.
#[derive(Debug)]
pub(in crate::http) struct CommandLease(pub(in crate::http) String);

impl FromRequest<App> for CommandLease {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        let LeaseQuery { lease_id: in_query } = query(&parts)?;
        let LeaseBody { lease_id: in_body } = optional_json(&parts, body, app).await?;
        lease_id(app, [in_body, in_query], &parts.headers).map(Self)
    }
}

/// The lease in the query.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct LeaseQuery {
    /// The same as the header `Lease-Id`.
    pub(in crate::http) lease_id: Option<String>,
}

/// The lease in the body.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = LeaseReference, example = json!({"lease_id": "l-0199f0c8-0000-7000-8000-000000000000"}))]
pub(in crate::http) struct LeaseBody {
    /// The same as the header `Lease-Id`.
    pub(in crate::http) lease_id: Option<String>,
}

/// The lease id of a command, from any of its possible locations.
///
/// # Errors
/// [`Code::CellAbsent`] if there is no cell, [`Code::LeaseRequired`] if the command contains no lease id, [`Code::OptionInvalid`]
/// if it contains two.
pub(in crate::http) fn lease_id(app: &App, said: [Option<String>; 2], headers: &HeaderMap) -> Result<String, Problem> {
    app.service.operating.cell_config()?;
    named_lease(said, headers)?.ok_or_else(|| {
        let detail = "this needs the lease: POST /v1/cell/lease, then name it by the header Lease-Id or by lease_id";
        Problem::new(Code::LeaseRequired, detail)
    })
}

/// The lease id of a request, if it contains one.
///
/// # Errors
/// [`Code::OptionInvalid`] if it contains two.
pub(in crate::http) fn named_lease(said: [Option<String>; 2], headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let mut named: Vec<String> = said.into_iter().chain([header_text(headers, &LEASE_ID)?]).flatten().collect();
    named.dedup();
    let one = named.pop();
    if named.is_empty() {
        return Ok(one);
    }
    let detail = "the header Lease-Id, the query and the body name different leases; send one of them";
    Err(Problem::new(Code::OptionInvalid, detail).with("field", "lease_id"))
}

/// How long to wait for an end.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct WaitQuery {
    /// How long to wait for the end, in seconds; the answer comes at the end or after this time, whichever is first.
    #[param(value_type = Option<u8>, minimum = 0, maximum = 60)]
    pub(in crate::http) wait_s: Option<WaitSeconds>,
}

/// A wait that is asked for, in whole seconds.
#[derive(Debug, Clone, Copy)]
pub(in crate::http) struct WaitSeconds(u8);

impl<'de> Deserialize<'de> for WaitSeconds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let seconds = text.parse().ok().filter(|seconds| *seconds <= WAIT_MAX_S);
        seconds.map(Self).ok_or_else(|| D::Error::custom(format!("must be a whole number from 0 to {WAIT_MAX_S}")))
    }
}

/// The requested wait; zero by default.
pub(in crate::http) fn wait(asked: Option<WaitSeconds>) -> Duration {
    Duration::from_secs(asked.map_or(0, |WaitSeconds(seconds)| seconds.into()))
}

/// The answer for a resource that was created now (201) or by an earlier equal request (200), with its address.
///
/// # Errors
/// If the address is not a valid header, which does not happen for addresses of this service.
pub(in crate::http) fn made<T: Serialize>(address: &str, replayed: bool, document: T) -> Result<Response, Problem> {
    let location = HeaderValue::from_str(address).map_err(|error| Problem::internal(error.to_string()))?;
    let body = axum::Json(document);
    Ok(match replayed {
        true => {
            let replay = (REPLAYED, HeaderValue::from_static("true"));
            (StatusCode::OK, [(header::LOCATION, location), replay], body).into_response()
        }
        false => (StatusCode::CREATED, [(header::LOCATION, location)], body).into_response(),
    })
}
