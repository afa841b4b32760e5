//! `coaxis devices`: checks that the configured devices are reachable and fulfil the contract of their adaptors. It only reads: it
//! moves nothing and starts no scan. If a service uses the devices, it checks them only on request; and a device that moves without
//! a commander is first given the time to be stopped by its watchdog.

use super::config::Sources;
use super::output::{FAILED, Outcome, print};
use crate::cell::{Devices, SILENCE};
use crate::device::contract::{Report, check_manipulator, check_sensor, check_stage};
use crate::motion::Pair;
use crate::service::Equipment;
use crate::store::{FolderLock, StoreError};
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use tokio::time::sleep;

/// Look after the devices that the configuration names
#[derive(Debug, clap::Subcommand)]
pub(super) enum Subject {
    Check(Arguments),
}

/// Connect to every device, read it, and hold it to the contract; moves nothing. Refuses while a service runs on the data folder
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// Print one JSON document a device
    #[arg(long)]
    json: bool,
    /// Check although a service runs that uses the devices. Its motions then go on for the devices' watchdog time longer if it
    /// dies meanwhile
    #[arg(long)]
    beside_service: bool,
}

pub(super) fn run(subject: &Subject) -> Outcome {
    let Subject::Check(arguments) = subject;
    let config = arguments.sources.config()?;
    let Some(equipment) = Equipment::of(&config.cell)? else {
        print("the configuration has no cell (cell.enabled = false)\n")?;
        return Ok(ExitCode::SUCCESS);
    };
    // Kept until the end, so that no service starts meanwhile.
    let _lock = if arguments.beside_service { None } else { keep_services_out(&config.data)? };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let reports = runtime.block_on(check(equipment.devices));
    for report in &reports {
        print(&if arguments.json { serde_json::to_string(report)? + "\n" } else { in_words(report) })?;
    }
    let passed = reports.iter().all(Report::passed);
    Ok(if passed { ExitCode::SUCCESS } else { ExitCode::from(FAILED) })
}

fn keep_services_out(data: &Path) -> Result<Option<FolderLock>, Box<dyn Error>> {
    FolderLock::take(data).map_err(|error| match error {
        StoreError::FolderInUse { folder } => format!(
            "a service is running on {} and uses the devices; stop it first, or check beside it with --beside-service",
            folder.display()
        )
        .into(),
        error => Box::<dyn Error>::from(error),
    })
}

/// Sends nothing to the devices at first, so that a motion left by an ended process is stopped by its watchdog, which any request
/// would restart.
async fn check(devices: Devices) -> Vec<Report> {
    sleep(SILENCE).await;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::now;
    use crate::device::contract::check_manipulator;
    use crate::device::simulated::{Device, Mounting, Settings, World};
    use crate::device::{Action, Command, Manipulator};
    use crate::motion::{Axes, AxisLimits, Carrier};
    use std::time::Duration;
    use tokio::time::{Instant, sleep_until};

    /// The longest watchdog time that a device may have here.
    const WATCHDOG: Duration = Duration::from_millis(400);

    /// A world in which m1 has just received a command for a long move from a client that has disappeared.
    async fn abandoned() -> (World, Instant) {
        let linear =
            AxisLimits { lower: -40.0, upper: 40.0, speed: 10.0, acceleration: 100.0, jerk: 2000.0, step: 30.0 };
        let turn = AxisLimits { lower: -0.5, upper: 0.5, speed: 0.2, acceleration: 2.0, jerk: 40.0, step: 0.5 };
        let limits = Axes { x: linear, y: linear, z: linear, c: turn };
        let mountings = Pair { m1: 150.0, m2: 650.0 }.map(|_, x: &f64| Mounting { mount_mm: [*x, 0.0, 0.0], limits });
        let world = World::new(&Settings::default(), &mountings).expect("valid settings");
        let mut commander = world.manipulator(Carrier::M1);
        commander.connect().await.expect("a link");
        let axes = Axes { y: true, ..Axes::default() };
        let (targets, speeds) = (Axes { y: 30.0, ..Axes::default() }, Axes { y: 10.0, ..Axes::default() });
        for (sequence, action) in [(1, Action::Enable), (2, Action::MoveTo { axes, targets, speeds })] {
            let command = Command { sequence, fence: 1, watchdog: WATCHDOG, action };
            commander.send(&command).await.expect("a link");
        }
        (world, now())
    }

    #[tokio::test(start_paused = true)]
    async fn a_check_does_not_prolong_a_motion_without_a_commander() {
        let (world, abandoned_at) = abandoned().await;
        let devices = Devices {
            manipulators: Pair { m1: Carrier::M1, m2: Carrier::M2 }
                .map(|_, carrier| Box::new(world.manipulator(*carrier)) as Box<dyn Manipulator>),
            sensor: Some(Box::new(world.sensor())),
            stage: Some(Box::new(world.stage())),
        };
        let checking = tokio::spawn(check(devices));
        // 400 ms of watchdog, 100 ms of braking from 10 mm/s at 100 mm/s², and some ms for the transmission of the command.
        sleep_until(abandoned_at + Duration::from_millis(510)).await;
        let stood_at = world.clamp(Carrier::M1);
        let reports = checking.await.expect("the task ends");
        assert_eq!(world.clamp(Carrier::M1), stood_at);
        let failed =
            |report: &Report| report.checks.iter().filter(|check| !check.passed).map(|check| check.name).collect();
        let failed: Vec<Vec<&str>> = reports.iter().map(failed).collect();
        assert_eq!(failed, [vec!["it has no fault"], vec![], vec![], vec![]], "its watchdog has stopped m1");
    }

    #[tokio::test(start_paused = true)]
    async fn a_moving_device_is_not_read_any_further() {
        let (world, abandoned_at) = abandoned().await;
        let steps = world.faults().steps(Device::Manipulator(Carrier::M1));
        let report = check_manipulator(&mut world.manipulator(Carrier::M1)).await;
        assert!(!report.passed());
        assert_eq!(world.faults().steps(Device::Manipulator(Carrier::M1)), steps + 2, "connecting takes two exchanges");
        sleep_until(abandoned_at + Duration::from_millis(510)).await;
        let stood_at = world.clamp(Carrier::M1);
        sleep_until(abandoned_at + Duration::from_secs(5)).await;
        assert_eq!(world.clamp(Carrier::M1), stood_at);
    }

    #[test]
    fn a_check_is_refused_while_a_service_has_the_data_folder() {
        let folder = std::env::temp_dir().join(format!("coaxis-check-{}", std::process::id()));
        assert!(keep_services_out(&folder).expect("no folder, no service").is_none());
        std::fs::create_dir_all(&folder).expect("a folder");
        let service = keep_services_out(&folder).expect("the folder is free");
        let refused = keep_services_out(&folder).map(|_| ()).expect_err("the folder is in use");
        assert!(refused.to_string().contains("--beside-service"), "{refused}");
        drop(service);
        assert!(keep_services_out(&folder).is_ok());
        std::fs::remove_dir_all(&folder).expect("the folder of this test");
    }
}
