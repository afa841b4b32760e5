//! Measurements by the sensor: the cell scans, profiles become points as they come, and when the last one is here the pose is
//! estimated while the points are kept as a file. The record is there from the start, in a state in -ing; what fails on the way
//! fails by name.

use super::Service;
use super::acquisition::Acquisition;
use super::answer::Accepted;
use super::answer::{Calculated, fingerprint_of, new_measurement};
use super::arriving::Arriving;
use super::compute::ComputeError;
use super::document::Entry;
use super::error::ServiceError;
use super::events::Happening;
use super::followers::aside;
use super::jobs::Commander;
use super::jobs::{Beginning, Ending, JobStanding, Kind, Recorded, Started, read_back};
use super::measure::Decoded;
use super::measurement::{Identity, Measurement};
use super::memory::Claim;
use super::recipes::RecipeName;
use super::scan_order::{SensorOrder, SensorRequest, check, misplaced};
use super::unwritten::{End, MeasuredScan, Points};
use crate::cell::{Job, JobEnd, ScanOrder};
use crate::device::Profile;
use crate::estimation::{Progress, Settings};
use crate::scan::Cloud;
use crate::scan::decode::Limits;
use crate::scan::encode::encode_cloud;
use crate::store::{Listing, Page, RequestKey, ScanRow};
use sha2::{Digest, Sha256};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinSet;

/// The description of a scan that was taken by the sensor. It tells such a scan from an upload, since no client can write the
/// description of a scan.
pub(super) const TAKEN_BY_SENSOR: &str = "taken by the sensor";

/// A measurement by the sensor as it is kept beside its result.
pub type SensorScan = Recorded<SensorOrder>;

/// A measurement: one that ran, or one by the sensor that did not come to that, or not yet.
#[derive(Debug, Clone, PartialEq)]
pub enum AnyMeasurement {
    /// It ran.
    Ran(Box<Measurement>),
    /// It scans, or it failed.
    Scan(Box<SensorScan>),
}

/// What is needed once the profiles are here.
struct Task {
    job: SensorScan,
    accepted: Accepted,
    acquisition: Acquisition,
    /// What the points may have in it.
    limits: Limits,
}

/// A scan whose profiles are all here; not recorded before the cell says that it is whole.
struct Arrived {
    row: ScanRow,
    points: Points,
    /// The one calculation, which waits for its turn or runs. Where the scan is given up, so is its turn.
    calculation: JoinSet<Result<Calculated, ServiceError>>,
}

impl Service {
    /// Begins a measurement by the sensor.
    ///
    /// # Errors
    /// Those of [`Service::accept`]; [`ServiceError::Cell`] where the cell refuses, [`ServiceError::RequestIdReused`].
    pub async fn measure_from_sensor(
        self: &Arc<Self>,
        request: SensorRequest,
    ) -> Result<Started<SensorOrder>, ServiceError> {
        let side = self.cell_side()?;
        let fingerprint = fingerprint_of("sensor", &request);
        let key = request.order.request_id.clone().map(|id| RequestKey { id, fingerprint });
        // A repeated request is answered whether there is a free place or not.
        if let Some(key) = &key
            && let Some(started) = self.scan_of_request(key).await?
        {
            return Ok(started);
        }
        let mut accepted = self.accept_with(request.order.clone(), &self.sensor_defaults()).await?;
        accepted.resolved.look_along_rail();
        let (way, scan) = (request.way, &side.config.scan);
        let order = SensorOrder {
            // Known once the lease was checked.
            by: Commander::NOBODY,
            recipe_name: request.order.recipe.map(RecipeName::into_string),
            x_from_mm: way.x_from_mm.unwrap_or(scan.x_from_mm),
            x_to_mm: way.x_to_mm.unwrap_or(scan.x_to_mm),
            profiles_count: way.profiles_count.unwrap_or(scan.profiles_count),
            speed_mm_s: way.speed_mm_s.unwrap_or(scan.speed_mm_s),
            positions: side.positions(),
        };
        check(&order, self.capacity.scan.profiles_max)?;
        let service = Arc::clone(self);
        let beginning = async move { service.begin_scan(request.lease_id, key, order, accepted).await };
        self.followers.whole(beginning).await
    }

    /// The scan that an earlier request of the same id asked for; `None` where there was none.
    async fn scan_of_request(&self, key: &RequestKey) -> Result<Option<Started<SensorOrder>>, ServiceError> {
        let reused = || Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
        let Some(row) = self.store.job_by_request(&key.id).await? else {
            // Where an upload has this id, a measurement by the sensor is another request.
            return if self.store.measurement_by_request(&key.id).await?.is_some() { reused() } else { Ok(None) };
        };
        if row.request.as_ref().is_none_or(|asked| asked.fingerprint != key.fingerprint) {
            return reused();
        }
        let row = self.unwritten.complete(row);
        // One whose refusal is not written yet may be tried again as soon as it is.
        if row.request.is_none() { Ok(None) } else { Ok(Some(Started { job: read_back(&row)?, replayed: true })) }
    }

    /// What holds for scans by the sensor where neither the request nor its recipe says otherwise.
    pub(super) fn sensor_defaults(&self) -> Settings {
        let stated = self.defaults.type_b;
        let type_b = self.cell_side().map_or(stated, |side| side.config.type_b_of_scans(stated));
        Settings { type_b, ..self.defaults }
    }

    /// A measurement, whether it ran or not; waits for its end, no longer than `wait`.
    ///
    /// # Errors
    /// [`ServiceError::MeasurementUnknown`].
    pub async fn any_measurement(&self, id: &str, wait: Duration) -> Result<AnyMeasurement, ServiceError> {
        let scan = self.job(Kind::Scan, id, wait).await?;
        match (self.recorded(id).await?, scan) {
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
        standing: JobStanding,
        page: &Page,
    ) -> Result<Listing<Entry<SensorScan>>, ServiceError> {
        self.list_jobs(Kind::Scan, Some(standing), page).await
    }

    /// Why there is no record of a measurement: it still scans, failed, or never was.
    pub(super) async fn why_not_measured(&self, id: &str) -> ServiceError {
        let id = id.to_owned();
        match self.scan_job(&id).await {
            Err(error) => error,
            Ok(None) => ServiceError::MeasurementUnknown { id },
            // Where it is done, it was recorded this very moment.
            Ok(Some(Recorded { standing: JobStanding::Running | JobStanding::Done, .. })) => {
                ServiceError::MeasurementRunning { id }
            }
            Ok(Some(Recorded { standing, ending, .. })) => {
                let (reason, text) = ending.map_or_else(
                    || (standing.name().to_owned(), format!("it is {}", standing.name())),
                    |Ending { code, text }| (code, text),
                );
                ServiceError::MeasurementFailed { id, standing, reason, text }
            }
        }
    }

    /// The scan by the sensor that a measurement is of; `None` where it was made from a file, or from a kept scan.
    pub(super) async fn scan_job(&self, id: &str) -> Result<Option<SensorScan>, ServiceError> {
        self.job(Kind::Scan, id, Duration::ZERO).await
    }

    async fn begin_scan(
        self: &Arc<Self>,
        lease_id: String,
        request: Option<RequestKey>,
        mut order: SensorOrder,
        accepted: Accepted,
    ) -> Result<Started<SensorOrder>, ServiceError> {
        let side = self.cell_side()?;
        order.by = self.authorise(&lease_id, request.as_ref()).await?;
        let id = self.clock.new_id("m-");
        let beginning = Beginning { kind: Kind::Scan, id, plan_id: None, request, order: &order };
        let started = self.write_down(beginning).await?;
        if started.replayed {
            return Ok(started);
        }
        // Memory for the points is set aside before anything moves.
        let Some(claim) = self.memory.sensor.claim_free() else {
            let busy = ServiceError::ScansBusy;
            let ending = Ending { code: "busy".to_owned(), text: busy.to_string() };
            self.conclude(&started.job, JobStanding::Refused, Some(&ending)).await;
            return Err(busy);
        };
        let SensorOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s, .. } = order;
        let way = ScanOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s };
        match side.cell.start_scan(&lease_id, &started.job.id, way).await {
            Ok((job, profiles)) => {
                // While the stage scans, nothing moves the part.
                let acquisition = Acquisition { positions: order.positions, ..self.acquisition_now() };
                let limits = claim.limits(&self.capacity.scan);
                let task = Task { job: started.job.clone(), accepted, acquisition, limits };
                let follower = Arc::clone(self);
                self.followers.add(async move { follower.follow_scan(job, profiles, task, claim).await });
                Ok(started)
            }
            Err(refusal) => {
                let (standing, ending) = Ending::of_refusal(&refusal);
                self.conclude(&started.job, standing, Some(&ending)).await;
                Err(refusal.into())
            }
        }
    }

    /// Waits for the cell's last word on the scan, and calculates meanwhile: when the last profile is here the sensor and the
    /// stage are still to be asked whether all is well, and the pose need not wait for that.
    async fn follow_scan(self: &Arc<Self>, job: Job, profiles: mpsc::Receiver<Vec<Profile>>, task: Task, claim: Claim) {
        let id = task.job.id.clone();
        let (arrived, ()) = tokio::join!(self.take_in(profiles, &task, claim), self.tell_progress(&job));
        let outcome = match (job.ended().await, arrived) {
            (JobEnd::Done, Ok(arrived)) => self.finish(arrived, &task).await,
            (JobEnd::Done, Err(ending)) => self.give_up(&task.job, JobStanding::Failed, ending).await,
            (end, _) => {
                let (standing, ending) = Ending::of(&end);
                let ending = ending.unwrap_or_else(|| Ending { code: "failed".to_owned(), text: end.to_string() });
                self.give_up(&task.job, standing, ending).await
            }
        };
        self.tell(outcome);
        tracing::debug!(measurement = id, "the measurement by the sensor is over");
    }

    /// Takes the profiles; when all are here, their calculation waits for its turn while they are written to a file.
    async fn take_in(
        self: &Arc<Self>,
        profiles: mpsc::Receiver<Vec<Profile>>,
        task: &Task,
        mut claim: Claim,
    ) -> Result<Arrived, Ending> {
        let arriving = collect(profiles, &task.limits).await.map_err(|error| ending_of(&error))?;
        let decoded =
            arriving.finish().map_err(|error| ending_of(&super::measure::MeasureError::from(error).into()))?;
        let tolerance_mm = self.cell_side().map_err(|error| ending_of(&error))?.config.scan.place_tolerance_mm;
        misplaced(&decoded.cloud, &task.job.order, tolerance_mm).map_or(Ok(()), Err)?;
        claim.keep_for(decoded.cloud.columns.len());
        self.begin_calculation(decoded, task, claim).await.map_err(|error| ending_of(&error))
    }

    async fn begin_calculation(
        self: &Arc<Self>,
        decoded: Decoded,
        task: &Task,
        claim: Claim,
    ) -> Result<Arrived, ServiceError> {
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
        Ok(Arrived { row, points, calculation })
    }

    /// The scan is whole: records what was measured. Where that is not there yet, or failed, the raw points are kept first.
    async fn finish(self: &Arc<Self>, arrived: Arrived, task: &Task) -> Happening {
        let Arrived { row, mut points, mut calculation } = arrived;
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
            Err(error) => self.give_up(&task.job, JobStanding::Failed, ending_of(&error)).await,
        }
    }

    /// Keeps the raw points of a scan, with their record, before there is a measurement of them.
    async fn keep_points(&self, row: &ScanRow, points: Points) -> Points {
        let Points::InFile(file) = &points else { return points };
        match self.store.keep_scan(row.clone(), Arc::clone(file)).await {
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
        task: &Task,
    ) -> Result<(End, Happening), ServiceError> {
        let Calculated { mut measurement, profiles } = calculated;
        measurement.scan_sha256 = row.id.trim_start_matches("s-").to_owned();
        let new = new_measurement(&measurement, profiles, Some(row), None)?;
        let job = self.ended(&task.job, JobStanding::Done, None)?;
        let happening = Happening::Measured { measurement_id: measurement.id.clone(), verdict: measurement.verdict() };
        Ok((End { job, frees: false, measured: Some(MeasuredScan { new, points }) }, happening))
    }

    async fn give_up(self: &Arc<Self>, job: &SensorScan, standing: JobStanding, ending: Ending) -> Happening {
        self.conclude(job, standing, Some(&ending)).await;
        let Ending { code, text } = ending;
        Happening::NotMeasured { measurement_id: job.id.clone(), code, text }
    }

    /// On threads of its own: uploads and what is measured again do not delay the line.
    async fn calculate_for_line(
        &self,
        decoded: Decoded,
        mut identity: Identity,
        accepted: Accepted,
        claim: Claim,
    ) -> Result<Calculated, ServiceError> {
        let (limits, clock) = (self.capacity.scan.clone(), self.clock);
        self.line
            .run(move |stop| {
                let (watch, _claim) = (clock.start(), claim);
                let measured = super::measure(decoded, &accepted.resolved, &limits, &Progress::until(stop))?;
                identity.duration_ms = watch.elapsed_ms();
                Calculated::of(identity, measured, &accepted.resolved)
            })
            .await?
    }
}

/// Takes the profiles as they come; after one that cannot be used the others are let pass.
async fn collect(mut profiles: mpsc::Receiver<Vec<Profile>>, limits: &Limits) -> Result<Arriving, ServiceError> {
    let mut collected = Ok(Arriving::new(limits.clone()));
    while let Some(new) = profiles.recv().await {
        for profile in &new {
            collected = collected.and_then(|mut arriving: Arriving| {
                arriving.take(profile).map_err(super::measure::MeasureError::from)?;
                Ok(arriving)
            });
        }
    }
    collected
}

/// The points as the bytes of a file, and their SHA-256.
async fn encoded(cloud: Cloud) -> Result<(Vec<u8>, String), ServiceError> {
    aside(move || {
        let mut bytes = Vec::new();
        // Memory takes whatever is written to it.
        let _ = encode_cloud(&cloud, &mut bytes);
        let sha256_hex = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok((bytes, sha256_hex))
    })
    .await
}

fn ending_of(error: &ServiceError) -> Ending {
    let code = match error {
        ServiceError::Content(_) => "scan_unusable",
        ServiceError::Store(cause) => cause.code(),
        ServiceError::Compute(ComputeError::TooLong { .. }) => "calculation_too_long",
        ServiceError::Compute(_) => "calculation_failed",
        _ => "failed",
    };
    Ending { code: code.to_owned(), text: error.to_string() }
}
