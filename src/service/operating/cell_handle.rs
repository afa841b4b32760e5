//! The cell as the service uses it, with related state: the newest fencing token, the due times of the set-points of the current
//! move, and the stops that are not recorded yet. `CellView` shows it at one moment, with ages and wall-clock times.

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

/// The cell, and the state that the service keeps about it.
#[derive(Debug)]
pub(in crate::service) struct CellHandle {
    pub(in crate::service) cell: Cell,
    pub(in crate::service) config: CellConfig,
    pub(in crate::service) arrangement: Arrangement,
    /// The newest fencing token issued. Locked while a lease is acquired, so that the token is stored before any client has it.
    pub(in crate::service) fence: tokio::sync::Mutex<u64>,
    /// Progress of the move under way.
    pub(in crate::service) pace: Pace,
    /// Stops that are not recorded yet.
    pub(in crate::service) stops: AtomicU64,
    /// Id and fencing token of the newest lease.
    pub(in crate::service) newest_lease: Mutex<Option<(String, u64)>>,
    /// Separate threads for the cell: however busy the requests are, a lease expires in time and devices are polled.
    runtime: Mutex<Option<Runtime>>,
}

/// When each set-point of the newest move is due. The progress of a move is measured by its time, not by the number of its
/// set-points: they lie close together where the move strains the part and far apart elsewhere.
#[derive(Debug, Default)]
pub(in crate::service) struct Pace(Mutex<Option<Due>>);

#[derive(Debug)]
struct Due {
    job: String,
    /// Time since its start, s.
    at_s: Vec<f64>,
}

impl CellHandle {
    /// Starts the cell on its devices; every future fencing token is greater than `fence_floor`.
    ///
    /// # Errors
    /// If its threads cannot be started.
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

    /// How often the part may have been moved.
    pub(in crate::service) fn motions_count(&self) -> u64 {
        self.cell.snapshot().motions_count
    }

    /// Ends the cell's threads without waiting for them.
    pub(in crate::service) fn end_threads(&self) {
        let runtime = self.runtime.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(runtime) = runtime {
            runtime.shutdown_background();
        }
    }

    /// Positions of the manipulators at their last readings; `None` if one never answered.
    pub(in crate::service) fn positions(&self) -> Option<Pair<Position>> {
        let snapshot = self.cell.snapshot();
        let at = |carrier| snapshot.manipulators.get(carrier).reading.as_ref().map(|reading| reading.position());
        Some(Pair { m1: at(Carrier::M1)?, m2: at(Carrier::M2)? })
    }
}

impl Pace {
    /// Called before this move begins.
    pub(in crate::service) fn set(&self, job: &str, path: &Path) {
        let at_s = path.waypoints.iter().map(|waypoint| waypoint.at_s).collect();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Due { job: job.to_owned(), at_s });
    }

    /// Progress of a job, 0 to 1: a move by its time, other jobs as reported by the cell.
    pub(in crate::service) fn progress(&self, job: &JobView) -> f64 {
        let due = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let due = due.as_ref().filter(|due| due.job == job.id);
        due.and_then(|due| share_of_time(&due.at_s, job.progress)).unwrap_or(job.progress)
    }
}

/// Share of the move's time that has passed when this share of the set-points after the first is reached.
fn share_of_time(at_s: &[f64], share_of_waypoints: f64) -> Option<f64> {
    let last = at_s.len().checked_sub(1)?;
    // The value is between 0 and the number of set-points, which is small.
    let reached = (share_of_waypoints.clamp(0.0, 1.0) * last as f64).round() as usize;
    let (at, whole) = (*at_s.get(reached)?, *at_s.last()?);
    (whole > 0.0).then(|| at / whole)
}

impl Drop for CellHandle {
    fn drop(&mut self) {
        self.end_threads();
    }
}

/// The state of the cell at one moment.
#[derive(Debug, Clone)]
pub struct CellView {
    /// As the cell published it.
    pub snapshot: Arc<Snapshot>,
    /// Progress of the job under way, 0 to 1: a move by its time, a scan by its profiles.
    pub progress: Option<f64>,
    pub(in crate::service) clock: Clock,
    pub(in crate::service) now: Instant,
}

impl CellView {
    /// Time since an instant of the snapshot.
    #[must_use]
    pub fn age(&self, at: Instant) -> Duration {
        self.now.saturating_duration_since(at)
    }

    /// Time until an instant of the snapshot.
    #[must_use]
    pub fn until(&self, at: Instant) -> Duration {
        at.saturating_duration_since(self.now)
    }

    /// Wall-clock time of an instant of the snapshot.
    #[must_use]
    pub fn wall(&self, at: Instant) -> Timestamp {
        self.clock.wall(at)
    }

    /// The instant of the view.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_progress_of_a_move_is_its_time_not_its_set_points() {
        // Three set-points close together, then a long distance: after the third, 3 s of 12 s are over.
        let at_s = [0.0, 1.0, 2.0, 3.0, 12.0];
        let close = |found: Option<f64>, wanted: f64| found.is_some_and(|found| (found - wanted).abs() < 1e-12);
        assert!(close(share_of_time(&at_s, 0.75), 0.25), "{:?}", share_of_time(&at_s, 0.75));
        assert!(close(share_of_time(&at_s, 0.0), 0.0) && close(share_of_time(&at_s, 1.0), 1.0));
        assert_eq!((share_of_time(&[], 0.5), share_of_time(&[0.0], 0.5)), (None, None));
    }
}
