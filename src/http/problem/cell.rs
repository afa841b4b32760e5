//! The cell's and the motion's reasons as problems, one by one: what happened, what to do, and the numbers as members.

use super::super::numbers::rounded;
use super::Problem;
use super::code::Code;
use crate::cell::{Refusal, ScanNumber, State};
use crate::device::AxisState;
use crate::motion::{Axis, Carrier, MotionRefusal};
use crate::service::{Stale, plain};
use axum::http::{HeaderValue, header};
use std::time::Duration;

/// After this another try may be worth it, seconds.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        use Refusal as R;
        let text = refusal.to_string();
        match refusal {
            R::WrongState { state, verb, job } => wrong_state(&text, state, verb, job),
            R::LeaseRequired => Self::new(Code::LeaseRequired, format!("{text}: POST /v1/cell/lease")),
            R::LeaseHeld { holder, remaining } => {
                Self::new(Code::LeaseHeld, format!("{text}; wait for it, or ask there"))
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
                format!("{text}; look after its link, `coaxis devices check` says more"),
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
            // Ids of jobs are our own.
            R::Repeated { job } => Self::internal(format!("the id of job {job} came twice")),
            R::ScanOutOfRange { what, given, least, most } => scan_out_of_range(what, given, least, most),
            R::Moves { device } => {
                Self::new(Code::DeviceMoves, format!("{text}, and nobody here has told it to")).with("device", device)
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

/// By the field of the request that it is about.
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
        State::Faulted => Problem::new(Code::Faulted, format!("{text}; see to the faults, then POST /v1/cell/reset")),
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
            // What a request says is within bounds; a pose or a position that is not is the device's or the scan's.
            R::NotFinite { what } => Self::new(Code::OptionInvalid, text).with("what", what),
            R::PathTooLong { max_count } => Self::new(Code::PathTooLong, text)
                .with("waypoints_max_count", u64::try_from(max_count).unwrap_or(u64::MAX)),
            R::Stale { carrier, axis, actual, planned } => on(Code::PlanStale, text, carrier, axis)
                .with("actual", rounded(actual))
                .with("planned", rounded(planned)),
            // Paths are cut here, and the arrangement was checked at the start.
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
