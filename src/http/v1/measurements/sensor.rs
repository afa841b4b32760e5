//! Measurements by the sensor: the request, and the document until the measurement is completed or has failed.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::http::v1::moves::EndingDocument;
use crate::http::wire::names::{MethodName, View};
use crate::http::wire::numbers::{permille, rounded};
use crate::http::wire::problem::Problem;
use crate::service::{AnyMeasurement, JobStatus, SensorScan, Service};

use super::document::MeasurementDocument;
use super::plc::PlcDocument;

/// A measurement by the sensor. Needs the lease, since the stage moves.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = SensorOrder, example = json!({"source": "sensor", "profiles_count": 200}))]
pub(in crate::http) struct SensorOrderDocument {
    /// `sensor`.
    #[serde(rename = "source")]
    pub(super) _source: Source,
    /// The same as the header `Lease-Id`.
    pub(super) lease_id: Option<String>,
    /// The lease in the query, which no body has.
    #[serde(skip)]
    #[schema(ignore)]
    pub(in crate::http) lease_in_query: Option<String>,
    /// Name of a stored recipe.
    #[schema(pattern = "^[a-z0-9][a-z0-9_-]{0,63}$")]
    pub(in crate::http) recipe: Option<String>,
    /// How the pose is found.
    pub(in crate::http) method: Option<MethodName>,
    /// The radius that the drawing gives.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub(in crate::http) nominal_radius_mm: Option<f64>,
    /// Where the scan begins, along the rail; as configured by default, as what follows.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    pub(super) x_from_mm: Option<f64>,
    /// Where it ends.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    pub(super) x_to_mm: Option<f64>,
    /// Profiles to take.
    #[schema(minimum = 2)]
    pub(super) profiles_count: Option<u64>,
    /// How fast the stage goes.
    #[schema(exclusive_minimum = 0.0, maximum = 100000.0)]
    pub(super) speed_mm_s: Option<f64>,
    /// A repeated request of the same id gets the first answer again.
    #[schema(pattern = "^[A-Za-z0-9._:-]{1,128}$")]
    pub(in crate::http) request_id: Option<String>,
}

/// Where the points come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::http) enum Source {
    /// The cell's sensor.
    Sensor,
}

/// A measurement by the sensor that has not run yet, or failed.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SensorMeasurement)]
pub(in crate::http) struct SensorMeasurementDocument {
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
    #[serde(serialize_with = "crate::http::wire::numbers::time")]
    created_at: Timestamp,
    /// When it was over, UTC; null while it is under way.
    #[schema(value_type = Option<String>, format = DateTime)]
    #[serde(serialize_with = "crate::http::wire::numbers::optional")]
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
pub(in crate::http) enum AnyMeasurementDocument {
    /// It ran.
    Ran(Box<MeasurementDocument>),
    /// It has not.
    Sensor(Box<SensorMeasurementDocument>),
}

/// The same for a PLC.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = PlcSensorMeasurement)]
pub(in crate::http) struct PlcSensorDocument {
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
    /// The document with the present progress.
    pub(in crate::http) fn of(scan: SensorScan, service: &Service) -> Self {
        let order = scan.order;
        Self {
            state: if scan.standing == JobStatus::Running { "scanning" } else { scan.standing.name() },
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

    /// The document before anything moves.
    pub(in crate::http) fn not_begun(self) -> Self {
        Self { progress: 0.0, ..self }
    }
}

impl AnyMeasurementDocument {
    /// The present document.
    pub(in crate::http) fn of(any: AnyMeasurement, service: &Service) -> Self {
        match any {
            AnyMeasurement::Ran(measurement) => Self::Ran(Box::new(MeasurementDocument::from(&*measurement))),
            AnyMeasurement::Scan(scan) => Self::Sensor(Box::new(SensorMeasurementDocument::of(*scan, service))),
        }
    }
}

impl PlcSensorDocument {
    pub(in crate::http) fn of(scan: &SensorScan, service: &Service) -> Self {
        let verdict_code = match scan.standing {
            JobStatus::Running | JobStatus::Done => 0,
            JobStatus::Stopped => 3,
            JobStatus::Failed => 4,
            JobStatus::Unknown => 5,
            JobStatus::Interrupted => 6,
            JobStatus::Refused => 7,
        };
        let progress_permille = permille(progress(scan.standing, &scan.id, service));
        Self { id: scan.id.clone(), verdict_code, progress_permille }
    }

    /// The document before anything moves.
    pub(in crate::http) fn not_begun(self) -> Self {
        Self { progress_permille: 0, ..self }
    }
}

/// Progress of the scan; if the cell has no such job, all profiles have arrived and the pose is being estimated.
fn progress(standing: JobStatus, id: &str, service: &Service) -> f64 {
    match standing {
        JobStatus::Running => rounded(service.operating.progress(id).unwrap_or(1.0)),
        _ => 0.0,
    }
}

/// A measurement, whole or for a PLC; one by the sensor that has not run has the fields that are known so far.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub(in crate::http) enum Shown {
    /// Whole.
    Full(Box<MeasurementDocument>),
    /// For a PLC.
    Plc(Box<PlcDocument>),
    /// By the sensor, still under way or come to nothing.
    Sensor(Box<SensorMeasurementDocument>),
    /// The same for a PLC.
    PlcSensor(PlcSensorDocument),
}

impl Shown {
    /// The present document of a measurement; of several parts, the PLC view shows the named one, or the first.
    pub(super) fn of(any: AnyMeasurement, view: View, part: Option<&str>, service: &Service) -> Result<Self, Problem> {
        Ok(match (any, view) {
            (AnyMeasurement::Ran(measurement), View::Full) => Self::Full(Box::new((&*measurement).into())),
            (AnyMeasurement::Ran(measurement), View::Plc) => {
                let chosen = measurement.result.choose(part)?;
                Self::Plc(Box::new(PlcDocument::new(&measurement, chosen)))
            }
            (AnyMeasurement::Scan(scan), View::Full) => {
                Self::Sensor(Box::new(SensorMeasurementDocument::of(*scan, service)))
            }
            (AnyMeasurement::Scan(scan), View::Plc) => Self::PlcSensor(PlcSensorDocument::of(&scan, service)),
        })
    }
}
