//! The status of the service: a flat document for polling, probes for a supervisor, counters for monitoring.

use crate::http::app::App;
use crate::http::server::metrics::Levels;
use crate::http::wire::extract::NoQuery;
use crate::http::wire::problem::{Code, Problem, reasons};
use crate::service::ServiceError;
use crate::store::StoreError;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

/// How the service is: fixed keys in a fixed order, null for unknown values, below 512 bytes.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct Status {
    /// `idle`, `measuring`, or `busy` where a further measurement would be refused.
    state: StateName,
    /// Made anew at every start.
    instance_id: String,
    /// Grows with everything that is recorded, from the start of this instance.
    sequence: u64,
    /// Its version.
    version: &'static str,
    /// When this instance was started, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    started_at: Timestamp,
    /// The service's clock, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    now_at: Timestamp,
    /// Measurements that are calculated.
    running_count: u64,
    /// Measurements that wait for their turn.
    queued_count: u64,
    /// Measurements that may be calculated at a time.
    running_max_count: u64,
    /// Measurements that may wait.
    queue_max_count: u64,
    /// The state of the cell; null if there is none.
    #[schema(example = "idle")]
    cell_state: Option<&'static str>,
    /// The newest measurement.
    last_measurement_id: Option<String>,
    /// Its verdict.
    #[schema(example = "accepted")]
    last_verdict: Option<&'static str>,
    /// When it was made, UTC.
    #[schema(value_type = Option<String>, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::optional")]
    last_created_at: Option<Timestamp>,
}

/// The state of the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = ServiceState)]
pub(in crate::http) enum StateName {
    /// Nothing.
    Idle,
    /// It measures, and takes more.
    Measuring,
    /// It measures, and takes no more.
    Busy,
}

/// Get the status
///
/// One flat document of fixed keys in a fixed order, below 512 bytes, for a gateway that polls.
#[utoipa::path(
    get, path = "/v1/status", tag = "status",
    responses((status = 200, description = "How the service is", body = Status))
)]
pub(in crate::http) async fn get_status(State(app): State<App>, _: NoQuery) -> Json<Status> {
    let service = &app.service;
    let (load, capacity, last) = (service.measuring.load(), service.capacity(), service.measuring.last());
    let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
    let state = match (service.measuring.check_free().is_ok(), load.running_count) {
        (false, _) => StateName::Busy,
        (true, 0) => StateName::Idle,
        (true, _) => StateName::Measuring,
    };
    Json(Status {
        state,
        instance_id: service.instance_id().to_owned(),
        sequence: service.sequence(),
        version: env!("CARGO_PKG_VERSION"),
        started_at: service.started_at(),
        now_at: service.now(),
        running_count: wide(load.running_count),
        queued_count: wide(load.queued_count),
        running_max_count: wide(capacity.running_max),
        queue_max_count: wide(capacity.queue_max),
        cell_state: service.operating.cell_view().ok().map(|view| view.snapshot.state.name()),
        last_verdict: last.as_ref().and_then(|last| last.verdict).map(|verdict| verdict.name()),
        last_created_at: last.as_ref().map(|last| last.created_at),
        last_measurement_id: last.map(|last| last.id),
    })
}

/// The answer of a successful probe.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct Healthy {
    /// `ok`.
    #[schema(example = "ok")]
    status: &'static str,
}

/// See whether the service lives
///
/// Answers as long as the process answers at all; when it does not, restart it.
#[utoipa::path(
    get, path = "/health/live", tag = "status",
    responses((status = 200, description = "It lives", body = Healthy))
)]
pub(in crate::http) async fn get_liveness() -> Json<Healthy> {
    Json(Healthy { status: "ok" })
}

/// See whether the service can do its work
///
/// Writes to the store to find out, and asks whether the cell, where there is one, still takes requests; 503 names what is not
/// ready.
#[utoipa::path(
    get, path = "/health/ready", tag = "status",
    responses((status = 200, description = "It can", body = Healthy))
)]
pub(in crate::http) async fn get_readiness(State(app): State<App>) -> Result<Json<Healthy>, Problem> {
    let store = app.service.check_ready().await.err();
    let cell = app.service.operating.cell_is_alive() == Some(false);
    let of_store = |cause: &ServiceError| match cause {
        ServiceError::Store(StoreError::RecordsLost(loss)) => reasons::records_lost(loss),
        _ => "the store cannot be written to; reads may still work".to_owned(),
    };
    let of_cell = "the cell has ended; nothing can be moved or scanned until the service is restarted";
    let reasons: Vec<(&str, String)> =
        [store.as_ref().map(|cause| ("store", of_store(cause))), cell.then(|| ("cell", of_cell.to_owned()))]
            .into_iter()
            .flatten()
            .collect();
    if reasons.is_empty() {
        return Ok(Json(Healthy { status: "ok" }));
    }
    let (names, texts): (Vec<&str>, Vec<String>) = reasons.into_iter().unzip();
    let problem = Problem::new(Code::NotReady, texts.join("; "))
        .with("not_ready", names)
        .with_header(header::RETRY_AFTER, HeaderValue::from_static("1"));
    Err(match store {
        Some(cause) => problem.because(cause.to_string()),
        None => problem,
    })
}

/// Get the counters
///
/// In the text format of Prometheus.
#[utoipa::path(
    get, path = "/metrics", tag = "status",
    responses((status = 200, description = "The counters", content((String = "text/plain"))))
)]
pub(in crate::http) async fn get_metrics(State(app): State<App>) -> Response {
    let limits = &app.limits;
    let usage = app.service.store_usage().await;
    let levels = Levels {
        load: app.service.measuring.load(),
        cell_alive: app.service.operating.cell_is_alive(),
        connections: app.connections.count(),
        connections_max: (limits.connections_max, limits.connections_reserved),
        uploads: (app.service.measuring.uploads_count(), limits.uploads_max),
        memory: app.service.memory_bytes(),
        listeners: (app.listeners.count(), app.listeners.most()),
        usage: usage
            .inspect_err(|error| tracing::warn!(%error, "the free space of the data folder could not be determined"))
            .ok(),
    };
    let text = app.metrics.render(&levels);
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
}
