//! Measures a scan and records the result once per request.

use super::acquisition::Acquisition;
use super::compute::Place;
use super::error::ServiceError;
use super::measure::Measured;
use super::measurement::{Identity, Measurement};
use super::points::{Context, PointFile, Points};
use super::recipe::{Recipe, Resolved};
use super::recipes::RecipeName;
use super::scans::Origin;
use super::sensor::TAKEN_BY_SENSOR;
use super::upload::Arrived;
use super::{Service, document};
use crate::estimation::{Progress, Settings};
use crate::scan::decode::Format;
use crate::store::{CompleteScan, Inserted, MeasurementRow, NewMeasurement, RequestKey, ScanRow};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::sync::Arc;
use tokio::sync::OwnedSemaphorePermit;

/// What a client calls a request of his, so that it may be repeated without harm.
pub type RequestId = String;

/// What is asked of a measurement besides the scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Order {
    /// Name of a stored recipe.
    pub recipe: Option<RecipeName>,
    /// What the request says over the recipe.
    pub overrides: Recipe,
    /// So that a repeated request gets the first answer again.
    #[serde(skip)]
    pub request_id: Option<RequestId>,
}

/// A measurement, and whether it was made for an earlier request of the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The record.
    pub measurement: Measurement,
    /// Whether nothing was calculated for this answer.
    pub replayed: bool,
}

/// An order whose recipe was looked up and resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    order: Order,
    pub(super) resolved: Resolved,
    /// Whether there is an answer to its request id, so that nothing will be calculated.
    pub(super) answered: bool,
    /// When the scan arrived, if it comes with this request.
    acquisition: Acquisition,
}

/// A measurement and its profiles, as the store keeps them.
pub(super) struct Calculated {
    pub(super) measurement: Measurement,
    pub(super) profiles: Vec<u8>,
}

impl Service {
    /// Looks up the recipe, resolves it and sees whether there is room: what can be refused before the scan is sent. A
    /// request that was answered before needs no room.
    ///
    /// # Errors
    /// [`ServiceError::Option`], [`ServiceError::RecipeUnknown`], [`ServiceError::Recipe`], [`ServiceError::Compute`]
    /// where the queue is full.
    pub async fn accept(&self, order: Order) -> Result<Accepted, ServiceError> {
        let accepted = self.accept_with(order, &self.defaults).await?;
        if !accepted.answered {
            self.compute.check_free()?;
        }
        Ok(accepted)
    }

    /// The same with other defaults than those of the configuration, and whether there is room or not.
    pub(super) async fn accept_with(&self, order: Order, defaults: &Settings) -> Result<Accepted, ServiceError> {
        order.overrides.resolve(defaults).map_err(ServiceError::Option)?;
        let under = match &order.recipe {
            Some(name) => self.recipe(name).await?.recipe,
            None => Recipe::default(),
        };
        let resolved = order.overrides.clone().over(&under).resolve(defaults)?;
        let answered = self.is_answered(order.request_id.as_deref()).await?;
        Ok(Accepted { order, resolved, answered, acquisition: self.acquisition_now() })
    }

    async fn is_answered(&self, request_id: Option<&str>) -> Result<bool, ServiceError> {
        let Some(id) = request_id else { return Ok(false) };
        Ok(self.store.measurement_by_request(id).await?.is_some())
    }

    /// Measures a scan that just arrived, and keeps it. What cannot be read leaves nothing behind.
    ///
    /// # Errors
    /// [`ServiceError`]; nothing is recorded then.
    pub async fn measure_upload(self: &Arc<Self>, arrived: Arrived) -> Result<Answer, ServiceError> {
        let Arrived { scan, read, sent, origin, accepted, place } = arrived;
        let arrival = accepted.arrival()?;
        let request = request_key(&scan.id(), &accepted.order);
        if let Some(earlier) = self.earlier_answer(request.as_ref()).await? {
            return Ok(earlier);
        }
        let queued = self.compute.take_place()?;
        let points = match read {
            Some(read) => Points::Read(Box::new(read)),
            None => Points::InFile(Box::new(PointFile {
                file: scan.open().await?,
                bytes_count: scan.bytes_count(),
                points_count: None,
                sent,
                origin: origin.clone(),
                resolved: accepted.resolved.clone(),
            })),
        };
        let acquisition = Some(accepted.acquisition.clone());
        let Calculated { measurement, profiles } =
            self.calculate(&scan.id(), (queued, points), accepted, acquisition).await?;
        let row = scan_row(&scan, &measurement, &origin, arrival);
        let new = new_measurement(&measurement, profiles, Some(row), request)?;
        // It holds its place among the uploads until it is kept.
        self.insert(measurement, new, Some((scan, place))).await
    }

    /// Measures a scan that is kept.
    ///
    /// # Errors
    /// [`ServiceError`]; nothing is recorded then.
    pub async fn measure_scan(self: &Arc<Self>, scan_id: &str, accepted: Accepted) -> Result<Answer, ServiceError> {
        let row = self.scan(scan_id).await?;
        let request = request_key(&row.id, &accepted.order);
        if let Some(earlier) = self.earlier_answer(request.as_ref()).await? {
            return Ok(earlier);
        }
        // Before its file is read, which takes a while.
        let queued = self.compute.take_place()?;
        let file = self.scan_file(&row.id).await?;
        // A scan by the sensor has the same uncertainty whenever it is measured.
        let accepted = match row.description.as_deref() {
            Some(TAKEN_BY_SENSOR) => self.accept_with(accepted.order, &self.sensor_defaults()).await?,
            _ => accepted,
        };
        // However often a scan is measured again, its pose gets no younger.
        let acquisition = row.arrival.as_deref().and_then(|arrival| serde_json::from_str(arrival).ok());
        let points = Points::InFile(Box::new(PointFile {
            file,
            bytes_count: row.bytes_count,
            points_count: row.points_count,
            sent: None,
            origin: Origin { parameter: Format::from_name(&row.format), ..Origin::default() },
            resolved: accepted.resolved.clone(),
        }));
        let Calculated { measurement, profiles } =
            self.calculate(&row.id, (queued, points), accepted, acquisition).await?;
        let new = new_measurement(&measurement, profiles, None, request)?;
        self.insert(measurement, new, None).await
    }

    async fn earlier_answer(&self, request: Option<&RequestKey>) -> Result<Option<Answer>, ServiceError> {
        let Some(request) = request else { return Ok(None) };
        match self.store.measurement_by_request(&request.id).await? {
            None if self.store.job_by_request(&request.id).await?.is_some() => {
                Err(ServiceError::RequestIdReused { request_id: request.id.clone() })
            }
            None => Ok(None),
            Some(earlier) if earlier.fingerprint == request.fingerprint => {
                Ok(Some(Answer { measurement: super::records::read_back(&earlier.measurement)?, replayed: true }))
            }
            Some(_) => Err(ServiceError::RequestIdReused { request_id: request.id.clone() }),
        }
    }

    async fn calculate(
        &self,
        scan_id: &str,
        (place, points): (Place, Points),
        accepted: Accepted,
        acquisition: Option<Acquisition>,
    ) -> Result<Calculated, ServiceError> {
        let Accepted { order, resolved, .. } = accepted;
        let (clock, limits) = (self.clock, self.capacity.scan.clone());
        let mut identity = Identity {
            id: clock.new_id("m-"),
            created_at: clock.now(),
            duration_ms: 0,
            scan_sha256: scan_id.trim_start_matches("s-").to_owned(),
            recipe_name: order.recipe.map(RecipeName::into_string),
            acquisition,
        };
        let work = move |decoded, context: &Context<'_>| {
            let measured = super::measure(decoded, &resolved, &limits, &Progress::until(context.stop))?;
            identity.duration_ms = context.watch.elapsed_ms();
            Calculated::of(identity, measured, &resolved)
        };
        self.with_points((&self.compute, place), points, work).await
    }

    /// Records a measurement and remembers it, whoever hangs up meanwhile.
    async fn insert(
        self: &Arc<Self>,
        measurement: Measurement,
        new: NewMeasurement,
        upload: Option<(CompleteScan, OwnedSemaphorePermit)>,
    ) -> Result<Answer, ServiceError> {
        let request_id = new.request.as_ref().map(|request| request.id.clone()).unwrap_or_default();
        let service = Arc::clone(self);
        let inserting = async move {
            let inserted = match upload {
                Some((file, _place)) => service.store.insert_measurement_of(new, file).await?,
                None => service.store.insert_measurement(new).await?,
            };
            if inserted == Inserted::New {
                service.remember_last().await;
            }
            Ok(inserted)
        };
        match self.followers.whole(inserting).await? {
            Inserted::New => Ok(Answer { measurement, replayed: false }),
            Inserted::Replayed(row) => Ok(Answer { measurement: super::records::read_back(&row)?, replayed: true }),
            Inserted::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }
}

impl Accepted {
    /// When the scan arrived, as the store keeps it.
    pub(super) fn arrival(&self) -> Result<String, ServiceError> {
        serde_json::to_string(&self.acquisition)
            .map_err(|source| ServiceError::RecordUnwritable { what: "scan", source: Arc::new(source) })
    }
}

impl Calculated {
    /// The record of what was measured. Writing the profiles takes the processor for a while, so it is done here.
    pub(super) fn of(identity: Identity, measured: Measured, resolved: &Resolved) -> Result<Self, ServiceError> {
        let (measurement, profiles) = Measurement::record(identity, &measured.prepared, measured.estimate, resolved);
        let unwritable = |source| ServiceError::RecordUnwritable { what: "list of profiles", source: Arc::new(source) };
        Ok(Self { measurement, profiles: serde_json::to_vec(&profiles).map_err(unwritable)? })
    }
}

fn scan_row(file: &CompleteScan, measurement: &Measurement, origin: &Origin, arrival: String) -> ScanRow {
    ScanRow {
        id: file.id(),
        created_at: measurement.created_at,
        bytes_count: file.bytes_count(),
        format: measurement.format.name().to_owned(),
        points_count: Some(measurement.points_count),
        description: origin.file_name.clone(),
        arrival: Some(arrival),
    }
}

pub(super) fn new_measurement(
    measurement: &Measurement,
    profiles: Vec<u8>,
    scan: Option<ScanRow>,
    request: Option<RequestKey>,
) -> Result<NewMeasurement, ServiceError> {
    let row = MeasurementRow {
        id: measurement.id.clone(),
        created_at: measurement.created_at,
        verdict: measurement.verdict().name().to_owned(),
        method: measurement.method.name().to_owned(),
        scan_id: measurement.scan_id(),
        recipe: measurement.recipe_name.clone(),
        document: document::write("measurement", measurement)?,
    };
    Ok(NewMeasurement { row, scan, profiles, request })
}

fn request_key(scan_id: &str, order: &Order) -> Option<RequestKey> {
    order.request_id.clone().map(|id| RequestKey { id, fingerprint: fingerprint_of(scan_id, order) })
}

/// What was asked, as a digest: what it is about, and everything said about it.
pub(super) fn fingerprint_of<T: Serialize>(subject: &str, order: &T) -> String {
    // No order has a value that JSON could not hold; should it, the request would merely not be recognised again.
    let asked = serde_json::to_string(order).unwrap_or_default();
    let digest = Sha256::new().chain_update(subject).chain_update([0]).chain_update(asked).finalize();
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
