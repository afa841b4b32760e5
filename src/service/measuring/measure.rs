//! Receives a scan piece by piece, measures it and records the result once per request.

use std::sync::Arc;

use serde::Serialize;
use sha2::{Digest, Sha256};
use tokio::sync::OwnedSemaphorePermit;

use crate::estimation::{Progress, Settings, Stop};
use crate::scan::decode::{Encoding, Format, Sent};
use crate::service::acquisition::Acquisition;
use crate::service::compute::Place;
use crate::service::document;
use crate::service::error::ServiceError;
use crate::store::{CompleteScan, Inserted, MeasurementRow, NewMeasurement, RequestKey, ScanRow, hex};

use super::order::{Answer, MeasurementOrder, Origin, ResolvedOrder};
use super::points::{Context, PointFile, Points};
use super::reading::unpack;
use super::recipe::{Recipe, RecipeName};
use super::record::{Calculated, Identity, Measurement, TAKEN_BY_SENSOR};
use super::state::Measuring;
use super::upload::{HEAD_BYTES, ReceivedScan, Said, Upload};

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

pub(in crate::service) fn new_measurement(
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

fn request_key(scan_id: &str, order: &MeasurementOrder) -> Option<RequestKey> {
    order.request_id.clone().map(|id| RequestKey { id, fingerprint: fingerprint_of(scan_id, order) })
}

/// Digest of a request: its subject and all its parameters.
pub(in crate::service) fn fingerprint_of<T: Serialize>(subject: &str, order: &T) -> String {
    // Every order can be serialised; if one could not, a repetition of the request would merely not be recognised.
    let asked = serde_json::to_string(order).unwrap_or_default();
    let digest = Sha256::new().chain_update(subject).chain_update([0]).chain_update(asked).finalize();
    hex(&digest)
}

impl Measuring {
    /// Looks up and resolves the recipe and checks the capacity, so that a request can be refused before the scan is sent. A
    /// request that was answered before needs no capacity.
    ///
    /// # Errors
    /// [`ServiceError::Option`], [`ServiceError::RecipeUnknown`], [`ServiceError::Recipe`], [`ServiceError::Compute`]
    /// if the queue is full.
    pub async fn accept(
        &self,
        order: MeasurementOrder,
        acquisition: Acquisition,
    ) -> Result<ResolvedOrder, ServiceError> {
        let accepted = self.accept_with(order, &self.shared.defaults, acquisition).await?;
        if !accepted.answered {
            self.compute.check_free()?;
        }
        Ok(accepted)
    }

    /// Like [`Self::accept`], but with the given defaults and without the check of the capacity.
    pub(in crate::service) async fn accept_with(
        &self,
        order: MeasurementOrder,
        defaults: &Settings,
        acquisition: Acquisition,
    ) -> Result<ResolvedOrder, ServiceError> {
        order.overrides.resolve(defaults).map_err(ServiceError::Option)?;
        let under = match &order.recipe {
            Some(name) => self.recipe(name).await?.recipe,
            None => Recipe::default(),
        };
        let resolved = order.overrides.clone().over(&under).resolve(defaults)?;
        let answered = self.is_answered(order.request_id.as_deref()).await?;
        Ok(ResolvedOrder { order, resolved, answered, acquisition })
    }

    async fn is_answered(&self, request_id: Option<&str>) -> Result<bool, ServiceError> {
        let Some(id) = request_id else { return Ok(false) };
        Ok(self.shared.store.measurement_by_request(id).await?.is_some())
    }

    /// Measures a scan that just arrived, and stores it. A scan that cannot be read is deleted.
    ///
    /// # Errors
    /// [`ServiceError`]; nothing is recorded then.
    pub async fn measure_upload(self: &Arc<Self>, arrived: ReceivedScan) -> Result<Answer, ServiceError> {
        let ReceivedScan { scan, read, sent, origin, accepted, place } = arrived;
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
        // The scan keeps its place among the uploads until it is stored.
        self.insert(measurement, new, Some((scan, place))).await
    }

    /// Measures a stored scan.
    ///
    /// # Errors
    /// [`ServiceError`]; nothing is recorded then.
    pub async fn measure_scan(
        self: &Arc<Self>,
        scan_id: &str,
        accepted: ResolvedOrder,
    ) -> Result<Answer, ServiceError> {
        let row = self.scan(scan_id).await?;
        let request = request_key(&row.id, &accepted.order);
        if let Some(earlier) = self.earlier_answer(request.as_ref()).await? {
            return Ok(earlier);
        }
        // The place is taken before the file is read, which takes a while.
        let queued = self.compute.take_place()?;
        let file = self.scan_file(&row.id).await?;
        // A scan by the sensor has the same uncertainty at every measurement.
        let accepted = match row.description.as_deref() {
            Some(TAKEN_BY_SENSOR) => {
                self.accept_with(accepted.order, &self.sensor_defaults, accepted.acquisition).await?
            }
            _ => accepted,
        };
        // The age of the pose counts from the scan, however often it is measured again.
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
        match self.shared.store.measurement_by_request(&request.id).await? {
            None if self.shared.store.job_by_request(&request.id).await?.is_some() => {
                Err(ServiceError::RequestIdReused { request_id: request.id.clone() })
            }
            None => Ok(None),
            Some(earlier) if earlier.fingerprint == request.fingerprint => {
                Ok(Some(Answer { measurement: super::measurements::read_back(&earlier.measurement)?, replayed: true }))
            }
            Some(_) => Err(ServiceError::RequestIdReused { request_id: request.id.clone() }),
        }
    }

    async fn calculate(
        &self,
        scan_id: &str,
        (place, points): (Place, Points),
        accepted: ResolvedOrder,
        acquisition: Option<Acquisition>,
    ) -> Result<Calculated, ServiceError> {
        let ResolvedOrder { order, resolved, .. } = accepted;
        let (clock, limits) = (self.shared.clock, self.shared.capacity.scan.clone());
        let mut identity = Identity {
            id: clock.new_id("m-"),
            created_at: clock.now(),
            duration_ms: 0,
            scan_sha256: scan_id.trim_start_matches("s-").to_owned(),
            recipe_name: order.recipe.map(RecipeName::into_string),
            acquisition,
        };
        let work = move |decoded, context: &Context<'_>| {
            let measured = super::pipeline::measure(decoded, &resolved, &limits, &Progress::until(context.stop))?;
            identity.duration_ms = context.watch.elapsed_ms();
            Calculated::of(identity, measured, &resolved)
        };
        self.with_points((&self.compute, place), points, work).await
    }

    /// Records a measurement and remembers it, even if the client disconnects meanwhile.
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
                Some((file, _place)) => service.shared.store.insert_measurement_of(new, file).await?,
                None => service.shared.store.insert_measurement(new).await?,
            };
            if inserted == Inserted::New {
                service.remember_last().await;
            }
            Ok(inserted)
        };
        match self.shared.background.run_detached(inserting).await? {
            Inserted::New => Ok(Answer { measurement, replayed: false }),
            Inserted::Replayed(row) => {
                Ok(Answer { measurement: super::measurements::read_back(&row)?, replayed: true })
            }
            Inserted::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }
}

impl Measuring {
    /// Begins an upload; `encoding` is the declared compression of its pieces and `bytes_expected` their announced total size, if
    /// given. Undeclared compression is recognised by the first bytes.
    ///
    /// # Errors
    /// [`ServiceError::UploadsBusy`], [`ServiceError::Store`] if the store has no space.
    pub async fn begin_upload(
        &self,
        encoding: Option<Encoding>,
        bytes_expected: Option<u64>,
        origin: Origin,
        accepted: ResolvedOrder,
    ) -> Result<Upload, ServiceError> {
        let place = self.uploads.take_place()?;
        let writer = self.shared.store.begin_scan(self.shared.capacity.body_bytes_max).await?;
        Ok(Upload {
            writer,
            said: Said { encoding, bytes_expected, origin, accepted },
            head: Vec::with_capacity(HEAD_BYTES),
            bytes_count: 0,
            readers: self.uploads.readers.clone(),
            limits: self.shared.capacity.scan.clone(),
            reading: None,
            place,
        })
    }

    /// Completes an upload after its last piece.
    ///
    /// # Errors
    /// [`ServiceError::Store`] if the store has no space, [`ServiceError::Content`] if the upload cannot be decompressed.
    pub async fn complete_upload(&self, upload: Upload) -> Result<ReceivedScan, ServiceError> {
        let encoding = upload.encoding();
        let Upload { writer, said, reading, limits, place, bytes_count, .. } = upload;
        let trail = writer.trail();
        let sent = writer.complete().await;
        // The reader ends with the upload, whatever the result.
        let read = match reading {
            Some(reading) => Some(reading.outcome().await),
            None => None,
        };
        let (sent, mut read) = (sent?, read.transpose()?);
        let scan = match (&mut read, encoding) {
            (Some(read), _) => read.unpacked.take().unwrap_or(sent),
            (None, Some(encoding)) => {
                let work = move |_: &Stop| {
                    let unpacked = unpack(&trail, encoding, &limits);
                    // The compressed file is needed until here.
                    drop(sent);
                    unpacked
                };
                self.unpacking.run(work).await??
            }
            (None, None) => sent,
        };
        let Said { origin, accepted, .. } = said;
        let sent = encoding.map(|_| Sent::of(u64::try_from(bytes_count).unwrap_or(u64::MAX)));
        let read = read.and_then(|read| read.points);
        Ok(ReceivedScan { scan, read, sent, origin, accepted, place })
    }
}
