//! The use cases of coaxis. `measuring` goes from scans to records and needs no cell; `operating` leases, moves and stops the cell
//! and scans with its sensor. Both use `Shared`: the store, the clock, the events, the limits.
//!
//! ```text
//! pieces --Upload--> a file --decode--> Decoded --slice--> Scan --estimate--> Estimate --record--> Measurement, acknowledged
//!                     during upload        \_____ on the compute pool _____/                      when durable
//! order --record--> job --start--> cell --end--> job, recorded
//! ```

mod acquisition;
mod background;
mod clock;
mod compute;
mod doctor;
mod document;
mod error;
mod events;
mod measuring;
mod memory;
mod operating;
mod shared;
#[cfg(test)]
mod tests;
mod unwritten;
mod wording;

pub use acquisition::Acquisition;
pub use acquisition::Stale;
pub use clock::Stopwatch;
pub use compute::{Compute, ComputeError, Load, Place, QueueLimits, Turn};
pub use doctor::{Examined, accept_loss, examine};
pub use document::{Entry, UnreadableRecord};
pub use error::Unreadable;
pub use error::{ContentError, ServiceError};
pub use events::{After, Event, Events, Happening};
pub use measuring::offline::{Offline, measure_offline};
pub use measuring::order::Origin;
pub use measuring::order::{Answer, MeasurementOrder, RequestId, ResolvedOrder};
pub use measuring::pictures::{PictureRequest, View};
pub use measuring::pipeline::{Decoded, MeasureError, Measured, Prepared, measure, read};
pub use measuring::propose::{PROPOSALS_MAX, Proposal, cylinder_decimals, propose, read_cloud};
pub use measuring::recipe::RecipeName;
pub use measuring::recipe::{DESCRIPTION_CHARACTERS_MAX, Recipe, RecipeError, Resolved};
pub use measuring::recipes::{Put, StoredRecipe};
pub use measuring::record::Last;
pub use measuring::record::{Chosen, MeasuredPart, MeasurementResult, PoseResult};
pub use measuring::record::{Identity, Measurement, ProfileCounts, SOFTWARE, Verdict};
pub use measuring::scans::{Content, Kept};
pub use measuring::state::Measuring;
pub use measuring::upload::{ReceivedScan, Upload};
pub use operating::cell_handle::CellView;
pub use operating::equipment::{Equipment, EquipmentError};
pub use operating::job::{Commander, EndReason, JobRecord, JobStatus, StartedJob, stop_code};
pub use operating::leases::{HOLDER_CHARACTERS_MAX, HeldLease};
pub use operating::moves::{Move, MoveOrder, MoveRequest};
pub use operating::plans::{PlanAnswer, PlanInList, PlanRequest, StoredPlan, Target};
pub use operating::scan_order::{ScanWay, SensorOrder, SensorRequest};
pub use operating::sensor::{AnyMeasurement, SensorScan};
pub use operating::state::Operating;
pub use shared::Capacity;
pub use wording::plain;
pub use wording::{in_words, without_mark};

use crate::estimation::Settings;
use crate::store::{Store, Usage};
use background::Stage;
use jiff::Timestamp;
use operating::cell_handle::CellHandle;
use shared::Shared;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// The service. Share it in an `Arc`; every method may be called from many tasks at once.
#[derive(Debug)]
pub struct Service {
    /// From scans to measurements, and all stored scans and records.
    pub measuring: Arc<Measuring>,
    /// The cell: its lease, plans, moves, scans by its sensor.
    pub operating: Arc<Operating>,
    shared: Arc<Shared>,
}

impl Service {
    /// A service without a cell, on the store of a folder.
    ///
    /// # Errors
    /// [`ServiceError`] if the folder cannot be used or the threads cannot be started.
    pub async fn open(folder: &Path, capacity: Capacity, defaults: Settings) -> Result<Arc<Self>, ServiceError> {
        Self::open_with(folder, capacity, defaults, None).await
    }

    /// Opens the store of a folder, starts the threads, and lets the cell, if there is one, connect to its devices. Nothing
    /// moves; jobs that an earlier process left unfinished are recorded as interrupted.
    ///
    /// # Errors
    /// [`ServiceError`] if the folder cannot be used or the threads cannot be started.
    pub async fn open_with(
        folder: &Path,
        capacity: Capacity,
        defaults: Settings,
        equipment: Option<Equipment>,
    ) -> Result<Arc<Self>, ServiceError> {
        let store = Store::open(folder).await?;
        let start = |running_max, queue_max| {
            let limits = QueueLimits { running_max, queue_max, deadline: capacity.calculation };
            Compute::start(capacity.threads, limits).map_err(|source| ServiceError::Threads(Arc::new(source)))
        };
        let compute = start(capacity.running_max, capacity.queue_max)?;
        // Memory is reserved for each scan by the sensor before it begins, so there are few.
        let line = start(1, usize::MAX)?;
        let cell = match equipment {
            Some(equipment) => {
                let cell = CellHandle::start(equipment, store.fence().await?);
                Some(cell.map_err(|source| ServiceError::CellThreads(Arc::new(source)))?)
            }
            None => None,
        };
        let shared = Arc::new(Shared::new(store, capacity, defaults));
        let type_b = cell.as_ref().map_or(defaults.type_b, |cell| cell.config.type_b_of_scans(defaults.type_b));
        let measuring = Arc::new(Measuring::new(Arc::clone(&shared), compute, Settings { type_b, ..defaults }));
        let operating =
            Arc::new(Operating { shared: Arc::clone(&shared), measuring: Arc::clone(&measuring), cell, line });
        measuring.recall_last().await?;
        operating.interrupt_jobs().await?;
        operating.follow_cell();
        Ok(Arc::new(Self { measuring, operating, shared }))
    }

    /// Resolves a measurement order for a scan that arrives now.
    ///
    /// # Errors
    /// Those of [`Measuring::accept`].
    pub async fn accept(&self, order: MeasurementOrder) -> Result<ResolvedOrder, ServiceError> {
        self.measuring.accept(order, self.operating.acquisition_now()).await
    }

    /// Memory reserved for points now, and the maximum, bytes.
    #[must_use]
    pub fn memory_bytes(&self) -> (u64, u64) {
        (self.shared.memory.taken_bytes(), self.shared.capacity.memory_mib << 20)
    }

    /// Used and free space of the store.
    ///
    /// # Errors
    /// If the operating system does not report it.
    pub async fn store_usage(&self) -> Result<Usage, ServiceError> {
        Ok(self.shared.store.usage().await?)
    }

    /// The capacity limits of the service.
    #[must_use]
    pub fn capacity(&self) -> &Capacity {
        &self.shared.capacity
    }

    /// Created anew at every start, so that a client detects a restart.
    #[must_use]
    pub fn instance_id(&self) -> &str {
        &self.shared.instance_id
    }

    /// When this instance was started.
    #[must_use]
    pub fn started_at(&self) -> Timestamp {
        self.shared.started_at
    }

    /// Increases with every record.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.shared.sequence()
    }

    /// A new request id.
    #[must_use]
    pub fn new_request_id(&self) -> String {
        self.shared.clock.new_id("")
    }

    /// Starts to measure a duration.
    #[must_use]
    pub fn start_stopwatch(&self) -> Stopwatch {
        self.shared.clock.start()
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        self.shared.clock.now()
    }

    /// At most `limit` of the events after `after`; waits for the first of them, no longer than `wait` and no longer
    /// than the service runs.
    pub async fn events(&self, after: After, limit: usize, wait: Duration) -> Events {
        self.shared.events(after, limit, wait).await
    }

    /// Whether the service is shutting down, so that no request should wait any longer.
    #[must_use]
    pub fn is_closing(&self) -> bool {
        self.shared.shutdown.has_begun()
    }

    /// Checks by writing whether records and scans can be stored.
    ///
    /// # Errors
    /// The reason if not.
    pub async fn check_ready(&self) -> Result<(), ServiceError> {
        Ok(self.shared.store.probe().await?)
    }

    /// Stops all motion and releases the devices, finishes pending writes, and refuses the rest, all within the configured time.
    pub async fn close(&self) {
        self.stop_motion().await;
        self.shared.background.finish(self.shared.time_left(Stage::Ends)).await;
        if timeout(self.shared.time_left(Stage::Store), self.shared.store.close()).await.is_err() {
            tracing::error!("the store is not closed yet; all acknowledged records are on the disk");
        }
        self.operating.end_threads();
    }

    /// Stops all motion permanently and releases the devices: the first step of the shutdown. Waiting requests are answered.
    pub async fn stop_motion(&self) {
        let left = self.shared.time_left(Stage::Motion);
        self.shared.shutdown.begin();
        self.operating.close_cell(left).await;
    }

    /// How long requests under way may still take during the shutdown. The time budget begins with the first call of this method
    /// or of [`Service::stop_motion`].
    #[must_use]
    pub fn time_for_requests(&self) -> Duration {
        self.shared.time_left(Stage::Requests)
    }
}
