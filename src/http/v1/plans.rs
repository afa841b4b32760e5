//! Plans: the motion that brings a measured part to a target pose. A plan moves nothing and is executed at most once.

use super::moves::MoveDocument;
use crate::geometry::AxisLine;
use crate::http::app::App;
use crate::http::wire::body::request_id;
use crate::http::wire::command::{CommandLease, LeaseBody, LeaseQuery, made};
use crate::http::wire::extract::{Json as JsonBody, NoQuery, Path, Query};
use crate::http::wire::numbers::{
    LENGTH_MAX_MM, TILT_MAX_DEG, TURN_MAX_DEG, TravelsDocument, degrees, rounded, within,
};
use crate::http::wire::paging::{EntryDocument, PageQuery, listed};
use crate::http::wire::problem::Problem;
use crate::motion::PartPose;
use crate::service::{Entry, PlanInList, PlanRequest, StoredPlan, Target};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// From where a measurement found the part to where it is wanted.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PlanRequest, example = json!({
    "measurement_id": "m-0199f0c8-0000-7000-8000-000000000000",
    "target": {"deflection_deg": 0.0, "pitch_deg": 0.0, "y_c0_mm": 0.0, "z_c0_mm": 0.0}
}))]
pub(in crate::http) struct PlanRequestDocument {
    /// The measurement of the position of the part.
    measurement_id: String,
    /// Which part of it, by name or by number from 1; the only one by default.
    part: Option<String>,
    /// Where it is wanted.
    target: TargetDocument,
    /// Share of the greatest speeds; 1 by default.
    #[schema(minimum = 0.001, maximum = 1.0)]
    speed_ratio: Option<f64>,
    /// A repeated request of the same id gets the first answer again.
    #[schema(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    request_id: Option<String>,
}

/// Where the part's axis is wanted, in the rail frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Target)]
pub(in crate::http) struct TargetDocument {
    /// Rotation towards +Y.
    #[schema(minimum = -45.0, maximum = 45.0)]
    deflection_deg: f64,
    /// Rotation towards +Z.
    #[schema(minimum = -45.0, maximum = 45.0)]
    pitch_deg: f64,
    /// Where the axis is to meet the plane x = 0.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    y_c0_mm: f64,
    /// Where the axis is to meet the plane x = 0.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    z_c0_mm: f64,
    /// Turn about the axis from where it is, from +Y towards +Z; 0 by default.
    #[serde(default)]
    #[schema(minimum = -3600.0, maximum = 3600.0)]
    roll_deg: f64,
    /// Shift along the axis from where it is; 0 by default.
    #[serde(default)]
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    shift_x_mm: f64,
}

/// What would move. Nothing does.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Plan)]
pub(in crate::http) struct PlanDocument {
    /// `p-` and a UUID that grows with time.
    #[schema(pattern = "^p-[0-9a-f-]{36}$", example = "p-0199f0c8-0000-7000-8000-000000000000")]
    id: String,
    /// When it was made, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    created_at: Timestamp,
    /// From then on it is too old to be executed: the measured pose is. It ends earlier where anything moves.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    expires_at: Timestamp,
    /// The move that executes it; null where none does yet.
    move_id: Option<String>,
    /// The measurement that it was made from.
    measurement_id: String,
    /// Where the part was found.
    measured: AxisDocument,
    /// Where it is wanted.
    target: TargetDocument,
    /// Where its axis will be, by the kinematics.
    predicted: Option<AxisDocument>,
    /// Share of the greatest speeds.
    speed_ratio: f64,
    /// Planned duration; the settling at every set-point comes on top.
    duration_s: f64,
    /// Largest change of the distance of the clamps along the path.
    strain_mm: f64,
    /// Largest change of the difference of the two turns along the path.
    twist_deg: f64,
    /// Set-points of the path.
    waypoints_count: u64,
    /// The travel of each axis.
    axes: TravelsDocument,
}

/// An axis in the rail frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = PartAxis)]
pub(in crate::http) struct AxisDocument {
    /// Rotation towards +Y.
    deflection_deg: f64,
    /// Rotation towards +Z.
    pitch_deg: f64,
    /// Where the axis meets the plane x = 0.
    y_c0_mm: f64,
    /// Where the axis meets the plane x = 0.
    z_c0_mm: f64,
    /// The plane of the part's reference point.
    x_ref_mm: f64,
}

/// A page of plans, newest first.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct PlanList {
    /// The plans.
    plans: Vec<EntryDocument<PlanDocument>>,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

impl TargetDocument {
    /// The target, if it is valid.
    fn target(self) -> Result<Target, Problem> {
        let Self { deflection_deg, pitch_deg, y_c0_mm, z_c0_mm, roll_deg, shift_x_mm } = self;
        Ok(Target {
            deflection: within("target.deflection_deg", deflection_deg, TILT_MAX_DEG)?.to_radians(),
            pitch: within("target.pitch_deg", pitch_deg, TILT_MAX_DEG)?.to_radians(),
            y_c0: within("target.y_c0_mm", y_c0_mm, LENGTH_MAX_MM)?,
            z_c0: within("target.z_c0_mm", z_c0_mm, LENGTH_MAX_MM)?,
            roll: within("target.roll_deg", roll_deg, TURN_MAX_DEG)?.to_radians(),
            shift_x: within("target.shift_x_mm", shift_x_mm, LENGTH_MAX_MM)?,
        })
    }
}

impl From<Target> for TargetDocument {
    fn from(target: Target) -> Self {
        let Target { deflection, pitch, y_c0, z_c0, roll, shift_x } = target;
        Self {
            deflection_deg: degrees(deflection),
            pitch_deg: degrees(pitch),
            y_c0_mm: rounded(y_c0),
            z_c0_mm: rounded(z_c0),
            roll_deg: degrees(roll),
            shift_x_mm: rounded(shift_x),
        }
    }
}

impl AxisDocument {
    fn of(axis: &AxisLine, x_ref_mm: f64) -> Self {
        Self {
            deflection_deg: rounded(axis.deflection().degrees()),
            pitch_deg: rounded(axis.pitch().degrees()),
            y_c0_mm: rounded(axis.y0),
            z_c0_mm: rounded(axis.z0),
            x_ref_mm: rounded(x_ref_mm),
        }
    }
}

impl PlanDocument {
    fn of(stored: StoredPlan, move_id: Option<String>) -> Self {
        let plan = &stored.plan;
        Self {
            created_at: stored.created_at,
            expires_at: stored.expires_at,
            move_id,
            measured: AxisDocument::of(&stored.measured, stored.x_ref),
            target: stored.target.into(),
            predicted: plan.predicted.as_ref().map(|PartPose { axis, x_ref }| AxisDocument::of(axis, *x_ref)),
            speed_ratio: stored.speed_ratio,
            duration_s: rounded(plan.duration_s),
            strain_mm: rounded(plan.strain_mm),
            twist_deg: degrees(plan.twist),
            waypoints_count: u64::try_from(plan.path.waypoints.len()).unwrap_or(u64::MAX),
            axes: plan.into(),
            measurement_id: stored.measurement_id,
            id: stored.id,
        }
    }
}

/// Plan an alignment
///
/// From the pose of a measurement to a target: what each axis would do, how long it takes, what the part bears on the way.
/// Moves nothing and needs no lease. The plan assumes that nothing moves until it is executed.
#[utoipa::path(
    post, path = "/v1/plans", tag = "motion",
    params(("Idempotency-Key" = Option<String>, Header, description = "The same as `request_id`", pattern = "^[A-Za-z0-9._:-]{1,128}$")),
    request_body(content = PlanRequestDocument, description = "From where to where"),
    responses(
        (status = 201, description = "Planned", body = PlanDocument,
            headers(("Location" = String, description = "Address of the plan"))),
        (status = 200, description = "Planned before, for a request of the same id", body = PlanDocument,
            headers(("Location" = String, description = "Address of the plan"),
                ("Idempotency-Replayed" = String, description = "true"))),
    )
)]
pub(in crate::http) async fn create_plan(
    State(app): State<App>,
    _: NoQuery,
    headers: HeaderMap,
    JsonBody(body): JsonBody<PlanRequestDocument>,
) -> Result<Response, Problem> {
    let request = PlanRequest {
        measurement_id: body.measurement_id,
        part: body.part,
        target: body.target.target()?,
        speed_ratio: body.speed_ratio.unwrap_or(1.0),
        request_id: request_id(body.request_id, &headers)?,
    };
    let answer = app.service.operating.create_plan(request).await?;
    let move_id = if answer.replayed { app.service.operating.move_of_plan(&answer.plan.id).await? } else { None };
    made(&format!("/v1/plans/{}", answer.plan.id), answer.replayed, PlanDocument::of(answer.plan, move_id))
}

/// List plans
///
/// Newest first, by the page. The header `Link` names the next page.
#[utoipa::path(
    get, path = "/v1/plans", tag = "motion", params(PageQuery),
    responses((status = 200, description = "A page of plans", body = PlanList,
        headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end"))))
)]
pub(in crate::http) async fn list_plans(
    State(app): State<App>,
    Query(query): Query<PageQuery>,
    uri: Uri,
) -> Result<Response, Problem> {
    let page = app.service.operating.plans(&query.page()?).await?;
    let document = |rows: Vec<Entry<PlanInList>>, next_cursor| {
        let show = |PlanInList { plan, move_id }| PlanDocument::of(plan, move_id);
        PlanList { plans: rows.into_iter().map(|entry| EntryDocument::of(entry, show)).collect(), next_cursor }
    };
    listed(&uri, page, document).await
}

/// Get a plan
///
/// With the id of the move that executes it, where one does.
#[utoipa::path(
    get, path = "/v1/plans/{id}", tag = "motion",
    params(("id" = String, Path, description = "Id of the plan")),
    responses((status = 200, description = "The plan", body = PlanDocument))
)]
pub(in crate::http) async fn get_plan(
    State(app): State<App>,
    Path(id): Path<String>,
    _: NoQuery,
) -> Result<Json<PlanDocument>, Problem> {
    let plan = app.service.operating.plan(&id).await?;
    let move_id = app.service.operating.move_of_plan(&id).await?;
    Ok(Json(PlanDocument::of(plan, move_id)))
}

/// Execute a plan
///
/// Needs the lease. Executing it again answers the same move, with status 200. A plan whose pose is too old, or since which
/// anything moved, is refused as `plan_stale`: measure and plan again.
#[utoipa::path(
    post, path = "/v1/plans/{id}/execute", tag = "motion",
    params(("id" = String, Path, description = "Id of the plan"),
        ("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery),
    request_body(content = Option<LeaseBody>, description = "The lease; may be left out"),
    responses(
        (status = 201, description = "The move has begun", body = MoveDocument,
            headers(("Location" = String, description = "Address of the move"))),
        (status = 200, description = "The move was begun before", body = MoveDocument,
            headers(("Location" = String, description = "Address of the move"),
                ("Idempotency-Replayed" = String, description = "true"))),
    )
)]
pub(in crate::http) async fn execute_plan(
    State(app): State<App>,
    Path(id): Path<String>,
    CommandLease(lease_id): CommandLease,
) -> Result<Response, Problem> {
    let started = app.service.operating.execute_plan(&id, lease_id).await?;
    let address = format!("/v1/moves/{}", started.job.id);
    made(&address, started.replayed, MoveDocument::of(started.job, &app.service))
}
