//! Measurements by the sensor: how one is asked for, and how it looks until it has run, or where it failed.

use super::super::app::App;
use super::super::cell::permille;
use super::super::command::{lease_id, made};
use super::super::moves::EndingDocument;
use super::super::names::{MethodName, View};
use super::super::numbers::{LENGTH_MAX_MM, rounded, within};
use super::super::problem::Problem;
use super::super::receive::request_id;
use super::Shown;
use super::create::recipe_name;
use super::document::MeasurementDocument;
use crate::service::{AnyMeasurement, JobStanding, Order, Recipe, ScanWay, SensorRequest, SensorScan, Service};
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use utoipa::ToSchema;

/// A measurement by the sensor. Needs the lease, since the stage moves.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = SensorOrder, example = json!({"source": "sensor", "profiles_count": 200}))]
pub(in super::super) struct SensorOrderDocument {
    /// `sensor`.
    #[serde(rename = "source")]
    _source: Source,
    /// The same as the header `Lease-Id`.
    lease_id: Option<String>,
    /// The lease in the query, which no body has.
    #[serde(skip)]
    #[schema(ignore)]
    pub(super) lease_in_query: Option<String>,
    /// Name of a stored recipe.
    #[schema(pattern = "^[a-z0-9][a-z0-9_-]{0,63}$")]
    pub(super) recipe: Option<String>,
    /// How the pose is found.
    pub(super) method: Option<MethodName>,
    /// The radius that the drawing gives.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub(super) nominal_radius_mm: Option<f64>,
    /// Where the scan begins, along the rail; as configured where nothing is said, as what follows.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    x_from_mm: Option<f64>,
    /// Where it ends.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    x_to_mm: Option<f64>,
    /// Profiles to take.
    #[schema(minimum = 2)]
    profiles_count: Option<u64>,
    /// How fast the stage goes.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    speed_mm_s: Option<f64>,
    /// A repeated request of the same id gets the first answer again.
    #[schema(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    pub(super) request_id: Option<String>,
}

/// Where the points come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Source {
    /// The cell's sensor.
    Sensor,
}

/// A measurement by the sensor that has not run yet, or failed.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SensorMeasurement)]
pub(in super::super) struct SensorMeasurementDocument {
    /// `m-` and a UUID that grows with time.
    #[schema(pattern = "^m-[0-9a-f-]{36}$", example = "m-0199f0c8-0000-7000-8000-000000000000")]
    id: String,
    /// `scanning`; then `done` in the document of a measurement, or `stopped`, `failed`, `unknown` (what the devices did is not
    /// known), `interrupted` (the service ended meanwhile), `refused` (nothing was sent).
    #[schema(example = "scanning")]
    state: &'static str,
    /// Always null.
    #[schema(value_type = Option<String>)]
    verdict: Option<()>,
    /// How far the scan is, 0 to 1.
    progress: f64,
    /// When it was asked for, UTC.
    #[schema(value_type = String, format = DateTime)]
    #[serde(serialize_with = "crate::http::times::time")]
    created_at: Timestamp,
    /// When it was over, UTC; null while it is under way.
    #[schema(value_type = Option<String>, format = DateTime)]
    #[serde(serialize_with = "crate::http::times::optional")]
    ended_at: Option<Timestamp>,
    /// Why it failed; null while it is under way.
    failure: Option<EndingDocument>,
    /// Name of the recipe, where one was named.
    recipe: Option<String>,
    /// Where the scan begins, along the rail.
    x_from_mm: f64,
    /// Where it ends.
    x_to_mm: f64,
    /// Profiles to take.
    profiles_count: u64,
    /// How fast the stage goes.
    speed_mm_s: f64,
    /// Who held the lease.
    holder: Option<String>,
}

/// A measurement that ran, or one by the sensor that has not, or not yet.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
#[schema(as = AnyMeasurement)]
pub(in super::super) enum AnyMeasurementDocument {
    /// It ran.
    Ran(Box<MeasurementDocument>),
    /// It has not.
    Sensor(Box<SensorMeasurementDocument>),
}

/// The same for a PLC.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = PlcSensorMeasurement)]
pub(in super::super) struct PlcSensorDocument {
    /// Id of the measurement.
    id: String,
    /// 0 it scans, 3 stopped, 4 failed, 5 unknown, 6 interrupted, 7 refused by the cell; 1 and 2 are those of a measurement
    /// that ran.
    #[schema(minimum = 0, maximum = 7)]
    verdict_code: u8,
    /// How far the scan is, per mille.
    progress_permille: u16,
}

impl SensorMeasurementDocument {
    /// With its progress at this moment.
    pub(super) fn of(scan: SensorScan, service: &Service) -> Self {
        let order = scan.order;
        Self {
            state: if scan.standing == JobStanding::Running { "scanning" } else { scan.standing.name() },
            verdict: None,
            progress: progress(scan.standing, &scan.id, service),
            created_at: scan.created_at,
            ended_at: scan.ended_at,
            failure: scan.ending.map(Into::into),
            recipe: order.recipe_name,
            x_from_mm: order.x_from_mm,
            x_to_mm: order.x_to_mm,
            profiles_count: order.profiles_count,
            speed_mm_s: order.speed_mm_s,
            holder: order.by.holder,
            id: scan.id,
        }
    }
}

impl AnyMeasurementDocument {
    /// As it is at this moment.
    pub(super) fn of(any: AnyMeasurement, service: &Service) -> Self {
        match any {
            AnyMeasurement::Ran(measurement) => Self::Ran(Box::new(MeasurementDocument::from(&*measurement))),
            AnyMeasurement::Scan(scan) => Self::Sensor(Box::new(SensorMeasurementDocument::of(*scan, service))),
        }
    }
}

impl PlcSensorDocument {
    pub(super) fn of(scan: &SensorScan, service: &Service) -> Self {
        let verdict_code = match scan.standing {
            JobStanding::Running | JobStanding::Done => 0,
            JobStanding::Stopped => 3,
            JobStanding::Failed => 4,
            JobStanding::Unknown => 5,
            JobStanding::Interrupted => 6,
            JobStanding::Refused => 7,
        };
        let progress_permille = permille(progress(scan.standing, &scan.id, service));
        Self { id: scan.id.clone(), verdict_code, progress_permille }
    }
}

/// Where the cell knows nothing of it, the profiles are all here, and the pose is estimated.
fn progress(standing: JobStanding, id: &str, service: &Service) -> f64 {
    match standing {
        JobStanding::Running => rounded(service.progress(id).unwrap_or(1.0)),
        _ => 0.0,
    }
}

fn bounded(field: &str, value: Option<f64>) -> Result<Option<f64>, Problem> {
    value.map(|value| within(field, value, LENGTH_MAX_MM)).transpose()
}

/// Begins a measurement by the sensor.
pub(super) async fn measure_from_sensor(
    app: &App,
    body: SensorOrderDocument,
    headers: &HeaderMap,
    view: View,
) -> Result<Response, Problem> {
    let overrides =
        Recipe { method: body.method.map(Into::into), nominal_radius_mm: body.nominal_radius_mm, ..Recipe::default() };
    let order = Order {
        recipe: body.recipe.map(recipe_name).transpose()?,
        overrides,
        request_id: request_id(body.request_id, headers)?,
    };
    let request = SensorRequest {
        lease_id: lease_id(app, [body.lease_id, body.lease_in_query], headers)?,
        way: ScanWay {
            x_from_mm: bounded("x_from_mm", body.x_from_mm)?,
            x_to_mm: bounded("x_to_mm", body.x_to_mm)?,
            profiles_count: body.profiles_count,
            speed_mm_s: bounded("speed_mm_s", body.speed_mm_s)?,
        },
        order,
    };
    let started = app.service.measure_from_sensor(request).await?;
    let address = format!("/v1/measurements/{}", started.job.id);
    if started.replayed {
        let any = app.service.any_measurement(&started.job.id, Duration::ZERO).await?;
        return made(&address, true, Shown::of(any, view, None, &app.service)?);
    }
    // The cell may not have begun.
    let begun = match view {
        View::Full => {
            let document = SensorMeasurementDocument::of(started.job, &app.service);
            Shown::Sensor(Box::new(SensorMeasurementDocument { progress: 0.0, ..document }))
        }
        View::Plc => {
            let document = PlcSensorDocument::of(&started.job, &app.service);
            Shown::PlcSensor(PlcSensorDocument { progress_permille: 0, ..document })
        }
    };
    made(&address, false, begun)
}
