//! The cell for a PLC: one flat object of integers, below 1024 bytes, fixed keys in a fixed order. Lengths in 10⁻⁶ metres
//! (`_um`), angles in 10⁻⁶ degrees (`_udeg`); null for unknown values. The tables of the codes are in docs/plc.md.

use crate::cell::{Live, Refusal, State};
use crate::device::{AxisState, Reading};
use crate::http::wire::numbers::{ms, permille};
use crate::http::wire::problem::{Code, Problem};
use crate::motion::Axis;
use crate::service::CellView;
use serde::Serialize;
use utoipa::ToSchema;

/// The cell as integers.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = PlcCell)]
pub(in crate::http) struct PlcCellDocument {
    /// Grows with every change.
    sequence: u64,
    /// 0 offline, 1 idle, 2 scanning, 3 moving, 4 stopping, 5 faulted.
    #[schema(minimum = 0, maximum = 5)]
    state_code: u8,
    /// 1 where a move by the holder of the lease would be begun, else 0.
    #[schema(minimum = 0, maximum = 1)]
    commands_allowed: u8,
    /// The most urgent reason why not: 0 none, 1 cell_busy, 2 lease_required, 3 lease_held, 4 lease_over, 5 faulted,
    /// 6 device_unavailable, 7 device_absent, 8 not_remote, 9 safety_open, 10 not_enabled, 11 not_homed, 12 device_moves,
    /// 13 device_fault, 14 stands_outside, 15 not_ready, 99 another.
    #[schema(minimum = 0, maximum = 99)]
    reason_code: u8,
    /// Reasons in all.
    reasons_count: u64,
    /// Faults that are latched until a reset.
    faults_count: u64,
    /// 1 if there is a lease, else 0.
    #[schema(minimum = 0, maximum = 1)]
    lease_held: u8,
    /// The fence of the lease that is held; null if there is none.
    fence: Option<u64>,
    /// How long the lease lasts unless it is used; null if there is none.
    lease_remaining_ms: Option<u64>,
    /// How far the move or scan under way is, per mille; null where there is none.
    progress_permille: Option<u16>,
    /// How well m1 is known: 0 lost, 1 stale, 2 good.
    #[schema(minimum = 0, maximum = 2)]
    m1_quality_code: u8,
    /// Age of its last reading; null if it never answered, as are all following fields of m1.
    m1_age_ms: Option<u64>,
    /// 0 disabled, 1 standstill, 2 homing, 3 discrete_motion, 4 continuous_motion, 5 synchronized_motion, 6 stopping,
    /// 7 error_stop.
    #[schema(minimum = 0, maximum = 7)]
    m1_state_code: Option<u8>,
    /// 1 where all of its axes have their references, else 0.
    m1_homed: Option<u8>,
    /// Its own fault code; 0 is none.
    m1_fault_code: Option<u32>,
    /// Where it is, along the rail.
    m1_x_um: Option<i64>,
    /// Across.
    m1_y_um: Option<i64>,
    /// Up.
    m1_z_um: Option<i64>,
    /// Its turn.
    m1_c_udeg: Option<i64>,
    /// The same of m2.
    #[schema(minimum = 0, maximum = 2)]
    m2_quality_code: u8,
    /// The same of m2.
    m2_age_ms: Option<u64>,
    /// The same of m2.
    #[schema(minimum = 0, maximum = 7)]
    m2_state_code: Option<u8>,
    /// The same of m2.
    m2_homed: Option<u8>,
    /// The same of m2.
    m2_fault_code: Option<u32>,
    /// The same of m2.
    m2_x_um: Option<i64>,
    /// The same of m2.
    m2_y_um: Option<i64>,
    /// The same of m2.
    m2_z_um: Option<i64>,
    /// The same of m2.
    m2_c_udeg: Option<i64>,
    /// Where the stage is, along the rail; null where there is none, or it never answered.
    stage_x_um: Option<i64>,
    /// 1 where the stage moves, else 0.
    stage_moves: Option<u8>,
    /// 1 where the sensor takes profiles, else 0.
    sensor_running: Option<u8>,
}

/// A manipulator as integers.
struct Manipulator {
    quality_code: u8,
    age_ms: Option<u64>,
    state_code: Option<u8>,
    homed: Option<u8>,
    fault_code: Option<u32>,
    /// x, y, z in 10⁻⁶ m, c in 10⁻⁶ degrees.
    axes: [Option<i64>; 4],
}

impl From<&CellView> for PlcCellDocument {
    fn from(view: &CellView) -> Self {
        let cell = &view.snapshot;
        let (m1, m2) = (Manipulator::of(&cell.manipulators.m1, view), Manipulator::of(&cell.manipulators.m2, view));
        let ([m1_x_um, m1_y_um, m1_z_um, m1_c_udeg], [m2_x_um, m2_y_um, m2_z_um, m2_c_udeg]) = (m1.axes, m2.axes);
        let stage = cell.stage.as_ref().and_then(|stage| stage.reading);
        let sensor = cell.sensor.as_ref().and_then(|sensor| sensor.reading.as_ref());
        let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        Self {
            sequence: cell.sequence,
            state_code: state_code(cell.state),
            commands_allowed: cell.commands_allowed.into(),
            reason_code: cell.reasons.first().map_or(0, reason_code),
            reasons_count: wide(cell.reasons.len()),
            faults_count: wide(cell.faults.len()),
            lease_held: cell.lease.is_some().into(),
            fence: cell.lease.as_ref().map(|lease| lease.fence),
            lease_remaining_ms: cell.lease.as_ref().map(|lease| ms(view.until(lease.until))),
            progress_permille: cell.job.as_ref().map(|job| permille(view.progress.unwrap_or(job.progress))),
            m1_quality_code: m1.quality_code,
            m1_age_ms: m1.age_ms,
            m1_state_code: m1.state_code,
            m1_homed: m1.homed,
            m1_fault_code: m1.fault_code,
            m1_x_um,
            m1_y_um,
            m1_z_um,
            m1_c_udeg,
            m2_quality_code: m2.quality_code,
            m2_age_ms: m2.age_ms,
            m2_state_code: m2.state_code,
            m2_homed: m2.homed,
            m2_fault_code: m2.fault_code,
            m2_x_um,
            m2_y_um,
            m2_z_um,
            m2_c_udeg,
            stage_x_um: stage.and_then(|stage| millionths(stage.actual_mm * 1e3)),
            stage_moves: stage.map(|stage| stage.moves.into()),
            sensor_running: sensor.map(|sensor| sensor.running.into()),
        }
    }
}

impl Manipulator {
    fn of(live: &Live<Reading>, view: &CellView) -> Self {
        let reading = live.reading.as_ref();
        let value = |axis: Axis| {
            let actual = reading?.axes.get(axis).actual;
            millionths(if axis == Axis::C { actual.to_degrees() * 1e6 } else { actual * 1e3 })
        };
        Self {
            quality_code: match live.quality(view.now()) {
                crate::cell::Quality::Lost => 0,
                crate::cell::Quality::Stale => 1,
                crate::cell::Quality::Good => 2,
            },
            age_ms: live.age(view.now()).map(ms),
            state_code: reading.map(|reading| axis_state_code(reading.state)),
            homed: reading.map(|reading| Axis::ALL.into_iter().all(|axis| reading.axes.get(axis).homed).into()),
            fault_code: reading.map(|reading| reading.fault_code),
            axes: [value(Axis::X), value(Axis::Y), value(Axis::Z), value(Axis::C)],
        }
    }
}

const fn state_code(state: State) -> u8 {
    match state {
        State::Offline => 0,
        State::Idle => 1,
        State::Scanning => 2,
        State::Moving => 3,
        State::Stopping => 4,
        State::Faulted => 5,
    }
}

const fn axis_state_code(state: AxisState) -> u8 {
    match state {
        AxisState::Disabled => 0,
        AxisState::Standstill => 1,
        AxisState::Homing => 2,
        AxisState::DiscreteMotion => 3,
        AxisState::ContinuousMotion => 4,
        AxisState::SynchronizedMotion => 5,
        AxisState::Stopping => 6,
        AxisState::ErrorStop => 7,
    }
}

/// The number of the code that a request would get. Numbers are never changed, because PLC programs contain them.
fn reason_code(refusal: &Refusal) -> u8 {
    match Problem::from(refusal.clone()).code() {
        Code::CellBusy => 1,
        Code::LeaseRequired => 2,
        Code::LeaseHeld => 3,
        Code::LeaseOver => 4,
        Code::Faulted => 5,
        Code::DeviceUnavailable => 6,
        Code::DeviceAbsent => 7,
        Code::NotRemote => 8,
        Code::SafetyOpen => 9,
        Code::NotEnabled => 10,
        Code::NotHomed => 11,
        Code::DeviceMoves => 12,
        Code::DeviceFault => 13,
        Code::StandsOutside => 14,
        Code::NotReady => 15,
        _ => 99,
    }
}

/// The nearest integer of at most nine digits, which fits the signed 32-bit word of a PLC; `None` if out of range.
fn millionths(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked in the same line")]
    (rounded.abs() <= 999_999_999.0).then_some(rounded as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_of_the_documentation_match_the_view() {
        let page = include_str!("../../../../docs/plc.md");
        let document: serde_json::Value =
            serde_json::from_str(&crate::http::openapi_json().expect("a document")).expect("JSON");
        let mut rows_count = 0;
        for name in ["state_code", "reason_code", "m1_quality_code", "m1_state_code"] {
            let pointer = format!("/components/schemas/PlcCell/properties/{name}/description");
            let text = document.pointer(&pointer).and_then(serde_json::Value::as_str).expect("described");
            let words: Vec<_> = text.split_whitespace().collect();
            for pair in words.windows(2) {
                let Ok(number) = pair[0].parse::<u32>() else { continue };
                let code = pair[1].trim_end_matches([',', '.', ':']);
                assert!(page.contains(&format!("| {number} | `{code}` |")), "{name}: {number} {code}");
                rows_count += 1;
            }
        }
        assert_eq!(rows_count, 6 + 17 + 3 + 8);
        for state in [State::Offline, State::Idle, State::Scanning, State::Moving, State::Stopping, State::Faulted] {
            assert!(page.contains(&format!("| {} | `{}` |", state_code(state), state.name())));
        }
    }

    #[test]
    fn the_reasons_have_the_documented_numbers() {
        assert_eq!(reason_code(&Refusal::LeaseRequired), 2);
        assert_eq!(reason_code(&Refusal::LeaseOver), 4);
        assert_eq!(reason_code(&Refusal::Faulted { count: 1 }), 5);
        assert_eq!(reason_code(&Refusal::Closing), 15);
    }
}
