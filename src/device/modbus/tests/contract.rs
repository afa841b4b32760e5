//! The contract of all adaptors, kept over map v1 and over the other map that docs/modbus.md shows.

use super::{Settings, Wire, controller, plc};
use crate::device::contract::motion::{check_manipulator_motion, check_stage_motion};
use crate::device::contract::{Report, check_manipulator, check_stage};
use crate::device::modbus::{Layout, Numbers, Plc, StatusFunction, WordOrder};
use crate::device::{Action, Manipulator};
use std::sync::Arc;

const PAGE: &str = include_str!("../../../../docs/modbus.md");

fn must_pass(report: &Report) {
    let failed: Vec<_> = report.checks.iter().filter(|check| !check.passed).collect();
    assert!(report.passed(), "{failed:#?}");
}

/// The settings of the page's example.
fn documented() -> Settings {
    let text = PAGE.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let page: toml::Table = toml::from_str(text).expect("TOML");
    let path = ["cell", "manipulators", "m1", "modbus"];
    let found = path.iter().fold(toml::Value::Table(page), |value, key| value[key].clone());
    found.try_into().expect("settings")
}

#[tokio::test(start_paused = true)]
async fn map_v1_keeps_the_contract() {
    let wire = Wire::to(&plc());
    let mut m1 = super::manipulator(&wire);
    must_pass(&check_manipulator(&mut m1).await);
    must_pass(&check_manipulator_motion(&mut m1, 5).await);
}

#[tokio::test(start_paused = true)]
async fn the_other_map_of_the_page_keeps_the_contract() {
    let settings = documented();
    assert_eq!(settings.check(), Ok(()));
    let wire = Wire::to(&Arc::new(Plc::new(settings.layout, vec![controller()])));
    let mut m1 = settings.manipulator("m1", wire.dial()).expect("settings that can be");
    must_pass(&check_manipulator(&mut m1).await);
    must_pass(&check_manipulator_motion(&mut m1, 5).await);
}

#[test]
fn the_other_map_of_the_page_is_another_one() {
    let Layout { status, numbers, word_order, .. } = documented().layout;
    assert_eq!((status.function, word_order), (StatusFunction::Holding, WordOrder::Cdab));
    assert!(matches!(numbers, Numbers::I32(_)) && status.magic.is_none());
}

#[test]
fn the_page_names_every_register_of_map_v1() {
    let Layout { status, command, .. } = Layout::default();
    let rows = [
        (status.heartbeat, "device heartbeat"),
        (status.state, "state of the device"),
        (status.sequence, "newest sequence number seen"),
        (status.result, "result of that command"),
        (status.actual.x, "actual position"),
        (status.speed.x, "greatest speed"),
        (command.watchdog_ms.expect("v1 has it"), "watchdog, ms"),
        (command.crc.expect("v1 has it"), "CRC-16"),
        (command.fence.expect("v1 has it"), "fence"),
        (command.sequence, "sequence number"),
    ];
    for (at, what) in rows {
        let named = PAGE.lines().any(|line| line.starts_with(&format!("| {at} |")) && line.contains(what));
        assert!(named, "no row {at} for {what}");
    }
}

#[tokio::test(start_paused = true)]
async fn the_stage_keeps_the_contract() {
    let plc = plc();
    let command = super::command(100, Action::Enable);
    plc.with(2, |stage, now| stage.take(&command, now)).expect("a stage");
    let wire = Wire::to(&plc);
    let settings = Settings { base: 512, ..Settings::default() };
    let mut stage = settings.stage("stage", wire.dial()).expect("settings that can be");
    must_pass(&check_stage(&mut stage).await);
    must_pass(&check_stage_motion(&mut stage, 5).await);
}

#[tokio::test(start_paused = true)]
async fn a_new_adaptor_goes_on_where_the_device_is() {
    let plc = plc();
    let wire = Wire::to(&plc);
    let mut before = super::manipulator(&wire);
    before.connect().await.expect("connects");
    before.send(&super::command(41, Action::Enable)).await.expect("sends");
    drop(before);
    assert_eq!(super::manipulator(&wire).connect().await.expect("connects").acknowledged.sequence, 41);
}
