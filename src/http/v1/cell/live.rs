//! The present state of the cell: its job, its latched faults, the state of each device, and whether motion is possible.

use super::plc::PlcCellDocument;
use crate::cell::{Fault, LeaseView, Live, Refusal};
use crate::device::{SensorReading, StageReading};
use crate::http::app::App;
use crate::http::wire::extract::Query;
use crate::http::wire::names::View;
use crate::http::wire::numbers::{ms, rounded};
use crate::http::wire::problem::Problem;
use crate::service::CellView;
use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// The cell at one moment.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Cell)]
pub(in crate::http) struct CellDocument {
    /// `offline`, `idle`, `scanning`, `moving`, `stopping`, `faulted`.
    #[schema(example = "idle")]
    state: &'static str,
    /// Since when, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    since_at: Timestamp,
    /// Grows with every change.
    sequence: u64,
    /// The move or the measurement under way; null where there is none.
    job: Option<JobDocument>,
    /// Who may move; null where nobody holds the lease. The id of the lease is its holder's alone.
    lease: Option<LeaseViewDocument>,
    /// Whether a move by the holder of the lease would be begun.
    commands_allowed: bool,
    /// Why not; all reasons, the most urgent first.
    reasons: Vec<ReasonDocument>,
    /// Latched until a reset, oldest first.
    faults: Vec<FaultDocument>,
    /// A reset was accepted, and the devices are being read.
    resetting: bool,
    /// How well each device is known.
    devices: Vec<DeviceDocument>,
    /// The linear stage; null where there is none, or it never answered.
    stage: Option<StageDocument>,
    /// The profile sensor; null where there is none, or it never answered.
    sensor: Option<SensorDocument>,
}

/// A job under way.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = CellJob)]
pub(in crate::http) struct JobDocument {
    /// Id of the move (`v-`) or of the measurement (`m-`).
    id: String,
    /// 0 to 1.
    progress: f64,
}

/// The lease as everybody may see it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LeaseView)]
pub(in crate::http) struct LeaseViewDocument {
    /// Who holds it.
    pub(in crate::http) holder: String,
    /// Goes to the devices with every command.
    pub(in crate::http) fence: u64,
    /// How long it lasts unless it is used.
    pub(in crate::http) remaining_ms: u64,
    /// When it ends unless it is used, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    pub(in crate::http) until_at: Timestamp,
}

/// A reason, for programs and for people.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = CellReason)]
pub(in crate::http) struct ReasonDocument {
    /// One of the problem codes.
    code: &'static str,
    /// A description of the fault.
    text: String,
}

/// A fault that is latched.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Fault)]
pub(in crate::http) struct FaultDocument {
    /// A short word.
    #[schema(example = "link_lost")]
    code: &'static str,
    /// The device.
    device: String,
    /// What happened.
    text: String,
    /// When, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    at: Timestamp,
}

/// How well a device is known.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Device)]
pub(in crate::http) struct DeviceDocument {
    /// `m1`, `m2`, `stage`, `sensor`.
    id: &'static str,
    /// Its name in the adaptor.
    name: String,
    /// `connecting`, `up`, `lost`.
    link: &'static str,
    /// `good`, `stale`, `lost`.
    quality: &'static str,
    /// Age of its last reading; null if it never answered.
    age_ms: Option<u64>,
}

/// The linear stage.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Stage)]
pub(in crate::http) struct StageDocument {
    /// Where it is, along the rail.
    actual_mm: f64,
    /// Its lower limit.
    lower_mm: f64,
    /// Its upper limit.
    upper_mm: f64,
    /// Its greatest speed.
    speed_mm_s: f64,
    /// It moves.
    moves: bool,
    /// It is at its target.
    in_position: bool,
    /// Its own fault code; 0 is none.
    fault_code: u32,
}

/// The profile sensor.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Sensor)]
pub(in crate::http) struct SensorDocument {
    /// As it gives it.
    model: String,
    /// As it gives it.
    serial: String,
    /// As it gives it.
    firmware: String,
    /// It takes profiles.
    running: bool,
    /// Where it says so.
    temperature_c: Option<f64>,
}

/// How the cell is shown.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct CellQuery {
    /// `plc` gives integers in one flat object below 1024 bytes.
    #[param(inline)]
    view: Option<View>,
}

/// The cell, whole or for a PLC.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
#[schema(as = ShownCell)]
pub(in crate::http) enum Shown {
    /// Whole.
    Full(Box<CellDocument>),
    /// For a PLC.
    Plc(Box<PlcCellDocument>),
}

/// Get the cell
///
/// Its state, who may move, the latched fault, how well each device is known, and whether a move would be begun, with the
/// reasons why not. With `?view=plc` integers in one flat object below 1024 bytes.
#[utoipa::path(
    get, path = "/v1/cell", tag = "cell", params(CellQuery),
    responses((status = 200, description = "The cell", body = Shown))
)]
pub(in crate::http) async fn get_cell(
    State(app): State<App>,
    Query(query): Query<CellQuery>,
) -> Result<Json<Shown>, Problem> {
    let view = app.service.operating.cell_view()?;
    Ok(Json(match query.view.unwrap_or(View::Full) {
        View::Full => Shown::Full(Box::new(CellDocument::from(&view))),
        View::Plc => Shown::Plc(Box::new(PlcCellDocument::from(&view))),
    }))
}

impl From<&CellView> for CellDocument {
    fn from(view: &CellView) -> Self {
        let cell = &view.snapshot;
        let mut devices = vec![device("m1", &cell.manipulators.m1, view), device("m2", &cell.manipulators.m2, view)];
        devices.extend(cell.stage.as_ref().map(|stage| device("stage", stage, view)));
        devices.extend(cell.sensor.as_ref().map(|sensor| device("sensor", sensor, view)));
        Self {
            state: cell.state.name(),
            since_at: view.wall(cell.since),
            sequence: cell.sequence,
            job: cell.job.as_ref().map(|job| JobDocument {
                id: job.id.clone(),
                progress: rounded(view.progress.unwrap_or(job.progress)),
            }),
            lease: cell.lease.as_ref().map(|lease| lease_view(lease, view)),
            commands_allowed: cell.commands_allowed,
            reasons: cell.reasons.iter().map(reason).collect(),
            faults: cell.faults.iter().map(|latched| fault(latched, view)).collect(),
            resetting: cell.resetting,
            devices,
            stage: cell.stage.as_ref().and_then(|stage| stage.reading.as_ref()).map(StageDocument::from),
            sensor: cell.sensor.as_ref().and_then(|sensor| sensor.reading.as_ref()).map(SensorDocument::from),
        }
    }
}

/// A refusal in short, with the code that a request would get.
fn reason(refusal: &Refusal) -> ReasonDocument {
    ReasonDocument { code: Problem::from(refusal.clone()).code().name(), text: refusal.to_string() }
}

pub(in crate::http) fn lease_view(lease: &LeaseView, view: &CellView) -> LeaseViewDocument {
    LeaseViewDocument {
        holder: lease.holder.clone(),
        fence: lease.fence,
        remaining_ms: ms(view.until(lease.until)),
        until_at: view.wall(lease.until),
    }
}

fn fault(fault: &Fault, view: &CellView) -> FaultDocument {
    FaultDocument {
        code: fault.failure.code(),
        device: fault.device.clone(),
        text: fault.failure.to_string(),
        at: view.wall(fault.at),
    }
}

fn device<R>(id: &'static str, live: &Live<R>, view: &CellView) -> DeviceDocument {
    DeviceDocument {
        id,
        name: live.name.clone(),
        link: live.link.name(),
        quality: live.quality(view.now()).name(),
        age_ms: live.age(view.now()).map(ms),
    }
}

impl From<&StageReading> for StageDocument {
    fn from(reading: &StageReading) -> Self {
        let StageReading { actual_mm, lower_mm, upper_mm, speed_mm_s, moves, in_position, fault_code } = *reading;
        Self {
            actual_mm: rounded(actual_mm),
            lower_mm: rounded(lower_mm),
            upper_mm: rounded(upper_mm),
            speed_mm_s: rounded(speed_mm_s),
            moves,
            in_position,
            fault_code,
        }
    }
}

impl From<&SensorReading> for SensorDocument {
    fn from(reading: &SensorReading) -> Self {
        let SensorReading { model, serial, firmware, running, temperature_c } = reading.clone();
        Self { model, serial, firmware, running, temperature_c }
    }
}
