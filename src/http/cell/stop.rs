//! Stop, which is always taken, and reset, which lets things move again.

use super::super::app::App;
use super::super::command::{CommandLease, LeaseBody, LeaseQuery};
use super::super::problem::Problem;
use super::live::ms;
use crate::cell::{StopReport, Taken};
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// What a stop is, and is not.
const NOTE: &str =
    "operational stop (category 2): the drives hold under power. It is no emergency stop and no safety function";

/// What a stop has brought about by the time of the answer; it goes on after it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StopReport)]
pub(in super::super) struct StopDocument {
    /// Time until the halt was handed to the last device that was reached.
    sent_ms: u64,
    /// Every device was seen at rest after the halt, and the sensor's laser off.
    confirmed: bool,
    /// Each device; the sensor's laser is switched off.
    devices: Vec<DeviceStopDocument>,
    /// Axes that were not seen at rest yet, such as `m1.x`; take them for moving. GET /v1/cell tells the rest.
    unconfirmed_axes: Vec<String>,
    /// What this stop is, and is not.
    note: &'static str,
}

/// One device's part of it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = DeviceStop)]
pub(in super::super) struct DeviceStopDocument {
    /// What its adaptor calls it.
    name: String,
    /// The halt was handed to it.
    sent: bool,
    /// It was seen at rest after the halt.
    confirmed: bool,
}

/// What became of a command.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Taken)]
pub(in super::super) struct TakenDocument {
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
    responses((status = 200, description = "Every device was told to stop", body = StopDocument))
)]
pub(in super::super) async fn stop_cell(State(app): State<App>) -> Result<Json<StopDocument>, Problem> {
    Ok(Json(app.service.stop().await?.into()))
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
pub(in super::super) async fn reset_cell(
    State(app): State<App>,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<TakenDocument>, Problem> {
    Ok(Json(app.service.reset(lease_id).await?.into()))
}
