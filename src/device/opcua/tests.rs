//! Tests the adaptor in parts and as a whole: its codec with hostile values, and its link with the simulated PLC of this crate on
//! loopback. The independent PLC is in tests/plc_opcua.rs.

use super::layout::Node;
use crate::device::contract::check_manipulator;
use crate::device::contract::motion::check_manipulator_motion;
use crate::device::opcua::codec::{self, NotEncodable, Torn};
use crate::device::opcua::server::plc;
use crate::device::opcua::{OpcuaManipulator, Plc, PlcServer, Security, Settings, device_path, nodes};
use crate::device::simulated::{Controller, ControllerSettings};
use crate::device::{Action, Command, DeviceError, Manipulator, Reading, States};
use crate::motion::{Axes, Axis, AxisLimits, Carrier, Pair};
use opcua::types::{
    AttributeId, ByteString, DataTypeId, DataValue, DateTime, EUInformation, ExtensionObject, NodeId, Range,
    StatusCode, UAString, Variant,
};
use proptest::prelude::*;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinHandle;

fn limits() -> Axes<AxisLimits> {
    let linear = AxisLimits { lower: -50.0, upper: 50.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 50.0 };
    let turn = AxisLimits { lower: -0.2, upper: 0.2, speed: 0.1, acceleration: 0.5, jerk: 5.0, step: 0.2 };
    Axes { x: linear, y: linear, z: linear, c: turn }
}

/// A value of good quality, as a server would send it.
fn good(value: impl Into<Variant>) -> DataValue {
    DataValue {
        value: Some(value.into()),
        status: Some(StatusCode::Good),
        source_timestamp: Some(DateTime::ymd_hms(2026, 5, 1, 12, 0, 0)),
        ..DataValue::null()
    }
}

/// Replaces the value of a node.
fn swap(values: &mut [(Node, DataValue)], node: Node, value: &DataValue) {
    for (_, place) in values.iter_mut().filter(|(of, _)| *of == node) {
        *place = value.clone();
    }
}

fn reading() -> Reading {
    let mut settings = ControllerSettings::exact(limits());
    settings.start = Axes { x: 1.25, y: -2.5, z: 3.0, c: 0.1 };
    Controller::new(settings).reading(Duration::from_millis(120))
}

fn answer(reading: &Reading) -> Vec<(Node, DataValue)> {
    let codes = States::default().codes();
    Node::reading().map(|node| (node, good(plc::value(node, reading, 8, codes).expect("a status")))).collect()
}

fn read(values: &[(Node, DataValue)]) -> Result<Reading, String> {
    codec::reading(values, States::default().codes()).map_err(|odd| odd.to_string())
}

#[test]
fn a_reading_is_encoded_without_loss_with_rotations_in_degrees() {
    let sent = reading();
    let values = answer(&sent);
    let received = read(&values).expect("a reading");
    // Converting to degrees and back rounds twice.
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
fn an_invalid_value_is_refused_by_name() {
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
fn a_value_without_good_quality_is_refused() {
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
fn an_answer_from_two_moments_is_torn() {
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
fn the_age_of_the_heartbeat_is_measured_by_the_servers_clock() {
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
fn a_command_is_encoded_without_loss_and_its_number_is_last() {
    let axes = Axes { x: true, y: false, z: false, c: true };
    let targets = Axes { x: 1.5, y: 0.0, z: 0.0, c: 0.5 };
    let moved = Action::MoveTo { axes, targets, speeds: Axes { c: 0.25, ..targets } };
    for action in [Action::Enable, Action::Disable, Action::Reset, Action::Home { axes }, Action::Halt, moved] {
        let sent = order(action);
        let written = codec::command(&sent).expect("a command");
        assert_eq!(written.last(), Some(&(Node::Sequence, Variant::UInt16(9))));
        let written: Vec<_> = written.into_iter().map(|(node, value)| (node, good(value))).collect();
        assert_eq!(plc::command(&written), Ok(sent));
    }
}

#[test]
fn an_invalid_command_is_not_sent() {
    let axes = Axes::from_fn(|_| true);
    let nowhere = Axes { z: f64::INFINITY, ..Axes::default() };
    let speeds = Axes::from_fn(|_| 1.0);
    for command in [
        Command { sequence: 0, ..order(Action::Halt) },
        Command { watchdog: Duration::ZERO, ..order(Action::Halt) },
        order(Action::MoveTo { axes, targets: nowhere, speeds }),
        order(Action::MoveTo { axes, targets: speeds, speeds: nowhere }),
    ] {
        assert!(matches!(codec::command(&command), Err(NotEncodable(_))), "{command:?}");
    }
}

#[test]
fn an_axis_in_another_unit_is_refused() {
    let unit = |id: i32| good(ExtensionObject::from_message(EUInformation { unit_id: id, ..EUInformation::default() }));
    let all = |c: i32| -> Vec<_> {
        let of = |axis| if axis == Axis::C { unit(c) } else { unit(nodes::MILLIMETRE) };
        Axis::ALL.map(|axis| (Node::Unit(axis), of(axis))).into()
    };
    assert_eq!(nodes::units(&all(nodes::DEGREE)), Ok(()));
    assert!(nodes::units(&all(nodes::MILLIMETRE)).is_err());
    assert!(nodes::units(&[]).is_err());
}

#[test]
fn a_server_that_could_accept_half_a_command_is_refused_on_connecting() {
    let answers = |change: &dyn Fn(Node, AttributeId) -> Option<Variant>| -> Vec<_> {
        let value = |node: Node, attribute: AttributeId| {
            let (data_type, array) = nodes::kind(node);
            change(node, attribute).unwrap_or_else(|| match attribute {
                AttributeId::DataType => NodeId::from(data_type).into(),
                AttributeId::ValueRank => (if array { 1 } else { -1 }).into(),
                _ => 3_u8.into(),
            })
        };
        nodes::asked_of_commands().into_iter().map(|(node, asked)| (node, good(value(node, asked)))).collect()
    };
    assert_eq!(nodes::writable(&answers(&|_, _| None)), Ok(()));
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
        let odd = nodes::writable(&changed(node, attribute, value)).expect_err(said).to_string();
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

    /// Up to four values of an answer are arbitrary: a reading keeps the guarantees of all readings.
    #[test]
    fn any_values_decode_to_a_valid_reading_or_an_error(
        changes in prop::collection::vec((0_usize..24, any_variant()), 1..5),
    ) {
        let mut values = answer(&reading());
        for (index, variant) in changes {
            values[index].1 = good(variant);
        }
        let _ = (codec::whole(&values), nodes::units(&values), nodes::writable(&values), plc::command(&values));
        if let Ok(reading) = read(&values) {
            for (_, axis) in reading.axes.iter() {
                prop_assert!([axis.actual, axis.commanded, axis.lower, axis.upper].iter().all(|value| value.is_finite()));
                prop_assert!(axis.lower < axis.upper && axis.speed > 0.0);
            }
        }
    }
}

struct Bench {
    folder: PathBuf,
    plc: Arc<Plc>,
    address: SocketAddr,
    server: JoinHandle<()>,
}

impl Bench {
    async fn start(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("coaxis-loopback-{name}-{}", std::process::id()));
        let controllers = Pair::from_fn(|_| Controller::new(ControllerSettings::exact(limits())));
        let plc = Arc::new(Plc::new(controllers, States::default().codes()));
        let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
        let server = PlcServer::listen(anywhere, &plc, &folder.join("plc")).await.expect("a server");
        let address = server.address();
        let server = tokio::spawn(async move { server.run().await.expect("serves") });
        Self { folder, plc, address, server }
    }

    fn link(&self, carrier: Carrier) -> OpcuaManipulator {
        let settings = Settings {
            endpoint: format!("opc.tcp://{}", self.address),
            device: device_path(carrier),
            security: Security { pki: Some(self.folder.join("client")), ..Security::default() },
            ..Settings::default()
        };
        OpcuaManipulator::new(carrier.name(), &settings).expect("settings")
    }

    fn executed(&self, carrier: Carrier) -> Vec<u16> {
        self.plc.with(carrier, |controller, _| controller.record().all_executed().map(|entry| entry.sequence).collect())
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.server.abort();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn told(sequence: u16, action: Action) -> Command {
    Command { sequence, fence: 1, watchdog: Duration::from_millis(400), action }
}

#[tokio::test]
async fn the_simulated_plc_and_the_adaptor_fulfil_the_contract() {
    let bench = Bench::start("contract").await;
    let mut link = bench.link(Carrier::M1);
    let report = check_manipulator(&mut link).await;
    assert!(report.passed(), "{report:#?}");
    let report = check_manipulator_motion(&mut link, 1).await;
    assert!(report.passed(), "{report:#?}");
    let executed = bench.executed(Carrier::M1);
    assert!(executed.windows(2).all(|pair| pair[0] < pair[1]), "each once: {executed:?}");
    assert!(bench.executed(Carrier::M2).is_empty());
}

#[tokio::test]
async fn each_manipulator_receives_its_own_commands() {
    let bench = Bench::start("two").await;
    let (mut m1, mut m2) = (bench.link(Carrier::M1), bench.link(Carrier::M2));
    m1.connect().await.expect("connected");
    m2.connect().await.expect("connected");
    m2.send(&told(3, Action::Enable)).await.expect("sent");
    assert_eq!(m1.read().await.expect("a reading").acknowledged.sequence, 0);
    assert_eq!(m2.read().await.expect("a reading").acknowledged.sequence, 3);
    assert_eq!((bench.executed(Carrier::M1), bench.executed(Carrier::M2)), (vec![], vec![3]));
}

#[tokio::test]
async fn without_a_connection_nothing_is_sent_and_a_stopped_server_is_a_lost_link() {
    let bench = Bench::start("gone").await;
    let mut link = bench.link(Carrier::M1);
    let early = link.send(&told(1, Action::Enable)).await;
    assert!(matches!(early, Err(DeviceError::LinkLost { .. })), "{early:?}");
    link.connect().await.expect("connected");
    bench.server.abort();
    let gone = tokio::time::timeout(Duration::from_secs(5), async {
        loop {
            if let Err(error) = link.read().await {
                return error;
            }
        }
    });
    let gone = gone.await.expect("detected");
    assert!(matches!(gone, DeviceError::LinkLost { .. } | DeviceError::Silent { .. }), "{gone}");
    let after = link.send(&told(2, Action::Enable)).await;
    assert!(matches!(after, Err(DeviceError::LinkLost { .. })), "{after:?}");
    assert!(bench.executed(Carrier::M1).is_empty());
}

#[tokio::test]
async fn a_dropped_reading_closes_the_session() {
    let bench = Bench::start("dropped").await;
    let mut link = bench.link(Carrier::M1);
    link.connect().await.expect("connected");
    {
        let mut reading = link.read();
        let started =
            std::future::poll_fn(|context| std::task::Poll::Ready(reading.as_mut().poll(context).is_pending()));
        assert!(started.await);
    }
    let after = link.read().await;
    assert!(matches!(after, Err(DeviceError::LinkLost { .. })), "{after:?}");
    link.connect().await.expect("connected again");
}
