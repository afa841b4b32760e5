//! Plans: from a measured pose and a target to what would move, how far, and what the part would bear. A plan moves nothing,
//! remembers the positions it assumed, and can be executed once. Must not know how a path is found, nor how it is sent.

use super::answer::fingerprint_of;
use super::followers::aside;
use super::jobs::Started;
use super::moves::{Departure, MoveOrder};
use super::side::CellSide;
use super::{Chosen, Measurement, Service, ServiceError};
use crate::estimation::{Outcome, Pose};
use crate::geometry::AxisLine;
use crate::motion::{Axis, Carrier, Pair, PartPose, Plan, PoseTarget, Position, plan_alignment};
use crate::store::{Filter, InsertedPlan, Listing, Page, PlanRow, RequestKey};
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Measurements that are looked through at a time.
const PAGE: u32 = 200;

/// Where the part's axis is wanted; angles in rad, lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// Rotation towards +Y.
    pub deflection: f64,
    /// Rotation towards +Z.
    pub pitch: f64,
    /// Where the axis is to meet the plane x = 0.
    pub y_c0: f64,
    /// Where the axis is to meet the plane x = 0.
    pub z_c0: f64,
    /// Turn about the axis, on top.
    pub roll: f64,
    /// Shift along the axis, on top.
    pub shift_x: f64,
}

/// What is asked of a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanRequest {
    /// The measurement that says where the part is.
    pub measurement_id: String,
    /// Which part of it; the only one where nothing is said.
    pub part: Option<String>,
    /// Where it is wanted.
    pub target: Target,
    /// Share of the greatest speeds; above 0, at most 1.
    pub speed_ratio: f64,
    /// So that a repeated request gets the first answer again.
    #[serde(skip)]
    pub request_id: Option<String>,
}

/// A plan as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredPlan {
    /// `p-` and a number that grows with time.
    pub id: String,
    /// When it was made.
    pub created_at: Timestamp,
    /// From this it is too old to be executed: the pose that it rests on is.
    pub expires_at: Timestamp,
    /// The measurement that it was made from.
    pub measurement_id: String,
    /// The measured axis.
    pub measured: AxisLine,
    /// x at which the measured axis is known best, mm.
    pub x_ref: f64,
    /// Where the axis is wanted.
    pub target: Target,
    /// Share of the greatest speeds.
    pub speed_ratio: f64,
    /// What would move.
    pub plan: Plan,
}

/// A plan, and whether it was made for an earlier request of the same id.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanAnswer {
    /// The plan.
    pub plan: StoredPlan,
    /// Whether nothing was planned for this answer.
    pub replayed: bool,
}

/// Why a plan, or a pose, no longer holds.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Stale {
    /// The pose is too old.
    #[error("the part was scanned {age_s} s ago, and holds for {max_s} s; measure again")]
    TooOld {
        /// Since it was measured.
        age_s: u64,
        /// How long a pose holds.
        max_s: u64,
    },
    /// Something was moved since the measurement.
    #[error("something was moved since the part was measured; measure again")]
    MovedSince,
    /// The service was restarted since, and does not know what was moved meanwhile.
    #[error("the service was restarted since the part was measured; measure again")]
    Restarted,
    /// A manipulator is not where it was when the part was measured.
    #[error(
        "axis {} of {} was at {then:.3} {unit} when the part was measured, and is at {now:.3} {unit}; measure again",
        axis.name(), carrier.name(), unit = axis.unit()
    )]
    Displaced {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
        /// Where it was; mm or degrees.
        then: f64,
        /// Where it is; mm or degrees.
        now: f64,
    },
}

/// When a scan was taken, and where the manipulators were, where that is known.
struct Taking {
    at: Timestamp,
    positions: Option<Pair<Position>>,
}

impl Service {
    /// Plans how the part comes from where a measurement found it to a target. Moves nothing.
    ///
    /// # Errors
    /// Those of [`Service::measurement`], [`ServiceError::PoseMissing`], [`ServiceError::Stale`] where something has
    /// moved since, [`ServiceError::Motion`] where no allowed path leads there, [`ServiceError::RequestIdReused`].
    pub async fn create_plan(&self, request: PlanRequest) -> Result<PlanAnswer, ServiceError> {
        let side = self.cell_side()?;
        let fingerprint = fingerprint_of("plan", &request);
        let key = request.request_id.clone().map(|id| RequestKey { id, fingerprint });
        if let Some(key) = &key
            && let Some(row) = self.store.plan_by_request(&key.id).await?
        {
            return replay(&row, key);
        }
        let measurement = self.measurement(&request.measurement_id).await?;
        let pose = pose(&measurement, request.part.as_deref())?;
        // A cell that has ended says nothing about where anything is.
        self.cell_view()?;
        let from = side.positions().ok_or(ServiceError::PositionsUnknown)?;
        let taken = self.taking_of(&measurement).await?;
        self.check_fresh(side, taken.at)?;
        check_in_place(side, &taken, from)?;
        let measured = pose.on_rail().ok_or(ServiceError::PoseMissing { measurement_id: measurement.id.clone() })?;
        let measured = PartPose { axis: measured.axis, x_ref: measured.x_ref };
        let plan = find_path(side, from, measured, &request).await?;
        let plan = StoredPlan {
            id: self.clock.new_id("p-"),
            created_at: self.clock.now(),
            expires_at: taken.at.saturating_add(max_age(side)).unwrap_or(taken.at),
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
        let row = self.store.plan(id).await?;
        read_back(&row.ok_or_else(|| ServiceError::PlanUnknown { id: id.to_owned() })?)
    }

    /// The id of the move that executes a plan, where one does.
    ///
    /// # Errors
    /// What the store says.
    pub async fn move_of_plan(&self, plan_id: &str) -> Result<Option<String>, ServiceError> {
        Ok(self.store.job_of_plan(plan_id).await?.map(|row| row.id))
    }

    /// A page of the plans, newest first.
    ///
    /// # Errors
    /// What the store says.
    pub async fn plans(&self, page: &Page) -> Result<Listing<StoredPlan>, ServiceError> {
        let Listing { rows, next } = self.store.plans(page).await?;
        Ok(Listing { rows: aside(move || rows.iter().map(read_back).collect::<Result<_, _>>()).await?, next })
    }

    /// Begins to execute a plan; one that was begun before answers with the same move.
    ///
    /// # Errors
    /// [`ServiceError::PlanUnknown`], [`ServiceError::Stale`], [`ServiceError::Cell`] where the cell refuses.
    pub async fn execute_plan(
        self: &Arc<Self>,
        id: &str,
        lease_id: String,
    ) -> Result<Started<MoveOrder>, ServiceError> {
        let side = self.cell_side()?;
        let stored = self.plan(id).await?;
        if let Some(row) = self.store.job_of_plan(id).await? {
            return Ok(Started { job: super::jobs::read_back(&row)?, replayed: true });
        }
        let by = self.authorise(&lease_id, None).await?;
        let taken_at = stored.expires_at.saturating_sub(max_age(side)).unwrap_or(stored.created_at);
        self.check_fresh(side, taken_at)?;
        let StoredPlan { id, measurement_id, speed_ratio, plan, .. } = stored;
        let order = MoveOrder { by, measurement_id: Some(measurement_id), speed_ratio, plan };
        self.depart(Departure { lease_id, plan_id: Some(id), request: None, order }).await
    }

    /// When the scan behind a measurement was taken, which is what its pose is about: however often a scan is measured again,
    /// its pose gets no younger. What came as a file was taken no later than when its bytes were here first.
    async fn taking_of(&self, measurement: &Measurement) -> Result<Taking, ServiceError> {
        if let Some(scan) = self.scan_job(&measurement.id).await? {
            return Ok(Taking { at: scan.created_at, positions: scan.order.positions });
        }
        let scan_id = measurement.scan_id();
        let at = self.scan(&scan_id).await?.created_at.min(measurement.created_at);
        let positions = match self.first_measurement_of(scan_id).await? {
            Some(first) => self.scan_job(&first).await?.and_then(|scan| scan.order.positions),
            None => None,
        };
        Ok(Taking { at, positions })
    }

    /// The id of the oldest measurement of a scan: the one by the sensor, where the sensor took it.
    async fn first_measurement_of(&self, scan_id: String) -> Result<Option<String>, ServiceError> {
        let filter = Filter { scan_id: Some(scan_id), ..Filter::default() };
        let (mut first, mut before) = (None, None);
        loop {
            let Listing { rows, next } = self.store.measurements(&filter, &Page { limit: PAGE, before }).await?;
            first = rows.last().map(|row| row.id.clone()).or(first);
            if next.is_none() {
                return Ok(first);
            }
            before = next;
        }
    }

    /// Refuses a pose from before a restart, from before the end of the last motion, or too long ago.
    fn check_fresh(&self, side: &CellSide, taken_at: Timestamp) -> Result<(), ServiceError> {
        if side.moved_at().is_some_and(|moved_at| moved_at >= taken_at) {
            return Err(Stale::MovedSince.into());
        }
        let (age, max) = (self.clock.now().duration_since(taken_at), max_age(side));
        if age > max {
            let seconds = |span: SignedDuration| u64::try_from(span.as_secs()).unwrap_or(0);
            return Err(Stale::TooOld { age_s: seconds(age), max_s: seconds(max) }.into());
        }
        if taken_at < self.started_at {
            return Err(Stale::Restarted.into());
        }
        Ok(())
    }

    async fn keep_plan(&self, plan: StoredPlan, key: Option<RequestKey>) -> Result<PlanAnswer, ServiceError> {
        let unwritable = |source| ServiceError::RecordUnwritable { what: "plan", source: Arc::new(source) };
        let document = serde_json::to_string(&plan).map_err(unwritable)?;
        let row = PlanRow { id: plan.id.clone(), created_at: plan.created_at, request: key, document };
        let request_id = row.request.as_ref().map(|request| request.id.clone()).unwrap_or_default();
        match self.store.insert_plan(row).await? {
            InsertedPlan::New => {
                self.advance();
                Ok(PlanAnswer { plan, replayed: false })
            }
            InsertedPlan::Replayed(row) => Ok(PlanAnswer { plan: read_back(&row)?, replayed: true }),
            InsertedPlan::RequestMismatch => Err(ServiceError::RequestIdReused { request_id }),
        }
    }
}

/// Refuses where a manipulator is elsewhere than when the scan was taken, whoever moved it.
fn check_in_place(side: &CellSide, taken: &Taking, now: Pair<Position>) -> Result<(), ServiceError> {
    let Some(then) = taken.positions else { return Ok(()) };
    for carrier in Carrier::ALL {
        for axis in Axis::ALL {
            let (then, now) = (*then.get(carrier).get(axis), *now.get(carrier).get(axis));
            if (then - now).abs() > *side.arrangement.settle_tolerance.get(axis) {
                let (then, now) = (axis.outside(then), axis.outside(now));
                return Err(Stale::Displaced { carrier, axis, then, now }.into());
            }
        }
    }
    Ok(())
}

async fn find_path(
    side: &CellSide,
    from: Pair<Position>,
    measured: PartPose,
    request: &PlanRequest,
) -> Result<Plan, ServiceError> {
    let Target { deflection, pitch, y_c0, z_c0, roll, shift_x } = request.target;
    let axis = AxisLine { p: deflection.tan(), q: pitch.tan(), y0: y_c0, z0: z_c0 };
    let target = PoseTarget { axis, roll, axial_shift: shift_x };
    let (arrangement, speed_ratio) = (side.arrangement, request.speed_ratio);
    aside(move || Ok(plan_alignment(&arrangement, &from, &measured, &target, speed_ratio)?)).await
}

fn max_age(side: &CellSide) -> SignedDuration {
    SignedDuration::from_secs(i64::try_from(side.config.plan_age_max_s).unwrap_or(i64::MAX))
}

/// The pose of a measurement, of the part that was asked for.
fn pose<'a>(measurement: &'a Measurement, part: Option<&str>) -> Result<&'a Pose, ServiceError> {
    let missing = || ServiceError::PoseMissing { measurement_id: measurement.id.clone() };
    let finding = match (part, measurement.findings.sole()) {
        (None, sole) => sole.ok_or_else(missing)?,
        (Some(_), _) => match measurement.findings.choose(part)? {
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

fn read_back(row: &PlanRow) -> Result<StoredPlan, ServiceError> {
    serde_json::from_str(&row.document).map_err(|source| ServiceError::RecordUnreadable {
        what: "plan",
        id: row.id.clone(),
        source: Arc::new(source),
    })
}
