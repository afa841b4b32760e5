//! The lease: which client may move, and for how long. It is renewed by use or on request, returned, and visible to all clients.
//! Also stop, which is always accepted, and reset, which enables motion again.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::cell::{StopReport, Taken};
use crate::http::app::App;
use crate::http::wire::command::{CommandLease, LeaseBody, LeaseQuery, named_lease};
use crate::http::wire::extract::{NoQuery, OptionalJson, Query};
use crate::http::wire::numbers::ms;
use crate::http::wire::problem::Problem;
use crate::service::HeldLease;

use super::live::{LeaseViewDocument, lease_view};

/// Who wants to move, or goes on.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = LeaseRequest, example = json!({"holder": "line 3", "ttl_s": 60}))]
pub(in crate::http) struct LeaseRequestDocument {
    /// Who asks, for others to read; `anonymous` by default.
    #[schema(min_length = 1, max_length = 64)]
    holder: Option<String>,
    /// How long it lasts unless it is used or renewed, in seconds: by default 5, at least 1 and at most 60; the configuration
    /// (cell.lease) may say otherwise.
    #[schema(minimum = 0.1, maximum = 600.0)]
    ttl_s: Option<f64>,
    /// Renews this lease instead of taking a new one.
    lease_id: Option<String>,
}

/// A lease as its holder sees it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Lease)]
pub(in crate::http) struct LeaseDocument {
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
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    until_at: Timestamp,
}

/// Who may move.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LeaseState)]
pub(in crate::http) struct LeaseStateDocument {
    /// The lease; null if there is none.
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
pub(in crate::http) async fn take_lease(
    State(app): State<App>,
    Query(query): Query<LeaseQuery>,
    headers: HeaderMap,
    OptionalJson(body): OptionalJson<LeaseRequestDocument>,
) -> Result<Response, Problem> {
    app.service.operating.cell_config()?;
    let LeaseRequestDocument { holder, ttl_s, lease_id: said } = body;
    let time_to_live = ttl_s.map(time_to_live);
    // Checked also if the lease is only renewed and keeps its time to live, so that the client learns of a mistake.
    time_to_live.map(|asked| app.service.operating.check_time_to_live(asked)).transpose()?;
    if let Some(id) = named_lease([said, query.lease_id], &headers)? {
        let lease = app.service.operating.renew_lease(&id).await?;
        return Ok(Json(LeaseDocument::from(lease)).into_response());
    }
    let lease =
        app.service.operating.take_lease(holder.unwrap_or_else(|| "anonymous".to_owned()), time_to_live).await?;
    Ok((StatusCode::CREATED, Json(LeaseDocument::from(lease))).into_response())
}

/// See who holds the lease
///
/// Without its id, which is its holder's alone.
#[utoipa::path(
    get, path = "/v1/cell/lease", tag = "cell",
    responses((status = 200, description = "Who may move", body = LeaseStateDocument))
)]
pub(in crate::http) async fn get_lease(
    State(app): State<App>,
    _: NoQuery,
) -> Result<Json<LeaseStateDocument>, Problem> {
    let view = app.service.operating.cell_view()?;
    let lease = view.snapshot.lease.as_ref().map(|lease| lease_view(lease, &view));
    Ok(Json(LeaseStateDocument { lease }))
}

/// Give the lease back
///
/// A motion under this lease is stopped.
#[utoipa::path(
    delete, path = "/v1/cell/lease", tag = "cell",
    params(("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "Given back", body = LeaseStateDocument))
)]
pub(in crate::http) async fn release_lease(
    State(app): State<App>,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<LeaseStateDocument>, Problem> {
    app.service.operating.release_lease(&lease_id).await?;
    Ok(Json(LeaseStateDocument { lease: None }))
}

/// Converts seconds; an invalid value becomes one that is out of range, and the service refuses it with the allowed range.
fn time_to_live(ttl_s: f64) -> Duration {
    let beyond = if ttl_s > 0.0 { Duration::MAX } else { Duration::ZERO };
    Duration::try_from_secs_f64(ttl_s).unwrap_or(beyond)
}

/// The properties of a stop.
const NOTE: &str =
    "operational stop (category 2): the drives hold under power. It is no emergency stop and no safety function";

/// The effect of a stop by the time of the answer; the stop continues after it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StopReport)]
pub(in crate::http) struct StopDocument {
    /// Time until the halt was handed to the last device that was reached.
    sent_ms: u64,
    /// Every device was seen at rest after the halt, and the sensor's laser off.
    confirmed: bool,
    /// Each device; the sensor's laser is switched off.
    devices: Vec<DeviceStopDocument>,
    /// Axes that were not seen at rest yet, such as `m1.x`; take them for moving. GET /v1/cell has the rest.
    unconfirmed_axes: Vec<String>,
    /// What this stop is, and is not.
    note: &'static str,
}

/// One device's part of it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DeviceStop)]
pub(in crate::http) struct DeviceStopDocument {
    /// Its name in the adaptor.
    name: String,
    /// The halt was handed to it.
    sent: bool,
    /// It was seen at rest after the halt.
    confirmed: bool,
}

/// The outcome of a command.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Taken)]
pub(in crate::http) struct TakenDocument {
    /// `accepted`: it is being done, watch the state. `already_so`: nothing was to be done.
    #[schema(example = "accepted")]
    result: &'static str,
}

impl From<Taken> for TakenDocument {
    fn from(taken: Taken) -> Self {
        let result = match taken {
            Taken::Accepted => "accepted",
            Taken::AlreadySo => "already_so",
        };
        Self { result }
    }
}

impl From<StopReport> for StopDocument {
    fn from(report: StopReport) -> Self {
        let StopReport { sent_within, devices, unconfirmed } = report;
        let name = |(carrier, axis): &(crate::motion::Carrier, crate::motion::Axis)| {
            format!("{}.{}", carrier.name(), axis.name())
        };
        Self {
            sent_ms: ms(sent_within),
            confirmed: devices.iter().all(|device| device.confirmed),
            unconfirmed_axes: unconfirmed.iter().map(name).collect(),
            devices: devices
                .into_iter()
                .map(|device| DeviceStopDocument { name: device.name, sent: device.sent, confirmed: device.confirmed })
                .collect(),
            note: NOTE,
        }
    }
}

/// Stop everything
///
/// Needs no lease and no body, works in every state, overtakes everything, and may be repeated. It is an operational stop of
/// category 2, not an emergency stop. It waits for no device: the answer says what is known by then, and `unconfirmed_axes`
/// were not seen at rest yet.
#[utoipa::path(
    post, path = "/v1/cell/stop", tag = "cell",
    responses((status = 200, description = "Every device was commanded to stop", body = StopDocument))
)]
pub(in crate::http) async fn stop_cell(State(app): State<App>) -> Result<Json<StopDocument>, Problem> {
    Ok(Json(app.service.operating.stop().await?.into()))
}

/// Acknowledge the faults
///
/// Latched faults are acknowledged and every device is read; when all stand without a fault, the cell is idle. Nothing that
/// was under way is resumed.
#[utoipa::path(
    post, path = "/v1/cell/reset", tag = "cell",
    params(("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "It is being done, or nothing was to be done", body = TakenDocument))
)]
pub(in crate::http) async fn reset_cell(
    State(app): State<App>,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<TakenDocument>, Problem> {
    Ok(Json(app.service.operating.reset(lease_id).await?.into()))
}
