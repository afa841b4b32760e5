//! The two manipulators: their states, and their commands enable, disable and home.

use super::cell::TakenDocument;
use crate::cell::Manual;
use crate::config;
use crate::device::{AxisReading, AxisState, CommandResult, Mode, Reading};
use crate::http::app::App;
use crate::http::wire::command::{CommandLease, LeaseBody, LeaseQuery};
use crate::http::wire::extract::{NoQuery, Path};
use crate::http::wire::numbers::{carrier, degrees, rounded};
use crate::http::wire::problem::{Code, Problem};
use crate::motion::{Axis, Carrier};
use crate::service::CellView;
use axum::Json;
use axum::extract::{FromRequestParts, State};
use axum::http::request::Parts;
use serde::Serialize;
use utoipa::ToSchema;

/// Both manipulators.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct ManipulatorList {
    /// The one at the smaller x first.
    manipulators: Vec<ManipulatorDocument>,
}

/// A manipulator at one moment.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Manipulator)]
pub(in crate::http) struct ManipulatorDocument {
    /// `m1` or `m2`.
    id: &'static str,
    /// `connecting`, `up`, `lost`.
    link: &'static str,
    /// `good`, `stale`, `lost`.
    quality: &'static str,
    /// Age of its last reading; null if it never answered.
    age_ms: Option<u64>,
    /// Where its clamp's centre is in the rail frame while all axes are at zero: x, y, z.
    mount_mm: [f64; 3],
    /// Its last reading; null if it never answered.
    reading: Option<ReadingDocument>,
}

/// The reading of a manipulator.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Reading)]
pub(in crate::http) struct ReadingDocument {
    /// `disabled`, `standstill`, `homing`, `discrete_motion`, `continuous_motion`, `synchronized_motion`, `stopping`,
    /// `error_stop`.
    #[schema(value_type = String, example = "standstill")]
    state: AxisState,
    /// `off`, `manual`, `automatic`.
    #[schema(value_type = String, example = "automatic")]
    mode: Mode,
    /// The emergency stop is not pressed.
    emergency_stop_ok: bool,
    /// The guard is closed.
    guard_closed: bool,
    /// The drives are ready.
    drives_ready: bool,
    /// It takes commands from us.
    remote_enabled: bool,
    /// Its own fault code; 0 is none.
    fault_code: u32,
    /// Number of the newest command that it has seen.
    acknowledged_sequence: u16,
    /// The outcome of that command.
    #[schema(value_type = String, example = "done")]
    acknowledged_result: CommandResult,
    /// Along the rail.
    x: LinearAxisDocument,
    /// Across.
    y: LinearAxisDocument,
    /// Up.
    z: LinearAxisDocument,
    /// The turn.
    c: TurnAxisDocument,
}

/// How an axis is, but for its numbers.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = AxisFlags)]
pub(in crate::http) struct FlagsDocument {
    /// Its current activity.
    #[schema(value_type = String, example = "standstill")]
    state: AxisState,
    /// Its reference is known.
    homed: bool,
    /// It is at its target.
    in_position: bool,
    /// It has a fault.
    fault: bool,
    /// It stands at a limit.
    limit_hit: bool,
}

/// A linear axis.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = LinearAxis)]
pub(in crate::http) struct LinearAxisDocument {
    /// Where it is.
    actual_mm: f64,
    /// Where it is told to be.
    commanded_mm: f64,
    /// Lower limit: the narrower of the device's and the configuration's.
    lower_mm: f64,
    /// Upper limit.
    upper_mm: f64,
    /// Longest way of one request.
    step_mm: f64,
    /// Greatest speed: the smaller of the device's and the configuration's.
    speed_mm_s: f64,
    /// How it is.
    #[serde(flatten)]
    flags: FlagsDocument,
}

/// The turning axis.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = TurnAxis)]
pub(in crate::http) struct TurnAxisDocument {
    /// Where it is.
    actual_deg: f64,
    /// Where it is told to be.
    commanded_deg: f64,
    /// Lower limit: the narrower of the device's and the configuration's.
    lower_deg: f64,
    /// Upper limit.
    upper_deg: f64,
    /// Longest way of one request.
    step_deg: f64,
    /// Greatest speed: the smaller of the device's and the configuration's.
    speed_deg_s: f64,
    /// How it is.
    #[serde(flatten)]
    flags: FlagsDocument,
}

/// The manipulator in the path.
pub(in crate::http) struct Chosen(Carrier);

impl<S: Send + Sync> FromRequestParts<S> for Chosen {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Path(id) = Path::<String>::from_request_parts(parts, state).await?;
        carrier(&id).map(Self).ok_or_else(|| {
            Problem::new(Code::ManipulatorUnknown, format!("there is no manipulator {id}; there are m1 and m2"))
                .with("manipulator", id)
        })
    }
}

/// List the manipulators
///
/// Both, each with its last reading.
#[utoipa::path(
    get, path = "/v1/manipulators", tag = "manipulators",
    responses((status = 200, description = "Both manipulators", body = ManipulatorList))
)]
pub(in crate::http) async fn list_manipulators(
    State(app): State<App>,
    _: NoQuery,
) -> Result<Json<ManipulatorList>, Problem> {
    let (view, config) = (app.service.operating.cell_view()?, app.service.operating.cell_config()?);
    let manipulators = Carrier::ALL.into_iter().map(|carrier| document(carrier, &view, config)).collect();
    Ok(Json(ManipulatorList { manipulators }))
}

/// Get a manipulator
///
/// Positions, limits and states of the last reading, with their age.
#[utoipa::path(
    get, path = "/v1/manipulators/{id}", tag = "manipulators",
    params(("id" = String, Path, description = "`m1` or `m2`")),
    responses((status = 200, description = "The manipulator", body = ManipulatorDocument))
)]
pub(in crate::http) async fn get_manipulator(
    State(app): State<App>,
    Chosen(carrier): Chosen,
    _: NoQuery,
) -> Result<Json<ManipulatorDocument>, Problem> {
    let (view, config) = (app.service.operating.cell_view()?, app.service.operating.cell_config()?);
    Ok(Json(document(carrier, &view, config)))
}

/// Enable a manipulator
///
/// Puts its drives under control; it stays where it is.
#[utoipa::path(
    post, path = "/v1/manipulators/{id}/enable", tag = "manipulators",
    params(("id" = String, Path, description = "`m1` or `m2`"),
        ("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "It is being done, or it was so", body = TakenDocument))
)]
pub(in crate::http) async fn enable_manipulator(
    State(app): State<App>,
    Chosen(carrier): Chosen,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<TakenDocument>, Problem> {
    Ok(Json(app.service.operating.command_manipulator(lease_id, carrier, Manual::Enable).await?.into()))
}

/// Disable a manipulator
///
/// Takes its drives out of control; brakes hold it.
#[utoipa::path(
    post, path = "/v1/manipulators/{id}/disable", tag = "manipulators",
    params(("id" = String, Path, description = "`m1` or `m2`"),
        ("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "It is being done, or it was so", body = TakenDocument))
)]
pub(in crate::http) async fn disable_manipulator(
    State(app): State<App>,
    Chosen(carrier): Chosen,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<TakenDocument>, Problem> {
    Ok(Json(app.service.operating.command_manipulator(lease_id, carrier, Manual::Disable).await?.into()))
}

/// Home a manipulator
///
/// Finds the reference of all its axes. This may move it; the cell is `moving` meanwhile.
#[utoipa::path(
    post, path = "/v1/manipulators/{id}/home", tag = "manipulators",
    params(("id" = String, Path, description = "`m1` or `m2`"),
        ("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses((status = 200, description = "It is being done, or it was so", body = TakenDocument))
)]
pub(in crate::http) async fn home_manipulator(
    State(app): State<App>,
    Chosen(carrier): Chosen,
    CommandLease(lease_id): CommandLease,
) -> Result<Json<TakenDocument>, Problem> {
    Ok(Json(app.service.operating.command_manipulator(lease_id, carrier, Manual::Home).await?.into()))
}

fn document(carrier: Carrier, view: &CellView, config: &config::Cell) -> ManipulatorDocument {
    let live = view.snapshot.manipulators.get(carrier);
    let own = config.manipulators.get(carrier);
    let age_ms = live.age(view.now()).map(|age| u64::try_from(age.as_millis()).unwrap_or(u64::MAX));
    ManipulatorDocument {
        id: carrier.name(),
        link: live.link.name(),
        quality: live.quality(view.now()).name(),
        age_ms,
        mount_mm: own.mount_mm,
        reading: live.reading.as_ref().map(|reading| reading_document(reading, &own.limits)),
    }
}

fn reading_document(reading: &Reading, limits: &config::SupportLimits) -> ReadingDocument {
    let axes = &reading.axes;
    ReadingDocument {
        state: reading.state,
        mode: reading.mode,
        emergency_stop_ok: reading.safety.emergency_stop_ok,
        guard_closed: reading.safety.guard_closed,
        drives_ready: reading.safety.drives_ready,
        remote_enabled: reading.safety.remote_enabled,
        fault_code: reading.fault_code,
        acknowledged_sequence: reading.acknowledged.sequence,
        acknowledged_result: reading.acknowledged.result,
        x: linear(axes.get(Axis::X), &limits.x),
        y: linear(axes.get(Axis::Y), &limits.y),
        z: linear(axes.get(Axis::Z), &limits.z),
        c: turn(axes.get(Axis::C), &limits.c),
    }
}

fn linear(axis: &AxisReading, limits: &config::LinearLimits) -> LinearAxisDocument {
    LinearAxisDocument {
        actual_mm: rounded(axis.actual),
        commanded_mm: rounded(axis.commanded),
        lower_mm: rounded(axis.lower.max(limits.lower_mm)),
        upper_mm: rounded(axis.upper.min(limits.upper_mm)),
        step_mm: limits.step_mm,
        speed_mm_s: rounded(axis.speed.min(limits.speed_mm_s)),
        flags: flags(axis),
    }
}

fn turn(axis: &AxisReading, limits: &config::TurnLimits) -> TurnAxisDocument {
    TurnAxisDocument {
        actual_deg: degrees(axis.actual),
        commanded_deg: degrees(axis.commanded),
        lower_deg: degrees(axis.lower).max(limits.lower_deg),
        upper_deg: degrees(axis.upper).min(limits.upper_deg),
        step_deg: limits.step_deg,
        speed_deg_s: degrees(axis.speed).min(limits.speed_deg_s),
        flags: flags(axis),
    }
}

const fn flags(axis: &AxisReading) -> FlagsDocument {
    FlagsDocument {
        state: axis.state,
        homed: axis.homed,
        in_position: axis.in_position,
        fault: axis.fault,
        limit_hit: axis.limit_hit,
    }
}
