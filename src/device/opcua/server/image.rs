//! The device's side of the codec: what a reading looks like in the nodes, and which command they make. Pure.

use crate::device::manipulator::{Action, Command, CommandResult, Mode, Reading, Safety};
use crate::device::opcua::codec::{listed, per_axis};
use crate::device::opcua::layout::Node;
use crate::device::opcua::nodes::{Answer, Odd};
use crate::device::opcua::plausible::unit;
use crate::device::states::StateCodes;
use crate::motion::{Axes, Axis, Position};
use opcua::types::{DataValue, EUInformation, ExtensionObject, LocalizedText, Range, Variant};
use std::time::Duration;

/// Whose codes the units are.
const CEFACT: &str = "http://www.opcfoundation.org/UA/units/un/cefact";

/// The value of a node by a reading; nothing where the node is no status.
pub(in crate::device::opcua) fn value(
    node: Node,
    reading: &Reading,
    snapshot: u32,
    codes: StateCodes,
) -> Option<Variant> {
    let axes = &reading.axes;
    let truths = |axes: Axes<bool>| Variant::from(listed(&axes).to_vec());
    let numbers = |axes: Position| Variant::from(listed(&axes.map(|axis, value| axis.outside(*value))).to_vec());
    Some(match node {
        Node::Snapshot => snapshot.into(),
        Node::Heartbeat => reading.heartbeat.into(),
        Node::State => codes.code(reading.state).into(),
        Node::Mode => mode(reading.mode).into(),
        Node::Safety => safety(reading.safety).into(),
        Node::AckSequence => reading.acknowledged.sequence.into(),
        Node::Result => result(reading.acknowledged.result).into(),
        Node::FaultCode => reading.fault_code.into(),
        Node::AxisStates => Variant::from(listed(&axes.map(|_, axis| codes.code(axis.state))).to_vec()),
        Node::Homed => truths(axes.map(|_, axis| axis.homed)),
        Node::InPosition => truths(axes.map(|_, axis| axis.in_position)),
        Node::AxisFaults => truths(axes.map(|_, axis| axis.fault)),
        Node::LimitsHit => truths(axes.map(|_, axis| axis.limit_hit)),
        Node::Commanded => numbers(axes.map(|_, axis| axis.commanded)),
        Node::MaxVelocities => numbers(axes.map(|_, axis| axis.speed)),
        Node::Actual(axis) => axis.outside(axes.get(axis).actual).into(),
        Node::Range(axis) => {
            let (low, high) = (axis.outside(axes.get(axis).lower), axis.outside(axes.get(axis).upper));
            ExtensionObject::from_message(Range { low, high }).into()
        }
        Node::Unit(axis) => ExtensionObject::from_message(units(axis)).into(),
        Node::Pulse
        | Node::Fence
        | Node::WatchdogMs
        | Node::Code
        | Node::Mask
        | Node::Targets
        | Node::Velocities
        | Node::Sequence => return None,
    })
}

fn units(axis: Axis) -> EUInformation {
    EUInformation {
        namespace_uri: CEFACT.into(),
        unit_id: unit(axis),
        display_name: LocalizedText::new("", axis.unit()),
        description: LocalizedText::new("", axis.unit()),
    }
}

const fn mode(mode: Mode) -> u16 {
    match mode {
        Mode::Off => 0,
        Mode::Manual => 1,
        Mode::Automatic => 2,
    }
}

fn safety(safety: Safety) -> u16 {
    let Safety { emergency_stop_ok, guard_closed, drives_ready, remote_enabled } = safety;
    let bits = [emergency_stop_ok, guard_closed, drives_ready, remote_enabled].into_iter().zip([1, 2, 4, 8]);
    bits.filter(|(holds, _)| *holds).map(|(_, bit)| bit).sum()
}

const fn result(result: CommandResult) -> u16 {
    match result {
        CommandResult::None => 0,
        CommandResult::Accepted => 1,
        CommandResult::Running => 2,
        CommandResult::Done => 3,
        CommandResult::Rejected => 4,
        CommandResult::Aborted => 5,
    }
}

/// The command that the written values make.
///
/// # Errors
/// [`Odd`] names the first value that cannot be.
pub(in crate::device::opcua) fn command(written: &[(Node, DataValue)]) -> Result<Command, Odd> {
    let told = Answer::new(written);
    let mask = told.word(Node::Mask)?;
    let axes = per_axis([1, 2, 4, 8].map(|bit| mask & bit != 0));
    let inside = |values: [f64; 4]| per_axis(values).map(|axis, value| axis.inside(*value));
    let action = match told.word(Node::Code)? {
        1 => Action::Enable,
        2 => Action::Disable,
        3 => Action::Reset,
        4 => Action::Home { axes },
        5 => Action::MoveTo {
            axes,
            targets: inside(told.numbers(Node::Targets)?),
            speeds: inside(told.numbers(Node::Velocities)?),
        },
        6 => Action::Halt,
        code => return Err(Odd::Value { node: Node::Code, value: code.to_string(), why: "is no command" }),
    };
    Ok(Command {
        sequence: told.word(Node::Sequence)?,
        fence: told.long(Node::Fence)?,
        watchdog: Duration::from_millis(told.double_word(Node::WatchdogMs)?.into()),
        action,
    })
}
