//! The product's verbs: keep a scan, measure, recall, draw; lease the cell, scan, plan, move, stop. Makes ids and times, owns
//! the compute pool, the store and the way to the cell.
//!
//! ```text
//! pieces --Upload--> a file --read--> Decoded --slice--> Scan --estimate--> Estimate --record--> Measurement, acknowledged
//!                     behind its writer    \_____ on the compute pool _____/                      when durable
//! order --write down--> job --start--> cell --end--> job, written down
//! ```

mod acquisition;
mod acts;
mod answer;
mod arriving;
mod clock;
mod closing;
mod compute;
mod doctor;
mod document;
mod equipment;
mod error;
mod events;
mod findings;
mod followers;
mod in_words;
mod jobs;
mod leases;
mod live;
mod measure;
mod measurement;
mod memory;
mod moves;
mod offline;
mod pictures;
mod plain;
mod plans;
mod points;
mod propose;
mod reading;
mod recipe;
mod recipes;
mod records;
mod scan_order;
mod scans;
mod sensor;
mod side;
mod tee;
#[cfg(test)]
mod tests;
mod unwritten;
mod upload;
mod view;

pub use acquisition::Acquisition;
pub use answer::{Accepted, Answer, Order, RequestId};
pub use clock::Stopwatch;
pub use compute::{Compute, ComputeError, Load, Place, QueueLimits, Turn};
pub use doctor::{Examined, accept_loss, examine};
pub use document::{Entry, Unreadable, UnreadableRecord};
pub use equipment::{Equipment, EquipmentError};
pub use error::{ContentError, ServiceError};
pub use events::{After, Event, Events, Happening};
pub use findings::{Chosen, Finding, Findings, MeasuredPart};
pub use in_words::{in_words, without_mark};
pub use jobs::{Commander, Ending, JobStanding, Recorded, Started, stop_code};
pub use leases::{HOLDER_CHARACTERS_MAX, HeldLease};
pub use live::CellView;
pub use measure::{Decoded, MeasureError, Measured, Prepared, measure, read};
pub use measurement::{Identity, Measurement, SOFTWARE, Tally, Verdict};
pub use moves::{Move, MoveOrder, MoveRequest};
pub use offline::{Offline, measure_offline};
pub use plain::plain;
pub use plans::{PlanAnswer, PlanInList, PlanRequest, Stale, StoredPlan, Target};
pub use propose::{PROPOSALS_MAX, Proposal, cylinder_decimals, propose, read_cloud};
pub use recipe::{DESCRIPTION_CHARACTERS_MAX, Recipe, RecipeError, Resolved};
pub use recipes::{Put, RecipeName, StoredRecipe};
pub use records::Last;
pub use scan_order::{ScanWay, SensorOrder, SensorRequest};
pub use scans::{Content, Kept, Origin};
pub use sensor::{AnyMeasurement, SensorScan};
pub use upload::{Arrived, Upload};
pub use view::{PictureRequest, View};

use crate::config::Config;
use crate::estimation::Settings;
use crate::scan::decode::Limits;
use crate::store::{Store, Usage};
use clock::Clock;
use closing::{Closing, Stage};
use events::EventLog;
use followers::Followers;
use jiff::Timestamp;
use measure::cut;
use memory::MemoryShares;
use side::CellSide;
use std::path::Path;
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::timeout;
use unwritten::UnwrittenEnds;
use upload::Uploads;

/// What a service may take on.
#[derive(Debug, Clone, PartialEq)]
pub struct Capacity {
    /// Bytes of an upload as sent.
    pub body_bytes_max: u64,
    /// What a scan file may cost.
    pub scan: Limits,
    /// Threads that calculate; 0 takes one a core.
    pub threads: usize,
    /// Calculations at a time.
    pub running_max: usize,
    /// Calculations that wait.
    pub queue_max: usize,
    /// Uploads under way: being received, unpacked, measured.
    pub uploads_max: usize,
    /// Pictures that are drawn at a time.
    pub pictures_running_max: usize,
    /// Pictures that wait.
    pub pictures_queue_max: usize,
    /// Memory that points may take, MiB.
    pub memory_mib: u64,
    /// For one calculation.
    pub calculation: Duration,
    /// For everything that has to be done when the service is told to end.
    pub shutdown: Duration,
}

impl Capacity {
    /// What a configuration lets a service take on.
    #[must_use]
    pub fn from_config(config: &Config) -> Self {
        let count = |value: u64| usize::try_from(value).unwrap_or(usize::MAX);
        let limits = &config.limits;
        Self {
            body_bytes_max: limits.body_bytes_max,
            scan: config.scan.clone(),
            threads: count(limits.threads),
            running_max: count(limits.measurements_running_max),
            queue_max: count(limits.queue_max),
            uploads_max: count(limits.uploads_max),
            pictures_running_max: count(limits.pictures_running_max),
            pictures_queue_max: count(limits.pictures_queue_max),
            memory_mib: limits.memory_max_mb,
            calculation: Duration::from_millis(config.timeouts.calculation_ms),
            shutdown: Duration::from_millis(config.timeouts.shutdown_ms),
        }
    }
}

/// The service. Share it behind an `Arc`; every method may be called from many tasks at once.
#[derive(Debug)]
pub struct Service {
    store: Store,
    /// The queue of measurements.
    compute: Compute,
    /// The queue of pictures: however many are asked for, no measurement is refused for them.
    drawing: Compute,
    /// The queue of packed uploads. There is room for each of them to wait.
    unpacking: Compute,
    /// Threads of their own for scans by the sensor, so that the line waits neither for uploads nor for what was asked to be
    /// measured again.
    line: Compute,
    memory: MemoryShares,
    uploads: Uploads,
    capacity: Capacity,
    /// What holds where neither request nor recipe says otherwise.
    defaults: Settings,
    clock: Clock,
    instance_id: String,
    started_at: Timestamp,
    uptime: Stopwatch,
    /// Counts what was recorded, so that a poller sees that something changed.
    sequence: AtomicU64,
    last: Mutex<Option<Last>>,
    cell: Option<CellSide>,
    events: Arc<EventLog>,
    /// Tasks that see jobs of the cell to their end.
    followers: Followers,
    /// Ends of jobs that the store has not taken yet.
    unwritten: UnwrittenEnds,
    closing: Closing,
}

impl Service {
    /// A service without a cell, on the store of a folder.
    ///
    /// # Errors
    /// [`ServiceError`] where the folder cannot be used or the threads cannot be started.
    pub async fn open(folder: &Path, capacity: Capacity, defaults: Settings) -> Result<Arc<Self>, ServiceError> {
        Self::open_with(folder, capacity, defaults, None).await
    }

    /// Opens the store of a folder, starts the threads, and has the cell, where there is one, reach for its devices. Nothing
    /// moves; what an earlier process left under way is written down as interrupted.
    ///
    /// # Errors
    /// [`ServiceError`] where the folder cannot be used or the threads cannot be started.
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
        // Memory is set aside for each before it begins, so there are few.
        let line = start(1, usize::MAX)?;
        let memory = MemoryShares::of(capacity.memory_mib, &capacity.scan);
        let drawing = compute.beside(capacity.pictures_running_max, capacity.pictures_queue_max);
        let unpacking = compute.beside(capacity.running_max, capacity.uploads_max);
        // Points that wait in memory are bounded as those that are calculated with are.
        let uploads = Uploads::new(capacity.uploads_max, capacity.running_max, memory.readers.clone());
        let (clock, closing) = (Clock, Closing::new(capacity.shutdown));
        let cell = match equipment {
            Some(equipment) => {
                let side = CellSide::start(equipment, store.fence().await?);
                Some(side.map_err(|source| ServiceError::CellThreads(Arc::new(source)))?)
            }
            None => None,
        };
        let service = Arc::new(Self {
            store,
            compute,
            drawing,
            unpacking,
            line,
            memory,
            uploads,
            capacity,
            defaults,
            clock,
            instance_id: clock.new_id(""),
            started_at: clock.now(),
            uptime: clock.start(),
            sequence: AtomicU64::new(0),
            last: Mutex::new(None),
            cell,
            events: EventLog::new(),
            followers: Followers::new(),
            unwritten: UnwrittenEnds::default(),
            closing,
        });
        service.recall_last().await?;
        service.interrupt_jobs().await?;
        service.follow_cell();
        Ok(service)
    }

    /// What the pool has to do right now.
    #[must_use]
    pub fn load(&self) -> Load {
        self.compute.load()
    }

    /// Uploads under way: being received, unpacked, measured.
    #[must_use]
    pub fn uploads_count(&self) -> u64 {
        u64::try_from(self.uploads.count()).unwrap_or(u64::MAX)
    }

    /// Memory that is set aside for points now, and how much may be, bytes.
    #[must_use]
    pub fn memory_bytes(&self) -> (u64, u64) {
        (self.memory.taken_bytes(), self.capacity.memory_mib << 20)
    }

    /// How much room the store takes and has left.
    ///
    /// # Errors
    /// Where the operating system does not say.
    pub async fn store_usage(&self) -> Result<Usage, ServiceError> {
        Ok(self.store.usage().await?)
    }

    /// Refuses where a measurement asked for now would be refused.
    ///
    /// # Errors
    /// [`ComputeError::Busy`].
    pub fn check_free(&self) -> Result<(), ComputeError> {
        self.compute.check_free()
    }

    /// What the service may take on.
    #[must_use]
    pub const fn capacity(&self) -> &Capacity {
        &self.capacity
    }

    /// Made anew at every start, so that a client sees a restart.
    #[must_use]
    pub fn instance_id(&self) -> &str {
        &self.instance_id
    }

    /// When this instance was started.
    #[must_use]
    pub const fn started_at(&self) -> Timestamp {
        self.started_at
    }

    /// Grows with everything that is recorded.
    #[must_use]
    pub fn sequence(&self) -> u64 {
        self.sequence.load(Ordering::Relaxed)
    }

    /// A new name for a request.
    #[must_use]
    pub fn new_request_id(&self) -> String {
        self.clock.new_id("")
    }

    /// Begins to measure a duration.
    #[must_use]
    pub fn start_stopwatch(&self) -> Stopwatch {
        self.clock.start()
    }

    /// The time now.
    #[must_use]
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// Whether records and scans can be written, found out by writing.
    ///
    /// # Errors
    /// Why not.
    pub async fn check_ready(&self) -> Result<(), ServiceError> {
        Ok(self.store.probe().await?)
    }

    /// Stops what moves and lets the devices go, finishes what is being written, and refuses the rest; all within the time that is
    /// set for it.
    pub async fn close(&self) {
        self.stop_motion().await;
        self.followers.finish(self.time_left(Stage::Ends)).await;
        if timeout(self.time_left(Stage::Store), self.store.close()).await.is_err() {
            tracing::error!("the store is not closed yet; what was acknowledged is on the disk");
        }
        if let Some(side) = &self.cell {
            side.end_threads();
        }
    }

    /// Stops what moves, for good, and lets the devices go: the first thing to do when the service is told to end. Whoever
    /// waits for something is answered.
    pub async fn stop_motion(&self) {
        let left = self.time_left(Stage::Motion);
        self.closing.tell();
        if let Some(side) = &self.cell
            && timeout(left, side.cell.close()).await.is_err()
        {
            tracing::error!("the devices were told to stop and have not been seen at rest");
        }
    }

    /// How long requests under way may still take when the service ends. The time for the end begins with the first call of this
    /// or of [`Service::stop_motion`].
    #[must_use]
    pub fn time_for_requests(&self) -> Duration {
        self.time_left(Stage::Requests)
    }

    fn time_left(&self, stage: Stage) -> Duration {
        self.closing.left(self.clock.instant(), stage)
    }
}
