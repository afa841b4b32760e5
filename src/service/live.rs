//! The cell as it is at this moment, with what turns its times into ages and into those of the wall; the lease, the stop, and
//! the commands to single devices. Must not know how any of it is sent.

use super::jobs::{Beginning, Ending, JobStanding, Kind, whole};
use super::{Clock, Commander, Equipment, Service, ServiceError};
use crate::cell::{Cell, Lease, LeaseRequest, Manual, Refusal, Snapshot, StopReport, Taken};
use crate::config::Cell as CellConfig;
use crate::motion::{Arrangement, Carrier, Pair, Position};
use crate::store::RequestKey;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tokio::time::Instant;

/// Longest name of a holder.
pub const HOLDER_CHARACTERS_MAX: usize = 64;

/// The cell, and what the service remembers about it.
#[derive(Debug)]
pub(super) struct CellSide {
    pub(super) cell: Cell,
    pub(super) config: CellConfig,
    pub(super) arrangement: Arrangement,
    /// When something that moves the part was last seen to begin or to end.
    pub(super) motion: Motion,
    /// Stops that are not recorded yet.
    stops: AtomicU64,
    /// Threads of the cell's own: whatever the requests are busy with, a lease runs out in time and a device is polled.
    runtime: Mutex<Option<Runtime>>,
}

/// When the part was last moved, as far as we had to do with it.
#[derive(Debug, Clone, Default)]
pub(super) struct Motion(Arc<Mutex<Option<Timestamp>>>);

/// The cell at one moment.
#[derive(Debug, Clone)]
pub struct CellView {
    /// As the cell published it.
    pub snapshot: Arc<Snapshot>,
    clock: Clock,
    now: Instant,
}

/// A lease as its holder is told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldLease {
    /// Names it in every command; a secret.
    pub id: String,
    /// Who holds it.
    pub holder: String,
    /// Goes to the devices with every command.
    pub fence: u64,
    /// How long it lasts after each use.
    pub time_to_live: Duration,
    /// When it ends unless it is used.
    pub until_at: Timestamp,
}

/// A command to a single device, or the reset, as it is kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct ActOrder {
    verb: String,
    manipulator: Option<Carrier>,
    /// How many commands it stands for, where it is more than one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    count: Option<u64>,
    #[serde(flatten)]
    by: Commander,
}

impl CellSide {
    /// Starts the cell on its devices; every fence to come is above `fence_floor`.
    ///
    /// # Errors
    /// Where its threads cannot be started.
    pub(super) fn start(equipment: Equipment, fence_floor: u64) -> io::Result<Self> {
        let Equipment { devices, config, .. } = equipment;
        let (settings, arrangement) = (config.settings(), config.arrangement());
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("cell").enable_all().build()?;
        let cell = {
            let _entered = runtime.enter();
            Cell::start(devices, settings, fence_floor)
        };
        let (motion, stops, runtime) = (Motion::default(), AtomicU64::new(0), Mutex::new(Some(runtime)));
        Ok(Self { cell, config, arrangement, motion, stops, runtime })
    }

    /// When something that moves the part was last seen to begin or to end.
    pub(super) fn moved_at(&self) -> Option<Timestamp> {
        *self.motion.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the cell's threads, waiting for none of them.
    pub(super) fn end_threads(&self) {
        let runtime = self.runtime.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(runtime) = runtime {
            runtime.shutdown_background();
        }
    }

    /// Where the manipulators are by their last readings; `None` where one never answered.
    pub(super) fn positions(&self) -> Option<Pair<Position>> {
        let snapshot = self.cell.snapshot();
        let at = |carrier| snapshot.manipulators.get(carrier).reading.as_ref().map(|reading| reading.position());
        Some(Pair { m1: at(Carrier::M1)?, m2: at(Carrier::M2)? })
    }
}

impl Drop for CellSide {
    fn drop(&mut self) {
        self.end_threads();
    }
}

impl Motion {
    /// Something that moves the part begins or ends. What is noted late takes nothing back.
    pub(super) fn note(&self, at: Timestamp) {
        let mut moved_at = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *moved_at = (*moved_at).max(Some(at));
    }
}

impl CellView {
    /// How long ago a moment of the snapshot was.
    #[must_use]
    pub fn age(&self, at: Instant) -> Duration {
        self.now.saturating_duration_since(at)
    }

    /// How long it is until a moment of the snapshot.
    #[must_use]
    pub fn until(&self, at: Instant) -> Duration {
        at.saturating_duration_since(self.now)
    }

    /// A moment of the snapshot on the clock on the wall.
    #[must_use]
    pub fn wall(&self, at: Instant) -> Timestamp {
        self.clock.wall(at)
    }

    /// The moment of the view.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }
}

impl Service {
    /// The cell, where there is one.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub(super) fn cell_side(&self) -> Result<&CellSide, ServiceError> {
        self.cell.as_ref().ok_or(ServiceError::CellAbsent)
    }

    /// The cell at this moment.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub fn cell_view(&self) -> Result<CellView, ServiceError> {
        let snapshot = self.cell_side()?.cell.snapshot();
        Ok(CellView { snapshot, clock: self.clock, now: self.clock.instant() })
    }

    /// How the cell is set up.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub fn cell_config(&self) -> Result<&CellConfig, ServiceError> {
        Ok(&self.cell_side()?.config)
    }

    /// Gives the lease to `holder`, unless somebody else holds it. Its fence is remembered before anybody can command by it.
    ///
    /// # Errors
    /// [`ServiceError::Value`], [`ServiceError::Cell`] where somebody else holds it.
    pub async fn take_lease(
        self: &Arc<Self>,
        holder: String,
        time_to_live: Option<Duration>,
    ) -> Result<HeldLease, ServiceError> {
        let side = self.cell_side()?;
        let time_to_live = self.time_to_live(side, time_to_live)?;
        let plain = !holder.is_empty()
            && holder.chars().count() <= HOLDER_CHARACTERS_MAX
            && !holder.chars().any(char::is_control);
        if !plain {
            let (field, allowed) = ("holder", "1 to 64 characters that can be seen");
            return Err(ServiceError::Value { field, allowed: allowed.to_owned() });
        }
        let request = LeaseRequest { id: self.clock.new_id("l-"), holder, time_to_live };
        let service = Arc::clone(self);
        // Whoever hangs up here has a lease that he knows nothing of; it runs out.
        whole(async move {
            let side = service.cell_side()?;
            let lease = side.cell.take_lease(request).await?;
            service.store.raise_fence(lease.fence).await?;
            Ok(service.held(lease))
        })
        .await
    }

    /// Uses the lease, which renews it.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] where it is over or somebody else's.
    pub async fn renew_lease(&self, id: &str) -> Result<HeldLease, ServiceError> {
        Ok(self.held(self.cell_side()?.cell.renew_lease(id).await?))
    }

    /// Gives the lease back; what moves by it stops.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] where it is over or somebody else's.
    pub async fn release_lease(&self, id: &str) -> Result<(), ServiceError> {
        Ok(self.cell_side()?.cell.release_lease(id).await?)
    }

    /// Stops whatever moves. Needs no lease, waits for no device and for no store; it is recorded afterwards.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub async fn stop(self: &Arc<Self>) -> Result<StopReport, ServiceError> {
        let side = self.cell_side()?;
        let report = side.cell.stop().await;
        // One record at a time is written; the stops that come meanwhile share the next one.
        if side.stops.fetch_add(1, Ordering::AcqRel) == 0 {
            let service = Arc::clone(self);
            self.followers.add(async move { service.record_stops().await });
        }
        Ok(report)
    }

    async fn record_stops(&self) {
        let Ok(side) = self.cell_side() else { return };
        loop {
            let count = side.stops.load(Ordering::Acquire);
            let order = ActOrder { count: (count > 1).then_some(count), ..self.act("stop", None) };
            let id = self.clock.new_id("a-");
            let beginning = Beginning { kind: Kind::Act, id, plan_id: None, request: None, order: &order };
            match self.write_down(beginning).await {
                Ok(act) => self.conclude(&act.job, JobStanding::Done, None).await,
                Err(error) => tracing::error!(%error, "{count} stops are not recorded"),
            }
            if side.stops.fetch_sub(count, Ordering::AcqRel) == count {
                return;
            }
        }
    }

    /// Refuses whoever does not hold the lease, before anything is written or planned for him; it is renewed by that. A request
    /// that was answered before is answered again without.
    pub(super) async fn check_lease(&self, id: &str, request: Option<&RequestKey>) -> Result<(), ServiceError> {
        if let Some(request) = request
            && self.store.job_by_request(&request.id).await?.is_some()
        {
            return Ok(());
        }
        self.cell_side()?.cell.renew_lease(id).await?;
        Ok(())
    }

    /// Acknowledges the faults and has every device read; only then may anything move.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] with what the cell refuses, and what the store says.
    pub async fn reset(self: &Arc<Self>, lease_id: String) -> Result<Taken, ServiceError> {
        self.check_lease(&lease_id, None).await?;
        let order = self.act("reset", None);
        self.command(order, move |cell| async move { cell.reset(&lease_id).await }).await
    }

    /// Has one manipulator enabled, disabled or homed.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] with what the cell refuses, and what the store says.
    pub async fn command_manipulator(
        self: &Arc<Self>,
        lease_id: String,
        carrier: Carrier,
        manual: Manual,
    ) -> Result<Taken, ServiceError> {
        let verb = match manual {
            Manual::Enable => "enable",
            Manual::Disable => "disable",
            Manual::Home => "home",
        };
        self.check_lease(&lease_id, None).await?;
        let (motion, clock) = (self.cell_side()?.motion.clone(), self.clock);
        let order = self.act(verb, Some(carrier));
        let give = move |cell: Cell| async move {
            let taken = cell.act(&lease_id, carrier, manual).await?;
            if manual == Manual::Home {
                motion.note(clock.now());
            }
            Ok(taken)
        };
        self.command(order, give).await
    }

    /// A single command: written down, given to the cell, and its taking written down.
    async fn command<F: Future<Output = Result<Taken, Refusal>> + Send>(
        self: &Arc<Self>,
        order: ActOrder,
        give: impl FnOnce(Cell) -> F + Send + 'static,
    ) -> Result<Taken, ServiceError> {
        let cell = self.cell_side()?.cell.clone();
        let service = Arc::clone(self);
        whole(async move {
            let id = service.clock.new_id("a-");
            let beginning = Beginning { kind: Kind::Act, id, plan_id: None, request: None, order: &order };
            let act = service.write_down(beginning).await?.job;
            let taken = give(cell).await;
            match &taken {
                Ok(_) => service.conclude(&act, JobStanding::Done, None).await,
                Err(refusal) => {
                    service.conclude(&act, JobStanding::Refused, Some(&Ending::refused(refusal))).await;
                }
            }
            Ok(taken?)
        })
        .await
    }

    fn act(&self, verb: &str, manipulator: Option<Carrier>) -> ActOrder {
        ActOrder { verb: verb.to_owned(), manipulator, count: None, by: self.commander() }
    }

    fn held(&self, lease: Lease) -> HeldLease {
        let until_at = self.clock.wall(lease.until);
        let Lease { id, holder, fence, time_to_live, .. } = lease;
        HeldLease { id, holder, fence, time_to_live, until_at }
    }

    fn time_to_live(&self, side: &CellSide, asked: Option<Duration>) -> Result<Duration, ServiceError> {
        let lease = &side.config.lease;
        let Some(asked) = asked else { return Ok(Duration::from_millis(lease.ttl_ms)) };
        let (least, most) = (Duration::from_millis(lease.ttl_min_ms), Duration::from_millis(lease.ttl_max_ms));
        if !(least..=most).contains(&asked) {
            let allowed = format!("between {} and {}", least.as_secs_f64(), most.as_secs_f64());
            return Err(ServiceError::Value { field: "ttl_s", allowed });
        }
        Ok(asked)
    }
}
