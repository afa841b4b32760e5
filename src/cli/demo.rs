//! `coaxis demo`: the product in one command. It starts the service, sends it a synthetic scan with interference, lets the
//! simulated cell scan its part and move it to a target, and prints the poses beside the true values, the addresses of the plots
//! and further commands. All requests go over HTTP, as those of a client do; only the true values are read from the simulation.

use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use tokio::time::sleep;

use crate::config::{Cell, Config, ManipulatorAdaptor, SensorAdaptor, StageAdaptor};
use crate::device::simulated::World;
use crate::estimation::Method;
use crate::http::Server;
use crate::scan::decode::Format;
use crate::scan::synthetic::{Part, Truth};

use super::client::{self, Answer};
use super::config::Sources;
use super::log;
use super::output::{Outcome, print};
use super::serve::{open_service, stop_on_signal};
use super::simulate::write_made;

/// Start the service, measure a synthetic scan and show the pose beside the truth; then keep serving
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(flatten)]
    sources: Sources,
    /// End after showing, instead of serving on
    #[arg(long)]
    once: bool,
}

/// Simulated seconds per second.
const TIME_FACTOR: f64 = 10.0;

/// Longest time for a measurement of the demonstration.
const WAIT: Duration = Duration::from_secs(60);

pub(super) fn run(arguments: &Arguments) -> Outcome {
    let mut config = arguments.sources.config()?;
    // Log lines would separate the lines of the demonstration; --set log.filter=info shows them.
    if config.log.filter == crate::config::Log::default().filter {
        config.log.filter = "warn".to_owned();
    }
    // A simulated cell need not run in real time.
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
    // The demonstration does not move real devices.
    let world = world.filter(|_| is_simulated(&config.cell));
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

/// Generates a scan, measures it by every method and prints the results.
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
        Some(world) => align(base, world).await?,
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

/// Longest time for any step of the cell.
const CELL_WAIT: Duration = Duration::from_secs(90);
/// Interval between two readings of the cell's state.
const LOOK: Duration = Duration::from_millis(50);

/// The target of the part: along the rail, slightly raised.
const TARGET: [(&str, f64); 4] = [("deflection_deg", 0.0), ("pitch_deg", 0.0), ("y_c0_mm", 0.0), ("z_c0_mm", 10.0)];

/// Whether every device is simulated, so that nothing real moves.
fn is_simulated(cell: &Cell) -> bool {
    cell.manipulators.iter().all(|(_, one)| one.adaptor == ManipulatorAdaptor::Simulated)
        && cell.stage.adaptor == StageAdaptor::Simulated
        && cell.sensor.adaptor == SensorAdaptor::Simulated
}

/// Measures the part, moves it, measures it again, and returns the text to show.
async fn align(base: &str, world: &World) -> Result<String, Box<dyn Error>> {
    until_idle(base).await?;
    let lease = post(base, "/v1/cell/lease", &json!({"holder": "demo", "ttl_s": 60}), 201).await?;
    let lease = json!({"lease_id": text(&lease, "lease_id")});
    for manipulator in ["m1", "m2"] {
        post(base, &format!("/v1/manipulators/{manipulator}/enable"), &lease, 200).await?;
    }
    until_allowed(base).await?;
    let before = measure(base, &lease).await?;
    let true_before = truth(world);
    let target: serde_json::Map<String, Value> =
        TARGET.iter().map(|(name, value)| ((*name).to_owned(), json!(value))).collect();
    let plan = post(base, "/v1/plans", &json!({"measurement_id": text(&before, "id"), "target": target}), 201).await?;
    let execute = format!("/v1/plans/{}/execute", text(&plan, "id"));
    let began = post(base, &execute, &lease, 201).await?;
    let moved = get(base, &format!("/v1/moves/{}?wait_s=60", text(&began, "id"))).await?;
    if text(&moved, "state") != "done" {
        return Err(format!("the move of the demonstration ended as {moved}").into());
    }
    let after = measure(base, &lease).await?;
    let true_after = truth(world);
    // A stop frees the lease for the next client.
    post(base, "/v1/cell/stop", &Value::Null, 200).await?;
    release(base, &lease).await?;
    Ok(report_alignment(&plan, [(&before, true_before), (&after, true_after)]))
}

async fn measure(base: &str, lease: &Value) -> Result<Value, Box<dyn Error>> {
    let order = json!({"source": "sensor", "lease_id": text(lease, "lease_id")});
    let began = post(base, "/v1/measurements", &order, 201).await?;
    let measured = get(base, &format!("/v1/measurements/{}?wait_s=60", text(&began, "id"))).await?;
    if text(&measured, "verdict") != "accepted" {
        return Err(format!("the measurement by the sensor ended as {measured}").into());
    }
    Ok(measured)
}

async fn until_idle(base: &str) -> Result<(), Box<dyn Error>> {
    let up = |device: &Value| text(device, "link") == "up";
    let all_up = |cell: &Value| cell.get("devices").and_then(Value::as_array).is_some_and(|all| all.iter().all(up));
    until(base, |cell| text(cell, "state") == "idle" && all_up(cell)).await
}

async fn until_allowed(base: &str) -> Result<(), Box<dyn Error>> {
    until(base, |cell| cell.get("commands_allowed").and_then(Value::as_bool) == Some(true)).await
}

async fn until(base: &str, so: impl Fn(&Value) -> bool) -> Result<(), Box<dyn Error>> {
    for _ in 0..200 {
        let cell = get(base, "/v1/cell").await?;
        if so(&cell) {
            return Ok(());
        }
        sleep(LOOK).await;
    }
    Err("the simulated cell does not become ready; GET /v1/cell shows the reasons".into())
}

async fn release(base: &str, lease: &Value) -> Result<(), Box<dyn Error>> {
    let url = format!("{base}/v1/cell/lease?lease_id={}", text(lease, "lease_id"));
    expect(&url, &client::delete(&url, CELL_WAIT).await?, 200).map(|_| ())
}

async fn post(base: &str, path: &str, body: &Value, status: u16) -> Result<Value, Box<dyn Error>> {
    let url = format!("{base}{path}");
    let body = if body.is_null() { String::new() } else { body.to_string() };
    expect(&url, &client::post_json(&url, &body, CELL_WAIT).await?, status)
}

async fn get(base: &str, path: &str) -> Result<Value, Box<dyn Error>> {
    let url = format!("{base}{path}");
    expect(&url, &client::get(&url, CELL_WAIT).await?, 200)
}

fn expect(url: &str, answer: &Answer, status: u16) -> Result<Value, Box<dyn Error>> {
    if answer.status != status {
        return Err(format!("{url} answered {}: {}", answer.status, answer.body).into());
    }
    Ok(serde_json::from_str(&answer.body)?)
}

fn text<'a>(document: &'a Value, field: &str) -> &'a str {
    document.get(field).and_then(Value::as_str).unwrap_or_default()
}

/// The true axis in the order of [`TARGET`].
fn truth(world: &World) -> [f64; 4] {
    let axis = world.truth();
    [axis.deflection().degrees(), axis.pitch().degrees(), axis.y0, axis.z0]
}

fn report_alignment(plan: &Value, [(before, true_before), (after, true_after)]: [(&Value, [f64; 4]); 2]) -> String {
    let number =
        |document: &Value, pointer: &str| document.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut text = format!(
        "\nThe simulated cell has scanned its part, moved it to a target by plan {} ({:.1} s, strain {:.4} mm) and scanned again:\n\
         {:<16}{:>12}{:>12}{:>12}{:>12}{:>12}",
        text(plan, "id"),
        number(plan, "/duration_s"),
        number(plan, "/strain_mm"),
        "",
        "before",
        "truth",
        "target",
        "after",
        "truth"
    );
    let rows = TARGET.iter().zip(true_before).zip(true_after);
    for (((field, wanted), true_before), true_after) in rows {
        let pointer = format!("/pose/{field}");
        text += &format!(
            "\n{field:<16}{:>12.4}{true_before:>12.4}{wanted:>12.4}{:>12.4}{true_after:>12.4}",
            number(before, &pointer),
            number(after, &pointer)
        );
    }
    text += "\nWhat is left of the way is the made backlash (0.05 mm) and cross-coupling (2 %); a second plan takes it. The made \
             cell runs faster than a real one.\n";
    text
}
