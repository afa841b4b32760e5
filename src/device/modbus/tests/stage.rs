//! The stage over the same map: moves, halts, says what was refused, and never uses a number twice.

use super::{Settings, Wire, WireFault, plc};
use crate::device::modbus::Plc;
use crate::device::simulated::code;
use crate::device::{DeviceError, Stage};
use std::time::Duration;
use tokio::time::sleep;

const STAGE: usize = 2;

fn stage(wire: &Wire) -> impl Stage + use<> {
    let settings = Settings { base: 512, ..Settings::default() };
    settings.stage("stage", wire.dial()).expect("settings that can be")
}

/// Puts the stage under control at its panel, so to speak: the trait has no word for it.
fn enable(plc: &Plc) {
    let command = super::command(100, crate::device::Action::Enable);
    plc.with(STAGE, |controller, now| controller.take(&command, now)).expect("a stage");
}

fn executed(plc: &Plc) -> Vec<u16> {
    plc.with(STAGE, |stage, _| stage.record().all_executed().map(|entry| entry.sequence).collect()).expect("a stage")
}

#[tokio::test(start_paused = true)]
async fn a_stage_goes_where_it_is_sent_and_halts() {
    let plc = plc();
    enable(&plc);
    let mut stage = stage(&Wire::to(&plc));
    let reading = stage.connect().await.expect("connects");
    assert_eq!((reading.lower_mm, reading.upper_mm, reading.speed_mm_s), (-200.0, 200.0, 50.0));
    stage.move_to(1, 20.0, 40.0).await.expect("is taken");
    while stage.read().await.expect("a reading").moves {
        sleep(Duration::from_millis(50)).await;
    }
    let reading = stage.read().await.expect("a reading");
    assert!(reading.in_position && (reading.actual_mm - 20.0).abs() < 1e-5, "{reading:?}");
    stage.move_to(1, 120.0, 40.0).await.expect("is taken");
    sleep(Duration::from_millis(300)).await;
    stage.halt().await.expect("is taken");
    sleep(Duration::from_millis(300)).await;
    let reading = stage.read().await.expect("a reading");
    assert!(!reading.moves && reading.actual_mm < 50.0, "{reading:?}");
    assert_eq!(executed(&plc), [100, 101, 102, 103], "numbers go on where the device was");
}

#[tokio::test(start_paused = true)]
async fn a_stage_that_is_sent_somewhere_is_put_under_control_first() {
    let plc = plc();
    let mut stage = stage(&Wire::to(&plc));
    stage.connect().await.expect("connects");
    assert_eq!(executed(&plc), [0_u16; 0], "connecting commands nothing");
    stage.move_to(1, 20.0, 40.0).await.expect("is taken");
    while stage.read().await.expect("a reading").moves {
        sleep(Duration::from_millis(50)).await;
    }
    let reading = stage.read().await.expect("a reading");
    assert!((reading.actual_mm - 20.0).abs() < 1e-5, "{reading:?}");
    assert_eq!(executed(&plc).len(), 2, "enable and move");
}

#[tokio::test(start_paused = true)]
async fn a_stage_says_what_the_device_refuses() {
    let plc = plc();
    enable(&plc);
    let mut stage = stage(&Wire::to(&plc));
    stage.connect().await.expect("connects");
    let refused = stage.move_to(1, 500.0, 40.0).await;
    assert_eq!(refused, Err(DeviceError::Rejected { device: "stage".to_owned(), code: code::OUT_OF_LIMITS }));
}

#[tokio::test(start_paused = true)]
async fn a_number_that_may_be_under_way_is_not_used_again() {
    let plc = plc();
    enable(&plc);
    let wire = Wire::to(&plc);
    let mut stage = stage(&wire);
    stage.connect().await.expect("connects");
    wire.plan([Some(WireFault::LateRequest(2000))]);
    assert!(stage.move_to(1, 100.0, 40.0).await.expect_err("cut").leaves_unknown());
    stage.connect().await.expect("connects anew");
    stage.move_to(1, 10.0, 40.0).await.expect("is taken");
    sleep(Duration::from_secs(3)).await;
    assert_eq!(executed(&plc), [100, 102], "101 came late, and is older than 102");
}

#[tokio::test(start_paused = true)]
async fn an_older_fence_moves_no_stage() {
    let mut stage = stage(&Wire::to(&plc()));
    stage.connect().await.expect("connects");
    let _ = stage.move_to(7, 10.0, 40.0).await;
    let refused = stage.move_to(6, 10.0, 40.0).await;
    assert_eq!(refused, Err(DeviceError::Fenced { device: "stage".to_owned(), fence: 6, newest: 7 }));
    assert!(stage.halt().await.is_ok(), "a halt carries the newest");
}
