//! The nodes that the adaptor reads and writes: a browse path for each value, below the manipulator's own node. Positions follow
//! OPC 40010-1 (robotics); values that this does not define, above all commands, are below `Status` and `Command`. Input: the
//! meaning of a node. Output: its path.
//!
//! A path is written `alias:Name/alias:Name/…`; the alias stands for the URI of a namespace, and a missing alias for OPC UA's own
//! namespace. Namespace indices are not used, because a server may assign new ones at every start.

use crate::motion::Axis;

/// A value that is read or written, by its meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Node {
    /// Counter that increases before and after every change of the status; it is odd during a change.
    Snapshot,
    /// Counter that increases while the device is running.
    Heartbeat,
    /// State of the device, by the code table.
    State,
    /// The mode.
    Mode,
    /// Bits of the safety functions.
    Safety,
    /// Sequence number of the newest command that was received.
    AckSequence,
    /// Result of that command.
    Result,
    /// Fault code of the device.
    FaultCode,
    /// State of every axis, by the code table.
    AxisStates,
    /// Axes whose reference is known.
    Homed,
    /// Axes at their targets.
    InPosition,
    /// Axes with a fault.
    AxisFaults,
    /// Axes at a limit.
    LimitsHit,
    /// The commanded positions of the axes.
    Commanded,
    /// Greatest speeds.
    MaxVelocities,
    /// Actual position of an axis.
    Actual(Axis),
    /// Limits of an axis: the range of [`Node::Actual`].
    Range(Axis),
    /// Unit of an axis: that of [`Node::Actual`].
    Unit(Axis),
    /// Heartbeat of coaxis.
    Pulse,
    /// Fencing token of the lease.
    Fence,
    /// How long the device continues to move without a heartbeat of coaxis.
    WatchdogMs,
    /// Code of the command.
    Code,
    /// Axes of the command.
    Mask,
    /// Target positions.
    Targets,
    /// Greatest speeds of the command.
    Velocities,
    /// Sequence number of the command; the device executes the command when it changes.
    Sequence,
}

use Node::*;

/// Status values of the device and of all axes together, in the order in which they are read.
const STATUS: [Node; 15] = [
    Snapshot,
    Heartbeat,
    State,
    Mode,
    Safety,
    AckSequence,
    Result,
    FaultCode,
    AxisStates,
    Homed,
    InPosition,
    AxisFaults,
    LimitsHit,
    Commanded,
    MaxVelocities,
];

impl Node {
    /// The nodes that a command writes, in this order: the sequence number is last, because the device then executes the command.
    pub(super) const COMMAND: [Self; 7] = [Fence, WatchdogMs, Code, Mask, Targets, Velocities, Sequence];

    /// The nodes that one reading reads, in this order: the snapshot counter is both first and last.
    pub(super) fn reading() -> impl Iterator<Item = Self> {
        let axes = Axis::ALL.into_iter().flat_map(|axis| [Actual(axis), Range(axis)]);
        STATUS.into_iter().chain(axes).chain([Snapshot])
    }

    /// Every node once.
    pub(super) fn all() -> impl Iterator<Item = Self> {
        let axes = Axis::ALL.into_iter().flat_map(|axis| [Actual(axis), Range(axis), Unit(axis)]);
        STATUS.into_iter().chain(axes).chain([Pulse]).chain(Self::COMMAND)
    }

    /// The name by which the configuration may assign it another path.
    pub(super) fn key(self) -> String {
        match self {
            Actual(axis) => format!("axes.{}.actual_position", axis.name()),
            Range(axis) => format!("axes.{}.range", axis.name()),
            Unit(axis) => format!("axes.{}.unit", axis.name()),
            Pulse | Fence | WatchdogMs | Code | Mask | Targets | Velocities | Sequence => {
                format!("command.{}", snake(self.word()))
            }
            _ => format!("status.{}", snake(self.word())),
        }
    }

    /// Its path below the manipulator's node, unless the configuration gives another one.
    pub(super) fn path(self) -> String {
        let axis = |axis: Axis| {
            format!("robotics:Axes/own:{}/di:ParameterSet/robotics:ActualPosition", axis.name().to_uppercase())
        };
        match self {
            Actual(of) => axis(of),
            Range(of) => format!("{}/EURange", axis(of)),
            Unit(of) => format!("{}/EngineeringUnits", axis(of)),
            Pulse | Fence | WatchdogMs | Code | Mask | Targets | Velocities | Sequence => {
                format!("own:Command/own:{}", self.word())
            }
            _ => format!("own:Status/own:{}", self.word()),
        }
    }

    /// Its browse name.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Snapshot => "Snapshot",
            Heartbeat | Pulse => "Heartbeat",
            State => "State",
            Mode => "Mode",
            Safety => "Safety",
            AckSequence => "AckSequence",
            Result => "Result",
            FaultCode => "FaultCode",
            AxisStates => "AxisStates",
            Homed => "Homed",
            InPosition => "InPosition",
            AxisFaults => "AxisFaults",
            LimitsHit => "LimitsHit",
            Commanded => "CommandedPositions",
            MaxVelocities => "MaxVelocities",
            Actual(_) => "ActualPosition",
            Range(_) => "EURange",
            Unit(_) => "EngineeringUnits",
            Fence => "Fence",
            WatchdogMs => "WatchdogMs",
            Code => "Code",
            Mask => "Mask",
            Targets => "Targets",
            Velocities => "Velocities",
            Sequence => "Sequence",
        }
    }
}

fn snake(word: &str) -> String {
    let mut text = String::with_capacity(word.len() + 2);
    for (place, letter) in word.chars().enumerate() {
        if letter.is_uppercase() && place > 0 {
            text.push('_');
        }
        text.extend(letter.to_lowercase());
    }
    text
}

/// One step of a browse path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Step<'a> {
    /// Alias of the namespace; `None` for OPC UA's own.
    pub(super) alias: Option<&'a str>,
    /// Browse name.
    pub(super) name: &'a str,
}

/// The greatest number of steps in a path.
const STEPS_MAX: usize = 32;

/// The steps of a path in text form; `None` if it is not a path.
pub(super) fn steps(path: &str) -> Option<Vec<Step<'_>>> {
    let steps: Option<Vec<_>> = path
        .split('/')
        .map(|step| match step.split_once(':') {
            Some((alias, name)) => Some(Step { alias: Some(alias), name }),
            None => Some(Step { alias: None, name: step }),
        })
        .map(|step| step.filter(|step| !step.name.is_empty() && step.alias.is_none_or(|alias| !alias.is_empty())))
        .collect();
    steps.filter(|steps| steps.len() <= STEPS_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_node_has_a_unique_name_and_path() {
        let keys: HashSet<_> = Node::all().map(Node::key).collect();
        let paths: HashSet<_> = Node::all().map(Node::path).collect();
        assert_eq!((keys.len(), paths.len()), (Node::all().count(), Node::all().count()));
        assert!(Node::all().all(|node| steps(&node.path()).is_some()));
        assert_eq!(Node::WatchdogMs.key(), "command.watchdog_ms");
        assert_eq!(Node::Actual(Axis::C).path(), "robotics:Axes/own:C/di:ParameterSet/robotics:ActualPosition");
    }

    #[test]
    fn a_commands_number_is_written_last_and_a_reading_has_its_counter_at_both_ends() {
        assert_eq!(Node::COMMAND.last(), Some(&Node::Sequence));
        let reading: Vec<_> = Node::reading().collect();
        assert_eq!((reading.first(), reading.last()), (Some(&Node::Snapshot), Some(&Node::Snapshot)));
        assert!(reading.iter().all(|node| !Node::COMMAND.contains(node)));
    }

    #[test]
    fn a_path_with_an_empty_step_is_refused() {
        assert_eq!(steps("di:Set/Value").map(|steps| steps.len()), Some(2));
        for wrong in ["", "/", "di:", ":Name", "di:Set//own:M1", "di:Set/"] {
            assert_eq!(steps(wrong), None, "{wrong}");
        }
        assert_eq!(steps(&["a"; 33].join("/")), None);
    }
}
