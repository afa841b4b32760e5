//! State shared by measuring and operating: the store, the clock, the numbered events and the capacity limits.

use super::background::{BackgroundTasks, Shutdown, Stage};
use super::clock::{Clock, Stopwatch};
use super::events::{After, EventLog, Events, Happening};
use super::memory::MemoryShares;
use super::unwritten::UnwrittenEnds;
use crate::config::Config;
use crate::estimation::Settings;
use crate::scan::decode::Limits;
use crate::store::Store;
use jiff::Timestamp;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::time::timeout;

/// The state that measuring and operating share.
#[derive(Debug)]
pub(in crate::service) struct Shared {
    pub(in crate::service) store: Store,
    pub(in crate::service) clock: Clock,
    pub(in crate::service) capacity: Capacity,
    /// Settings that apply unless the request or the recipe overrides them.
    pub(in crate::service) defaults: Settings,
    pub(in crate::service) memory: MemoryShares,
    pub(in crate::service) events: Arc<EventLog>,
    /// Tasks that run to their end independent of the request that started them.
    pub(in crate::service) background: BackgroundTasks,
    /// Ends of jobs that the store has not recorded yet.
    pub(in crate::service) unwritten: UnwrittenEnds,
    pub(in crate::service) shutdown: Shutdown,
    pub(in crate::service) instance_id: String,
    pub(in crate::service) started_at: Timestamp,
    pub(in crate::service) uptime: Stopwatch,
    /// Counts records, so that a polling client detects changes.
    sequence: AtomicU64,
}

impl Shared {
    pub(in crate::service) fn new(store: Store, capacity: Capacity, defaults: Settings) -> Self {
        let clock = Clock;
        Self {
            store,
            clock,
            memory: MemoryShares::of(capacity.memory_mib, &capacity.scan),
            shutdown: Shutdown::new(capacity.shutdown),
            capacity,
            defaults,
            events: EventLog::new(),
            background: BackgroundTasks::new(),
            unwritten: UnwrittenEnds::default(),
            instance_id: clock.new_id(""),
            started_at: clock.now(),
            uptime: clock.start(),
            sequence: AtomicU64::new(0),
        }
    }

    /// Adds an event that happened now.
    pub(in crate::service) fn announce(&self, what: Happening) {
        self.events.add(self.clock.now(), what);
    }

    /// Counts a new record.
    pub(in crate::service) fn advance(&self) {
        self.sequence.fetch_add(1, Ordering::Relaxed);
    }

    /// How many records were written since the start.
    pub(in crate::service) fn sequence(&self) -> u64 {
        self.sequence.load(Ordering::Relaxed)
    }

    /// How long a stage of the shutdown may still take.
    pub(in crate::service) fn time_left(&self, stage: Stage) -> Duration {
        self.shutdown.left(self.clock.instant(), stage)
    }

    /// At most `limit` of the events after `after`; waits for the first of them, no longer than `wait` and no longer
    /// than the service runs.
    pub(in crate::service) async fn events(&self, after: After, limit: usize, wait: Duration) -> Events {
        let mut newest = self.events.newest.subscribe();
        // A client that names an event of another instance is answered at once.
        let seen = *newest.borrow();
        if after == After::Number(seen) && !wait.is_zero() {
            let more = newest.wait_for(|newest| *newest != seen);
            let _ = timeout(wait, async {
                tokio::select! {
                    _ = more => {}
                    () = self.shutdown.wait() => {}
                }
            })
            .await;
        }
        self.events.after(after, limit)
    }
}

/// Capacity limits of the service.
#[derive(Debug, Clone, PartialEq)]
pub struct Capacity {
    /// Maximum size of an upload as sent, bytes.
    pub body_bytes_max: u64,
    /// Limits of a scan file.
    pub scan: Limits,
    /// Threads that calculate; 0 is one per core.
    pub threads: usize,
    /// Simultaneous calculations.
    pub running_max: usize,
    /// Calculations that wait.
    pub queue_max: usize,
    /// Uploads under way: being received, decompressed, measured.
    pub uploads_max: usize,
    /// Pictures drawn at a time.
    pub pictures_running_max: usize,
    /// Pictures that wait.
    pub pictures_queue_max: usize,
    /// Memory for points, MiB.
    pub memory_mib: u64,
    /// Time limit of one calculation.
    pub calculation: Duration,
    /// Time limit of the shutdown.
    pub shutdown: Duration,
}

impl Capacity {
    /// The capacity limits of a configuration.
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
