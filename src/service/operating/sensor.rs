//! Measurements by the sensor: the cell scans, profiles become points as they arrive, and after the last one the pose is
//! estimated while the points are stored as a file. The record exists from the start in a transient state; a failure on the way
//! is recorded with its reason.

use crate::service::measuring::record::TAKEN_BY_SENSOR;
use std::sync::Arc;
use std::time::Duration;

use sha2::{Digest, Sha256};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::job::{Commander, EndReason, JobRecord, JobStatus, Kind, StartedJob};
use super::jobs::{Beginning, read_back};
use super::scan_order::{IncomingScan, SensorOrder, SensorRequest, check, misplaced};
use super::state::Operating;
use crate::cell::{Job, JobEnd, ScanOrder};
use crate::device::Profile;
use crate::estimation::Progress;
use crate::scan::Cloud;
use crate::scan::decode::Limits;
use crate::scan::encode::encode_cloud;
use crate::service::acquisition::Acquisition;
use crate::service::background::run_blocking;
use crate::service::compute::ComputeError;
use crate::service::document::Entry;
use crate::service::error::ServiceError;
use crate::service::events::Happening;
use crate::service::measuring::measure::{fingerprint_of, new_measurement};
use crate::service::measuring::order::ResolvedOrder;
use crate::service::measuring::pipeline::Decoded;
use crate::service::measuring::recipe::RecipeName;
use crate::service::measuring::record::{Calculated, Identity, Measurement};
use crate::service::memory::Claim;
use crate::service::unwritten::{End, MeasuredScan, Points};
use crate::store::{Listing, Page, RequestKey, ScanRow, hex};

/// The record of a scan by the sensor, stored besides its result.
pub type SensorScan = JobRecord<SensorOrder>;

/// A completed measurement, or one by the sensor that is running or failed.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMeasurement {
    /// It is completed.
    Ran(Box<Measurement>),
    /// It is running, or it failed.
    Scan(Box<SensorScan>),
}

/// The data needed once the profiles have arrived.
struct ScanTask {
    job: SensorScan,
    accepted: ResolvedOrder,
    acquisition: Acquisition,
    /// Limits of the points within it.
    limits: Limits,
}

/// A scan whose profiles have all arrived; it is not recorded before the cell confirms that it is complete.
struct CompleteScanPoints {
    row: ScanRow,
    points: Points,
    /// The single calculation, waiting for its turn or running. It is cancelled if the scan is abandoned.
    calculation: JoinSet<Result<Calculated, ServiceError>>,
}

/// Receives the profiles; after one that cannot be used, the others are ignored.
async fn collect(mut profiles: mpsc::Receiver<Vec<Profile>>, limits: &Limits) -> Result<IncomingScan, ServiceError> {
    let mut collected = Ok(IncomingScan::new(limits.clone()));
    while let Some(new) = profiles.recv().await {
        for profile in &new {
            collected = collected.and_then(|mut arriving: IncomingScan| {
                arriving.take(profile).map_err(crate::service::measuring::pipeline::MeasureError::from)?;
                Ok(arriving)
            });
        }
    }
    collected
}

/// The points as the bytes of a file, and their SHA-256.
async fn encoded(cloud: Cloud) -> Result<(Vec<u8>, String), ServiceError> {
    run_blocking(move || {
        let mut bytes = Vec::new();
        // Writing to memory cannot fail.
        let _ = encode_cloud(&cloud, &mut bytes);
        let sha256_hex = hex(&Sha256::digest(&bytes));
        Ok((bytes, sha256_hex))
    })
    .await
}

fn ending_of(error: &ServiceError) -> EndReason {
    let code = match error {
        ServiceError::Content(_) => "scan_unusable",
        ServiceError::Store(cause) => cause.code(),
        ServiceError::Compute(ComputeError::TooLong { .. }) => "calculation_too_long",
        ServiceError::Compute(_) => "calculation_failed",
        _ => "failed",
    };
    EndReason { code: code.to_owned(), text: error.to_string() }
}

impl Operating {
    /// Begins a measurement by the sensor.
    ///
    /// # Errors
    /// Those of [`Measuring::accept`](crate::service::Measuring::accept); [`ServiceError::Cell`] if the cell refuses,
    /// [`ServiceError::RequestIdReused`].
    pub async fn measure_from_sensor(
        self: &Arc<Self>,
        request: SensorRequest,
    ) -> Result<StartedJob<SensorOrder>, ServiceError> {
        let handle = self.cell_handle()?;
        let fingerprint = fingerprint_of("sensor", &request);
        let key = request.order.request_id.clone().map(|id| RequestKey { id, fingerprint });
        // A repeated request is answered even if no place is free.
        if let Some(key) = &key
            && let Some(started) = self.scan_of_request(key).await?
        {
            return Ok(started);
        }
        let mut accepted = self
            .measuring
            .accept_with(request.order.clone(), &self.measuring.sensor_defaults, self.acquisition_now())
            .await?;
        accepted.resolved.look_along_rail();
        let (way, scan) = (request.way, &handle.config.scan);
        let order = SensorOrder {
            // Set after the lease is checked.
            by: Commander::NOBODY,
            recipe_name: request.order.recipe.map(RecipeName::into_string),
            x_from_mm: way.x_from_mm.unwrap_or(scan.x_from_mm),
            x_to_mm: way.x_to_mm.unwrap_or(scan.x_to_mm),
            profiles_count: way.profiles_count.unwrap_or(scan.profiles_count),
            speed_mm_s: way.speed_mm_s.unwrap_or(scan.speed_mm_s),
            positions: handle.positions(),
        };
        check(&order, self.shared.capacity.scan.profiles_max)?;
        let service = Arc::clone(self);
        let beginning = async move { service.begin_scan(request.lease_id, key, order, accepted).await };
        self.shared.background.run_detached(beginning).await
    }

    /// The scan that an earlier request of the same id started; `None` if there was none.
    async fn scan_of_request(&self, key: &RequestKey) -> Result<Option<StartedJob<SensorOrder>>, ServiceError> {
        let reused = || Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
        let Some(row) = self.shared.store.job_by_request(&key.id).await? else {
            // If an upload used this id, a measurement by the sensor is a different request.
            return if self.shared.store.measurement_by_request(&key.id).await?.is_some() {
                reused()
            } else {
                Ok(None)
            };
        };
        if row.request.as_ref().is_none_or(|asked| asked.fingerprint != key.fingerprint) {
            return reused();
        }
        let row = self.shared.unwritten.complete(row);
        // A request whose refusal is not written yet may be repeated as soon as it is.
        if row.request.is_none() { Ok(None) } else { Ok(Some(StartedJob { job: read_back(&row)?, replayed: true })) }
    }

    /// The completed measurement of this id.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementRunning`], [`ServiceError::MeasurementFailed`], [`ServiceError::MeasurementUnknown`].
    pub async fn measurement(&self, id: &str) -> Result<Measurement, ServiceError> {
        match self.measuring.recorded(id).await? {
            Some(measurement) => Ok(measurement),
            None => Err(self.why_not_measured(id).await),
        }
    }

    /// A measurement, completed or not; waits for its end, at most for `wait`.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`].
    pub async fn any_measurement(&self, id: &str, wait: Duration) -> Result<AnyMeasurement, ServiceError> {
        let scan = self.job(Kind::Scan, id, wait).await?;
        match (self.measuring.recorded(id).await?, scan) {
            (Some(measurement), _) => Ok(AnyMeasurement::Ran(Box::new(measurement))),
            (None, Some(scan)) => Ok(AnyMeasurement::Scan(Box::new(scan))),
            (None, None) => Err(ServiceError::MeasurementUnknown { id: id.to_owned() }),
        }
    }

    /// A page of the measurements by the sensor of one status that are not completed, newest first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn sensor_scans(
        &self,
        standing: JobStatus,
        page: &Page,
    ) -> Result<Listing<Entry<SensorScan>>, ServiceError> {
        self.list_jobs(Kind::Scan, Some(standing), page).await
    }

    /// Why there is no record of a measurement: it is running, failed, or never existed.
    async fn why_not_measured(&self, id: &str) -> ServiceError {
        let id = id.to_owned();
        match self.scan_job(&id).await {
            Err(error) => error,
            Ok(None) => ServiceError::MeasurementUnknown { id },
            // If it is done, it was recorded between the two queries.
            Ok(Some(JobRecord { standing: JobStatus::Running | JobStatus::Done, .. })) => {
                ServiceError::MeasurementRunning { id }
            }
            Ok(Some(JobRecord { standing, ending, .. })) => {
                let (reason, text) = ending.map_or_else(
                    || (standing.name().to_owned(), format!("it is {}", standing.name())),
                    |EndReason { code, text }| (code, text),
                );
                ServiceError::MeasurementFailed { id, standing, reason, text }
            }
        }
    }

    /// The scan by the sensor that a measurement is based on; `None` if its scan is a file or was stored before.
    pub(in crate::service) async fn scan_job(&self, id: &str) -> Result<Option<SensorScan>, ServiceError> {
        self.job(Kind::Scan, id, Duration::ZERO).await
    }

    async fn begin_scan(
        self: &Arc<Self>,
        lease_id: String,
        request: Option<RequestKey>,
        mut order: SensorOrder,
        accepted: ResolvedOrder,
    ) -> Result<StartedJob<SensorOrder>, ServiceError> {
        let handle = self.cell_handle()?;
        order.by = self.authorise(&lease_id, request.as_ref()).await?;
        let id = self.shared.clock.new_id("m-");
        let beginning = Beginning { kind: Kind::Scan, id, plan_id: None, request, order: &order };
        let started = self.write_down(beginning).await?;
        if started.replayed {
            return Ok(started);
        }
        // Memory for the points is reserved before anything moves.
        let Some(claim) = self.shared.memory.sensor.claim_free() else {
            let busy = ServiceError::ScansBusy;
            let ending = EndReason { code: "busy".to_owned(), text: busy.to_string() };
            self.conclude(&started.job, JobStatus::Refused, Some(&ending)).await;
            return Err(busy);
        };
        let SensorOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s, .. } = order;
        let way = ScanOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s };
        match handle.cell.start_scan(&lease_id, &started.job.id, way).await {
            Ok((job, profiles)) => {
                // Nothing moves the part while the stage scans.
                let acquisition = Acquisition { positions: order.positions, ..self.acquisition_now() };
                let limits = claim.limits(&self.shared.capacity.scan);
                let task = ScanTask { job: started.job.clone(), accepted, acquisition, limits };
                let follower = Arc::clone(self);
                self.shared.background.add(async move { follower.follow_scan(job, profiles, task, claim).await });
                Ok(started)
            }
            Err(refusal) => {
                let (standing, ending) = EndReason::of_refusal(&refusal);
                self.conclude(&started.job, standing, Some(&ending)).await;
                Err(refusal.into())
            }
        }
    }

    /// Waits for the cell to confirm the scan, and calculates meanwhile: after the last profile, the sensor and the
    /// stage must still be checked, and the pose need not wait for that.
    async fn follow_scan(
        self: &Arc<Self>,
        job: Job,
        profiles: mpsc::Receiver<Vec<Profile>>,
        task: ScanTask,
        claim: Claim,
    ) {
        let id = task.job.id.clone();
        let (arrived, ()) = tokio::join!(self.take_in(profiles, &task, claim), self.tell_progress(&job));
        let outcome = match (job.ended().await, arrived) {
            (JobEnd::Done, Ok(arrived)) => self.finish(arrived, &task).await,
            (JobEnd::Done, Err(ending)) => self.give_up(&task.job, JobStatus::Failed, ending).await,
            (end, _) => {
                let (standing, ending) = EndReason::of(&end);
                let ending = ending.unwrap_or_else(|| EndReason { code: "failed".to_owned(), text: end.to_string() });
                self.give_up(&task.job, standing, ending).await
            }
        };
        self.shared.announce(outcome);
        tracing::debug!(measurement = id, "the measurement by the sensor is over");
    }

    /// Receives the profiles; when all have arrived, their calculation waits for its turn while they are written to a file.
    async fn take_in(
        self: &Arc<Self>,
        profiles: mpsc::Receiver<Vec<Profile>>,
        task: &ScanTask,
        mut claim: Claim,
    ) -> Result<CompleteScanPoints, EndReason> {
        let arriving = collect(profiles, &task.limits).await.map_err(|error| ending_of(&error))?;
        let decoded = arriving
            .finish()
            .map_err(|error| ending_of(&crate::service::measuring::pipeline::MeasureError::from(error).into()))?;
        let tolerance_mm = self.cell_handle().map_err(|error| ending_of(&error))?.config.scan.place_tolerance_mm;
        misplaced(&decoded.cloud, &task.job.order, tolerance_mm).map_or(Ok(()), Err)?;
        claim.keep_for(decoded.cloud.columns.len());
        self.begin_calculation(decoded, task, claim).await.map_err(|error| ending_of(&error))
    }

    async fn begin_calculation(
        self: &Arc<Self>,
        decoded: Decoded,
        task: &ScanTask,
        claim: Claim,
    ) -> Result<CompleteScanPoints, ServiceError> {
        let arrival = serde_json::to_string(&task.acquisition)
            .map_err(|source| ServiceError::RecordUnwritable { what: "scan", source: Arc::new(source) })?;
        let (format, points_count) = (decoded.format, u64::try_from(decoded.cloud.columns.len()).unwrap_or(u64::MAX));
        let cloud = decoded.cloud.clone();
        let identity = Identity {
            id: task.job.id.clone(),
            created_at: task.job.created_at,
            duration_ms: 0,
            // Set when the points are written.
            scan_sha256: String::new(),
            recipe_name: task.job.order.recipe_name.clone(),
            acquisition: Some(task.acquisition.clone()),
        };
        let mut calculation = JoinSet::new();
        let (service, accepted) = (Arc::clone(self), task.accepted.clone());
        calculation.spawn(async move { service.calculate_for_line(decoded, identity, accepted, claim).await });
        let (bytes, scan_sha256) = encoded(cloud).await?;
        let row = ScanRow {
            id: format!("s-{scan_sha256}"),
            created_at: task.job.created_at,
            bytes_count: u64::try_from(bytes.len()).unwrap_or(u64::MAX),
            format: format.name().to_owned(),
            points_count: Some(points_count),
            description: Some(TAKEN_BY_SENSOR.to_owned()),
            arrival: Some(arrival),
        };
        let points = match self.file_with(&bytes).await {
            Ok(file) => Points::InFile(Arc::new(file)),
            Err(error) => {
                tracing::warn!(%error, "the points of a scan by the sensor stay in memory until there is space for a file");
                Points::InMemory(Arc::new(bytes))
            }
        };
        Ok(CompleteScanPoints { row, points, calculation })
    }

    /// Records the measurement of a complete scan. If it is not calculated yet, or failed, the raw points are stored first.
    async fn finish(self: &Arc<Self>, arrived: CompleteScanPoints, task: &ScanTask) -> Happening {
        let CompleteScanPoints { row, mut points, mut calculation } = arrived;
        let calculated = match calculation.try_join_next() {
            Some(Ok(Ok(calculated))) => Ok(calculated),
            other => {
                points = self.keep_points(&row, points).await;
                let joined = if other.is_some() { other } else { calculation.join_next().await };
                joined.and_then(Result::ok).unwrap_or_else(|| Err(ComputeError::Panicked.into()))
            }
        };
        match calculated.and_then(|calculated| self.end_with(calculated, row, points, task)) {
            Ok((end, happening)) => {
                self.end_job(end).await;
                happening
            }
            Err(error) => self.give_up(&task.job, JobStatus::Failed, ending_of(&error)).await,
        }
    }

    /// Stores the raw points of a scan, with their record, before there is a measurement of them.
    async fn keep_points(&self, row: &ScanRow, points: Points) -> Points {
        let Points::InFile(file) = &points else { return points };
        match self.shared.store.keep_scan(row.clone(), Arc::clone(file)).await {
            Ok(_) => Points::Kept,
            Err(error) => {
                tracing::warn!(scan = row.id, %error, "the points of a scan by the sensor are not stored yet");
                points
            }
        }
    }

    fn end_with(
        &self,
        calculated: Calculated,
        row: ScanRow,
        points: Points,
        task: &ScanTask,
    ) -> Result<(End, Happening), ServiceError> {
        let Calculated { mut measurement, profiles } = calculated;
        measurement.scan_sha256 = row.id.trim_start_matches("s-").to_owned();
        let new = new_measurement(&measurement, profiles, Some(row), None)?;
        let job = self.ended(&task.job, JobStatus::Done, None)?;
        let happening = Happening::Measured { measurement_id: measurement.id.clone(), verdict: measurement.verdict() };
        Ok((End { job, frees: false, measured: Some(MeasuredScan { new, points }) }, happening))
    }

    async fn give_up(self: &Arc<Self>, job: &SensorScan, standing: JobStatus, ending: EndReason) -> Happening {
        self.conclude(job, standing, Some(&ending)).await;
        let EndReason { code, text } = ending;
        Happening::NotMeasured { measurement_id: job.id.clone(), code, text }
    }

    /// Calculates on separate threads, so that uploads and repeated measurements do not delay the production line.
    async fn calculate_for_line(
        &self,
        decoded: Decoded,
        mut identity: Identity,
        accepted: ResolvedOrder,
        claim: Claim,
    ) -> Result<Calculated, ServiceError> {
        let (limits, clock) = (self.shared.capacity.scan.clone(), self.shared.clock);
        self.line
            .run(move |stop| {
                let (watch, _claim) = (clock.start(), claim);
                let measured = crate::service::measuring::pipeline::measure(
                    decoded,
                    &accepted.resolved,
                    &limits,
                    &Progress::until(stop),
                )?;
                identity.duration_ms = watch.elapsed_ms();
                Calculated::of(identity, measured, &accepted.resolved)
            })
            .await?
    }
}
