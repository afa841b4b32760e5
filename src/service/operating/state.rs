//! State of the operating service: the cell, if there is one, the queue of its sensor, and measuring.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::timeout;

use super::cell_handle::{CellHandle, CellView};
use crate::config::Cell as CellConfig;
use crate::service::compute::Compute;
use crate::service::error::ServiceError;
use crate::service::events::Happening;
use crate::service::measuring::state::Measuring;
use crate::service::shared::Shared;

/// Leases, moves and stops the cell, scans with its sensor, and records every command.
#[derive(Debug)]
pub struct Operating {
    pub(in crate::service) shared: Arc<Shared>,
    pub(in crate::service) measuring: Arc<Measuring>,
    pub(in crate::service) cell: Option<CellHandle>,
    /// Separate threads for scans by the sensor, so that they wait neither for uploads nor for repeated measurements.
    pub(in crate::service) line: Compute,
}

impl Operating {
    /// The cell, if there is one.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub(in crate::service) fn cell_handle(&self) -> Result<&CellHandle, ServiceError> {
        self.cell.as_ref().ok_or(ServiceError::CellAbsent)
    }

    /// The state of the cell at this moment.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`], [`ServiceError::CellGone`].
    pub fn cell_view(&self) -> Result<CellView, ServiceError> {
        let handle = self.cell_handle()?;
        if !handle.cell.is_alive() {
            return Err(ServiceError::CellGone);
        }
        let snapshot = handle.cell.snapshot();
        let progress = snapshot.job.as_ref().map(|job| handle.pace.progress(job));
        Ok(CellView { snapshot, progress, clock: self.shared.clock, now: self.shared.clock.instant() })
    }

    /// Whether the cell still accepts requests; `None` if there is none.
    #[must_use]
    pub fn cell_is_alive(&self) -> Option<bool> {
        self.cell.as_ref().map(|handle| handle.cell.is_alive())
    }

    /// The configuration of the cell.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub fn cell_config(&self) -> Result<&CellConfig, ServiceError> {
        Ok(&self.cell_handle()?.config)
    }
}

impl Operating {
    /// Starts a task that copies the events of the cell while both exist.
    pub(in crate::service) fn follow_cell(&self) {
        let Some(handle) = &self.cell else { return };
        let (cell, log, clock) = (handle.cell.clone(), Arc::clone(&self.shared.events), self.shared.clock);
        tokio::spawn(async move {
            let mut newest = cell.newest_event();
            let mut seen = 0;
            loop {
                newest.borrow_and_update();
                for event in cell.events(seen).events {
                    seen = event.number;
                    log.add(clock.wall(event.at), Happening::Cell(event.kind));
                }
                if newest.changed().await.is_err() {
                    return;
                }
            }
        });
    }

    /// Stops all motion permanently and releases the devices, within this time.
    pub(in crate::service) async fn close_cell(&self, within: Duration) {
        if let Some(handle) = &self.cell
            && timeout(within, handle.cell.close()).await.is_err()
        {
            tracing::error!("the devices were commanded to stop, but standstill was not confirmed");
        }
    }

    /// Ends the threads of the cell.
    pub(in crate::service) fn end_threads(&self) {
        if let Some(handle) = &self.cell {
            handle.end_threads();
        }
    }
}
