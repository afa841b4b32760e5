//! State of the measuring service: its queues, the uploads under way and the newest measurement.

use std::sync::{Arc, Mutex};

use super::pipeline::{Decoded, MeasureError};
use super::points::{Attempt, Context, Points, ReadPoints};
use super::record::Last;
use super::upload::Uploads;
use crate::estimation::{Settings, Stop};
use crate::service::compute::{Compute, ComputeError, Load, Place};
use crate::service::error::ServiceError;
use crate::service::shared::Shared;

/// Measures uploaded and stored scans, and looks up, lists and draws the results. Needs no cell.
#[derive(Debug)]
pub struct Measuring {
    pub(in crate::service) shared: Arc<Shared>,
    /// The queue of measurements.
    pub(in crate::service) compute: Compute,
    /// The queue of pictures, separate so that pictures never block a measurement.
    pub(in crate::service) drawing: Compute,
    /// The queue of compressed uploads, with a place for each of them.
    pub(in crate::service) unpacking: Compute,
    pub(in crate::service) uploads: Uploads,
    /// Settings for scans by the sensor that apply unless the request or its recipe overrides them.
    pub(in crate::service) sensor_defaults: Settings,
    pub(in crate::service) last: Mutex<Option<Last>>,
}

impl Measuring {
    /// The measuring service on the threads of `compute`.
    pub(in crate::service) fn new(shared: Arc<Shared>, compute: Compute, sensor_defaults: Settings) -> Self {
        let capacity = &shared.capacity;
        let drawing = compute.beside(capacity.pictures_running_max, capacity.pictures_queue_max);
        let unpacking = compute.beside(capacity.running_max, capacity.uploads_max);
        // Points that wait in memory have the same limit as points in a calculation.
        let uploads = Uploads::new(capacity.uploads_max, capacity.running_max, shared.memory.readers.clone());
        Self { shared, compute, drawing, unpacking, uploads, sensor_defaults, last: Mutex::new(None) }
    }

    /// The current load of the queue of measurements.
    #[must_use]
    pub fn load(&self) -> Load {
        self.compute.load()
    }

    /// Uploads under way: being received, decompressed, measured.
    #[must_use]
    pub fn uploads_count(&self) -> u64 {
        u64::try_from(self.uploads.count()).unwrap_or(u64::MAX)
    }

    /// Refuses if a measurement requested now would be refused.
    ///
    /// # Errors
    /// [`ComputeError::Busy`].
    pub fn check_free(&self) -> Result<(), ComputeError> {
        self.compute.check_free()
    }
}

impl Measuring {
    /// Runs `work` on points when it is the turn of `place` and memory is available: first the amount that a file of this size
    /// usually needs, then repeatedly [`Claim::more`] up to the maximum for any file.
    pub(in crate::service) async fn with_points<T: Send + 'static>(
        &self,
        (queue, place): (&Compute, Place),
        points: Points,
        work: impl FnOnce(Decoded, &Context<'_>) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let clock = self.shared.clock;
        let (mut file, mut work) = match points {
            Points::InFile(file) => (file, work),
            Points::Read(read) => {
                let ReadPoints { decoded, claim } = *read;
                let work = move |stop: &Stop| {
                    let _claim = claim;
                    work(decoded.map_err(MeasureError::from)?, &Context { stop, watch: clock.start() })
                };
                return queue.run_in(queue.take_turn(&place).await?, work).await?;
            }
        };
        let mut points_count = file.points_expected();
        loop {
            // The turn comes first: memory of this share is then released without waiting for anything else.
            let turn = queue.take_turn(&place).await?;
            let mut claim = self.shared.memory.rest.claim(points_count).await?;
            let (limits, more) = (claim.limits(&self.shared.capacity.scan), claim.more());
            let attempt = move |stop: &Stop| {
                let context = Context { stop, watch: clock.start() };
                match file.decode(&limits, stop) {
                    Err(error) if claim.is_outgrown(&error) => Attempt::Outgrown(file, work),
                    Err(error) => Attempt::Over(Err(MeasureError::from(error).into())),
                    Ok(decoded) => {
                        claim.keep_for(decoded.cloud.columns.len());
                        Attempt::Over(work(decoded, &context))
                    }
                }
            };
            match queue.run_in(turn, attempt).await? {
                Attempt::Over(outcome) => return outcome,
                Attempt::Outgrown(back, again) => {
                    (file, work, points_count) = (back, again, more);
                }
            }
        }
    }
}
