//! Measurements: created from an upload or a stored scan, listed, shown in full or for a PLC.

use sensor::Shown;
pub(in crate::http) mod create;
pub(in crate::http) mod document;
pub(in crate::http) mod plc;
pub(in crate::http) mod plots;
pub(in crate::http) mod profiles;
pub(in crate::http) mod sensor;
pub(in crate::http) mod uncertainty;

pub(in crate::http) use create::{__path_create_measurement, create_measurement};
pub use document::PartDocument;
pub use document::{MeasurementDocument, PoseDocument, ReasonDocument, TallyDocument, VerdictName};
pub(in crate::http) use plots::{__path_get_plot, get_plot};
pub(in crate::http) use profiles::{__path_list_profiles, list_profiles};
pub use profiles::{ProfileDocument, profiles_csv};
pub use uncertainty::{ScopeDocument, UncertaintyDocument};

use crate::http::app::App;
use crate::http::server::shares::Peer;
use crate::http::wire::command::{WaitSeconds, wait};
use crate::http::wire::extract::{Path, Query};
use crate::http::wire::names::View;
use crate::http::wire::paging::{EntryDocument, listed, page};
use crate::http::wire::problem::{Code, Problem};
use crate::service::{AnyMeasurement, Entry, JobStatus, Service};
use crate::store::Filter;
use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use axum::response::Response;
use sensor::AnyMeasurementDocument;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::{IntoParams, ToSchema};

/// Which measurements.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct ListQuery {
    /// Most entries of the page; 100 by default.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    #[param(pattern = "^[0-9a-f]{16}$")]
    cursor: Option<String>,
    /// Only those with this verdict.
    #[param(inline)]
    verdict: Option<VerdictFilter>,
    /// Only those made from this scan.
    scan_id: Option<String>,
    /// Only those made with the recipe of this name.
    recipe: Option<String>,
    /// Those in this state: `done`, those that ran, by default. Those by the sensor that have not run have neither
    /// verdict nor scan, so these do not go together with other words than `done`; neither does `recipe`.
    #[param(inline)]
    state: Option<StateFilter>,
}

/// A state to ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum StateFilter {
    /// It ran.
    Done,
    /// By the sensor, under way.
    Scanning,
    /// By the sensor, stopped.
    Stopped,
    /// By the sensor, not possible.
    Failed,
    /// By the sensor, and what the devices did is not known.
    Unknown,
    /// By the sensor, when the service ended.
    Interrupted,
    /// By the sensor, not begun.
    Refused,
}

/// A verdict to ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum VerdictFilter {
    /// Those with a pose.
    Accepted,
    /// Those without.
    Refused,
}

/// A page of measurements, newest first.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::http) struct MeasurementList {
    /// The measurements.
    measurements: Vec<EntryDocument<AnyMeasurementDocument>>,
    /// The `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
}

/// List measurements
///
/// Newest first, by the page: those that ran, or with `?state=` those by the sensor that have not, or not yet. The header `Link`
/// names the next page.
#[utoipa::path(
    get, path = "/v1/measurements", tag = "measurements", params(ListQuery),
    responses((status = 200, description = "A page of measurements", body = MeasurementList,
        headers(("Link" = String, description = "The next page, rel=\"next\"; absent at the end"))))
)]
pub(in crate::http) async fn list_measurements(
    State(app): State<App>,
    Query(query): Query<ListQuery>,
    uri: Uri,
) -> Result<Response, Problem> {
    let page = page(query.limit, query.cursor.as_deref())?;
    let verdict = query.verdict.map(|verdict| match verdict {
        VerdictFilter::Accepted => "accepted".to_owned(),
        VerdictFilter::Refused => "refused".to_owned(),
    });
    let filter = Filter { scan_id: query.scan_id, verdict, recipe: query.recipe };
    let service = Arc::clone(&app.service);
    match query.state.and_then(StateFilter::standing) {
        None => {
            let ran = |one| AnyMeasurement::Ran(Box::new(one));
            let page = app.service.measuring.measurements(&filter, &page).await?;
            listed(&uri, page, move |rows, next| MeasurementList::of(rows, next, &service, ran)).await
        }
        Some(_) if filter != Filter::default() => {
            let detail = "verdict, scan_id and recipe filter completed measurements; omit them or state";
            Err(Problem::new(Code::QueryInvalid, detail))
        }
        Some(standing) => {
            let by_sensor = |one| AnyMeasurement::Scan(Box::new(one));
            let page = app.service.operating.sensor_scans(standing, &page).await?;
            listed(&uri, page, move |rows, next| MeasurementList::of(rows, next, &service, by_sensor)).await
        }
    }
}

impl MeasurementList {
    fn of<R>(
        rows: Vec<Entry<R>>,
        next_cursor: Option<String>,
        service: &Service,
        any: impl Fn(R) -> AnyMeasurement,
    ) -> Self {
        let show = |entry| EntryDocument::of(entry, |one| AnyMeasurementDocument::of(any(one), service));
        Self { measurements: rows.into_iter().map(show).collect(), next_cursor }
    }
}

/// How one measurement is shown.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::http) struct GetQuery {
    /// `plc` gives integers in one flat object below 1024 bytes.
    #[param(inline)]
    view: Option<View>,
    /// Which part `plc` shows, by name or by number from 1 in order of x; the first by default.
    #[param(pattern = "^[A-Za-z0-9_-]{1,32}$")]
    part: Option<String>,
    /// How long to wait for the end of a measurement by the sensor, in seconds; a file is measured before its answer.
    #[param(value_type = Option<u8>, minimum = 0, maximum = 60)]
    wait_s: Option<WaitSeconds>,
}

/// Get a measurement
///
/// The whole document, or with `?view=plc` integers in one flat object below 1024 bytes. Of several parts that is one
/// part, the first unless `?part=` says which. One by the sensor is in state `scanning` until it has run; with `?wait_s=` the
/// answer comes at its end, or after that time.
#[utoipa::path(
    get, path = "/v1/measurements/{id}", tag = "measurements",
    params(("id" = String, Path, description = "Id of the measurement"), GetQuery),
    responses((status = 200, description = "The measurement", body = Shown))
)]
pub(in crate::http) async fn get_measurement(
    State(app): State<App>,
    peer: Peer,
    Path(id): Path<String>,
    Query(query): Query<GetQuery>,
) -> Result<Json<Shown>, Problem> {
    query.check()?;
    let view = query.view.unwrap_or(View::Full);
    let wait = wait(query.wait_s);
    let _place = app.listeners.place_for(peer, wait)?;
    let any = app.service.operating.any_measurement(&id, wait).await?;
    Shown::of(any, view, query.part.as_deref(), &app.service).map(Json)
}

impl StateFilter {
    /// The corresponding status of a job of the cell; `None` for a completed measurement.
    const fn standing(self) -> Option<JobStatus> {
        Some(match self {
            Self::Done => return None,
            Self::Scanning => JobStatus::Running,
            Self::Stopped => JobStatus::Stopped,
            Self::Failed => JobStatus::Failed,
            Self::Unknown => JobStatus::Unknown,
            Self::Interrupted => JobStatus::Interrupted,
            Self::Refused => JobStatus::Refused,
        })
    }
}

impl GetQuery {
    fn check(&self) -> Result<(), Problem> {
        if self.part.is_some() && self.view != Some(View::Plc) {
            let detail = "part requires view=plc; the full document contains all parts";
            return Err(Problem::new(Code::QueryInvalid, detail));
        }
        Ok(())
    }
}
