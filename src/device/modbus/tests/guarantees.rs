//! The guarantees of the adaptor of a manipulator, one fault at a time.

use super::{Settings, Wire, WireFault, command, controller, manipulator, plc, x_to};
use crate::device::modbus::{Layout, Plc, WordOrder};
use crate::device::simulated::code;
use crate::device::{Action, AxisState, CommandResult, DeviceError, Manipulator};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep, timeout};

const READ_INPUT: u8 = 4;
const WRITE_ONE: u8 = 6;
const WRITE_COMMAND: u8 = 16;

/// The sequence numbers that the first device has executed.
fn executed(plc: &Plc) -> Vec<u16> {
    plc.with(0, |controller, _| controller.record().all_executed().map(|entry| entry.sequence).collect()).expect("m1")
}

/// Waits until a reading shows that the newest command has ended.
async fn until_done(manipulator: &mut impl Manipulator) {
    for _ in 0..1000 {
        let reading = manipulator.read().await.expect("a reading");
        if reading.acknowledged.result == CommandResult::Done {
            return;
        }
        sleep(Duration::from_millis(20)).await;
    }
    panic!("the command does not end");
}

#[tokio::test(start_paused = true)]
async fn connecting_only_reads() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    let reading = m1.connect().await.expect("connects");
    assert_eq!(reading.state, AxisState::Disabled);
    assert_eq!(wire.functions(), [READ_INPUT]);
    m1.read().await.expect("reads");
    assert_eq!(wire.functions(), [READ_INPUT, WRITE_ONE, READ_INPUT]);
}

#[tokio::test(start_paused = true)]
async fn a_move_is_sent_once_and_reaches_its_target() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    m1.send(&command(1, Action::Enable)).await.expect("sends");
    m1.send(&command(2, x_to(12.5))).await.expect("sends");
    until_done(&mut m1).await;
    let reading = m1.read().await.expect("a reading");
    assert!((reading.axes.x.actual - 12.5).abs() < 1e-6, "{:?}", reading.axes.x);
    assert_eq!((reading.acknowledged.sequence, reading.state), (2, AxisState::Standstill));
    assert_eq!(executed(&plc), [1, 2]);
}

#[tokio::test(start_paused = true)]
async fn an_older_fencing_token_is_refused_before_a_byte_is_sent() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    let mut newer = command(1, Action::Enable);
    newer.fence = 5;
    m1.send(&newer).await.expect("sends");
    let sent = wire.functions();
    let refused = m1.send(&command(2, Action::Enable)).await;
    assert_eq!(refused, Err(DeviceError::Fenced { device: "m1".to_owned(), fence: 1, newest: 5 }));
    m1.connect().await.expect("connects again");
    assert!(matches!(m1.send(&command(2, Action::Enable)).await, Err(DeviceError::Fenced { newest: 5, .. })));
    assert_eq!(wire.functions().len(), sent.len() + 1, "only the reading of the new connection");
}

#[tokio::test(start_paused = true)]
async fn a_command_whose_answer_is_lost_is_resolved_by_reading() {
    for (fault, arrives) in [
        (WireFault::StallAfter, true),
        (WireFault::CutAfter, true),
        (WireFault::HalfAnswer, true),
        (WireFault::LateAnswer(500), true),
        (WireFault::StallBefore, false),
        (WireFault::CutBefore, false),
    ] {
        let plc = plc();
        let wire = Wire::to(&plc);
        let mut m1 = manipulator(&wire);
        m1.connect().await.expect("connects");
        wire.plan([Some(fault)]);
        let error = m1.send(&command(7, Action::Enable)).await.expect_err("no answer");
        assert!(error.leaves_unknown(), "{fault:?}: {error}");
        assert!(m1.read().await.is_err(), "{fault:?}: the connection must be closed");
        m1.connect().await.expect("connects again");
        let reading = m1.read().await.expect("a reading");
        assert_eq!(reading.acknowledged.sequence == 7, arrives, "{fault:?}");
        assert_eq!(executed(&plc), if arrives { vec![7] } else { vec![] }, "{fault:?}");
        let commands_count = wire.functions().iter().filter(|function| **function == WRITE_COMMAND).count();
        assert_eq!(commands_count, 1, "{fault:?}: the command must not be sent again");
    }
}

#[tokio::test(start_paused = true)]
async fn a_link_without_an_answer_times_out() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    wire.every(Some(WireFault::StallBefore));
    let start = crate::device::clock::now();
    let silent = DeviceError::Silent { device: "m1".to_owned(), within: Duration::from_millis(200) };
    assert_eq!(m1.read().await, Err(silent));
    let waited: Duration = crate::device::clock::now() - start;
    assert!(waited <= Duration::from_millis(202), "{waited:?}");
}

#[tokio::test(start_paused = true)]
async fn a_request_dropped_half_way_closes_the_connection() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    wire.plan([Some(WireFault::LateAnswer(100))]);
    assert!(timeout(Duration::from_millis(50), m1.read()).await.is_err());
    assert!(
        matches!(m1.read().await, Err(DeviceError::LinkLost { .. })),
        "a late answer must not be attributed to another request"
    );
    assert_eq!(wire.dials_count(), 1, "reading does not connect");
}

#[tokio::test(start_paused = true)]
async fn a_repeated_answer_is_not_attributed_to_the_next_request() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    for fault in [WireFault::DoubleAnswer, WireFault::DoubleRequest] {
        wire.plan([Some(fault)]);
        // The surplus answer is either detected and ends the connection, or discarded; it is never used.
        match m1.read().await {
            Ok(reading) => assert_eq!(reading.state, AxisState::Disabled),
            Err(error) => assert!(error.leaves_unknown(), "{error}"),
        }
        m1.connect().await.expect("connects again");
    }
}

#[tokio::test(start_paused = true)]
async fn a_torn_status_is_read_again_a_few_times() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    let torn = Some(WireFault::ChangeRegister(63, 1));
    wire.plan([None, torn, torn, torn, torn, torn]);
    assert!(m1.read().await.is_ok(), "five torn readings, then a complete one");
    wire.plan([None, torn, torn, torn, torn, torn, torn]);
    let Err(DeviceError::Implausible { what, .. }) = m1.read().await else { panic!("always torn") };
    assert!(what.contains("torn"), "{what}");
}

#[tokio::test(start_paused = true)]
async fn a_wrong_word_order_is_detected_on_connecting() {
    for word_order in [WordOrder::Cdab, WordOrder::Badc, WordOrder::Dcba] {
        let layout = Layout { word_order, ..Layout::default() };
        let wire = Wire::to(&Arc::new(Plc::new(layout, vec![controller()])));
        let Err(DeviceError::Implausible { what, .. }) = manipulator(&wire).connect().await else {
            panic!("{word_order:?} was not detected")
        };
        assert!(what.contains("word order"), "{what}");
    }
}

#[tokio::test(start_paused = true)]
async fn readings_of_a_device_whose_program_has_stopped_are_rejected() {
    let wire = Wire::to(&plc());
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    wire.every(Some(WireFault::HoldRegister(1, 4711)));
    for _ in 0..12 {
        m1.read().await.expect("not stale before 600 ms");
        sleep(Duration::from_millis(50)).await;
    }
    sleep(Duration::from_millis(10)).await;
    for again in [m1.read().await, m1.connect().await] {
        let Err(DeviceError::Implausible { what, .. }) = again else { panic!("a stopped heartbeat was accepted") };
        assert!(what.contains("heartbeat has been 4711"), "{what}");
    }
    wire.every(None);
    m1.connect().await.expect("the heartbeat changes again");
}

#[tokio::test(start_paused = true)]
async fn a_refusal_of_the_device_is_reported() {
    let plc = plc();
    let mut m1 = manipulator(&Wire::to(&plc));
    m1.connect().await.expect("connects");
    m1.send(&command(1, Action::Enable)).await.expect("sends");
    m1.send(&command(2, x_to(200.5))).await.expect("sent");
    let reading = m1.read().await.expect("a reading");
    assert_eq!((reading.acknowledged.sequence, reading.acknowledged.result), (2, CommandResult::Rejected));
    assert_eq!(reading.fault_code, code::OUT_OF_LIMITS);
    assert_eq!(executed(&plc), [1]);
}

#[tokio::test(start_paused = true)]
async fn a_command_corrupted_during_transmission_is_not_executed() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    // Byte 15 of the frame is in register 1 of the block: 7 bytes of header and 6 bytes precede the registers.
    wire.plan([Some(WireFault::CorruptRequest(16, 4))]);
    let illegal_data_value = DeviceError::Rejected { device: "m1".to_owned(), code: 3 };
    assert_eq!(m1.send(&command(1, Action::Enable)).await, Err(illegal_data_value));
    assert!(executed(&plc).is_empty());
    assert_eq!(m1.read().await.expect("the link is still open").acknowledged.sequence, 0);
}

#[tokio::test(start_paused = true)]
async fn an_old_command_that_arrives_late_is_not_executed() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut m1 = manipulator(&wire);
    m1.connect().await.expect("connects");
    m1.send(&command(1, Action::Enable)).await.expect("sends");
    wire.plan([Some(WireFault::LateRequest(3000))]);
    assert!(m1.send(&command(2, x_to(50.0))).await.is_err());
    m1.connect().await.expect("connects again");
    m1.send(&command(3, Action::Halt)).await.expect("sends");
    sleep(Duration::from_secs(5)).await;
    assert_eq!(executed(&plc), [1, 3], "the move arrived after the halt");
}

#[tokio::test(start_paused = true)]
async fn a_device_without_heartbeat_stops_by_itself() {
    let plc = plc();
    let mut m1 = manipulator(&Wire::to(&plc));
    m1.connect().await.expect("connects");
    m1.send(&command(1, Action::Enable)).await.expect("sends");
    m1.send(&command(2, x_to(150.0))).await.expect("sends");
    sleep(Duration::from_secs(2)).await;
    let reading = m1.connect().await.expect("connects again");
    assert_eq!((reading.state, reading.fault_code), (AxisState::ErrorStop, code::WATCHDOG));
    // 500 ms at 50 mm/s, and 50²/(2·500) = 2.5 mm of braking.
    assert!(reading.axes.x.actual < 0.5 * 50.0 + 2.5 + 0.1, "{:?}", reading.axes.x);
    assert_eq!(executed(&plc), [1, 2], "a new connection must move nothing");
}

#[tokio::test(start_paused = true)]
async fn each_device_of_a_plc_receives_its_own_commands() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let second = Settings { base: 256, ..Settings::default() };
    let by_unit = Settings { unit_id: 3, ..Settings::default() };
    let mut m2 = second.manipulator("m2", wire.dial()).expect("settings");
    let mut third = by_unit.manipulator("third", wire.dial()).expect("settings");
    m2.connect().await.expect("connects");
    third.connect().await.expect("connects");
    m2.send(&command(1, Action::Enable)).await.expect("sends");
    third.send(&command(9, Action::Enable)).await.expect("sends");
    let counts: Vec<_> = (0..3)
        .map(|index| {
            plc.with(index, |device, _| device.reading(Duration::ZERO).acknowledged.sequence).expect("a device")
        })
        .collect();
    assert_eq!(counts, [0, 1, 9]);
}

#[tokio::test(start_paused = true)]
async fn an_address_without_a_device_is_an_error() {
    let wire = Wire::to(&plc());
    let beyond = Settings { base: 768, ..Settings::default() };
    let Err(DeviceError::Implausible { what, .. }) =
        beyond.manipulator("m4", wire.dial()).expect("settings").connect().await
    else {
        panic!("there is no fourth device")
    };
    assert!(what.contains("Illegal data address"), "{what}");
}

#[tokio::test(start_paused = true)]
async fn missing_answers_do_not_accumulate() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut m1 = manipulator(&wire);
    wire.every(Some(WireFault::StallBefore));
    let start: Instant = crate::device::clock::now();
    for _ in 0..10 {
        assert!(m1.connect().await.is_err());
    }
    assert!(crate::device::clock::now() - start <= Duration::from_millis(10 * 202));
    wire.every(None);
    assert!(m1.connect().await.is_ok());
}
