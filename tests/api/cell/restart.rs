//! The service is killed during a move: the next start records this, moves nothing, and has the record of the command.

use crate::api::harness::{Folder, at};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A service with a simulated cell in a separate process, and its address.
fn serve(folder: &Folder) -> (Child, String) {
    serve_with(folder, &[])
}

/// The same with more arguments.
pub(super) fn serve_with(folder: &Folder, more: &[&str]) -> (Child, String) {
    let data = folder.path().display().to_string();
    let arguments = ["serve", "--listen", "127.0.0.1:0", "--data", &data, "--set", "log.format=json"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_coaxis"))
        .args(arguments.iter().chain(more))
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let log = BufReader::new(child.stderr.take().expect("a log"));
    let mut lines = log.lines().map(|line| line.expect("text"));
    let address = lines.find_map(|line| {
        let line: Value = serde_json::from_str(&line).expect("JSON");
        line["address"].as_str().map(str::to_owned)
    });
    // The output must be read continuously, so that the log never blocks the service.
    std::thread::spawn(move || lines.count());
    (child, address.expect("it listens"))
}

/// Kills a service.
pub(super) fn end(child: &mut Child) {
    child.kill().expect("it runs");
    child.wait().expect("it ends");
}

#[test]
fn a_move_during_which_the_service_was_killed_is_interrupted_and_not_resumed() {
    let folder = Folder::new();
    let (mut child, address) = serve(&folder);
    let service = at(&address);
    super::until(&service, "/v1/cell", |cell| cell["state"] == "idle");
    let lease = service.post_json("/v1/cell/lease", &json!({"holder": "night shift", "ttl_s": 60})).expect(201);
    let lease = json!({"lease_id": lease["lease_id"]});
    for manipulator in ["m1", "m2"] {
        service.post_json(&format!("/v1/manipulators/{manipulator}/enable"), &lease).expect(200);
    }
    super::until(&service, "/v1/cell", |cell| cell["commands_allowed"] == true);
    let order = json!({"m1": {"y_mm": 20.0}, "m2": {"y_mm": 20.0}, "speed_ratio": 0.1, "lease_id": lease["lease_id"],
        "request_id": "night-1"});
    let begun = service.post_json("/v1/moves", &order).expect(201);
    child.kill().expect("it runs");
    child.wait().expect("it ends");

    let (mut child, address) = serve(&folder);
    let service = at(&address);
    let path = format!("/v1/moves/{}", begun["id"].as_str().expect("an id"));
    let after = service.get(&path).expect(200);
    assert_eq!((&after["state"], &after["ending"]["code"]), (&json!("interrupted"), &json!("interrupted")));
    assert_eq!((&after["holder"], &after["axes"]["m1"]["y"]["to_mm"]), (&json!("night shift"), &json!(20.0)));
    let cell = super::until(&service, "/v1/cell", |cell| cell["state"] == "idle");
    assert_eq!((&cell["job"], &cell["lease"]), (&json!(null), &json!(null)));
    let one = service.get("/v1/manipulators/m1").expect(200);
    assert_eq!(one["reading"]["state"], "disabled", "nothing was sent to it");
    let lease = service.post_json("/v1/cell/lease", &json!({"ttl_s": 60})).expect(201);
    let mut again = order;
    again["lease_id"] = lease["lease_id"].clone();
    assert_eq!(service.post_json("/v1/moves", &again).expect(200)["state"], "interrupted", "it is not begun again");
    child.kill().expect("it runs");
    child.wait().expect("it ends");
}

#[test]
fn a_signal_stops_all_motion_before_the_service_ends() {
    let folder = Folder::new();
    let (mut child, address) = serve(&folder);
    let service = at(&address);
    super::until(&service, "/v1/cell", |cell| cell["state"] == "idle");
    let lease = service.post_json("/v1/cell/lease", &json!({"ttl_s": 60})).expect(201);
    let lease = json!({"lease_id": lease["lease_id"]});
    for manipulator in ["m1", "m2"] {
        service.post_json(&format!("/v1/manipulators/{manipulator}/enable"), &lease).expect(200);
    }
    super::until(&service, "/v1/cell", |cell| cell["commands_allowed"] == true);
    let order = json!({"m1": {"y_mm": 20.0}, "m2": {"y_mm": 20.0}, "speed_ratio": 0.1, "lease_id": lease["lease_id"]});
    let begun = service.post_json("/v1/moves", &order).expect(201);
    let signal = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().expect("sent");
    assert!(signal.success());
    assert_eq!(child.wait().expect("it ends").code(), Some(0));

    let (mut child, address) = serve(&folder);
    let after = at(&address).get(&format!("/v1/moves/{}", begun["id"].as_str().expect("an id"))).expect(200);
    assert_eq!((&after["state"], &after["ending"]["code"]), (&json!("stopped"), &json!("service_stopping")));
    child.kill().expect("it runs");
    child.wait().expect("it ends");
}
