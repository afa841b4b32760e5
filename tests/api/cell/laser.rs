//! The laser of a sensor on the network: a service that is killed during a scan leaves it on, and the next start switches it
//! off; a service that ends by a signal switches it off itself. The configuration that the simulated sensor prints can be used
//! without changes.

use super::restart::{end, serve_with};
use crate::api::harness::{Folder, Running, at};
use coaxis::device::ProfileSensor;
use coaxis::device::gocator::{Gocator, Settings};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Maximum time from the restart until the laser is off.
const OFF_WITHIN: Duration = Duration::from_secs(1);

/// A simulated sensor in a separate process, and the configuration that it prints.
struct Sensor {
    process: Child,
    document: String,
    runtime: tokio::runtime::Runtime,
}

impl Sensor {
    fn start(form: &str, rate_hz: &str) -> Self {
        let arguments = ["simulate", "gocator", "--form", form, "--rate-hz", rate_hz];
        let ports = ["--control-port", "0", "--data-port", "0", "--health-port", "0"];
        let mut process = Command::new(env!("CARGO_BIN_EXE_coaxis"))
            .args(arguments.iter().chain(&ports))
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let mut lines = BufReader::new(process.stdout.take().expect("a document")).lines();
        let mut document = String::new();
        // The start of the travel is the last line.
        while !document.contains("\nstart_mm = ") {
            document += &lines.next().expect("more of it").expect("text");
            document.push('\n');
        }
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        Self { process, document, runtime }
    }

    /// Whether its laser is on, read over a separate connection.
    fn is_on(&self) -> bool {
        let settings = settings(&self.document).expect("what it printed");
        let mut probe = Gocator::new("probe", &settings).expect("what it printed");
        self.runtime.block_on(probe.connect()).expect("it answers").running
    }

    #[expect(clippy::disallowed_methods, reason = "the sensor is another process on the machine's clock")]
    fn until(&self, on: bool, within: Duration) {
        let since = Instant::now();
        while self.is_on() != on {
            assert!(since.elapsed() < within, "the laser is {} after {within:?}", if on { "off" } else { "on" });
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Sensor {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _gone = self.process.wait();
    }
}

fn settings(document: &str) -> Option<Settings> {
    let table: toml::Table = document.parse().ok()?;
    table.get("cell")?.get("sensor")?.get("gocator")?.clone().try_into().ok()
}

/// A service with this sensor.
fn serve(folder: &Folder, sensor: &Sensor) -> (Child, Running) {
    std::fs::create_dir_all(folder.path()).expect("a folder");
    let file = folder.path().join("coaxis.toml");
    std::fs::write(&file, &sensor.document).expect("written");
    let (child, address) = serve_with(folder, &["--config", &file.display().to_string()]);
    let service = at(&address);
    super::until(&service, "/v1/cell", |cell| cell["state"] == "idle" && super::all_up(cell));
    (child, service)
}

fn measure(service: &Running) -> Value {
    let lease = service.post_json("/v1/cell/lease", &json!({"ttl_s": 60})).expect(201);
    service.post_json("/v1/measurements", &json!({"source": "sensor", "lease_id": lease["lease_id"]})).expect(201)
}

#[test]
fn a_laser_left_on_by_a_killed_service_is_off_within_a_second_of_the_restart() {
    let (sensor, folder) = (Sensor::start("point_cloud", "20"), Folder::new());
    let (mut child, service) = serve(&folder, &sensor);
    measure(&service);
    sensor.until(true, Duration::from_secs(20));
    end(&mut child);
    assert!(sensor.is_on(), "it was not switched off");
    let (mut child, _) = serve_with(&folder, &["--config", &folder.path().join("coaxis.toml").display().to_string()]);
    sensor.until(false, OFF_WITHIN);
    end(&mut child);
}

#[test]
fn a_signal_during_a_scan_switches_the_laser_off_before_the_service_ends() {
    let (sensor, folder) = (Sensor::start("point_cloud", "20"), Folder::new());
    let (mut child, service) = serve(&folder, &sensor);
    measure(&service);
    sensor.until(true, Duration::from_secs(20));
    let signal = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().expect("sent");
    assert!(signal.success());
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
    assert!(!sensor.is_on());
}

#[test]
fn the_configuration_that_the_simulated_sensor_prints_for_a_surface_works_as_printed() {
    let (sensor, folder) = (Sensor::start("surface", "100"), Folder::new());
    let (mut child, service) = serve(&folder, &sensor);
    let begun = measure(&service);
    let id = begun["id"].as_str().expect("an id");
    let mut measured = begun.clone();
    while measured["state"] == "scanning" {
        measured = service.get(&format!("/v1/measurements/{id}?wait_s=20")).expect(200);
    }
    assert!(measured["pose"].is_object(), "{measured}");
    end(&mut child);
}
