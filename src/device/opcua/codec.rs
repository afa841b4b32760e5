//! Converts the values of the nodes: those of the status into a [`Reading`], and a [`Command`] into those of the command. OPC UA
//! values are in millimetres and degrees, coaxis uses millimetres and radians. Pure.

use super::layout::Node;
use super::nodes::{Answer, UnexpectedValue};
use crate::device::manipulator::{
    Acknowledged, Action, AxisReading, AxisState, Command, CommandResult, Mode, Reading, Safety,
};
use crate::device::states::StateCodes;
use crate::motion::{Axes, Axis, Position};
use opcua::types::{DataValue, DateTime, Variant};
use std::time::Duration;

/// The device changed its status while it was read, so that it must be read again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Torn;

/// Checks that the answer belongs to one moment: its counter is even, and the same at both ends.
pub(super) fn whole(values: &[(Node, DataValue)]) -> Result<Result<(), Torn>, UnexpectedValue> {
    let (Some(first), Some(last)) = (values.first(), values.last()) else {
        return Err(UnexpectedValue::Missing(Node::Snapshot));
    };
    let first = Answer::new(std::slice::from_ref(first)).double_word(Node::Snapshot)?;
    let last = Answer::new(std::slice::from_ref(last)).double_word(Node::Snapshot)?;
    Ok(if first == last && first.is_multiple_of(2) { Ok(()) } else { Err(Torn) })
}

/// The age of the device's heartbeat at `answered`, by the server's own clock.
pub(super) fn age(values: &[(Node, DataValue)], answered: &DateTime) -> Result<Duration, UnexpectedValue> {
    let node = Node::Heartbeat;
    let given = Answer::new(values).raw(node)?.source_timestamp.filter(|stamp| !stamp.is_null());
    let given = given.ok_or(UnexpectedValue::Type { node, wanted: "stamped with the time of its source" })?;
    // Ticks are 100 ns. A time stamp in the future means that the clock was set, and counts as age zero.
    let ticks = answered.ticks().saturating_sub(given.ticks()).max(0).unsigned_abs();
    Ok(Duration::from_micros(ticks / 10))
}

/// Decodes the reading from the values.
///
/// # Errors
/// [`UnexpectedValue`] names the first value that cannot be used.
pub(super) fn reading(values: &[(Node, DataValue)], codes: StateCodes) -> Result<Reading, UnexpectedValue> {
    let answer = Answer::new(values);
    Ok(Reading {
        state: state(Node::State, answer.word(Node::State)?, codes)?,
        mode: mode(answer.word(Node::Mode)?)?,
        safety: safety(answer.word(Node::Safety)?),
        acknowledged: Acknowledged {
            sequence: answer.word(Node::AckSequence)?,
            result: result(answer.word(Node::Result)?)?,
        },
        fault_code: answer.double_word(Node::FaultCode)?,
        heartbeat: answer.word(Node::Heartbeat)?,
        axes: axes(&answer, codes)?,
    })
}

fn axes(answer: &Answer<'_>, codes: StateCodes) -> Result<Axes<AxisReading>, UnexpectedValue> {
    let states = per_axis(answer.words(Node::AxisStates)?);
    let homed = per_axis(answer.truths(Node::Homed)?);
    let in_position = per_axis(answer.truths(Node::InPosition)?);
    let faults = per_axis(answer.truths(Node::AxisFaults)?);
    let limits = per_axis(answer.truths(Node::LimitsHit)?);
    let commanded = per_axis(answer.numbers(Node::Commanded)?);
    let speeds = per_axis(answer.numbers(Node::MaxVelocities)?);
    let one = |axis: Axis| {
        let (lower, upper) = answer.range(Node::Range(axis))?;
        let speed = *speeds.get(axis);
        if speed <= 0.0 {
            let (node, value) = (Node::MaxVelocities, speed.to_string());
            return Err(UnexpectedValue::Value { node, value, why: "is no speed" });
        }
        Ok(AxisReading {
            actual: axis.inside(answer.number(Node::Actual(axis))?),
            commanded: axis.inside(*commanded.get(axis)),
            lower: axis.inside(lower),
            upper: axis.inside(upper),
            speed: axis.inside(speed),
            state: state(Node::AxisStates, *states.get(axis), codes)?,
            homed: *homed.get(axis),
            in_position: *in_position.get(axis),
            fault: *faults.get(axis),
            limit_hit: *limits.get(axis),
        })
    };
    Ok(Axes { x: one(Axis::X)?, y: one(Axis::Y)?, z: one(Axis::Z)?, c: one(Axis::C)? })
}

pub(super) const fn per_axis<T: Copy>([x, y, z, c]: [T; 4]) -> Axes<T> {
    Axes { x, y, z, c }
}

pub(super) const fn listed<T: Copy>(axes: &Axes<T>) -> [T; 4] {
    [axes.x, axes.y, axes.z, axes.c]
}

fn state(node: Node, code: u16, codes: StateCodes) -> Result<AxisState, UnexpectedValue> {
    let why = "is no state of the table";
    codes.state(code).ok_or_else(|| UnexpectedValue::Value { node, value: code.to_string(), why })
}

fn mode(code: u16) -> Result<Mode, UnexpectedValue> {
    match code {
        0 => Ok(Mode::Off),
        1 => Ok(Mode::Manual),
        2 => Ok(Mode::Automatic),
        _ => Err(UnexpectedValue::Value { node: Node::Mode, value: code.to_string(), why: "is no mode" }),
    }
}

const fn safety(bits: u16) -> Safety {
    Safety {
        emergency_stop_ok: bits & 1 != 0,
        guard_closed: bits & 2 != 0,
        drives_ready: bits & 4 != 0,
        remote_enabled: bits & 8 != 0,
    }
}

fn result(code: u16) -> Result<CommandResult, UnexpectedValue> {
    match code {
        0 => Ok(CommandResult::None),
        1 => Ok(CommandResult::Accepted),
        2 => Ok(CommandResult::Running),
        3 => Ok(CommandResult::Done),
        4 => Ok(CommandResult::Rejected),
        5 => Ok(CommandResult::Aborted),
        _ => Err(UnexpectedValue::Value { node: Node::Result, value: code.to_string(), why: "is no result" }),
    }
}

/// A command that must not be sent, with the reason as text for "cannot …".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NotEncodable(pub(super) &'static str);

/// The values that the command writes, in the order of [`Node::COMMAND`]; they replace all values of the previous command.
///
/// # Errors
/// [`NotEncodable`] if a number is not finite.
pub(super) fn command(command: &Command) -> Result<[(Node, Variant); 7], NotEncodable> {
    if command.sequence == 0 {
        return Err(NotEncodable("take a command without a number"));
    }
    let (code, axes, targets, speeds): (u16, _, _, _) = match command.action {
        Action::Enable => (1, NO_AXES, AT_REST, AT_REST),
        Action::Disable => (2, NO_AXES, AT_REST, AT_REST),
        Action::Reset => (3, NO_AXES, AT_REST, AT_REST),
        Action::Home { axes } => (4, axes, AT_REST, AT_REST),
        Action::MoveTo { axes, targets, speeds } => (5, axes, targets, speeds),
        Action::Halt => (6, NO_AXES, AT_REST, AT_REST),
    };
    let watchdog_ms = u32::try_from(command.watchdog.as_millis()).unwrap_or(0);
    if watchdog_ms == 0 {
        return Err(NotEncodable("be watched for no time, or for weeks"));
    }
    let mask = listed(&axes).into_iter().zip([1_u16, 2, 4, 8]).filter(|(moves, _)| *moves).map(|(_, bit)| bit).sum();
    let [fence, watch, what, which, to, fast, number] = Node::COMMAND;
    Ok([
        (fence, Variant::UInt64(command.fence)),
        (watch, Variant::UInt32(watchdog_ms)),
        (what, Variant::UInt16(code)),
        (which, Variant::UInt16(mask)),
        (to, outside(&targets)?),
        (fast, outside(&speeds)?),
        (number, Variant::UInt16(command.sequence)),
    ])
}

const NO_AXES: Axes<bool> = Axes { x: false, y: false, z: false, c: false };
const AT_REST: Position = Axes { x: 0.0, y: 0.0, z: 0.0, c: 0.0 };

fn outside(values: &Position) -> Result<Variant, NotEncodable> {
    let values = listed(&values.map(|axis, value| axis.outside(*value)));
    if values.iter().all(|value| value.is_finite()) {
        Ok(Variant::from(values.to_vec()))
    } else {
        Err(NotEncodable("go where no number is"))
    }
}
