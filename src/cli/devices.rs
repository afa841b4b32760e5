//! `coaxis devices`: whether the devices that the configuration names are there, and keep what their adaptors promise. Reads
//! alone; moves nothing, starts no scan.

use super::config::Sources;
use super::{FAILED, Outcome, print};
use crate::cell::Devices;
use crate::device::contract::{Report, check_manipulator, check_sensor, check_stage};
use crate::motion::Pair;
use crate::service::Equipment;
use std::process::ExitCode;

/// Look after the devices that the configuration names
#[derive(Debug, clap::Subcommand)]
pub(super) enum Subject {
    Check(Arguments),
}

/// Connect to every device, read it, and hold it to the contract; moves nothing. Not beside a service that uses them
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// Print one JSON document a device
    #[arg(long)]
    json: bool,
}

pub(super) fn run(subject: &Subject) -> Outcome {
    let Subject::Check(arguments) = subject;
    let config = arguments.sources.config()?;
    let Some(equipment) = Equipment::of(&config.cell)? else {
        print("the configuration has no cell (cell.enabled = false)\n")?;
        return Ok(ExitCode::SUCCESS);
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let reports = runtime.block_on(check(equipment.devices));
    for report in &reports {
        print(&if arguments.json { serde_json::to_string(report)? + "\n" } else { in_words(report) })?;
    }
    let passed = reports.iter().all(Report::passed);
    Ok(if passed { ExitCode::SUCCESS } else { ExitCode::from(FAILED) })
}

async fn check(devices: Devices) -> Vec<Report> {
    let Devices { manipulators: Pair { mut m1, mut m2 }, sensor, stage } = devices;
    let mut reports = vec![check_manipulator(m1.as_mut()).await, check_manipulator(m2.as_mut()).await];
    if let Some(mut stage) = stage {
        reports.push(check_stage(stage.as_mut()).await);
    }
    if let Some(mut sensor) = sensor {
        reports.push(check_sensor(sensor.as_mut()).await);
    }
    reports
}

fn in_words(report: &Report) -> String {
    let mut text = format!("{}\n", report.device);
    for check in &report.checks {
        let mark = if check.passed { "ok  " } else { "FAIL" };
        text += &format!("  {mark} {}: {}\n", check.name, check.words);
    }
    text
}
