//! Measurements by the sensor: the cell scans, profiles become points as they come, and when the last one is here the pose is
//! estimated while the points are kept as a file. The record is there from the start, in a state in -ing; what fails on the
//! way fails by name. Must not know how a scan is taken, nor how anything is sent.

use super::answer::{fingerprint_of, new_measurement};
use super::arriving::Arriving;
use super::followers::whole;
use super::jobs::{Beginning, Ending, JobStanding, Kind, Recorded, Started, read_back};
use super::scan_order::{SensorOrder, SensorRequest, check, misplaced};
use super::{
    Accepted, Commander, Decoded, Happening, Identity, Measured, Measurement, RecipeName, Resolved, Service,
    ServiceError,
};
use crate::cell::{Job, JobEnd, ScanOrder};
use crate::device::Profile;
use crate::estimation::{Progress, Settings};
use crate::scan::Cloud;
use crate::scan::encode::encode_cloud;
use crate::store::{CompleteScan, Listing, Page, RequestKey, ScanRow};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::sleep;

/// A full pool is asked again after this.
const POOL_RETRY: Duration = Duration::from_millis(20);

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
    /// It scans, or it came to nothing.
    Scan(Box<SensorScan>),
}

/// What is needed once the profiles are here.
struct Task {
    job: SensorScan,
    accepted: Accepted,
}

/// What the profiles came to; not recorded before the cell says that the scan is whole.
struct Arrived {
    measured: Measured,
    duration_ms: u64,
    /// The points, not kept yet.
    file: CompleteScan,
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
        let mut accepted = self.accept_with(request.order.clone(), &self.sensor_defaults()).await?;
        accepted.resolved.look_along_rail();
        let fingerprint = fingerprint_of("sensor", &request);
        let key = request.order.request_id.clone().map(|id| RequestKey { id, fingerprint });
        if let Some(key) = &key
            && self.store.measurement_by_request(&key.id).await?.is_some()
        {
            // An upload has this id; a measurement by the sensor is another request.
            return Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
        }
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
        whole(async move { service.begin_scan(request.lease_id, key, order, accepted).await }).await
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
    pub async fn sensor_scans(&self, standing: JobStanding, page: &Page) -> Result<Listing<SensorScan>, ServiceError> {
        let Listing { rows, next } = self.store.jobs(Kind::Scan.name(), Some(standing.name()), page).await?;
        Ok(Listing { rows: rows.iter().map(read_back).collect::<Result<_, _>>()?, next })
    }

    /// Why there is no record of a measurement: it still scans, came to nothing, or never was.
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
        let SensorOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s, .. } = order;
        let way = ScanOrder { x_from_mm, x_to_mm, profiles_count, speed_mm_s };
        match side.cell.start_scan(&lease_id, &started.job.id, way).await {
            Ok((job, profiles)) => {
                let (follower, task) = (Arc::clone(self), Task { job: started.job.clone(), accepted });
                self.followers.add(async move { follower.follow_scan(job, profiles, task).await });
                Ok(started)
            }
            Err(refusal) => {
                let (standing, ending) = Ending::of_refusal(&refusal);
                self.conclude(&started.job, standing, Some(&ending)).await;
                Err(refusal.into())
            }
        }
    }

    /// Waits for the cell's last word on the scan, and measures meanwhile: when the last profile is here the sensor and the
    /// stage are still to be asked whether all is well, and the pose need not wait for that.
    async fn follow_scan(&self, job: Job, profiles: mpsc::Receiver<Vec<Profile>>, task: Task) {
        let id = task.job.id.clone();
        let (arrived, ()) = tokio::join!(self.measure_arriving(profiles, &task), self.tell_progress(&job));
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

    async fn measure_arriving(&self, profiles: mpsc::Receiver<Vec<Profile>>, task: &Task) -> Result<Arrived, Ending> {
        let arriving = self.collect(profiles).await.map_err(|error| ending_of(&error))?;
        let decoded = arriving.finish().map_err(|error| ending_of(&super::MeasureError::from(error).into()))?;
        let tolerance_mm = self.cell_side().map_err(|error| ending_of(&error))?.config.scan.place_tolerance_mm;
        misplaced(&decoded.cloud, &task.job.order, tolerance_mm).map_or(Ok(()), Err)?;
        self.measure_decoded(decoded, task).await.map_err(|error| ending_of(&error))
    }

    async fn measure_decoded(&self, decoded: Decoded, task: &Task) -> Result<Arrived, ServiceError> {
        let cloud = decoded.cloud.clone();
        let (measured, file) = tokio::join!(self.estimate(decoded, &task.accepted.resolved), self.keep(cloud));
        let (measured, duration_ms) = measured?;
        Ok(Arrived { measured, duration_ms, file: file? })
    }

    /// Takes the profiles as they come; after one that cannot be used the others are let pass.
    async fn collect(&self, mut profiles: mpsc::Receiver<Vec<Profile>>) -> Result<Arriving, ServiceError> {
        let mut collected = Ok(Arriving::new(self.capacity.scan.clone()));
        while let Some(new) = profiles.recv().await {
            for profile in &new {
                collected = collected.and_then(|mut arriving: Arriving| {
                    arriving.take(profile).map_err(super::MeasureError::from)?;
                    Ok(arriving)
                });
            }
        }
        collected
    }

    /// The scan is whole: records what was measured.
    async fn finish(&self, arrived: Arrived, task: &Task) -> Happening {
        match self.record_arrived(arrived, task).await {
            Ok(measurement) => {
                self.note(&measurement);
                self.has_ended();
                let verdict = measurement.verdict();
                Happening::Measured { measurement_id: measurement.id, verdict }
            }
            Err(error) => {
                if matches!(error, ServiceError::Store(_)) {
                    tracing::error!(measurement = task.job.id, %error, "a measurement by the sensor is not recorded");
                }
                self.give_up(&task.job, JobStanding::Failed, ending_of(&error)).await
            }
        }
    }

    async fn give_up(&self, job: &SensorScan, standing: JobStanding, ending: Ending) -> Happening {
        self.conclude(job, standing, Some(&ending)).await;
        let Ending { code, text } = ending;
        Happening::NotMeasured { measurement_id: job.id.clone(), code, text }
    }

    async fn record_arrived(&self, arrived: Arrived, task: &Task) -> Result<Measurement, ServiceError> {
        let Arrived { measured: Measured { prepared, estimate }, duration_ms, file } = arrived;
        let identity = Identity {
            id: task.job.id.clone(),
            created_at: task.job.created_at,
            duration_ms,
            scan_sha256: file.id().trim_start_matches("s-").to_owned(),
            recipe_name: task.job.order.recipe_name.clone(),
        };
        let (measurement, profiles) = Measurement::record(identity, &prepared, estimate, &task.accepted.resolved);
        let row = ScanRow {
            id: file.id(),
            created_at: measurement.created_at,
            bytes_count: file.bytes_count(),
            format: measurement.format.name().to_owned(),
            points_count: Some(measurement.points_count),
            description: Some(TAKEN_BY_SENSOR.to_owned()),
        };
        let new = new_measurement(&measurement, &profiles, Some(row), None)?;
        self.store.end_job_with(self.ended(&task.job, JobStanding::Done, None)?, new, file).await?;
        Ok(measurement)
    }

    /// Waits for its turn as long as it takes: the scan is taken, and cannot be asked for again as a file can.
    async fn estimate(&self, decoded: Decoded, resolved: &Resolved) -> Result<(Measured, u64), ServiceError> {
        while self.compute.check_free().is_err() {
            sleep(POOL_RETRY).await;
        }
        let (resolved, limits, clock) = (resolved.clone(), self.capacity.scan.clone(), self.clock);
        self.compute
            .run(move || {
                let watch = clock.start();
                let measured = super::measure(decoded, &resolved, &limits, &Progress::default())?;
                Ok((measured, watch.elapsed_ms()))
            })
            .await?
    }

    /// The points as a file that is not kept yet.
    async fn keep(&self, cloud: Cloud) -> Result<CompleteScan, ServiceError> {
        let encoded = tokio::task::spawn_blocking(move || {
            let mut bytes = Vec::new();
            // Memory takes whatever is written to it.
            let _ = encode_cloud(&cloud, &mut bytes);
            bytes
        });
        let bytes = encoded.await.map_err(|_| super::ComputeError::Panicked)?;
        let mut writer = self.store.begin_scan(u64::MAX).await?;
        writer.write(&bytes).await?;
        Ok(writer.complete().await?)
    }
}

fn ending_of(error: &ServiceError) -> Ending {
    let code = match error {
        ServiceError::Content(_) => "scan_unusable",
        ServiceError::Store(cause) => cause.code(),
        ServiceError::Compute(_) => "calculation_failed",
        _ => "failed",
    };
    Ending { code: code.to_owned(), text: error.to_string() }
}
