//! `coaxis demo`: the product in one command. Starts the service, sends it a synthetic scan with interference, has the simulated cell
//! scan its part and move it to a target, and shows the poses beside the truth, where the pictures are and what to type next.

use super::config::Sources;
use super::log;
use super::serve::{open_service, stop_on_signal};
use super::simulate::write_made;
use super::{Outcome, client, demo_cell, print};
use crate::config::Config;
use crate::device::simulated::World;
use crate::estimation::Method;
use crate::http::Server;
use crate::scan::decode::Format;
use crate::scan::synthetic::{Part, Truth};
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

/// Start the service, measure a synthetic scan and show the pose beside the truth; then keep serving
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// End after showing, instead of serving on
    #[arg(long)]
    once: bool,
}

/// Simulated seconds in a second.
const TIME_FACTOR: f64 = 10.0;

/// Longest that a measurement of the demonstration may take.
const WAIT: Duration = Duration::from_secs(60);

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut config = arguments.sources.config()?;
    // What is shown is to be read, not to be lost between lines of the log; --set log.filter=info brings them back.
    if config.log.filter == crate::config::Log::default().filter {
        config.log.filter = "warn".to_owned();
    }
    // A simulated cell has no reason to be slow.
    if config.cell.simulated.time_factor == crate::device::simulated::Settings::default().time_factor {
        config.cell.simulated.time_factor = TIME_FACTOR;
    }
    let _last_lines = log::start(&config.log)?;
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(demonstrate(&config, arguments.once))?;
    Ok(ExitCode::SUCCESS)
}

async fn demonstrate(config: &Config, once: bool) -> Result<(), Box<dyn Error>> {
    let (service, world) = open_service(config).await?;
    let stopped = Arc::clone(&service);
    // Devices that are not made are not moved by a demonstration.
    let world = world.filter(|_| demo_cell::is_made(&config.cell));
    let server = Server::bind(config, service).map_err(|error| {
        format!("cannot listen on {}: {error}; choose another port with --listen 127.0.0.1:0", config.listen)
    })?;
    let (base, stopper) = (format!("http://{}", server.address()), server.stopper());
    tokio::spawn(stop_on_signal(stopper.clone(), stopped));
    let serving = tokio::spawn(server.serve());
    let shown = show(&base, &config.data.join("demo"), world.as_ref(), once).await;
    if once || shown.is_err() {
        stopper.stop();
    }
    serving.await??;
    shown
}

/// Makes a scan, has it measured by every method and prints what came out.
async fn show(base: &str, folder: &Path, world: Option<&World>, once: bool) -> Result<(), Box<dyn Error>> {
    let file = folder.join("scan.ply");
    fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let truth_file = write_made(&[Part::with_interference(1)], Format::Ply, &file)?;
    let truth: Truth = serde_json::from_slice(&fs::read(&truth_file)?)?;
    let scan = fs::read(&file)?;
    let mut measurements = Vec::new();
    for method in Method::ALL {
        let url = format!("{base}/v1/measurements?format=ply&method={}", method.name());
        let answer = client::post(&url, &scan, WAIT).await?;
        if answer.status != 201 {
            return Err(format!("{url} answered {}: {}", answer.status, answer.body).into());
        }
        measurements.push((method, serde_json::from_str::<Value>(&answer.body)?));
    }
    let aligned = match world {
        Some(world) => demo_cell::align(base, world).await?,
        None => String::new(),
    };
    let end = if once { "" } else { "\nCtrl-C ends the service.\n" };
    print(&(report(base, &file, &truth, &measurements) + &aligned + end))
}

fn report(base: &str, file: &Path, truth: &Truth, measurements: &[(Method, Value)]) -> String {
    let file = file.display();
    let mut text = format!(
        "coaxis listens on {base}\n\nA synthetic part of {} mm radius, {} profiles of {} points, with screw holes, straight holes and \
         clamps on it:\n{file}\n\n{:<16}{:>10}",
        truth.radius_mm, truth.profiles_count, truth.points_per_profile_count, "", "truth"
    );
    for (method, _) in measurements {
        text += &format!("{:>20}{:>12}", method.name(), "error");
    }
    let rows = [
        ("deflection °", "deflection_deg", truth.deflection_deg),
        ("pitch °", "pitch_deg", truth.pitch_deg),
        ("y at x = 0 mm", "y_c0_mm", truth.y_c0_mm),
        ("z at x = 0 mm", "z_c0_mm", truth.z_c0_mm),
        ("radius mm", "radius_mm", truth.radius_mm),
    ];
    for (name, field, true_value) in rows {
        text += &format!("\n{name:<16}{true_value:>10.4}");
        for (_, measurement) in measurements {
            match measurement.pointer(&format!("/pose/{field}")).and_then(Value::as_f64) {
                Some(value) => text += &format!("{value:>20.4}{:>+12.4}", value - true_value),
                None => text += &format!("{:>20}{:>12}", "refused", ""),
            }
        }
    }
    text += "\nprofiles valid            ";
    for (_, measurement) in measurements {
        let count = |field: &str| measurement.pointer(&format!("/profiles/{field}")).cloned().unwrap_or_default();
        text += &format!("{:>20}{:>12}", format!("{} of {}", count("valid_count"), count("total_count")), "");
    }
    let id = measurements.first().and_then(|(_, first)| first["id"].as_str()).unwrap_or_default();
    text + &format!(
        "\n\nLook at it in a browser:\n  {base}/v1/measurements/{id}/plots/residual_map.svg\n  {base}/docs\n\nGo on with:\n  \
         curl -s --data-binary @{file} '{base}/v1/measurements?format=ply'\n  curl -s '{base}/v1/measurements?limit=3'\n  \
         curl -s {base}/v1/measurements/{id}/profiles -H 'Accept: text/csv'\n"
    )
}
