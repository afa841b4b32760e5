//! The cell as the service uses it, with what is remembered about it: the newest fencing token, when the set-points of the current
//! move are due, which stops are not recorded yet; and a view of it at one moment, with its times as ages and wall-clock times.

use std::io;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use tokio::runtime::{Builder, Runtime};
use tokio::time::Instant;

use crate::cell::{Cell, JobView, Snapshot};
use crate::config::Cell as CellConfig;
use crate::motion::{Arrangement, Carrier, Pair, Path, Position};
use crate::service::clock::Clock;

use super::equipment::Equipment;

/// The cell, and what the service remembers about it.
#[derive(Debug)]
pub(in crate::service) struct CellHandle {
    pub(in crate::service) cell: Cell,
    pub(in crate::service) config: CellConfig,
    pub(in crate::service) arrangement: Arrangement,
    /// The newest fence that was given out. Held while a lease is taken, so that its fence is stored before anybody has it.
    pub(in crate::service) fence: tokio::sync::Mutex<u64>,
    /// How far the move under way is.
    pub(in crate::service) pace: Pace,
    /// Stops that are not recorded yet.
    pub(in crate::service) stops: AtomicU64,
    /// Id and fence of the newest lease.
    pub(in crate::service) newest_lease: Mutex<Option<(String, u64)>>,
    /// Threads of the cell's own: whatever the requests are busy with, a lease runs out in time and a device is polled.
    runtime: Mutex<Option<Runtime>>,
}

/// When each set-point of the newest move is due. A move is as far as its time, whatever its set-points' number: they lie close
/// where it strains the part and far apart where it does not.
#[derive(Debug, Default)]
pub(in crate::service) struct Pace(Mutex<Option<Due>>);

#[derive(Debug)]
struct Due {
    job: String,
    /// From its begin, s.
    at_s: Vec<f64>,
}

impl CellHandle {
    /// Starts the cell on its devices; every fence to come is above `fence_floor`.
    ///
    /// # Errors
    /// Where its threads cannot be started.
    pub(in crate::service) fn start(equipment: Equipment, fence_floor: u64) -> io::Result<Self> {
        let Equipment { devices, config, .. } = equipment;
        let (settings, arrangement) = (config.settings(), config.arrangement());
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("cell").enable_all().build()?;
        let cell = {
            let _entered = runtime.enter();
            Cell::start(devices, settings, fence_floor)
        };
        Ok(Self {
            cell,
            config,
            arrangement,
            fence: tokio::sync::Mutex::new(fence_floor),
            pace: Pace::default(),
            stops: AtomicU64::new(0),
            newest_lease: Mutex::new(None),
            runtime: Mutex::new(Some(runtime)),
        })
    }

    /// How often something may have moved the part.
    pub(in crate::service) fn motions_count(&self) -> u64 {
        self.cell.snapshot().motions_count
    }

    /// Ends the cell's threads, waiting for none of them.
    pub(in crate::service) fn end_threads(&self) {
        let runtime = self.runtime.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(runtime) = runtime {
            runtime.shutdown_background();
        }
    }

    /// Where the manipulators are by their last readings; `None` where one never answered.
    pub(in crate::service) fn positions(&self) -> Option<Pair<Position>> {
        let snapshot = self.cell.snapshot();
        let at = |carrier| snapshot.manipulators.get(carrier).reading.as_ref().map(|reading| reading.position());
        Some(Pair { m1: at(Carrier::M1)?, m2: at(Carrier::M2)? })
    }
}

impl Pace {
    /// This move is about to begin.
    pub(in crate::service) fn set(&self, job: &str, path: &Path) {
        let at_s = path.waypoints.iter().map(|waypoint| waypoint.at_s).collect();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Due { job: job.to_owned(), at_s });
    }

    /// How far a job is, 0 to 1: a move by its time, anything else as the cell says.
    pub(in crate::service) fn progress(&self, job: &JobView) -> f64 {
        let due = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let due = due.as_ref().filter(|due| due.job == job.id);
        due.and_then(|due| share_of_time(&due.at_s, job.progress)).unwrap_or(job.progress)
    }
}

/// The share of the time that is over where this share of the set-points behind the first is reached.
fn share_of_time(at_s: &[f64], share_of_waypoints: f64) -> Option<f64> {
    let last = at_s.len().checked_sub(1)?;
    // Between 0 and the number of set-points, which is small.
    let reached = (share_of_waypoints.clamp(0.0, 1.0) * last as f64).round() as usize;
    let (at, whole) = (*at_s.get(reached)?, *at_s.last()?);
    (whole > 0.0).then(|| at / whole)
}

impl Drop for CellHandle {
    fn drop(&mut self) {
        self.end_threads();
    }
}

/// The cell at one moment.
#[derive(Debug, Clone)]
pub struct CellView {
    /// As the cell published it.
    pub snapshot: Arc<Snapshot>,
    /// How far the job under way is, 0 to 1: a move by its time, a scan by its profiles.
    pub progress: Option<f64>,
    pub(in crate::service) clock: Clock,
    pub(in crate::service) now: Instant,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_is_as_far_as_its_time_not_as_its_set_points() {
        // Three set-points close together, then a long way: after the third, 3 s of 12 s are over.
        let at_s = [0.0, 1.0, 2.0, 3.0, 12.0];
        let close = |found: Option<f64>, wanted: f64| found.is_some_and(|found| (found - wanted).abs() < 1e-12);
        assert!(close(share_of_time(&at_s, 0.75), 0.25), "{:?}", share_of_time(&at_s, 0.75));
        assert!(close(share_of_time(&at_s, 0.0), 0.0) && close(share_of_time(&at_s, 1.0), 1.0));
        assert_eq!((share_of_time(&[], 0.5), share_of_time(&[0.0], 0.5)), (None, None));
    }
}
