//! The simulated PLC between its controllers and its nodes: an image of the status, updated once per cycle, and the values written
//! so far for the next command. Also the device side of the codec: a reading as values of nodes, and a command from them.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use opcua::types::{DataValue, EUInformation, ExtensionObject, LocalizedText, Range, StatusCode, Variant};
use tokio::time::Instant;

use crate::device::clock::now;
use crate::device::manipulator::{Action, Command, CommandResult, Mode, Reading, Safety};
use crate::device::opcua::codec::{listed, per_axis};
use crate::device::opcua::layout::Node;
use crate::device::opcua::nodes::{Answer, UnexpectedValue, unit};
use crate::device::simulated::Controller;
use crate::device::states::StateCodes;
use crate::motion::{Axes, Axis, Carrier, Pair, Position};

/// Interval between two updates of the image: the cycle of a PLC program.
const CYCLE: Duration = Duration::from_millis(5);

/// A simulated PLC with two manipulators.
#[derive(Debug)]
pub struct Plc {
    began: Instant,
    codes: StateCodes,
    stations: Mutex<Pair<Station>>,
}

#[derive(Debug)]
struct Station {
    controller: Controller,
    image: Option<Image>,
    cycles_count: u32,
    written: Vec<(Node, DataValue)>,
}

#[derive(Debug)]
struct Image {
    at: Duration,
    reading: Reading,
}

impl Plc {
    /// A PLC with these controllers; its time begins now.
    #[must_use]
    pub fn new(controllers: Pair<Controller>, codes: StateCodes) -> Self {
        let Pair { m1, m2 } = controllers;
        let stations = Mutex::new(Pair { m1: Station::new(m1), m2: Station::new(m2) });
        Self { began: now(), codes, stations }
    }

    /// Accesses a controller at the PLC's time.
    pub fn with<T>(&self, carrier: Carrier, act: impl FnOnce(&mut Controller, Duration) -> T) -> T {
        let now = self.time();
        act(&mut self.lock().get_mut(carrier).controller, now)
    }

    /// Sets the states of the safety functions, e.g. presses an emergency stop or opens a guard.
    pub fn set_safety(&self, carrier: Carrier, safety: Safety) {
        self.with(carrier, |controller, now| controller.set_safety(safety, now));
    }

    fn time(&self) -> Duration {
        now().saturating_duration_since(self.began)
    }

    /// After a panic elsewhere the values are old, but consistent.
    fn lock(&self) -> MutexGuard<'_, Pair<Station>> {
        self.stations.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The value of a node in the newest image, or the value that was last written.
    pub(super) fn read(&self, carrier: Carrier, node: Node) -> Result<DataValue, StatusCode> {
        let now = self.time();
        let mut stations = self.lock();
        let station = stations.get_mut(carrier);
        let (reading, snapshot) = station.image(now);
        let status = value(node, reading, snapshot, self.codes).map(DataValue::new_now);
        let written = || station.written.iter().find(|(of, _)| *of == node).map(|(_, value)| value.clone());
        status.or_else(written).ok_or(StatusCode::BadNoData)
    }

    /// Writes a node. Writing the sequence number of a command executes the command.
    pub(super) fn write(&self, carrier: Carrier, node: Node, value: Variant) -> StatusCode {
        let now = self.time();
        let mut stations = self.lock();
        let station = stations.get_mut(carrier);
        let Some((_, kept)) = station.written.iter_mut().find(|(of, _)| *of == node) else {
            return StatusCode::BadNotWritable;
        };
        let news = kept.value.as_ref() != Some(&value);
        *kept = DataValue::new_now(value);
        match node {
            Node::Pulse if news => station.controller.beat(now),
            Node::Sequence => {
                let Ok(command) = command(&station.written) else { return StatusCode::BadOutOfRange };
                station.controller.take(&command, now);
                station.image = None;
            }
            _ => {}
        }
        StatusCode::Good
    }
}

impl Station {
    fn new(controller: Controller) -> Self {
        let zero = |node: Node| match node {
            Node::Fence => Variant::UInt64(0),
            Node::WatchdogMs => Variant::UInt32(0),
            Node::Targets | Node::Velocities => Variant::from(vec![0.0_f64; 4]),
            _ => Variant::UInt16(0),
        };
        let written = Node::COMMAND.into_iter().chain([Node::Pulse]);
        let written = written.map(|node| (node, DataValue::new_now(zero(node)))).collect();
        Self { controller, image: None, cycles_count: 0, written }
    }

    /// The image of this cycle, and its counter, which is even because the image is not read while it is updated.
    fn image(&mut self, now: Duration) -> (&Reading, u32) {
        let fresh = self.image.take().filter(|image| now.saturating_sub(image.at) < CYCLE);
        if fresh.is_none() {
            self.cycles_count = self.cycles_count.wrapping_add(2);
        }
        let image = fresh.unwrap_or_else(|| Image { at: now, reading: self.controller.reading(now) });
        (&self.image.insert(image).reading, self.cycles_count)
    }
}

/// The namespace of the unit codes.
const CEFACT: &str = "http://www.opcfoundation.org/UA/units/un/cefact";

/// The value of a node for a reading; `None` if the node is not part of the status.
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

/// Assembles the command from the written values.
///
/// # Errors
/// [`UnexpectedValue`] names the first value that cannot be used.
pub(in crate::device::opcua) fn command(written: &[(Node, DataValue)]) -> Result<Command, UnexpectedValue> {
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
        code => return Err(UnexpectedValue::Value { node: Node::Code, value: code.to_string(), why: "is no command" }),
    };
    Ok(Command {
        sequence: told.word(Node::Sequence)?,
        fence: told.long(Node::Fence)?,
        watchdog: Duration::from_millis(told.double_word(Node::WatchdogMs)?.into()),
        action,
    })
}
