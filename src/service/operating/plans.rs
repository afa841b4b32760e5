//! Plans: from a measured pose and a target to the motion, its length, and the strain on the part. A plan moves nothing,
//! contains the positions that it assumes, and can be executed once. It is refused if its pose was measured before a restart,
//! before a motion, or too long ago.

use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::estimation::{Outcome, Pose};
use crate::geometry::AxisLine;
use crate::motion::{Axis, Carrier, Pair, PartPose, Plan, PoseTarget, Position, plan_alignment};
use crate::service::acquisition::{Acquisition, Stale};
use crate::service::background::run_blocking;
use crate::service::document;
use crate::service::document::Entry;
use crate::service::error::ServiceError;
use crate::service::measuring::measure::fingerprint_of;
use crate::service::measuring::record::{Chosen, Measurement};
use crate::store::{InsertedPlan, ListedPlan, Listing, Page, PlanRow, RequestKey};

use super::cell_handle::CellHandle;
use super::job::StartedJob;
use super::moves::{Departure, MoveOrder};
use super::state::Operating;

/// Target pose of the part's axis; angles in rad, lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Rotation towards +Y.
    pub deflection: f64,
    /// Rotation towards +Z.
    pub pitch: f64,
    /// Target y of the axis in the plane x = 0.
    pub y_c0: f64,
    /// Target z of the axis in the plane x = 0.
    pub z_c0: f64,
    /// Additional rotation about the axis.
    pub roll: f64,
    /// Additional shift along the axis.
    pub shift_x: f64,
}

/// Parameters of a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanRequest {
    /// The measurement that gives the part's pose.
    pub measurement_id: String,
    /// The part; the only one by default.
    pub part: Option<String>,
    /// The target.
    pub target: Target,
    /// Share of the maximum speeds; above 0, at most 1.
    pub speed_ratio: f64,
    /// With an id, a repeated request gets the first answer again.
    #[serde(skip)]
    pub request_id: Option<String>,
}

/// The record of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredPlan {
    /// `p-` and a number that grows with time.
    pub id: String,
    /// When it was created.
    pub created_at: Timestamp,
    /// When the plan becomes too old to be executed, because its pose does.
    pub expires_at: Timestamp,
    /// When the scan of its measurement was taken.
    #[serde(default)]
    pub acquisition: Option<Acquisition>,
    /// The measurement that it is based on.
    pub measurement_id: String,
    /// The measured axis.
    pub measured: AxisLine,
    /// x at which the position of the measured axis is most accurate, mm.
    pub x_ref: f64,
    /// The target of the axis.
    pub target: Target,
    /// Share of the maximum speeds.
    pub speed_ratio: f64,
    /// The planned motion.
    pub plan: Plan,
}

/// A plan as a list shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanInList {
    /// The plan.
    pub plan: StoredPlan,
    /// The move that executes it, if there is one.
    pub move_id: Option<String>,
}

/// A plan, and whether it was created for an earlier request of the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanAnswer {
    /// The plan.
    pub plan: StoredPlan,
    /// Whether an earlier answer is repeated, without planning.
    pub replayed: bool,
}

async fn find_path(
    handle: &CellHandle,
    from: Pair<Position>,
    measured: PartPose,
    request: &PlanRequest,
) -> Result<Plan, ServiceError> {
    let Target { deflection, pitch, y_c0, z_c0, roll, shift_x } = request.target;
    let axis = AxisLine { p: deflection.tan(), q: pitch.tan(), y0: y_c0, z0: z_c0 };
    let target = PoseTarget { axis, roll, axial_shift: shift_x };
    let (arrangement, speed_ratio) = (handle.arrangement, request.speed_ratio);
    run_blocking(move || Ok(plan_alignment(&arrangement, &from, &measured, &target, speed_ratio)?)).await
}

fn max_age(handle: &CellHandle) -> SignedDuration {
    SignedDuration::from_secs(i64::try_from(handle.config.plan_age_max_s).unwrap_or(i64::MAX))
}

/// The pose of the requested part of a measurement.
fn pose<'a>(measurement: &'a Measurement, part: Option<&str>) -> Result<&'a Pose, ServiceError> {
    let missing = || ServiceError::PoseMissing { measurement_id: measurement.id.clone() };
    let finding = match (part, measurement.result.sole()) {
        (None, sole) => sole.ok_or_else(missing)?,
        (Some(_), _) => match measurement.result.choose(part)? {
            Chosen::Whole(finding) => finding,
            Chosen::Part(part, _) => &part.finding,
            Chosen::None(_) => return Err(missing()),
        },
    };
    match &finding.outcome {
        Outcome::Accepted(pose) => Ok(pose),
        Outcome::Refused(_) => Err(missing()),
    }
}

fn replay(row: &PlanRow, key: &RequestKey) -> Result<PlanAnswer, ServiceError> {
    if row.request.as_ref().is_none_or(|asked| asked.fingerprint != key.fingerprint) {
        return Err(ServiceError::RequestIdReused { request_id: key.id.clone() });
    }
    Ok(PlanAnswer { plan: read_back(row)?, replayed: true })
}

pub(in crate::service) fn read_back(row: &PlanRow) -> Result<StoredPlan, ServiceError> {
    document::read("plan", &row.id, &row.document)
}

impl Operating {
    /// Plans the motion of the part from its measured pose to a target. Moves nothing.
    ///
    /// # Errors
    /// Those of [`Operating::measurement`], [`ServiceError::PoseMissing`], [`ServiceError::Stale`] if something has
    /// moved since, [`ServiceError::Motion`] if there is no allowed path, [`ServiceError::RequestIdReused`].
    pub async fn create_plan(self: &Arc<Self>, request: PlanRequest) -> Result<PlanAnswer, ServiceError> {
        let handle = self.cell_handle()?;
        let fingerprint = fingerprint_of("plan", &request);
        let key = request.request_id.clone().map(|id| RequestKey { id, fingerprint });
        if let Some(key) = &key
            && let Some(row) = self.shared.store.plan_by_request(&key.id).await?
        {
            return replay(&row, key);
        }
        let measurement = self.measurement(&request.measurement_id).await?;
        let pose = pose(&measurement, request.part.as_deref())?;
        // The positions are unknown if the cell has ended.
        self.cell_view()?;
        let from = handle.positions().ok_or(ServiceError::PositionsUnknown)?;
        let taken = measurement.acquisition.as_ref();
        self.check_fresh(handle, taken)?;
        let taken = taken.ok_or(Stale::Restarted)?;
        check_in_place(taken, handle, &from)?;
        let measured = pose.on_rail().ok_or(ServiceError::PoseMissing { measurement_id: measurement.id.clone() })?;
        let measured = PartPose { axis: measured.axis, x_ref: measured.x_ref };
        let plan = find_path(handle, from, measured, &request).await?;
        let plan = StoredPlan {
            id: self.shared.clock.new_id("p-"),
            created_at: self.shared.clock.now(),
            expires_at: taken.at.saturating_add(max_age(handle)).unwrap_or(taken.at),
            acquisition: Some(taken.clone()),
            measurement_id: measurement.id.clone(),
            measured: measured.axis,
            x_ref: measured.x_ref,
            target: request.target,
            speed_ratio: request.speed_ratio,
            plan,
        };
        self.keep_plan(plan, key).await
    }

    /// The plan of an id.
    ///
    /// # Errors
    /// [`ServiceError::PlanUnknown`].
    pub async fn plan(&self, id: &str) -> Result<StoredPlan, ServiceError> {
        let row = self.shared.store.plan(id).await?;
        let row = row.ok_or_else(|| ServiceError::PlanUnknown { id: id.to_owned() })?;
        run_blocking(move || read_back(&row)).await
    }

    /// The id of the move that executes a plan, if there is one.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn move_of_plan(&self, plan_id: &str) -> Result<Option<String>, ServiceError> {
        Ok(self.shared.store.job_of_plan(plan_id).await?.map(|row| row.id))
    }

    /// A page of the plans, newest first.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn plans(&self, page: &Page) -> Result<Listing<Entry<PlanInList>>, ServiceError> {
        let Listing { rows, next } = self.shared.store.plans(page).await?;
        let read = move || {
            let entry = |ListedPlan { plan: row, job_id }: ListedPlan| {
                let read = read_back(&row).map(|plan| PlanInList { plan, move_id: job_id });
                Entry::of(read, row.created_at)
            };
            rows.into_iter().map(entry).collect()
        };
        Ok(Listing { rows: run_blocking(read).await?, next })
    }

    /// Begins to execute a plan; a plan that was begun before returns the same move.
    ///
    /// # Errors
    /// [`ServiceError::PlanUnknown`], [`ServiceError::Stale`], [`ServiceError::Cell`] if the cell refuses.
    pub async fn execute_plan(
        self: &Arc<Self>,
        id: &str,
        lease_id: String,
    ) -> Result<StartedJob<MoveOrder>, ServiceError> {
        let handle = self.cell_handle()?;
        let stored = self.plan(id).await?;
        if let Some(row) = self.shared.store.job_of_plan(id).await? {
            return Ok(StartedJob {
                job: super::jobs::read_back(&self.shared.unwritten.complete(row))?,
                replayed: true,
            });
        }
        let by = self.authorise(&lease_id, None).await?;
        self.check_fresh(handle, stored.acquisition.as_ref())?;
        let StoredPlan { id, measurement_id, speed_ratio, plan, .. } = stored;
        let order = MoveOrder { by, measurement_id: Some(measurement_id), speed_ratio, plan };
        self.depart(Departure { lease_id, plan_id: Some(id), request: None, order }).await
    }

    async fn keep_plan(
        self: &Arc<Self>,
        plan: StoredPlan,
        key: Option<RequestKey>,
    ) -> Result<PlanAnswer, ServiceError> {
        let (plan, document) =
            run_blocking(move || document::write("plan", &plan).map(|document| (plan, document))).await?;
        let row = PlanRow { id: plan.id.clone(), created_at: plan.created_at, request: key, document };
        let request_id = row.request.as_ref().map(|request| request.id.clone()).unwrap_or_default();
        let service = Arc::clone(self);
        let inserting = async move {
            let inserted = service.shared.store.insert_plan(row).await?;
            if inserted == InsertedPlan::New {
                service.shared.advance();
            }
            Ok(inserted)
        };
        match self.shared.background.run_detached(inserting).await? {
            InsertedPlan::New => Ok(PlanAnswer { plan, replayed: false }),
            InsertedPlan::Replayed(row) => Ok(PlanAnswer { plan: read_back(&row)?, replayed: true }),
            InsertedPlan::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }
}

impl Operating {
    /// The acquisition data of the present moment.
    pub(in crate::service) fn acquisition_now(&self) -> Acquisition {
        Acquisition {
            instance_id: self.shared.instance_id.clone(),
            motions_count: self.cell.as_ref().map_or(0, CellHandle::motions_count),
            uptime_ms: self.shared.uptime.elapsed_ms(),
            at: self.shared.clock.now(),
            positions: self.cell.as_ref().and_then(CellHandle::positions),
        }
    }

    /// Refuses a pose from before a restart, from before the end of the last motion, or from too long ago.
    pub(in crate::service) fn check_fresh(
        &self,
        handle: &CellHandle,
        taken: Option<&Acquisition>,
    ) -> Result<(), Stale> {
        // Records of earlier versions lack the instance; they are from before a restart.
        let Some(taken) = taken.filter(|taken| taken.instance_id == self.shared.instance_id) else {
            return Err(Stale::Restarted);
        };
        if taken.motions_count != handle.motions_count() {
            return Err(Stale::MovedSince);
        }
        let age_ms = self.shared.uptime.elapsed_ms().saturating_sub(taken.uptime_ms);
        let max_s = handle.config.plan_age_max_s;
        if age_ms > max_s.saturating_mul(1000) {
            return Err(Stale::TooOld { age_s: age_ms / 1000, max_s });
        }
        Ok(())
    }
}

/// Refuses if a manipulator has changed its position since then, whatever moved it.
pub(in crate::service) fn check_in_place(
    taken: &Acquisition,
    handle: &CellHandle,
    now: &Pair<Position>,
) -> Result<(), Stale> {
    let Some(then) = &taken.positions else { return Ok(()) };
    for carrier in Carrier::ALL {
        for axis in Axis::ALL {
            let (then, now) = (*then.get(carrier).get(axis), *now.get(carrier).get(axis));
            if (then - now).abs() > *handle.arrangement.settle_tolerance.get(axis) {
                let (then, now) = (axis.outside(then), axis.outside(now));
                return Err(Stale::Displaced { carrier, axis, then, now });
            }
        }
    }
    Ok(())
}
