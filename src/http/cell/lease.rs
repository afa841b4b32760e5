//! The lease: who may move, for how long; renewed by use or by asking again, given back, seen by everybody.

use super::super::app::App;
use super::super::command::{CommandLease, LeaseBody, LeaseQuery, named_lease};
use super::super::extract::{NoQuery, OptionalJson, Query};
use super::super::problem::Problem;
use super::live::{LeaseViewDocument, lease_view, ms};
use crate::service::HeldLease;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use utoipa::ToSchema;

/// Who wants to move, or goes on.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = LeaseRequest, example = json!({"holder": "line 3", "ttl_s": 60}))]
pub(in super::super) struct LeaseRequestDocument {
    /// Who asks, for others to read; `anonymous` where nothing is said.
    #[schema(min_length = 1, max_length = 64)]
    holder: Option<String>,
    /// How long it lasts unless it is used or renewed, in seconds: by default 5, at least 1 and at most 60; the configuration
    /// (cell.lease) may say otherwise.
    #[schema(minimum = 0.1, maximum = 600.0)]
    ttl_s: Option<f64>,
    /// Renews this lease instead of taking a new one.
    lease_id: Option<String>,
}

/// A lease as its holder is told.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Lease)]
pub(in super::super) struct LeaseDocument {
    /// Names the lease in every command. Keep it to yourself.
    #[schema(example = "l-0199f0c8-0000-7000-8000-000000000000")]
    lease_id: String,
    /// Who holds it.
    holder: String,
    /// Goes to the devices with every command; greater than that of every lease before.
    fence: u64,
    /// How long it lasts after each use.
    ttl_ms: u64,
    /// When it ends unless it is used, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::times::time")]
    until_at: Timestamp,
}

/// Who may move.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LeaseState)]
pub(in super::super) struct LeaseStateDocument {
    /// The lease; null where nobody holds it.
    lease: Option<LeaseViewDocument>,
}

impl From<HeldLease> for LeaseDocument {
    fn from(lease: HeldLease) -> Self {
        let HeldLease { id, holder, fence, time_to_live, until_at } = lease;
        Self { lease_id: id, holder, fence, ttl_ms: ms(time_to_live), until_at }
    }
}

/// Take or renew the lease
///
/// Moving needs it. It runs out unless it is used or renewed; what it moves stops then. With `lease_id` (or the header
/// `Lease-Id`) it is renewed as it was taken, with status 200: `holder` and `ttl_s` change nothing then. While somebody else holds it the answer is 423.
#[utoipa::path(
    post, path = "/v1/cell/lease", tag = "cell",
    params(("Lease-Id" = Option<String>, Header, description = "Renews this lease"), LeaseQuery),
    request_body(content = Option<LeaseRequestDocument>, description = "Who asks; may be left out"),
    responses(
        (status = 201, description = "Taken", body = LeaseDocument),
        (status = 200, description = "Renewed", body = LeaseDocument),
    )
)]
pub(in super::super) async fn take_lease(
    State(app): State<App>,
    Query(query): Query<LeaseQuery>,
    headers: HeaderMap,
    OptionalJson(body): OptionalJson<LeaseRequestDocument>,
) -> Result<Response, Problem> {
    app.service.cell_config()?;
    let LeaseRequestDocument { holder, ttl_s, lease_id: said } = body;
    let time_to_live = ttl_s.map(time_to_live);
    // Also where the lease is renewed, which changes nothing about it: a mistake is better told.
    time_to_live.map(|asked| app.service.check_time_to_live(asked)).transpose()?;
    if let Some(id) = named_lease([said, query.lease_id], &headers)? {
        let lease = app.service.renew_lease(&id).await?;
        return Ok(Json(LeaseDocument::from(lease)).into_response());
    }
    let lease = app.service.take_lease(holder.unwrap_or_else(|| "anonymous".to_owned()), time_to_live).await?;
    Ok((StatusCode::CREATED, Json(LeaseDocument::from(lease))).into_response())
}

/// See who holds the lease
///
/// Without its id, which is its holder's alone.
#[utoipa::path(
    get, path = "/v1/cell/lease", tag = "cell",
    responses((status = 200, description = "Who may move", body = LeaseStateDocument))
)]
pub(in super::super) async fn get_lease(
    State(app): State<App>,
    _: NoQuery,
) -> Result<Json<LeaseStateDocument>, Problem> {
    let view = app.service.cell_view()?;
    let lease = view.snapshot.lease.as_ref().map(|lease| lease_view(lease, &view));
    Ok(Json(LeaseStateDocument { lease }))
}

/// Give the lease back
///
/// What it moves stops.
#[utoipa::path(
    delete, path = "/v1/cell/lease", tag = "cell",
    params(("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "Given back", body = LeaseStateDocument))
)]
pub(in super::super) async fn release_lease(
    State(app): State<App>,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<LeaseStateDocument>, Problem> {
    app.service.release_lease(&lease_id).await?;
    Ok(Json(LeaseStateDocument { lease: None }))
}

/// What is no duration is beyond every bound; the service knows the bounds that hold, and refuses it.
fn time_to_live(ttl_s: f64) -> Duration {
    let beyond = if ttl_s > 0.0 { Duration::MAX } else { Duration::ZERO };
    Duration::try_from_secs_f64(ttl_s).unwrap_or(beyond)
}
