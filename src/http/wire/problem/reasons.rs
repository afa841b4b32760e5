//! Maps the errors of the service, the store, the cell and the motion to problems, one by one: what happened, what to do, and the
//! numbers as members.

use crate::service::plain;
use std::error::Error;
use std::time::Duration;

use axum::http::{HeaderValue, header};
use serde_json::Value;

use crate::cell::{Refusal, ScanNumber, State};
use crate::device::AxisState;
use crate::http::wire::numbers::rounded;
use crate::motion::{Axis, Carrier, MotionRefusal};
use crate::scan::slice::RegionError;
use crate::service::{ComputeError, ContentError, MeasureError, RecipeError, ServiceError, Stale};
use crate::store::{Loss, StoreError};

use super::Problem;
use super::code::Code;

/// Seconds after which a busy service may be tried again.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// How to repair the file of a scan.
const REPAIR: &str =
    "send the original file again with POST /v1/scans, which repairs it; `coaxis doctor --scrub` checks all files";

/// What to do about lost records.
pub(in crate::http) fn records_lost(loss: &Loss) -> String {
    format!(
        "{loss}. Nothing is written until an operator has decided: stop the service, then restore the database, or accept the \
         loss with `coaxis doctor --accept-loss`"
    )
}

impl From<ServiceError> for Problem {
    fn from(error: ServiceError) -> Self {
        use ServiceError as E;
        let text = error.to_string();
        match error {
            E::Compute(cause) => cause.into(),
            E::Store(cause) => cause.into(),
            E::Content(cause) => cause.into(),
            E::Recipe(cause) => recipe_problem(Code::RecipeInvalid, &cause),
            E::Option(cause) => recipe_problem(Code::OptionInvalid, &cause),
            E::ScansBusy => {
                Self::new(Code::Busy, format!("{text}; nothing was moved, try again after the time in Retry-After"))
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            E::UploadsBusy { uploads_max } => {
                Self::new(Code::Busy, format!("{text}; nothing was recorded, try again after the time in Retry-After"))
                    .with("uploads_max_count", wide(uploads_max))
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            E::ScanUnknown { id } => {
                Self::new(Code::ScanUnknown, format!("{text}; list them with GET /v1/scans")).with("scan_id", id)
            }
            E::ScanFileMissing { id } => {
                Self::new(Code::ScanFileMissing, format!("{text}; {REPAIR}")).with("scan_id", id)
            }
            E::MeasurementUnknown { id } => {
                Self::new(Code::MeasurementUnknown, format!("{text}; list them with GET /v1/measurements"))
                    .with("measurement_id", id)
            }
            E::MeasurementRunning { id } => {
                Self::new(Code::MeasurementRunning, format!("{text}; GET it with ?wait_s= for its end"))
                    .with("measurement_id", id)
                    .with("state", "scanning")
            }
            E::MeasurementFailed { id, standing, reason, .. } => {
                Self::new(Code::MeasurementFailed, format!("{text}; measure again"))
                    .with("measurement_id", id)
                    .with("state", standing.name())
                    .with("reason", reason)
            }
            E::RecipeUnknown { name } => {
                Self::new(Code::RecipeUnknown, format!("{text}; list them with GET /v1/recipes")).with("recipe", name)
            }
            E::RecipeChanged { name, current_etag } => {
                Self::new(Code::RecipeChanged, format!("{text}; read the current revision and send the change again"))
                    .with("recipe", name)
                    .with("current_etag", current_etag)
            }
            E::RecipeAbsent { name } => {
                Self::new(Code::RecipeChanged, format!("{text}; send it without If-Match to create it"))
                    .with("recipe", name)
                    .with("current_etag", Value::Null)
            }
            E::RequestIdReused { request_id } => {
                Self::new(Code::RequestIdReused, format!("{text}; every new request needs a new id"))
                    .with("reused_request_id", request_id)
            }
            E::PartUnknown { part, names } => {
                Self::new(Code::PartUnknown, text).with("part", part).with("parts", names)
            }
            E::ProfileUnknown { index, profiles_count } => {
                Self::new(Code::ProfileUnknown, text).with("index", index).with("profiles_count", profiles_count)
            }
            E::RecordUnreadable { what, id, .. } => {
                let detail = format!("{text}; `coaxis doctor` checks all records");
                Self::new(Code::RecordUnreadable, detail).with("record", what).with("record_id", id)
            }
            E::RecordUnwritable { ref source, .. } => Self::internal(format!("{text}: {source}")),
            E::EndsUnwritten { count } => Self::new(Code::StoreUnavailable, text)
                .with("unwritten_count", wide(count))
                .with_header(header::RETRY_AFTER, RETRY_AFTER_S),
            E::CellAbsent => Self::new(
                Code::CellAbsent,
                format!("{text}; give it one with cell.enabled = true in its configuration"),
            ),
            E::CellGone => {
                Self::new(Code::NotReady, format!("{text}; restart the service, unless it is being stopped"))
                    .with("not_ready", vec!["cell"])
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            E::LeaseOfAnother { holder, remaining } => {
                Self::new(Code::LeaseHeld, format!("{text}; wait for its end, or ask its holder"))
                    .with("holder", holder)
                    .with("remaining_ms", u64::try_from(remaining.as_millis()).unwrap_or(u64::MAX))
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            E::Cell(cause) => cause.into(),
            E::Motion(cause) => cause.into(),
            E::Stale(cause) => cause.into(),
            E::PositionsUnknown => Self::new(Code::DeviceUnavailable, format!("{text}; try again"))
                .with_header(header::RETRY_AFTER, RETRY_AFTER_S),
            E::MoveUnknown { id } => {
                Self::new(Code::MoveUnknown, format!("{text}; list them with GET /v1/moves")).with("move_id", id)
            }
            E::PlanUnknown { id } => {
                Self::new(Code::PlanUnknown, format!("{text}; list them with GET /v1/plans")).with("plan_id", id)
            }
            E::PoseMissing { measurement_id } => {
                Self::new(Code::PoseMissing, text).with("measurement_id", measurement_id)
            }
            E::Value { field, allowed } => {
                Self::new(Code::OptionInvalid, text).with("field", field).with("allowed", allowed)
            }
            E::Equipment(source) => Self::internal(format!("{text}: {source}")),
            E::Threads(source) => Self::internal(format!("{text}: {source}")),
            E::CellThreads(source) => Self::internal(format!("{text}: {source}")),
        }
    }
}

impl From<ComputeError> for Problem {
    fn from(error: ComputeError) -> Self {
        match error {
            ComputeError::Busy { running_max, queue_max } => {
                Self::new(Code::Busy, format!("{error}; nothing was recorded, try again after the time in Retry-After"))
                    .with("running_max_count", wide(running_max))
                    .with("queue_max_count", wide(queue_max))
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            ComputeError::TooLong { deadline_ms } => {
                let detail = format!(
                    "{error}; nothing was recorded. Thin the scan out, restrict it to a region, or raise timeouts.calculation_ms"
                );
                Self::new(Code::CalculationTooLong, detail).with("deadline_ms", deadline_ms)
            }
            ComputeError::Panicked => Self::internal(error.to_string()),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        use StoreError as E;
        let cause = chain(&error);
        match error {
            E::Full => Self::new(
                Code::StoreFull,
                "the store is full; nothing was recorded. Free space on the disk of the data folder",
            ),
            E::Unavailable(_) | E::FileUnavailable { .. } | E::FolderInUse { .. } | E::Closed => Self::new(
                Code::StoreUnavailable,
                "the store cannot be used now; try again after the time in Retry-After",
            )
            .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            .because(cause),
            E::RecordsLost(loss) => Self::new(Code::NotReady, records_lost(&loss)).with("not_ready", vec!["store"]),
            E::ScanDamaged { id, found_sha256 } => Self::new(Code::ScanFileDamaged, format!("{cause}; {REPAIR}"))
                .with("scan_id", id)
                .with("found_sha256", found_sha256),
            E::Damaged(_)
            | E::NewerSchema { .. }
            | E::OlderSchema { .. }
            | E::MigrationDiffers { .. }
            | E::IdTaken { .. }
            | E::NumberTooLarge { .. } => Self::internal(cause),
            E::ScanTooLarge { bytes_max } => {
                Self::new(Code::BodyTooLarge, format!("{cause}; thin it out or raise the limit"))
                    .with("bytes_max", bytes_max)
            }
            E::ScanUnknown { scan_id } => Self::new(Code::ScanUnknown, cause).with("scan_id", scan_id),
            E::CursorMalformed => Self::new(
                Code::CursorMalformed,
                "the cursor did not come from a list of this service; start without a cursor",
            ),
        }
    }
}

impl From<ContentError> for Problem {
    fn from(error: ContentError) -> Self {
        match error {
            ContentError::Scan(cause) => cause.into(),
            ContentError::Packing(cause) => cause.into(),
        }
    }
}

impl From<MeasureError> for Problem {
    fn from(error: MeasureError) -> Self {
        match error {
            MeasureError::Decode(cause) => cause.into(),
            MeasureError::Slice(cause) => cause.into(),
        }
    }
}

/// A problem of an invalid recipe value, with the field concerned.
fn recipe_problem(code: Code, error: &RecipeError) -> Problem {
    use RecipeError as E;
    let problem = Problem::new(code, error.to_string());
    match error {
        &E::OutOfRange { name, allowed, value } => {
            problem.with("field", name).with("allowed", allowed).with("value", value)
        }
        E::EpsilonTwice => problem.with("field", "epsilon_noise_multiple"),
        E::NoiseUnknown => problem.with("field", "noise_sigma_mm"),
        E::ProfileRule(_) => problem.with("field", "profile_by"),
        E::Frame(_) => problem.with("field", "frame"),
        E::Parts(cause) => problem.with("field", format!("parts.{}", cause.field())),
        E::Region(RegionError { axis }) => problem.with("field", format!("region.{axis}")),
        &E::DescriptionTooLong { characters_count, characters_max } => problem
            .with("field", "description")
            .with("characters_count", wide(characters_count))
            .with("characters_max", wide(characters_max)),
    }
}

fn wide(count: usize) -> Value {
    Value::from(u64::try_from(count).unwrap_or(u64::MAX))
}

/// An error with all its causes, for the log.
fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        use Refusal as R;
        let text = refusal.to_string();
        match refusal {
            R::WrongState { state, verb, job } => wrong_state(&text, state, verb, job),
            R::LeaseRequired => Self::new(Code::LeaseRequired, format!("{text}: POST /v1/cell/lease")),
            R::LeaseHeld { holder, remaining } => {
                Self::new(Code::LeaseHeld, format!("{text}; wait for its end, or ask its holder"))
                    .with("holder", holder)
                    .with("remaining_ms", ms(remaining))
                    .with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
            R::LeaseOver => Self::new(Code::LeaseOver, format!("{text}: POST /v1/cell/lease")),
            R::Faulted { count } => Self::new(
                Code::Faulted,
                format!("{text}: GET /v1/cell names them, POST /v1/cell/reset acknowledges them"),
            )
            .with("faults_count", u64::try_from(count).unwrap_or(u64::MAX)),
            R::DeviceStale { device, age } => Self::new(
                Code::DeviceUnavailable,
                format!("{text}; check its connection, e.g. with `coaxis devices check`"),
            )
            .with("device", device)
            .with("age_ms", age.map(ms))
            .with_header(header::RETRY_AFTER, RETRY_AFTER_S),
            R::NotRemote { carrier, .. } => of(Code::NotRemote, text, carrier),
            R::SafetyOpen { carrier } => of(Code::SafetyOpen, text, carrier),
            R::NotEnabled { carrier, state: AxisState::ErrorStop } => {
                of(Code::NotEnabled, format!("{text}: POST /v1/cell/reset"), carrier)
            }
            R::NotEnabled { carrier, .. } => {
                let detail = format!("{text}: POST /v1/manipulators/{}/enable", carrier.name());
                of(Code::NotEnabled, detail, carrier)
            }
            R::NotHomed { carrier, axis } => {
                let detail = format!("{text}: POST /v1/manipulators/{}/home", carrier.name());
                of(Code::NotHomed, detail, carrier).with("axis", axis.name())
            }
            R::Motion(cause) => cause.into(),
            R::NotThere { what } => Self::new(Code::DeviceAbsent, text).with("device", what),
            // The service creates the ids of jobs itself.
            R::Repeated { job } => Self::internal(format!("the id of job {job} was used twice")),
            R::ScanOutOfRange { what, given, least, most } => scan_out_of_range(what, given, least, most),
            R::Moves { device } => {
                Self::new(Code::DeviceMoves, format!("{text}, without a command from coaxis")).with("device", device)
            }
            R::DeviceFault { device, code } => {
                Self::new(Code::DeviceFault, text).with("device", device).with("device_code", code)
            }
            R::Closing | R::Unanswered => {
                Self::new(Code::NotReady, text).with_header(header::RETRY_AFTER, RETRY_AFTER_S)
            }
        }
    }
}

/// The problem of a scan order, with the field of the request concerned.
fn scan_out_of_range(what: ScanNumber, given: f64, least: f64, most: f64) -> Problem {
    let field = match what {
        ScanNumber::Start => "x_from_mm",
        ScanNumber::End => "x_to_mm",
        ScanNumber::Way => "x_to_mm - x_from_mm",
        ScanNumber::Speed => "speed_mm_s",
        ScanNumber::Profiles => "profiles_count",
    };
    let detail = format!("{field} must be between {} and {}, got {}", plain(least), plain(most), plain(given));
    Problem::new(Code::ScanOutOfRange, detail)
        .with("field", field)
        .with("value", given)
        .with("least", least)
        .with("most", most)
}

fn wrong_state(text: &str, state: State, verb: &str, job: Option<String>) -> Problem {
    let problem = match state {
        State::Offline => Problem::new(Code::DeviceUnavailable, format!("{text}; a device was not reached yet"))
            .with_header(header::RETRY_AFTER, RETRY_AFTER_S),
        State::Faulted => {
            Problem::new(Code::Faulted, format!("{text}; remove the causes of the faults, then POST /v1/cell/reset"))
        }
        State::Stopping => Problem::new(Code::CellBusy, format!("{text}; wait until it is idle")),
        State::Idle | State::Scanning | State::Moving => {
            Problem::new(Code::CellBusy, format!("{text}; wait for its end, or stop it"))
        }
    };
    problem.with("state", state.name()).with("verb", verb).with("job_id", job)
}

impl From<MotionRefusal> for Problem {
    fn from(refusal: MotionRefusal) -> Self {
        use MotionRefusal as R;
        let text = refusal.to_string();
        match refusal {
            R::OutOfLimits { carrier, axis, value, lower, upper } => on(Code::OutOfLimits, text, carrier, axis)
                .with("value", rounded(value))
                .with("lower", rounded(lower))
                .with("upper", rounded(upper)),
            R::StandsOutside { carrier, axis, actual, lower, upper } => on(Code::StandsOutside, text, carrier, axis)
                .with("actual", rounded(actual))
                .with("lower", rounded(lower))
                .with("upper", rounded(upper)),
            R::StepTooLarge { carrier, axis, travel, max } => {
                on(Code::StepTooLarge, text, carrier, axis).with("travel", rounded(travel)).with("max", rounded(max))
            }
            R::TooFast { carrier, axis, speed, max } => {
                on(Code::TooFast, text, carrier, axis).with("speed", rounded(speed)).with("max", rounded(max))
            }
            R::RunsOn { carrier, run_on, max, unit } => of(Code::TooFast, text, carrier)
                .with("run_on", rounded(run_on))
                .with("max", rounded(max))
                .with("unit", unit),
            R::ShareOutOfRange { share, min } => {
                let detail = format!("speed_ratio must be between {min} and 1, got {}", plain(share));
                Self::new(Code::OptionInvalid, detail)
                    .with("field", "speed_ratio")
                    .with("value", share)
                    .with("least", min)
            }
            R::SpansMeet { gap_mm, min_mm } => {
                Self::new(Code::SpansMeet, text).with("gap_mm", rounded(gap_mm)).with("min_mm", rounded(min_mm))
            }
            R::StrainTooLarge { strain_mm, max_mm } => Self::new(Code::StrainTooLarge, text)
                .with("strain_mm", rounded(strain_mm))
                .with("max_mm", rounded(max_mm)),
            R::TwistTooLarge { twist_deg, max_deg } => Self::new(Code::TwistTooLarge, text)
                .with("twist_deg", rounded(twist_deg))
                .with("max_deg", rounded(max_deg)),
            R::NothingToMove => Self::new(Code::NothingToMove, text),
            // Values of a request were checked; a pose or a position that is not finite comes from the device or the scan.
            R::NotFinite { what } => Self::new(Code::OptionInvalid, text).with("what", what),
            R::PathTooLong { max_count } => Self::new(Code::PathTooLong, text)
                .with("waypoints_max_count", u64::try_from(max_count).unwrap_or(u64::MAX)),
            R::Stale { carrier, axis, actual, planned } => on(Code::PlanStale, text, carrier, axis)
                .with("actual", rounded(actual))
                .with("planned", rounded(planned)),
            // The service divides the paths itself, and it checked the arrangement at the start.
            R::PathTooCoarse { .. } | R::PathMalformed { .. } | R::Arrangement(_) => Self::internal(text),
        }
    }
}

impl From<Stale> for Problem {
    fn from(stale: Stale) -> Self {
        let problem = Self::new(Code::PlanStale, stale.to_string());
        match stale {
            Stale::TooOld { age_s, max_s } => problem.with("age_s", age_s).with("max_s", max_s),
            Stale::MovedSince | Stale::Restarted => problem,
            Stale::Displaced { carrier, axis, then, now } => problem
                .with("manipulator", carrier.name())
                .with("axis", axis.name())
                .with("unit", axis.unit())
                .with("planned", rounded(then))
                .with("actual", rounded(now)),
        }
    }
}

fn of(code: Code, text: String, carrier: Carrier) -> Problem {
    Problem::new(code, text).with("manipulator", carrier.name())
}

fn on(code: Code, text: String, carrier: Carrier, axis: Axis) -> Problem {
    of(code, text, carrier).with("axis", axis.name()).with("unit", axis.unit())
}

fn ms(span: Duration) -> u64 {
    u64::try_from(span.as_millis()).unwrap_or(u64::MAX)
}
