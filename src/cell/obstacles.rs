//! What keeps a manipulator, or the stage, from being moved: found in what was read last. Pure. Must not know leases or states.

use super::driver::moves;
use super::input::{Manual, Taken};
use super::snapshot::Live;
use super::{Refusal, ScanOrder};
use crate::device::{AxisState, CommandResult, Mode, Reading, SensorReading, StageReading};
use crate::motion::{Carrier, Pair, Position};
use std::time::Duration;
use tokio::time::Instant;

/// Profiles that one scan may have.
const PROFILES_MAX: u64 = 1_000_000;

/// Everything that keeps the two manipulators from being moved, the first to see to first.
pub(super) fn of_move(live: &Pair<Live<Reading>>, now: Instant) -> Vec<Refusal> {
    let found = live.iter().map(|(carrier, one)| match good(one, now) {
        Ok(reading) => of_reading(&one.name, carrier, reading),
        Err(stale) => vec![stale],
    });
    found.flatten().collect()
}

/// The same, of one that was read.
pub(super) fn of_reading(device: &str, carrier: Carrier, reading: &Reading) -> Vec<Refusal> {
    let mut found = of_homing(device, carrier, reading);
    let unknown = reading.axes.iter().filter(|(_, one)| !one.homed);
    found.extend(unknown.map(|(axis, _)| Refusal::NotHomed { carrier, axis }));
    found
}

/// What keeps one from finding its references.
fn of_homing(device: &str, carrier: Carrier, reading: &Reading) -> Vec<Refusal> {
    let mut found = of_enabling(device, carrier, reading);
    if !enabled(reading) && !moves(reading) {
        found.push(Refusal::NotEnabled { carrier, state: reading.state });
    }
    if moves(reading) {
        found.push(Refusal::Moves { device: device.to_owned() });
    }
    found
}

/// Why a manipulator must not go on, nor the other one with it, while either is under way.
pub(super) fn under_way(carrier: Carrier, reading: &Reading) -> Option<Refusal> {
    if !reading.safety.allows_motion() {
        return Some(Refusal::SafetyOpen { carrier });
    }
    if reading.mode != Mode::Automatic {
        return Some(Refusal::NotRemote { carrier, mode: reading.mode });
    }
    let states = reading.axes.iter().map(|(_, axis)| axis.state).chain([reading.state]);
    let powerless = states.into_iter().find(|state| matches!(state, AxisState::Disabled | AxisState::ErrorStop));
    powerless.map(|state| Refusal::NotEnabled { carrier, state })
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

/// Whether a manipulator can be told so by hand, or is so already.
pub(super) fn of_manual(
    live: &Live<Reading>,
    carrier: Carrier,
    manual: Manual,
    now: Instant,
) -> Result<Taken, Refusal> {
    let reading = good(live, now)?;
    let (found, already) = match manual {
        Manual::Enable => (of_enabling(&live.name, carrier, reading), enabled(reading)),
        Manual::Disable => (Vec::new(), reading.state == AxisState::Disabled),
        Manual::Home => (of_homing(&live.name, carrier, reading), false),
    };
    match found.into_iter().next() {
        Some(refusal) => Err(refusal),
        None if already => Ok(Taken::AlreadySo),
        None => Ok(Taken::Accepted),
    }
}

/// Whether a scan can be taken as ordered.
pub(super) fn of_scan(
    stage: Option<&Live<StageReading>>,
    sensor: Option<&Live<SensorReading>>,
    order: &ScanOrder,
    now: Instant,
) -> Result<(), Refusal> {
    let stage = stage.ok_or(Refusal::NotThere { what: "stage" })?;
    let sensor = sensor.ok_or(Refusal::NotThere { what: "sensor" })?;
    let reading = good(stage, now)?;
    good(sensor, now)?;
    if reading.fault_code != 0 {
        return Err(Refusal::DeviceFault { device: stage.name.clone(), code: reading.fault_code });
    }
    if reading.moves {
        return Err(Refusal::Moves { device: stage.name.clone() });
    }
    let (lower, upper) = (reading.lower_mm, reading.upper_mm);
    in_range("the start of the scan, mm,", order.x_from_mm, lower, upper)?;
    in_range("the end of the scan, mm,", order.x_to_mm, lower, upper)?;
    in_range("the speed of the scan, mm/s,", order.speed_mm_s, f64::MIN_POSITIVE, reading.speed_mm_s)?;
    let way = (order.x_to_mm - order.x_from_mm).abs();
    in_range("the way of the scan, mm,", way, f64::MIN_POSITIVE, f64::MAX)?;
    // Counts this small are exact as doubles.
    in_range("the number of profiles", order.profiles_count as f64, 1.0, PROFILES_MAX as f64)
}

/// Refuses what is not a number, too.
fn in_range(what: &'static str, given: f64, least: f64, most: f64) -> Result<(), Refusal> {
    if (least..=most).contains(&given) { Ok(()) } else { Err(Refusal::ScanOutOfRange { what, given, least, most }) }
}

/// Whether every device that moves answers and stands: what a reset needs.
pub(super) fn of_reset(
    live: &Pair<Live<Reading>>,
    stage: Option<&Live<StageReading>>,
    now: Instant,
) -> Result<(), Refusal> {
    for (_, one) in live.iter() {
        if moves(good(one, now)?) {
            return Err(Refusal::Moves { device: one.name.clone() });
        }
    }
    match stage {
        Some(stage) if good(stage, now)?.moves => Err(Refusal::Moves { device: stage.name.clone() }),
        Some(_) | None => Ok(()),
    }
}

/// Where both are, by readings that may be trusted.
pub(super) fn positions(live: &Pair<Live<Reading>>, now: Instant) -> Result<Pair<Position>, Refusal> {
    Ok(Pair { m1: good(&live.m1, now)?.position(), m2: good(&live.m2, now)?.position() })
}

/// The fault that a manipulator reports. A code beside a refused command says why it was refused and is no fault.
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
    live.good(now)
        .ok_or_else(|| Refusal::DeviceStale { device: live.name.clone(), age: live.age(now).unwrap_or(Duration::ZERO) })
}
