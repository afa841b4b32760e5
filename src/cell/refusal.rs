//! The reasons for which the cell refuses a request, with their messages. A refused request has sent nothing to any device. Numbers
//! are written with at most six decimals, and very large or small ones with an exponent, so that no message becomes long.

use std::time::Duration;

use crate::device::{AxisState, Mode};
use crate::motion::{Axis, Carrier};

use super::state::State;

/// Why a request was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The current state of the cell does not allow the request.
    #[error("cannot {verb}: {}", occupation(*state, job.as_deref()))]
    WrongState {
        /// The state.
        state: State,
        /// The verb of the request.
        verb: &'static str,
        /// The current move or scan, if there is one.
        job: Option<String>,
    },
    /// No client holds the lease.
    #[error("no client holds the lease; take it first")]
    LeaseRequired,
    /// Another client holds the lease.
    #[error("{holder} holds the lease for another {} ms", remaining.as_millis())]
    LeaseHeld {
        /// Name of the holder.
        holder: String,
        /// Remaining time to live.
        remaining: Duration,
    },
    /// The lease with this id has ended.
    #[error("the lease has ended; take it again")]
    LeaseOver,
    /// Faults are latched.
    #[error("{}; see to the cause, then reset", latched(*count))]
    Faulted {
        /// Number of latched faults.
        count: usize,
    },
    /// A device cannot be reached, or its last reading is old.
    #[error("{device} {}", age.map_or_else(|| "has never answered".to_owned(), |age| format!("has not answered for {} ms", age.as_millis())))]
    DeviceStale {
        /// Its name in the configuration.
        device: String,
        /// Time since its last valid answer, if there was one.
        age: Option<Duration>,
    },
    /// The manipulator is not in automatic mode.
    #[error("{} is in mode {}; switch it to automatic", carrier.name(), mode_name(*mode))]
    NotRemote {
        /// The manipulator.
        carrier: Carrier,
        /// Its mode.
        mode: Mode,
    },
    /// A safety function does not allow the manipulator to move.
    #[error("the safety functions of {} do not allow motion", carrier.name())]
    SafetyOpen {
        /// The manipulator.
        carrier: Carrier,
    },
    /// The manipulator is not enabled.
    #[error("{} {}", carrier.name(), unfit(*state))]
    NotEnabled {
        /// The manipulator.
        carrier: Carrier,
        /// Its state.
        state: AxisState,
    },
    /// An axis has no reference.
    #[error("axis {} of {} has no reference; home it first", axis.name(), carrier.name())]
    NotHomed {
        /// The manipulator.
        carrier: Carrier,
        /// The axis.
        axis: Axis,
    },
    /// The path is not allowed, or does not start at the positions of the devices.
    #[error(transparent)]
    Motion(#[from] crate::motion::MotionRefusal),
    /// The cell has no stage, or no sensor.
    #[error("this cell has no {what}")]
    NotThere {
        /// The kind of device.
        what: &'static str,
    },
    /// A job with this id was started before.
    #[error("the job {job} was started before; it is not started again")]
    Repeated {
        /// Its id.
        job: String,
    },
    /// A value of the scan order is outside the range or the speed of the stage.
    #[error("{} is {}; it must be from {} to {}", what.text(), number_text(*given), number_text(*least), number_text(*most))]
    ScanOutOfRange {
        /// The value of the order.
        what: ScanNumber,
        /// Its value.
        given: f64,
        /// The least value.
        least: f64,
        /// The greatest value.
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
        /// The code of the device.
        code: u32,
    },
    /// The cell is being shut down.
    #[error("the service is stopping")]
    Closing,
    /// The cell failed before it answered the request; its outcome is not known.
    #[error("the cell failed before it answered; whether it had started the request is not known")]
    Unanswered,
}

/// The activity of the cell, as part of a message.
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

/// Why a manipulator in this state cannot move, and what to do about it.
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

/// A value of the scan order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanNumber {
    /// The start, mm.
    Start,
    /// The end, mm.
    End,
    /// The distance between start and end, mm.
    Way,
    /// The speed, mm/s.
    Speed,
    /// The number of profiles.
    Profiles,
}

impl ScanNumber {
    const fn text(self) -> &'static str {
        match self {
            Self::Start => "the start of the scan in mm",
            Self::End => "the end of the scan in mm",
            Self::Way => "the length of the scan in mm",
            Self::Speed => "the speed of the scan in mm/s",
            Self::Profiles => "the number of profiles",
        }
    }
}

/// The fault code of a device, as part of a message.
pub(super) fn fault_code(code: u32) -> String {
    match code {
        0 => "a fault without a code".to_owned(),
        code => format!("fault code {code} of the device (see its manual)"),
    }
}

/// Numbers from this magnitude on are written with an exponent.
const LARGE: f64 = 1e7;
/// Numbers below this magnitude are also written with an exponent.
const SMALL: f64 = 1e-5;

/// The number as part of a message.
pub(super) fn number_text(number: f64) -> String {
    if number.is_nan() {
        "no number".to_owned()
    } else if number.is_infinite() {
        if number > 0.0 { "infinity" } else { "-infinity" }.to_owned()
    } else if number != 0.0 && !(SMALL..LARGE).contains(&number.abs()) {
        format!("{number:.3e}")
    } else {
        let text = format!("{number:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
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
    fn a_manipulator_that_is_not_ready_is_reported_with_what_to_do() {
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
    fn a_message_attributes_a_fault_code_to_the_device() {
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
    fn messages_stay_short_for_any_number() {
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

#[cfg(test)]
mod number_tests {
    use super::number_text;

    #[test]
    fn any_number_is_written_with_a_few_digits() {
        for (number, text) in [
            (0.0, "0"),
            (40.0, "40"),
            (-3.25, "-3.25"),
            (40.000_001, "40.000001"),
            (0.1 + 0.2, "0.3"),
            (f64::MIN_POSITIVE, "2.225e-308"),
            (-f64::MAX, "-1.798e308"),
            (f64::NAN, "no number"),
            (f64::NEG_INFINITY, "-infinity"),
            (100.0, "100"),
        ] {
            assert_eq!(number_text(number), text);
        }
    }
}
