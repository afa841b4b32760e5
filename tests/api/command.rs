//! The `coaxis` command as used by a person, a container or an init system: configuration, signals, exit codes.

use crate::api::harness::Folder;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};

fn coaxis(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_coaxis"));
    command.args(arguments);
    command
}

fn output(arguments: &[&str]) -> Output {
    coaxis(arguments).output().expect("it runs")
}

fn complaint(arguments: &[&str]) -> String {
    let output = output(arguments);
    assert_eq!(output.status.code(), Some(1), "2 means refused, and this is not");
    String::from_utf8(output.stderr).expect("text")
}

/// A service in a separate process, and its address.
fn serve(folder: &Folder) -> (Child, String) {
    let data = folder.path().display().to_string();
    let mut child = coaxis(&["serve", "--listen", "127.0.0.1:0", "--data", &data, "--set", "log.format=json"])
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let log = BufReader::new(child.stderr.take().expect("a log"));
    let mut lines = log.lines().map(|line| line.expect("text"));
    let first: serde_json::Value = serde_json::from_str(&lines.next().expect("a line")).expect("JSON");
    // The output must be read continuously, so that the log never blocks the service.
    std::thread::spawn(move || lines.count());
    let address = first["address"].as_str().unwrap_or_else(|| panic!("{first}")).to_owned();
    (child, address)
}

#[test]
fn a_signal_shuts_the_service_down_and_health_reports_both_states() {
    let folder = Folder::new();
    let (mut child, address) = serve(&folder);
    let ready = format!("http://{address}/health/ready");
    assert_eq!(output(&["health", &ready]).status.code(), Some(0));
    assert_eq!(coaxis(&["health"]).env("COAXIS_LISTEN", &address).status().expect("it runs").code(), Some(0));
    assert!(complaint(&["health", &format!("http://{address}/v1/nothing")]).contains("route_unknown"));
    let signal = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().expect("sent");
    assert!(signal.success());
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
    let gone = complaint(&["health", &ready]);
    assert!(gone.contains(&address) && gone.contains("is the service running?"), "{gone}");
}

#[test]
fn one_folder_belongs_to_one_service() {
    let folder = Folder::new();
    let (mut child, _) = serve(&folder);
    let data = folder.path().display().to_string();
    let second = complaint(&["serve", "--listen", "127.0.0.1:0", "--data", &data]);
    child.kill().expect("it runs");
    child.wait().expect("it ends");
    assert!(second.contains("in use by another process"), "{second}");
}

#[test]
fn the_service_listens_on_the_network_only_if_configured() {
    let text = complaint(&["serve", "--listen", "0.0.0.0:0"]);
    assert!(text.contains("0.0.0.0:0") && text.contains("--insecure-lan"), "{text}");
}

#[test]
fn file_environment_and_flags_set_the_configuration_in_this_order() {
    let folder = Folder::new();
    let file = folder.path().join("coaxis.toml");
    std::fs::write(&file, "[limits]\nqueue_max = 3\nthreads = 3\nconnections_max = 3\n").expect("written");
    let file = file.display().to_string();
    let printed = coaxis(&["config", "--config", &file, "--set", "limits.threads=5"])
        .env("COAXIS_LIMITS__QUEUE_MAX", "4")
        .env("COAXIS_LIMITS__THREADS", "4")
        .output()
        .expect("it runs");
    let text = String::from_utf8(printed.stdout).expect("text");
    for line in ["connections_max = 3", "queue_max = 4", "threads = 5"] {
        assert!(text.lines().any(|found| found == line), "{line} is missing in\n{text}");
    }
    assert_eq!(output(&["config", "--check", &file]).status.code(), Some(0));
    std::fs::write(&file, "[limits]\nqueue_maximum = 3\n").expect("written");
    let text = complaint(&["config", "--check", &file]);
    assert!(text.contains(&file) && text.contains("queue_maximum"), "{text}");
}

#[test]
fn the_printed_default_can_be_used_as_a_file() {
    let folder = Folder::new();
    let file = folder.path().join("default.toml");
    std::fs::write(&file, output(&["config", "--default"]).stdout).expect("written");
    assert_eq!(output(&["config", "--check", &file.display().to_string()]).status.code(), Some(0));
}

#[test]
fn a_mistyped_command_is_not_a_refusal() {
    assert!(complaint(&["sevre"]).contains("sevre"));
    assert!(complaint(&["serve", "--lisen", "x"]).contains("--lisen"));
    assert_eq!(output(&["--help"]).status.code(), Some(0));
    let problems = String::from_utf8(output(&["openapi", "--problems"]).stdout).expect("text");
    assert!(problems.contains("| `busy` | 503 | yes |"), "{problems}");
}
