//! Moves: absolute targets for one or both manipulators, checked, synchronous, supervised.

use crate::http::app::App;
use crate::http::server::shares::Peer;
use crate::http::wire::body::request_id;
use crate::http::wire::command::{LeaseQuery, WaitQuery, lease_id, made, wait};
use crate::http::wire::extract::{Json as JsonBody, Path, Query};
use crate::http::wire::numbers::{TargetsDocument, TravelsDocument, degrees, rounded};
use crate::http::wire::paging::{EntryDocument, PageQuery, listed};
use crate::http::wire::problem::{Code, Problem};
use crate::motion::{Carrier, MoveTargets, Pair, Plan};
use crate::service::{EndReason, Entry, JobStatus, Move, MoveRequest, Service};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::ToSchema;

/// Where to move; manipulators and axes that are not named stay.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = MoveRequest, example = json!({"m1": {"y_mm": 1.5}, "m2": {"y_mm": 1.5}, "speed_ratio": 0.5}))]
pub(in crate::http) struct MoveRequestDocument {
    /// Absolute targets of the manipulator at the smaller x.
    m1: Option<TargetsDocument>,
    /// Absolute targets of the manipulator at the greater x.
    m2: Option<TargetsDocument>,
    /// Share of the greatest speeds; 1 by default.
    #[schema(minimum = 0.001, maximum = 1.0)]
    speed_ratio: Option<f64>,
    /// The same as the header `Lease-Id`.
    lease_id: Option<String>,
    /// A repeated request of the same id gets the first answer again.
    #[schema(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    request_id: Option<String>,
}

/// A move, under way or over.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Move)]
pub(in crate::http) struct MoveDocument {
    /// `v-` and a UUID that grows with time.
    #[schema(pattern = "^v-[0-9a-f-]{36}$", example = "v-0199f0c8-0000-7000-8000-000000000000")]
    id: String,
    /// `moving`; then `done`, `stopped`, `failed`, `unknown` (where the devices are is not known), `interrupted` (the service
    /// ended meanwhile), or `refused` (nothing was sent).
    #[schema(example = "moving")]
    state: &'static str,
    /// How far it is by its time, 0 to 1.
    progress: f64,
    /// When it was asked for, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    created_at: Timestamp,
    /// When it was over, UTC; null while it is under way.
    #[schema(value_type = Option<String>, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::optional")]
    ended_at: Option<Timestamp>,
    /// Why it ended, where there is more to say than that it is done.
    ending: Option<EndingDocument>,
    /// The plan that it executes; null where it was asked for by targets.
    plan_id: Option<String>,
    /// The measurement that it was planned from.
    measurement_id: Option<String>,
    /// Who held the lease.
    holder: Option<String>,
    /// The lease's fence.
    fence: Option<u64>,
    /// Share of the greatest speeds.
    speed_ratio: f64,
    /// Planned duration; the settling at every set-point comes on top.
    duration_s: f64,
    /// Largest change of the distance of the clamps along the path.
    strain_mm: f64,
    /// Largest change of the difference of the two turns along the path.
    twist_deg: f64,
    /// Set-points of the path; null where it was refused, since those are not kept.
    waypoints_count: Option<u64>,
    /// The state of each axis.
    axes: TravelsDocument,
}

/// Why something ended.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Ending)]
pub(in crate::http) struct EndingDocument {
    /// A short word.
    #[schema(example = "stop_requested")]
    code: String,
    /// What happened.
    text: String,
}

/// A page of moves, newest first.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct MoveList {
    /// The moves.
    moves: Vec<EntryDocument<MoveDocument>>,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

impl From<EndReason> for EndingDocument {
    fn from(EndReason { code, text }: EndReason) -> Self {
        Self { code, text }
    }
}

impl MoveDocument {
    /// The document with the present progress.
    pub(in crate::http) fn of(one: Move, service: &Service) -> Self {
        let progress = match one.standing {
            JobStatus::Done => 1.0,
            JobStatus::Running => rounded(service.operating.progress(&one.id).unwrap_or(0.0)),
            _ => 0.0,
        };
        let plan = &one.order.plan;
        Self {
            state: if one.standing == JobStatus::Running { "moving" } else { one.standing.name() },
            progress,
            created_at: one.created_at,
            ended_at: one.ended_at,
            ending: one.ending.map(Into::into),
            plan_id: one.plan_id,
            measurement_id: one.order.measurement_id,
            speed_ratio: one.order.speed_ratio,
            duration_s: rounded(plan.duration_s),
            strain_mm: rounded(plan.strain_mm),
            twist_deg: degrees(plan.twist),
            waypoints_count: waypoints_count(one.standing, plan),
            axes: plan.into(),
            holder: one.order.by.holder,
            fence: one.order.by.fence,
            id: one.id,
        }
    }
}

fn waypoints_count(standing: JobStatus, plan: &Plan) -> Option<u64> {
    let count = u64::try_from(plan.path.waypoints.len()).unwrap_or(u64::MAX);
    (standing != JobStatus::Refused).then_some(count)
}

/// Move to absolute targets
///
/// Needs the lease. The path is checked against limits, steps, speeds, the manipulators' spans and what the part bears before
/// anything is sent; both manipulators move together. Answers when the move has begun; the move goes on when the client hangs
/// up. Repeating a request of the same `request_id` answers the same move, with status 200.
#[utoipa::path(
    post, path = "/v1/moves", tag = "motion",
    params(
        ("Lease-Id" = Option<String>, Header, description = "The lease"), LeaseQuery,
        ("Idempotency-Key" = Option<String>, Header, description = "The same as `request_id`", pattern = "^[A-Za-z0-9._:-]{1,128}$"),
    ),
    request_body(content = MoveRequestDocument, description = "Where to"),
    responses(
        (status = 201, description = "It has begun", body = MoveDocument,
            headers(("Location" = String, description = "Address of the move"))),
        (status = 200, description = "It was begun before, for a request of the same id", body = MoveDocument,
            headers(("Location" = String, description = "Address of the move"),
                ("Idempotency-Replayed" = String, description = "true"))),
    )
)]
pub(in crate::http) async fn create_move(
    State(app): State<App>,
    Query(query): Query<LeaseQuery>,
    headers: HeaderMap,
    JsonBody(body): JsonBody<MoveRequestDocument>,
) -> Result<Response, Problem> {
    let request = MoveRequest {
        lease_id: lease_id(&app, [body.lease_id, query.lease_id], &headers)?,
        targets: targets(body.m1, body.m2)?,
        speed_ratio: body.speed_ratio.unwrap_or(1.0),
        request_id: request_id(body.request_id, &headers)?,
    };
    let started = app.service.operating.start_move(request).await?;
    let address = format!("/v1/moves/{}", started.job.id);
    made(&address, started.replayed, MoveDocument::of(started.job, &app.service))
}

/// The target positions of both manipulators.
fn targets(m1: Option<TargetsDocument>, m2: Option<TargetsDocument>) -> Result<MoveTargets, Problem> {
    let of = |named: Option<TargetsDocument>, carrier| named.map_or(Ok(None), |named| named.targets(carrier));
    let targets = Pair { m1: of(m1, Carrier::M1)?, m2: of(m2, Carrier::M2)? };
    if targets == Pair::default() {
        let detail = "no target is named, so nothing would move: send at least one, such as {\"m1\": {\"y_mm\": 1.5}}";
        return Err(Problem::new(Code::NothingToMove, detail).with("field", "m1"));
    }
    Ok(targets)
}

/// List moves
///
/// Newest first, by the page. The header `Link` names the next page.
#[utoipa::path(
    get, path = "/v1/moves", tag = "motion", params(PageQuery),
    responses((status = 200, description = "A page of moves", body = MoveList,
        headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end"))))
)]
pub(in crate::http) async fn list_moves(
    State(app): State<App>,
    Query(query): Query<PageQuery>,
    uri: Uri,
) -> Result<Response, Problem> {
    let page = app.service.operating.moves(&query.page()?).await?;
    let service = Arc::clone(&app.service);
    let document = move |rows: Vec<Entry<Move>>, next_cursor| {
        let show = |entry| EntryDocument::of(entry, |one| MoveDocument::of(one, &service));
        MoveList { moves: rows.into_iter().map(show).collect(), next_cursor }
    };
    listed(&uri, page, document).await
}

/// Get a move
///
/// With `?wait_s=` the answer comes at its end, or after that time.
#[utoipa::path(
    get, path = "/v1/moves/{id}", tag = "motion",
    params(("id" = String, Path, description = "Id of the move"), WaitQuery),
    responses((status = 200, description = "The move", body = MoveDocument))
)]
pub(in crate::http) async fn get_move(
    State(app): State<App>,
    peer: Peer,
    Path(id): Path<String>,
    Query(query): Query<WaitQuery>,
) -> Result<Json<MoveDocument>, Problem> {
    let wait = wait(query.wait_s);
    let _place = app.listeners.place_for(peer, wait)?;
    let one = app.service.operating.get_move(&id, wait).await?;
    Ok(Json(MoveDocument::of(one, &app.service)))
}
