//! Measurements by the sensor: the cell scans, profiles become points as they come, and when the last one is here the pose is
//! estimated while the points are kept as a file. The record is there from the start, in a state in -ing; what fails on the way
//! fails by name.

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

/// A measurement by the sensor as it is kept beside its result.
pub type SensorScan = JobRecord<SensorOrder>;

/// A measurement: one that ran, or one by the sensor that did not come to that, or not yet.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMeasurement {
    /// It ran.
    Ran(Box<Measurement>),
    /// It scans, or it failed.
    Scan(Box<SensorScan>),
}

/// What is needed once the profiles are here.
struct ScanTask {
    job: SensorScan,
    accepted: ResolvedOrder,
    acquisition: Acquisition,
    /// What the points may have in it.
    limits: Limits,
}

/// A scan whose profiles are all here; not recorded before the cell says that it is whole.
struct CompleteScanPoints {
    row: ScanRow,
    points: Points,
    /// The one calculation, which waits for its turn or runs. Where the scan is given up, so is its turn.
    calculation: JoinSet<Result<Calculated, ServiceError>>,
}

/// Takes the profiles as they come; after one that cannot be used the others are let pass.
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
        // Memory takes whatever is written to it.
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
    /// Those of [`Measuring::accept`](crate::service::Measuring::accept); [`ServiceError::Cell`] where the cell refuses, [`ServiceError::RequestIdReused`].
    pub async fn measure_from_sensor(
        self: &Arc<Self>,
        request: SensorRequest,
    ) -> Result<StartedJob<SensorOrder>, ServiceError> {
        let handle = self.cell_handle()?;
        let fingerprint = fingerprint_of("sensor", &request);
        let key = request.order.request_id.clone().map(|id| RequestKey { id, fingerprint });
        // A repeated request is answered whether there is a free place or not.
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
            // Known once the lease was checked.
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

    /// The scan that an earlier request of the same id asked for; `None` where there was none.
    async fn scan_of_request(&self, key: &RequestKey) -> Result<Option<StartedJob<SensorOrder>>, ServiceError> {
        let reused = || Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
        let Some(row) = self.shared.store.job_by_request(&key.id).await? else {
            // Where an upload has this id, a measurement by the sensor is another request.
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
        // One whose refusal is not written yet may be tried again as soon as it is.
        if row.request.is_none() { Ok(None) } else { Ok(Some(StartedJob { job: read_back(&row)?, replayed: true })) }
    }

    /// The measurement of an id that ran.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementRunning`], [`ServiceError::MeasurementFailed`], [`ServiceError::MeasurementUnknown`].
    pub async fn measurement(&self, id: &str) -> Result<Measurement, ServiceError> {
        match self.measuring.recorded(id).await? {
            Some(measurement) => Ok(measurement),
            None => Err(self.why_not_measured(id).await),
        }
    }

    /// A measurement, whether it ran or not; waits for its end, no longer than `wait`.
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

    /// A page of the measurements by the sensor of one standing, newest first: those that have not run, or not yet.
    ///
    /// # Errors
    /// What the store says.
    pub async fn sensor_scans(
        &self,
        standing: JobStatus,
        page: &Page,
    ) -> Result<Listing<Entry<SensorScan>>, ServiceError> {
        self.list_jobs(Kind::Scan, Some(standing), page).await
    }

    /// Why there is no record of a measurement: it still scans, failed, or never was.
    async fn why_not_measured(&self, id: &str) -> ServiceError {
        let id = id.to_owned();
        match self.scan_job(&id).await {
            Err(error) => error,
            Ok(None) => ServiceError::MeasurementUnknown { id },
            // Where it is done, it was recorded this very moment.
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

    /// The scan by the sensor that a measurement is of; `None` where it was made from a file, or from a kept scan.
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
        // Memory for the points is set aside before anything moves.
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
                // While the stage scans, nothing moves the part.
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

    /// Waits for the cell's last word on the scan, and calculates meanwhile: when the last profile is here the sensor and the
    /// stage are still to be asked whether all is well, and the pose need not wait for that.
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

    /// Takes the profiles; when all are here, their calculation waits for its turn while they are written to a file.
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
            // Known when the points are written.
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
                tracing::warn!(%error, "the points of a scan by the sensor stay in memory until there is room for a file");
                Points::InMemory(Arc::new(bytes))
            }
        };
        Ok(CompleteScanPoints { row, points, calculation })
    }

    /// The scan is whole: records what was measured. Where that is not there yet, or failed, the raw points are kept first.
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

    /// Keeps the raw points of a scan, with their record, before there is a measurement of them.
    async fn keep_points(&self, row: &ScanRow, points: Points) -> Points {
        let Points::InFile(file) = &points else { return points };
        match self.shared.store.keep_scan(row.clone(), Arc::clone(file)).await {
            Ok(_) => Points::Kept,
            Err(error) => {
                tracing::warn!(scan = row.id, %error, "the points of a scan by the sensor are not kept yet");
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

    /// On threads of its own: uploads and what is measured again do not delay the line.
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
