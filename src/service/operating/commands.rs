//! Commands without a job: stop, reset, and commands to a single manipulator. Each is recorded.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use serde::{Deserialize, Serialize};
use tokio::time::timeout;

use super::job::{Commander, EndReason, JobStatus, Kind};
use super::jobs::Beginning;
use super::state::Operating;
use crate::cell::{Cell, Manual, Refusal, StopReport, Taken};
use crate::motion::Carrier;
use crate::service::error::ServiceError;
use crate::service::unwritten::{PAUSE_FIRST, PAUSE_MAX};

/// The record of a reset or of a command to a single device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct ActOrder {
    verb: String,
    manipulator: Option<Carrier>,
    /// Number of commands that the record stands for, if more than one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    count: Option<u64>,
    #[serde(flatten)]
    by: Commander,
}

fn act(verb: &str, manipulator: Option<Carrier>, by: Commander) -> ActOrder {
    ActOrder { verb: verb.to_owned(), manipulator, count: None, by }
}

impl Operating {
    /// Stops all motion. Needs no lease and waits for neither a device nor the store; it is recorded afterwards.
    ///
    /// # Errors
    /// [`ServiceError::CellAbsent`].
    pub async fn stop(self: &Arc<Self>) -> Result<StopReport, ServiceError> {
        let handle = self.cell_handle()?;
        let report = handle.cell.stop().await;
        // One record is written at a time; the stops that arrive meanwhile share the next one.
        if handle.stops.fetch_add(1, Ordering::AcqRel) == 0 {
            let service = Arc::clone(self);
            self.shared.background.add(async move { service.record_stops().await });
        }
        Ok(report)
    }

    async fn record_stops(self: &Arc<Self>) {
        let Ok(handle) = self.cell_handle() else { return };
        let mut pause = PAUSE_FIRST;
        loop {
            let count = handle.stops.load(Ordering::Acquire);
            let order = ActOrder { count: (count > 1).then_some(count), ..act("stop", None, Commander::NOBODY) };
            let id = self.shared.clock.new_id("a-");
            let beginning = Beginning { kind: Kind::Act, id, plan_id: None, request: None, order: &order };
            match self.write_down(beginning).await {
                Ok(act) => self.conclude(&act.job, JobStatus::Done, None).await,
                Err(error) if self.shared.shutdown.has_begun() => {
                    tracing::error!(%error, "{count} stops are not recorded");
                }
                Err(error) => {
                    tracing::warn!(%error, "{count} stops are not recorded yet; writing is retried");
                    let _ = timeout(pause, self.shared.shutdown.wait()).await;
                    pause = (pause * 2).min(PAUSE_MAX);
                    continue;
                }
            }
            if handle.stops.fetch_sub(count, Ordering::AcqRel) == count {
                return;
            }
        }
    }

    /// Acknowledges the faults and has every device read; motion is possible only afterwards.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] with the refusal of the cell, and errors of the store.
    pub async fn reset(self: &Arc<Self>, lease_id: String) -> Result<Taken, ServiceError> {
        let by = self.authorise(&lease_id, None).await?;
        let order = act("reset", None, by);
        self.command(order, move |cell| async move { cell.reset(&lease_id).await }).await
    }

    /// Enables, disables or homes one manipulator.
    ///
    /// # Errors
    /// [`ServiceError::Cell`] with the refusal of the cell, and errors of the store.
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
        let by = self.authorise(&lease_id, None).await?;
        let order = act(verb, Some(carrier), by);
        self.command(order, move |cell| async move { cell.act(&lease_id, carrier, manual).await }).await
    }

    /// Executes a single command: records it, sends it to the cell, and records its acceptance.
    async fn command<F: Future<Output = Result<Taken, Refusal>> + Send>(
        self: &Arc<Self>,
        order: ActOrder,
        give: impl FnOnce(Cell) -> F + Send + 'static,
    ) -> Result<Taken, ServiceError> {
        let cell = self.cell_handle()?.cell.clone();
        let service = Arc::clone(self);
        self.shared
            .background
            .run_detached(async move {
                let id = service.shared.clock.new_id("a-");
                let beginning = Beginning { kind: Kind::Act, id, plan_id: None, request: None, order: &order };
                let act = service.write_down(beginning).await?.job;
                let taken = give(cell).await;
                match &taken {
                    Ok(_) => service.conclude(&act, JobStatus::Done, None).await,
                    Err(refusal) => {
                        let (standing, ending) = EndReason::of_refusal(refusal);
                        service.conclude(&act, standing, Some(&ending)).await;
                    }
                }
                Ok(taken?)
            })
            .await
    }
}
