//! Why the cell does not do what it is asked, as an operator would say it. Nothing was sent to any device then.

use super::failure::fault_code;
use super::number::said;
use super::state::State;
use crate::device::{AxisState, Mode};
use crate::motion::{Axis, Carrier};
use std::time::Duration;

/// Why a request was refused. Must not carry texts of its own; the numbers are the message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The cell is doing something else, or cannot do anything.
    #[error("cannot {verb}: {}", occupation(*state, job.as_deref()))]
    WrongState {
        /// What it does.
        state: State,
        /// What it was asked for.
        verb: &'static str,
        /// The move or scan under way, where there is one.
        job: Option<String>,
    },
    /// Nobody holds the lease.
    #[error("nobody holds the lease; take it first")]
    LeaseRequired,
    /// Another client holds the lease.
    #[error("{holder} holds the lease for another {} ms", remaining.as_millis())]
    LeaseHeld {
        /// Who.
        holder: String,
        /// How long it lasts unless renewed.
        remaining: Duration,
    },
    /// The lease that is named is over, or never was.
    #[error("the lease is over; take it again")]
    LeaseOver,
    /// Faults are latched.
    #[error("{}; see to the cause, then reset", latched(*count))]
    Faulted {
        /// How many.
        count: usize,
    },
    /// A device cannot be reached, or its state is old.
    #[error("{device} {}", age.map_or_else(|| "has never answered".to_owned(), |age| format!("has not answered for {} ms", age.as_millis())))]
    DeviceStale {
        /// Its name in the configuration.
        device: String,
        /// Since its last good answer, where there was one.
        age: Option<Duration>,
    },
    /// Somebody commands the manipulator at its panel, or nobody does.
    #[error("{} is in mode {}; switch it to automatic", carrier.name(), mode_name(*mode))]
    NotRemote {
        /// Which.
        carrier: Carrier,
        /// Its mode.
        mode: Mode,
    },
    /// A safety function keeps the manipulator from moving.
    #[error("the safety functions of {} do not let it move", carrier.name())]
    SafetyOpen {
        /// Which.
        carrier: Carrier,
    },
    /// The manipulator is not enabled.
    #[error("{} {}", carrier.name(), unfit(*state))]
    NotEnabled {
        /// Which.
        carrier: Carrier,
        /// Its state.
        state: AxisState,
    },
    /// An axis has no reference.
    #[error("axis {} of {} has no reference; home it first", axis.name(), carrier.name())]
    NotHomed {
        /// Which.
        carrier: Carrier,
        /// Which.
        axis: Axis,
    },
    /// The path is not allowed, or does not start where the devices are.
    #[error(transparent)]
    Motion(#[from] crate::motion::MotionRefusal),
    /// There is no stage, or no sensor, in this cell.
    #[error("this cell has no {what}")]
    NotThere {
        /// What.
        what: &'static str,
    },
    /// A job with this id was started before.
    #[error("the job {job} was started before; it is not started again")]
    Repeated {
        /// Its id.
        job: String,
    },
    /// The scan is beyond the range or the speed of the stage.
    #[error("{} is {}; it must be from {} to {}", what.said(), said(*given), said(*least), said(*most))]
    ScanOutOfRange {
        /// Which number of the order.
        what: ScanNumber,
        /// As ordered.
        given: f64,
        /// Least.
        least: f64,
        /// Most.
        most: f64,
    },
    /// A device is moving without a command from coaxis.
    #[error("{device} moves")]
    Moves {
        /// Its name in the configuration.
        device: String,
    },
    /// A device reports a fault.
    #[error("{device} reports {}; see to it, then reset", fault_code(*code))]
    DeviceFault {
        /// Its name in the configuration.
        device: String,
        /// As the device gives it.
        code: u32,
    },
    /// The cell is being shut down.
    #[error("the service is stopping")]
    Closing,
    /// The cell failed while it had the request; what became of that is not known.
    #[error("the cell failed before it answered; whether it had begun this is not known")]
    Unanswered,
}

/// What the cell is busy with.
const fn occupation(state: State, job: Option<&str>) -> &'static str {
    match (state, job) {
        (State::Offline, _) => "the cell is offline",
        (State::Idle, _) => "nothing is under way",
        (State::Scanning, _) => "a scan is under way",
        (State::Moving, Some(_)) => "a move is under way",
        (State::Moving, None) => "a manipulator is finding its references",
        (State::Stopping, _) => "the cell is coming to rest",
        (State::Faulted, _) => "a fault is latched",
    }
}

fn latched(count: usize) -> String {
    if count == 1 { "a fault is latched".to_owned() } else { format!("{count} faults are latched") }
}

const fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Off => "off",
        Mode::Manual => "manual",
        Mode::Automatic => "automatic",
    }
}

/// What keeps a manipulator in this state from moving, and what to do about it.
const fn unfit(state: AxisState) -> &'static str {
    match state {
        AxisState::Disabled => "is switched off; enable it first",
        AxisState::ErrorStop => "is in error stop; see to the cause, then reset",
        AxisState::Standstill => "has an axis that is not under control; enable it first",
        AxisState::Homing
        | AxisState::DiscreteMotion
        | AxisState::ContinuousMotion
        | AxisState::SynchronizedMotion
        | AxisState::Stopping => "moves; wait for its rest",
    }
}

/// A number of the order to scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanNumber {
    /// Where it begins, mm.
    Start,
    /// Where it ends, mm.
    End,
    /// The way between them, mm.
    Way,
    /// mm/s.
    Speed,
    /// How many profiles.
    Profiles,
}

impl ScanNumber {
    const fn said(self) -> &'static str {
        match self {
            Self::Start => "the start of the scan in mm",
            Self::End => "the end of the scan in mm",
            Self::Way => "the way of the scan in mm",
            Self::Speed => "the speed of the scan in mm/s",
            Self::Profiles => "the number of profiles",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Failure;

    fn busy(state: State, job: Option<&str>) -> String {
        Refusal::WrongState { state, verb: "move", job: job.map(str::to_owned) }.to_string()
    }

    #[test]
    fn what_keeps_a_manipulator_from_moving_is_said_in_an_operators_words() {
        let unfit = |state| Refusal::NotEnabled { carrier: Carrier::M1, state }.to_string();
        assert_eq!(unfit(AxisState::Disabled), "m1 is switched off; enable it first");
        assert_eq!(unfit(AxisState::ErrorStop), "m1 is in error stop; see to the cause, then reset");
        let remote = Refusal::NotRemote { carrier: Carrier::M2, mode: Mode::Manual };
        assert_eq!(remote.to_string(), "m2 is in mode manual; switch it to automatic");
        assert_eq!(busy(State::Moving, Some("job-1")), "cannot move: a move is under way");
        assert_eq!(busy(State::Moving, None), "cannot move: a manipulator is finding its references");
        assert_eq!(busy(State::Scanning, Some("job-1")), "cannot move: a scan is under way");
        assert_eq!(Refusal::Faulted { count: 1 }.to_string(), "a fault is latched; see to the cause, then reset");
    }

    #[test]
    fn a_devices_code_is_said_to_be_the_devices() {
        let fault = |code| Refusal::DeviceFault { device: "stage".to_owned(), code }.to_string();
        assert_eq!(fault(17), "stage reports fault code 17 of the device (see its manual); see to it, then reset");
        assert_eq!(fault(0), "stage reports a fault without a code; see to it, then reset");
        let latched = Failure::DeviceFault { device: "m1".to_owned(), code: 17 };
        assert_eq!(
            latched.to_string(),
            "m1: reports fault code 17 of the device (see its manual); see to it, then reset"
        );
    }

    #[test]
    fn no_text_grows_with_its_numbers() {
        let refusal = Refusal::ScanOutOfRange {
            what: ScanNumber::Speed,
            given: f64::MAX,
            least: f64::MIN_POSITIVE,
            most: -f64::MAX,
        };
        assert!(refusal.to_string().len() < 110, "{refusal}");
        let (carrier, axis, within) = (Carrier::M1, Axis::C, Duration::from_secs(1));
        let failure = Failure::NotArrived { carrier, axis, actual: f64::NAN, target: f64::MAX, within };
        assert!(failure.to_string().len() < 100, "{failure}");
    }
}
