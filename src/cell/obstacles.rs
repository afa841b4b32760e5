//! The reasons why a manipulator or the stage must not be moved, derived from the last readings. Pure.

use super::input::{Manual, Taken};
use super::refusal::{Refusal, ScanNumber};
use super::settings::ScanOrder;
use super::snapshot::Live;
use crate::device::{AxisReading, AxisState, CommandResult, Mode, Reading, SensorReading, StageReading};
use crate::motion::{Axes, Axis, Carrier, MotionRefusal, Pair, Path, Position};
use tokio::time::Instant;

/// Greatest number of profiles in one scan.
const PROFILES_MAX: u64 = 1_000_000;
/// Least speed and length of a scan, mm/s and mm. A smaller number is an error of the client.
const SCAN_LEAST: f64 = 0.001;
/// Relative tolerance of the limits of a device: the rounding of single precision in its protocol.
const ROUNDING: f64 = 1e-6;

/// Every reason why the two manipulators must not be moved, the most urgent first.
pub(super) fn of_move(live: &Pair<Live<Reading>>, now: Instant) -> Vec<Refusal> {
    let found = live.iter().map(|(carrier, one)| match good(one, now) {
        Ok(reading) => of_reading(&one.name, carrier, reading),
        Err(stale) => vec![stale],
    });
    found.flatten().collect()
}

/// Every reason why one manipulator must not be moved, the most urgent first.
pub(super) fn of_reading(device: &str, carrier: Carrier, reading: &Reading) -> Vec<Refusal> {
    let mut found = of_homing(device, carrier, reading);
    let unknown = reading.axes.iter().filter(|(_, one)| !one.homed);
    found.extend(unknown.map(|(axis, _)| Refusal::NotHomed { carrier, axis }));
    found
}

/// The reasons why a manipulator must not be homed.
fn of_homing(device: &str, carrier: Carrier, reading: &Reading) -> Vec<Refusal> {
    let mut found = of_enabling(device, carrier, reading);
    // The fault of a manipulator in error stop is reported above, and needs a reset.
    if !enabled(reading) && !reading.moves() && fault_of(reading).is_none() {
        found.push(Refusal::NotEnabled { carrier, state: reading.state });
    }
    if reading.moves() {
        found.push(Refusal::Moves { device: device.to_owned() });
    }
    found
}

fn of_enabling(device: &str, carrier: Carrier, reading: &Reading) -> Vec<Refusal> {
    let mut found = Vec::new();
    if let Some(code) = fault_of(reading) {
        found.push(Refusal::DeviceFault { device: device.to_owned(), code });
    }
    if reading.mode != Mode::Automatic {
        found.push(Refusal::NotRemote { carrier, mode: reading.mode });
    }
    if !reading.safety.allows_motion() {
        found.push(Refusal::SafetyOpen { carrier });
    }
    found
}

/// Why a motion must not go on.
pub(super) fn of_motion(carrier: Carrier, reading: &Reading) -> Option<Refusal> {
    if !reading.safety.allows_motion() {
        Some(Refusal::SafetyOpen { carrier })
    } else if reading.mode != Mode::Automatic {
        Some(Refusal::NotRemote { carrier, mode: reading.mode })
    } else if matches!(reading.state, AxisState::Disabled | AxisState::ErrorStop) {
        Some(Refusal::NotEnabled { carrier, state: reading.state })
    } else {
        None
    }
}

/// Checks a manipulator that has to stay at its position.
pub(super) fn of_staying(
    device: &str,
    carrier: Carrier,
    reading: &Reading,
    place: &Position,
    tolerance: &Axes<f64>,
) -> Option<Refusal> {
    if reading.moves() {
        return Some(Refusal::Moves { device: device.to_owned() });
    }
    let (axis, actual, planned) = away(&reading.position(), place, tolerance)?;
    Some(Refusal::Motion(MotionRefusal::Stale { carrier, axis, actual, planned }))
}

/// The first axis that is not at its planned position, with its actual and its planned position; mm or degrees.
pub(super) fn away(actual: &Position, planned: &Position, tolerance: &Axes<f64>) -> Option<(Axis, f64, f64)> {
    let far = |axis: &Axis| {
        let distance = (actual.get(*axis) - planned.get(*axis)).abs();
        distance.is_nan() || distance > *tolerance.get(*axis)
    };
    let axis = Axis::ALL.into_iter().find(far)?;
    Some((axis, axis.outside(*actual.get(axis)), axis.outside(*planned.get(axis))))
}

/// Checks a path against the limits of the devices, which may be narrower than the configured ones.
pub(super) fn of_own_limits(live: &Pair<Live<Reading>>, path: &Path, now: Instant) -> Result<(), Refusal> {
    for (carrier, one) in live.iter().filter(|(carrier, _)| *path.moves.get(*carrier)) {
        let reading = good(one, now)?;
        for (axis, own) in reading.axes.iter() {
            if path.waypoints.iter().any(|to| *to.speeds.get(carrier).get(axis) > 0.0) {
                for to in &path.waypoints {
                    let (value, speed) = (*to.targets.get(carrier).get(axis), *to.speeds.get(carrier).get(axis));
                    within_own(carrier, axis, own, (value, speed))?;
                }
            }
        }
    }
    Ok(())
}

fn within_own(carrier: Carrier, axis: Axis, own: &AxisReading, (value, speed): (f64, f64)) -> Result<(), Refusal> {
    let (lower, upper, max) = (own.lower, own.upper, own.speed);
    let slack = ROUNDING * lower.abs().max(upper.abs());
    if !(lower - slack..=upper + slack).contains(&value) {
        let (value, lower, upper) = (axis.outside(value), axis.outside(lower), axis.outside(upper));
        return Err(Refusal::Motion(MotionRefusal::OutOfLimits { carrier, axis, value, lower, upper }));
    }
    if speed > max * (1.0 + ROUNDING) {
        let (speed, max) = (axis.outside(speed), axis.outside(max));
        return Err(Refusal::Motion(MotionRefusal::TooFast { carrier, axis, speed, max }));
    }
    Ok(())
}

/// Checks a manual command. A manipulator is homed only if the other one is at rest, and in the state that it must keep during the
/// homing.
pub(super) fn of_manual(
    both: &Pair<Live<Reading>>,
    carrier: Carrier,
    manual: Manual,
    now: Instant,
) -> Result<Taken, Refusal> {
    let live = both.get(carrier);
    let reading = good(live, now)?;
    let homed = reading.axes.iter().all(|(_, one)| one.homed);
    let (found, already) = match manual {
        Manual::Enable => (of_enabling(&live.name, carrier, reading), enabled(reading)),
        Manual::Disable => (Vec::new(), reading.state == AxisState::Disabled),
        Manual::Home => (of_homing(&live.name, carrier, reading), homed),
    };
    match found.into_iter().next() {
        Some(refusal) => Err(refusal),
        None if already => Ok(Taken::AlreadySo),
        None if manual == Manual::Home => of_others(both, carrier, now).map(|()| Taken::Accepted),
        None => Ok(Taken::Accepted),
    }
}

/// Checks the other manipulator before anything is sent, because both clamp the same part.
fn of_others(both: &Pair<Live<Reading>>, carrier: Carrier, now: Instant) -> Result<(), Refusal> {
    for (one, live) in both.iter().filter(|(one, _)| *one != carrier) {
        let reading = good(live, now)?;
        if let Some(code) = fault_of(reading) {
            return Err(Refusal::DeviceFault { device: live.name.clone(), code });
        }
        if reading.moves() {
            return Err(Refusal::Moves { device: live.name.clone() });
        }
        if let Some(refusal) = of_motion(one, reading) {
            return Err(refusal);
        }
    }
    Ok(())
}

/// Checks an order to scan. While a manipulator moves the part, its pose cannot be measured.
pub(super) fn of_scan(
    manipulators: &Pair<Live<Reading>>,
    stage: Option<&Live<StageReading>>,
    sensor: Option<&Live<SensorReading>>,
    order: &ScanOrder,
    now: Instant,
) -> Result<(), Refusal> {
    let stage = stage.ok_or(Refusal::NotThere { what: "stage" })?;
    let sensor = sensor.ok_or(Refusal::NotThere { what: "sensor" })?;
    let reading = good(stage, now)?;
    good(sensor, now)?;
    for (_, one) in manipulators.iter() {
        if good(one, now)?.moves() {
            return Err(Refusal::Moves { device: one.name.clone() });
        }
    }
    if reading.fault_code != 0 {
        return Err(Refusal::DeviceFault { device: stage.name.clone(), code: reading.fault_code });
    }
    if reading.moves {
        return Err(Refusal::Moves { device: stage.name.clone() });
    }
    let (lower, upper) = (reading.lower_mm, reading.upper_mm);
    in_range(ScanNumber::Start, order.x_from_mm, lower, upper)?;
    in_range(ScanNumber::End, order.x_to_mm, lower, upper)?;
    in_range(ScanNumber::Speed, order.speed_mm_s, SCAN_LEAST, reading.speed_mm_s)?;
    let way = (order.x_to_mm - order.x_from_mm).abs();
    in_range(ScanNumber::Way, way, SCAN_LEAST, upper - lower)?;
    // Counts of this size are exact as `f64`.
    in_range(ScanNumber::Profiles, order.profiles_count as f64, 1.0, PROFILES_MAX as f64)
}

/// Written so that NaN is refused as well.
fn in_range(what: ScanNumber, given: f64, least: f64, most: f64) -> Result<(), Refusal> {
    if (least..=most).contains(&given) { Ok(()) } else { Err(Refusal::ScanOutOfRange { what, given, least, most }) }
}

/// Checks what a reset needs: every device that can move answers and is at rest.
pub(super) fn of_reset(
    live: &Pair<Live<Reading>>,
    stage: Option<&Live<StageReading>>,
    now: Instant,
) -> Result<(), Refusal> {
    for (_, one) in live.iter() {
        if good(one, now)?.moves() {
            return Err(Refusal::Moves { device: one.name.clone() });
        }
    }
    match stage {
        Some(stage) if good(stage, now)?.moves => Err(Refusal::Moves { device: stage.name.clone() }),
        Some(_) | None => Ok(()),
    }
}

/// The positions of both manipulators, from good readings.
pub(super) fn positions(live: &Pair<Live<Reading>>, now: Instant) -> Result<Pair<Position>, Refusal> {
    Ok(Pair { m1: good(&live.m1, now)?.position(), m2: good(&live.m2, now)?.position() })
}

/// The fault that a manipulator reports. A code beside a rejected command is the reason for the rejection, not a fault.
pub(super) fn fault_of(reading: &Reading) -> Option<u32> {
    let axis = reading.axes.iter().any(|(_, one)| one.fault || one.state == AxisState::ErrorStop);
    let refused = reading.acknowledged.result == CommandResult::Rejected;
    let faulted = axis || reading.state == AxisState::ErrorStop || (reading.fault_code != 0 && !refused);
    faulted.then_some(reading.fault_code)
}

fn enabled(reading: &Reading) -> bool {
    reading.state == AxisState::Standstill && reading.axes.iter().all(|(_, one)| one.state == AxisState::Standstill)
}

fn good<R>(live: &Live<R>, now: Instant) -> Result<&R, Refusal> {
    live.good(now).ok_or_else(|| Refusal::DeviceStale { device: live.name.clone(), age: live.age(now) })
}
