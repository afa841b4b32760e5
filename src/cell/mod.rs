//! The cell: one task owns the devices and does one thing at a time; everybody else sends to it and watches it.
//!
//! ```text
//!  handlers --requests--> task (state machine, lease, job) --orders--> drivers --> devices
//!      |                    |   ^------------ reports --------------------'
//!      |                    '--> snapshot (watch), events (ring)
//!      '------- stop: raises the halt flag that every driver looks at first ---^
//! ```
//!
//! Read them in this order: state (the diagram), task, run, driver. Knows geometry, motion and devices; must not know HTTP,
//! files, or what a pose is. Its stop is an operational stop, category 2: not an emergency stop, and no safety function.

mod driver;
mod events;
mod failure;
mod following;
mod homing;
mod input;
mod job;
mod lease;
mod number;
mod obstacles;
mod refusal;
mod request;
mod run;
mod scanning;
mod settings;
mod snapshot;
mod start;
mod state;
mod stop;
mod task;
mod work;

pub use driver::SILENCE;
pub use events::{EVENTS_KEPT, Event, EventKind, Events};
pub use failure::{Failure, Fault, StopCause};
pub use input::{Manual, Taken};
pub use job::{Job, JobEnd, JobState};
pub use lease::{Lease, LeaseRequest, LeaseView};
pub use refusal::{Refusal, ScanNumber};
pub use settings::{Devices, ScanOrder, Settings, SettingsError};
pub use snapshot::{JobView, Link, Live, Quality, Snapshot};
pub use state::State;
pub use stop::{DeviceStop, StopReport};

use crate::device::Profile;
use crate::motion::{Carrier, Path};
use events::EventLog;
use request::{Reply, Request};
use std::sync::Arc;
use stop::StopDoor;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::Instant;

/// The cell, as everybody holds it. Cheap to clone. When the last one is dropped, the cell stops and ends.
#[derive(Debug, Clone)]
pub struct Cell {
    requests: mpsc::Sender<Request>,
    stops: Arc<StopDoor>,
    snapshots: watch::Receiver<Arc<Snapshot>>,
    log: Arc<EventLog>,
}

/// The time that everything in the cell is told by.
#[must_use]
#[expect(clippy::disallowed_methods, reason = "the cell waits by tokio's clock, which tests can pause")]
pub fn now() -> Instant {
    Instant::now()
}

impl Cell {
    /// Starts the cell: connects to the devices, and moves nothing. Every fence that is given out is above `fence_floor`;
    /// pass the greatest that was ever given out. Must be called within a tokio runtime.
    #[must_use]
    pub fn start(devices: Devices, settings: Settings, fence_floor: u64) -> Self {
        start::start(devices, settings, fence_floor).0
    }

    /// Whether the cell's task still takes requests. Where it does not and nobody has closed it, it has failed: every device was
    /// told to halt, and nothing here is true any more.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        !self.requests.is_closed()
    }

    /// The cell as it is now.
    #[must_use]
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.snapshots.borrow().clone()
    }

    /// Changes with every snapshot.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Arc<Snapshot>> {
        self.snapshots.clone()
    }

    /// Takes the lease, or renews it where it has the same id.
    ///
    /// # Errors
    /// [`Refusal::LeaseHeld`] where somebody else holds it.
    pub async fn take_lease(&self, request: LeaseRequest) -> Result<Lease, Refusal> {
        self.ask(|reply| Request::TakeLease(request, reply)).await
    }

    /// Renews the lease.
    ///
    /// # Errors
    /// Where it is over, or somebody else's.
    pub async fn renew_lease(&self, id: &str) -> Result<Lease, Refusal> {
        self.ask(|reply| Request::RenewLease(id.to_owned(), reply)).await
    }

    /// Gives the lease back. What it moves stops.
    ///
    /// # Errors
    /// Where it is over, or somebody else's.
    pub async fn release_lease(&self, id: &str) -> Result<(), Refusal> {
        self.ask(|reply| Request::ReleaseLease(id.to_owned(), reply)).await
    }

    /// Enables, disables or homes a manipulator. Answers when it is under way.
    ///
    /// # Errors
    /// Why not; nothing was sent then.
    pub async fn act(&self, lease: &str, carrier: Carrier, manual: Manual) -> Result<Taken, Refusal> {
        self.ask(|reply| Request::Act { lease: lease.to_owned(), carrier, manual, reply }).await
    }

    /// Begins a move along a path, which is checked anew against limits and where the devices are. Answers at once. The same
    /// job while it is under way is answered again.
    ///
    /// # Errors
    /// Why not; nothing was sent then.
    pub async fn start_move(&self, lease: &str, job: &str, path: Path) -> Result<Job, Refusal> {
        let (lease, job) = (lease.to_owned(), job.to_owned());
        self.ask(|reply| Request::Move { lease, job, path, reply }).await
    }

    /// Begins a scan. Answers at once; the profiles come as the sensor gives them. A receiver that is dropped, or not read
    /// for a second, fails the scan.
    ///
    /// # Errors
    /// Why not; nothing was sent then.
    pub async fn start_scan(
        &self,
        lease: &str,
        job: &str,
        order: ScanOrder,
    ) -> Result<(Job, mpsc::Receiver<Vec<Profile>>), Refusal> {
        let (lease, job) = (lease.to_owned(), job.to_owned());
        self.ask(|reply| Request::Scan { lease, job, order, reply }).await
    }

    /// Stops everything: an operational stop, category 2. Needs no lease, works in every state, may be repeated; the halt is
    /// raised before this first waits, and waits behind nobody. It waits at most 30 ms for what the devices make of
    /// it, and answers with what is known then.
    pub async fn stop(&self) -> StopReport {
        self.stops.stop().await
    }

    /// Acknowledges the latched faults and reads every device; when all stand without a fault, the cell is idle. Answers when
    /// that has begun; watch the state.
    ///
    /// # Errors
    /// Why not.
    pub async fn reset(&self, lease: &str) -> Result<Taken, Refusal> {
        self.ask(|reply| Request::Reset { lease: lease.to_owned(), reply }).await
    }

    /// Events whose number is greater than `after`.
    #[must_use]
    pub fn events(&self, after: u64) -> Events {
        self.log.after(after)
    }

    /// The number of the newest event; changes with every one.
    #[must_use]
    pub fn newest_event(&self) -> watch::Receiver<u64> {
        self.log.newest()
    }

    /// Stops everything, waits until it is at rest or the time for that is over, and lets go of the devices.
    pub async fn close(&self) {
        let (reply, closed) = oneshot::channel();
        if self.requests.send(Request::Close(reply)).await.is_ok() {
            // An error says that the task has ended, which is what was asked for.
            let _ended = closed.await;
        }
    }

    async fn ask<T>(&self, make: impl FnOnce(Reply<T>) -> Request) -> Result<T, Refusal> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(make(reply)).await.map_err(|_| Refusal::Closing)?;
        // A cell that ends in order refuses every request that waits.
        answer.await.map_err(|_| Refusal::Unanswered)?
    }
}

#[cfg(test)]
mod tests;
