//! Moves: a planned and checked path is recorded, sent to the cell, and followed to its end. A client that disconnects
//! does not affect the move.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::job::{Commander, EndReason, JobRecord, JobStatus, Kind, StartedJob};
use super::jobs::{self, Beginning};
use super::state::Operating;
use crate::cell::{Job, JobState, JobView};
use crate::motion::{MoveTargets, Plan, plan_move};
use crate::service::background::run_blocking;
use crate::service::document::Entry;
use crate::service::error::ServiceError;
use crate::service::events::Happening;
use crate::service::measuring::measure::fingerprint_of;
use crate::store::{Listing, Page, RequestKey};

/// Step of progress between two events of a job.
const PROGRESS_STEP: f64 = 0.1;

/// Parameters of a move.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MoveRequest {
    /// Authorises the motion.
    #[serde(skip)]
    pub lease_id: String,
    /// Target positions; axes without a target keep their position.
    pub targets: MoveTargets,
    /// Share of the maximum speeds; above 0, at most 1.
    pub speed_ratio: f64,
    /// With an id, a repeated request gets the first answer again.
    #[serde(skip)]
    pub request_id: Option<String>,
}

/// The order of a move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MoveOrder {
    /// Who commanded it.
    #[serde(flatten)]
    pub by: Commander,
    /// The measurement that it was planned from.
    pub measurement_id: Option<String>,
    /// Share of the maximum speeds.
    pub speed_ratio: f64,
    /// Every set-point, and what it means.
    pub plan: Plan,
}

/// The record of a move.
pub type Move = JobRecord<MoveOrder>;

/// A move that is about to begin.
pub(in crate::service) struct Departure {
    pub(in crate::service) lease_id: String,
    pub(in crate::service) plan_id: Option<String>,
    pub(in crate::service) request: Option<RequestKey>,
    pub(in crate::service) order: MoveOrder,
}

impl Operating {
    /// Plans a move to absolute targets and begins it.
    ///
    /// # Errors
    /// [`ServiceError::Motion`] if the path is not allowed, [`ServiceError::Cell`] if the cell refuses,
    /// [`ServiceError::RequestIdReused`].
    pub async fn start_move(self: &Arc<Self>, request: MoveRequest) -> Result<StartedJob<MoveOrder>, ServiceError> {
        let handle = self.cell_handle()?;
        let fingerprint = fingerprint_of("move", &request);
        let key = request.request_id.map(|id| RequestKey { id, fingerprint });
        // A repeated request gets its first answer whatever the present positions.
        if let Some(key) = &key
            && let Some(row) = self.shared.store.job_by_request(&key.id).await?
        {
            if row.request.as_ref().is_none_or(|asked| asked.fingerprint != key.fingerprint) {
                return Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
            }
            return Ok(StartedJob { job: jobs::read_back(&self.shared.unwritten.complete(row))?, replayed: true });
        }
        let by = self.authorise(&request.lease_id, None).await?;
        let from = handle.positions().ok_or(ServiceError::PositionsUnknown)?;
        let (arrangement, targets, speed_ratio) = (handle.arrangement, request.targets, request.speed_ratio);
        let plan = run_blocking(move || Ok(plan_move(&arrangement, &from, &targets, speed_ratio)?)).await?;
        let order = MoveOrder { by, measurement_id: None, speed_ratio, plan };
        self.depart(Departure { lease_id: request.lease_id, plan_id: None, request: key, order }).await
    }

    /// A move; waits for its end, at most for `wait`.
    ///
    /// # Errors
    /// [`ServiceError::MoveUnknown`].
    pub async fn get_move(&self, id: &str, wait: Duration) -> Result<Move, ServiceError> {
        let found = self.job(Kind::Move, id, wait).await?;
        found.ok_or_else(|| ServiceError::MoveUnknown { id: id.to_owned() })
    }

    /// A page of the moves, newest first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn moves(&self, page: &Page) -> Result<Listing<Entry<Move>>, ServiceError> {
        self.list_jobs(Kind::Move, None, page).await
    }

    /// Progress of a job under way, 0 to 1; `None` if it is not under way.
    #[must_use]
    pub fn progress(&self, job_id: &str) -> Option<f64> {
        let view = self.cell_view().ok()?;
        view.snapshot.job.as_ref().filter(|job| job.id == job_id).and(view.progress)
    }

    /// Records the move, begins it, and follows it in the background.
    pub(in crate::service) async fn depart(
        self: &Arc<Self>,
        departure: Departure,
    ) -> Result<StartedJob<MoveOrder>, ServiceError> {
        let service = Arc::clone(self);
        self.shared
            .background
            .run_detached(async move {
                let handle = service.cell_handle()?;
                let Departure { lease_id, plan_id, request, order } = departure;
                let id = service.shared.clock.new_id("v-");
                let beginning = Beginning { kind: Kind::Move, id, plan_id, request, order: &order };
                let started = service.write_down(beginning).await?;
                if started.replayed {
                    return Ok(started);
                }
                let path = started.job.order.plan.path.clone();
                handle.pace.set(&started.job.id, &path);
                match handle.cell.start_move(&lease_id, &started.job.id, path).await {
                    Ok(job) => {
                        let follower = Arc::clone(&service);
                        let recorded = started.job.clone();
                        service.shared.background.add(async move { follower.follow_move(job, &recorded).await });
                        Ok(started)
                    }
                    Err(refusal) => {
                        let (standing, ending) = EndReason::of_refusal(&refusal);
                        let mut job = started.job;
                        if standing == JobStatus::Refused {
                            // The set-points of a move that never began are not needed.
                            job.order.plan.path.waypoints.clear();
                        }
                        service.conclude(&job, standing, Some(&ending)).await;
                        Err(refusal.into())
                    }
                }
            })
            .await
    }

    async fn follow_move(self: &Arc<Self>, job: Job, recorded: &Move) {
        self.tell_progress(&job).await;
        let (standing, ending) = EndReason::of(&job.ended().await);
        self.conclude(recorded, standing, ending.as_ref()).await;
    }

    /// Publishes the progress of a job until it is over.
    pub(in crate::service) async fn tell_progress(&self, job: &Job) {
        let mut state = job.watch();
        let mut told = 0.0;
        loop {
            let now = state.borrow_and_update().clone();
            let JobState::Running { progress } = now else { return };
            let view = JobView { id: job.id.clone(), progress };
            let progress = self.cell.as_ref().map_or(progress, |handle| handle.pace.progress(&view));
            if progress >= told + PROGRESS_STEP {
                told = progress;
                self.shared.announce(Happening::Progress { job: job.id.clone(), progress });
            }
            if state.changed().await.is_err() {
                return;
            }
        }
    }
}
