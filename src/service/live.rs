//! The cell as it is at this moment, with what turns its times into ages and into those of the wall.

use super::Service;
use super::clock::Clock;
use super::error::ServiceError;
use super::side::CellSide;
use crate::cell::Snapshot;
use crate::config::Cell as CellConfig;
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// The cell at one moment.
#[derive(Debug, Clone)]
pub struct CellView {
    /// As the cell published it.
    pub snapshot: Arc<Snapshot>,
    /// How far the job under way is, 0 to 1: a move by its time, a scan by its profiles.
    pub progress: Option<f64>,
    clock: Clock,
    now: Instant,
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
    /// [`ServiceError::CellAbsent`], [`ServiceError::CellGone`].
    pub fn cell_view(&self) -> Result<CellView, ServiceError> {
        let side = self.cell_side()?;
        if !side.cell.is_alive() {
            return Err(ServiceError::CellGone);
        }
        let snapshot = side.cell.snapshot();
        let progress = snapshot.job.as_ref().map(|job| side.pace.progress(job));
        Ok(CellView { snapshot, progress, clock: self.clock, now: self.clock.instant() })
    }

    /// Whether the cell still takes requests; `None` where there is none.
    #[must_use]
    pub fn cell_is_alive(&self) -> Option<bool> {
        self.cell.as_ref().map(|side| side.cell.is_alive())
    }

    /// How the cell is set up.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub fn cell_config(&self) -> Result<&CellConfig, ServiceError> {
        Ok(&self.cell_side()?.config)
    }
}
