//! Whatever a server answers, it is a reading that is true to the values, or a reason by name; never a panic.

use super::{good, limits, swap};
use crate::device::opcua::codec::{self, Torn, Unspeakable};
use crate::device::opcua::layout::Node;
use crate::device::opcua::nodes;
use crate::device::opcua::plausible;
use crate::device::opcua::server::image;
use crate::device::simulated::{Controller, ControllerSettings};
use crate::device::{Action, Command, Reading, States};
use crate::motion::{Axes, Axis};
use opcua::types::{
    AttributeId, ByteString, DataTypeId, DataValue, DateTime, EUInformation, ExtensionObject, NodeId, Range,
    StatusCode, UAString, Variant,
};
use proptest::prelude::*;
use std::time::Duration;

fn reading() -> Reading {
    let mut settings = ControllerSettings::exact(limits());
    settings.start = Axes { x: 1.25, y: -2.5, z: 3.0, c: 0.1 };
    Controller::new(settings).reading(Duration::from_millis(120))
}

fn answer(reading: &Reading) -> Vec<(Node, DataValue)> {
    let codes = States::default().codes();
    Node::reading().map(|node| (node, good(image::value(node, reading, 8, codes).expect("a status")))).collect()
}

fn read(values: &[(Node, DataValue)]) -> Result<Reading, String> {
    codec::reading(values, States::default().codes()).map_err(|odd| odd.to_string())
}

#[test]
fn a_reading_goes_over_the_wire_unharmed_and_turns_are_degrees_there() {
    let sent = reading();
    let values = answer(&sent);
    let received = read(&values).expect("a reading");
    // Degrees and back: two roundings of a double.
    assert!((received.axes.c.actual - 0.1).abs() < 1e-15 && (received.axes.c.upper - 0.2).abs() < 1e-15);
    let c = received.axes.c;
    assert_eq!(Reading { axes: Axes { c, ..sent.axes }, ..sent }, received);
    let degrees = nodes::Answer::new(&values).number(Node::Actual(Axis::C)).expect("a number");
    assert!((degrees - 0.1 * 180.0 / std::f64::consts::PI).abs() < 1e-14, "{degrees}");
}

#[test]
fn single_precision_and_other_integers_are_understood() {
    let mut values = answer(&reading());
    swap(&mut values, Node::Actual(Axis::X), &good(7.5_f32));
    swap(&mut values, Node::State, &good(2_i32));
    swap(&mut values, Node::FaultCode, &good(4_000_000_000_u64));
    let read = read(&values).expect("a reading");
    assert_eq!(
        (read.axes.x.actual, read.state, read.fault_code),
        (7.5, crate::device::AxisState::Standstill, 4_000_000_000)
    );
}

#[test]
fn what_cannot_be_is_refused_by_name() {
    let range = |low: f64, high: f64| good(ExtensionObject::from_message(Range { low, high }));
    let cases: [(Node, DataValue, &str); 16] = [
        (Node::State, good(9_u16), "status.state is 9, which is no state of the table"),
        (Node::State, good(2.0_f64), "status.state is not a whole number of 16 bits"),
        (Node::State, good(70_000_u32), "status.state is not a whole number of 16 bits"),
        (Node::Heartbeat, good(-1_i16), "status.heartbeat is not a whole number of 16 bits"),
        (Node::Mode, good(3_u16), "status.mode is 3, which is no mode"),
        (Node::Result, good(6_u16), "status.result is 6, which is no result"),
        (Node::FaultCode, good(u64::MAX), "status.fault_code is not a whole number of 32 bits"),
        (Node::Actual(Axis::Z), good(f64::NAN), "axes.z.actual_position is NaN, which is not finite"),
        (Node::Actual(Axis::Z), good(UAString::from("1.0")), "axes.z.actual_position is not a number"),
        (Node::Homed, good(vec![true; 3]), "status.homed is not four truth values"),
        (Node::Homed, good(true), "status.homed is not four truth values"),
        (Node::Homed, good(vec![1_u16; 4]), "status.homed is not four truth values"),
        (Node::Commanded, good(vec![0.0_f64; 1000]), "status.commanded_positions is not four numbers"),
        (Node::MaxVelocities, good(vec![1.0, 1.0, 0.0, 1.0]), "status.max_velocities is 0, which is no speed"),
        (Node::Range(Axis::X), range(5.0, 5.0), "axes.x.range is 5 to 5, which is no range"),
        (Node::Range(Axis::X), range(f64::NEG_INFINITY, 5.0), "axes.x.range is -inf, which is not finite"),
    ];
    for (node, value, said) in cases {
        let mut values = answer(&reading());
        swap(&mut values, node, &value);
        assert_eq!(read(&values), Err(said.to_owned()));
    }
}

#[test]
fn a_value_that_the_server_does_not_stand_by_is_none() {
    for quality in [StatusCode::BadSensorFailure, StatusCode::UncertainLastUsableValue, StatusCode::GoodLocalOverride] {
        for node in Node::reading().filter(|node| *node != Node::Snapshot) {
            let mut values = answer(&reading());
            for (_, value) in values.iter_mut().filter(|(of, _)| *of == node) {
                value.status = Some(quality);
            }
            assert_eq!(read(&values), Err(format!("{} has the quality {quality}", node.key())));
        }
    }
    let mut values = answer(&reading());
    swap(&mut values, Node::Mode, &DataValue::null());
    assert_eq!(read(&values), Err("status.mode is not there".to_owned()));
    values.retain(|(node, _)| *node != Node::Mode);
    assert_eq!(read(&values), Err("status.mode is missing in the answer".to_owned()));
}

#[test]
fn an_answer_of_two_moments_is_torn() {
    let whole = answer(&reading());
    assert_eq!(codec::whole(&whole), Ok(Ok(())));
    for (first, last) in [(8_u32, 10_u32), (9, 9), (8, 9)] {
        let mut torn = whole.clone();
        torn.first_mut().expect("a value").1 = good(first);
        torn.last_mut().expect("a value").1 = good(last);
        assert_eq!(codec::whole(&torn), Ok(Err(Torn)), "{first} and {last}");
    }
    assert!(codec::whole(&[]).is_err());
}

#[test]
fn the_age_of_the_heartbeat_is_told_by_the_servers_own_clock() {
    let mut values = answer(&reading());
    let answered = DateTime::ymd_hms_nano(2026, 5, 1, 12, 0, 0, 600_000_000);
    assert_eq!(codec::age(&values, &answered), Ok(Duration::from_millis(600)));
    let earlier = DateTime::ymd_hms(2026, 5, 1, 11, 0, 0);
    assert_eq!(codec::age(&values, &earlier), Ok(Duration::ZERO));
    swap(&mut values, Node::Heartbeat, &DataValue { source_timestamp: None, ..good(1_u16) });
    assert!(codec::age(&values, &answered).expect_err("no stamp").to_string().contains("stamped"));
}

fn order(action: Action) -> Command {
    Command { sequence: 9, fence: u64::MAX, watchdog: Duration::from_millis(400), action }
}

#[test]
fn a_command_goes_over_the_wire_unharmed_with_its_number_last() {
    let axes = Axes { x: true, y: false, z: false, c: true };
    let targets = Axes { x: 1.5, y: 0.0, z: 0.0, c: 0.5 };
    let moved = Action::MoveTo { axes, targets, speeds: Axes { c: 0.25, ..targets } };
    for action in [Action::Enable, Action::Disable, Action::Reset, Action::Home { axes }, Action::Halt, moved] {
        let sent = order(action);
        let written = codec::command(&sent).expect("a command");
        assert_eq!(written.last(), Some(&(Node::Sequence, Variant::UInt16(9))));
        let written: Vec<_> = written.into_iter().map(|(node, value)| (node, good(value))).collect();
        assert_eq!(image::command(&written), Ok(sent));
    }
}

#[test]
fn a_command_that_says_nothing_is_not_sent() {
    let axes = Axes::from_fn(|_| true);
    let nowhere = Axes { z: f64::INFINITY, ..Axes::default() };
    let speeds = Axes::from_fn(|_| 1.0);
    for command in [
        Command { sequence: 0, ..order(Action::Halt) },
        Command { watchdog: Duration::ZERO, ..order(Action::Halt) },
        order(Action::MoveTo { axes, targets: nowhere, speeds }),
        order(Action::MoveTo { axes, targets: speeds, speeds: nowhere }),
    ] {
        assert!(matches!(codec::command(&command), Err(Unspeakable(_))), "{command:?}");
    }
}

#[test]
fn an_axis_in_another_unit_is_refused() {
    let unit = |id: i32| good(ExtensionObject::from_message(EUInformation { unit_id: id, ..EUInformation::default() }));
    let all = |c: i32| -> Vec<_> {
        let of = |axis| if axis == Axis::C { unit(c) } else { unit(plausible::MILLIMETRE) };
        Axis::ALL.map(|axis| (Node::Unit(axis), of(axis))).into()
    };
    assert_eq!(plausible::units(&all(plausible::DEGREE)), Ok(()));
    assert!(plausible::units(&all(plausible::MILLIMETRE)).is_err());
    assert!(plausible::units(&[]).is_err());
}

#[test]
fn a_command_that_could_be_taken_by_halves_is_refused_before_the_first() {
    let answers = |change: &dyn Fn(Node, AttributeId) -> Option<Variant>| -> Vec<_> {
        let value = |node: Node, attribute: AttributeId| {
            let (data_type, array) = plausible::kind(node);
            change(node, attribute).unwrap_or_else(|| match attribute {
                AttributeId::DataType => NodeId::from(data_type).into(),
                AttributeId::ValueRank => (if array { 1 } else { -1 }).into(),
                _ => 3_u8.into(),
            })
        };
        plausible::asked_of_commands().into_iter().map(|(node, asked)| (node, good(value(node, asked)))).collect()
    };
    assert_eq!(plausible::writable(&answers(&|_, _| None)), Ok(()));
    let changed = |of: Node, which: AttributeId, to: Variant| {
        answers(&move |node, attribute| (node == of && attribute == which).then(|| to.clone()))
    };
    for (node, attribute, value, said) in [
        (Node::Targets, AttributeId::DataType, NodeId::from(DataTypeId::Float).into(), "command.targets is of type"),
        (Node::Targets, AttributeId::ValueRank, Variant::Int32(-1), "command.targets is of rank -1"),
        (Node::Sequence, AttributeId::ValueRank, Variant::Int32(1), "command.sequence is of rank 1"),
        (Node::Velocities, AttributeId::UserAccessLevel, Variant::Byte(1), "command.velocities is of access 1"),
        (Node::Fence, AttributeId::UserAccessLevel, ByteString::null().into(), "command.fence is of access"),
    ] {
        let odd = plausible::writable(&changed(node, attribute, value)).expect_err(said).to_string();
        assert!(odd.starts_with(said), "{odd}");
    }
}

fn any_variant() -> impl Strategy<Value = Variant> {
    prop_oneof![
        Just(Variant::Empty),
        any::<bool>().prop_map(Variant::from),
        any::<i8>().prop_map(Variant::from),
        any::<u16>().prop_map(Variant::from),
        any::<i64>().prop_map(Variant::from),
        any::<u64>().prop_map(Variant::from),
        any::<f32>().prop_map(Variant::from),
        any::<f64>().prop_map(Variant::from),
        ".{0,8}".prop_map(|text| Variant::from(UAString::from(text))),
        prop::collection::vec(any::<f64>(), 0..7).prop_map(Variant::from),
        prop::collection::vec(any::<bool>(), 0..7).prop_map(Variant::from),
        prop::collection::vec(any::<u16>(), 0..7).prop_map(Variant::from),
        (any::<f64>(), any::<f64>())
            .prop_map(|(low, high)| Variant::from(ExtensionObject::from_message(Range { low, high }))),
        any::<i32>().prop_map(|unit_id| {
            Variant::from(ExtensionObject::from_message(EUInformation { unit_id, ..EUInformation::default() }))
        }),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Up to four values of an answer are anything at all: what is read keeps what readings promise.
    #[test]
    fn whatever_comes_is_a_true_reading_or_a_reason(
        changes in prop::collection::vec((0_usize..24, any_variant()), 1..5),
    ) {
        let mut values = answer(&reading());
        for (index, variant) in changes {
            values[index].1 = good(variant);
        }
        let _ = (codec::whole(&values), plausible::units(&values), plausible::writable(&values), image::command(&values));
        if let Ok(reading) = read(&values) {
            for (_, axis) in reading.axes.iter() {
                prop_assert!([axis.actual, axis.commanded, axis.lower, axis.upper].iter().all(|value| value.is_finite()));
                prop_assert!(axis.lower < axis.upper && axis.speed > 0.0);
            }
        }
    }
}
