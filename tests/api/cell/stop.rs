//! Stop: accepted from every client in every state; and jobs that continue after their client has disconnected.

use super::{FAST, Line, REAL, id, untouched};
use serde_json::json;
use std::io::Write;

#[test]
fn a_stop_needs_no_lease_and_no_body_and_states_its_category() {
    let (service, _folder) = untouched(FAST);
    for _ in 0..2 {
        let stopped = service.post("/v1/cell/stop", &[]).expect(200);
        assert!(stopped["note"].as_str().is_some_and(|note| note.contains("no emergency stop")), "{stopped}");
        assert!(stopped["unconfirmed_axes"].is_array() && stopped["sent_ms"].is_u64());
    }
}

#[test]
fn a_stop_ends_the_move_under_way_and_the_cell_continues_from_there() {
    let line = Line::ready(REAL);
    let begun = line.long_move();
    super::until(&line.service, "/v1/manipulators/m1", |one| one["reading"]["y"]["actual_mm"].as_f64() > Some(0.5));
    let stopped = line.service.post("/v1/cell/stop", &[]).expect(200);
    assert!(stopped["sent_ms"].as_u64() <= Some(250), "{stopped}");
    assert_eq!(stopped["devices"].as_array().map(Vec::len), Some(4), "two manipulators, the stage and the sensor");
    let ended = line.wait_for(&begun);
    assert_eq!((&ended["state"], &ended["ending"]["code"]), (&json!("stopped"), &json!("stop_requested")));
    super::until(&line.service, "/v1/cell", |cell| cell["state"] == "idle" && cell["commands_allowed"] == true);
    let back = line.post("/v1/moves", &json!({"m1": {"y_mm": 0.0}, "m2": {"y_mm": 0.0}})).expect(201);
    assert_eq!(line.wait_for(&back)["state"], "done");
}

#[test]
fn a_stop_ends_a_scan_and_the_measurement_reports_it() {
    let line = Line::ready(REAL);
    let begun = line.post("/v1/measurements", &json!({"source": "sensor", "speed_mm_s": 20.0})).expect(201);
    let path = format!("/v1/measurements/{}", id(&begun));
    let shown = line.service.get(&path).expect(200);
    assert_eq!((&shown["state"], &shown["failure"]), (&json!("scanning"), &json!(null)));
    assert_eq!(line.service.get(&format!("{path}?view=plc")).expect(200)["verdict_code"], 0);
    let shown_in = |state: &str| {
        let list = line.service.get(&format!("/v1/measurements?state={state}")).expect(200);
        list["measurements"].as_array().expect("a list").iter().map(|one| one["id"].clone()).collect::<Vec<_>>()
    };
    let plan = json!({"measurement_id": id(&begun),
        "target": {"deflection_deg": 0, "pitch_deg": 0, "y_c0_mm": 0, "z_c0_mm": 0}});
    let needing_a_result = |code: &str| {
        let problem = line.service.get(&format!("{path}/profiles")).problem(409, code);
        line.service.get(&format!("{path}/plots/centres.svg")).problem(409, code);
        line.service.post_json("/v1/plans", &plan).problem(409, code);
        (problem["state"].clone(), problem["reason"].clone())
    };
    assert_eq!(needing_a_result("measurement_running"), (json!("scanning"), json!(null)));
    assert_eq!((shown_in("scanning"), shown_in("stopped")), (vec![begun["id"].clone()], vec![]));
    line.service.get("/v1/measurements?state=scanning&verdict=accepted").problem(400, "query_invalid");
    line.service.post("/v1/cell/stop", &[]).expect(200);
    let ended = line.service.get(&format!("{path}?wait_s=20")).expect(200);
    assert_eq!(needing_a_result("measurement_failed"), (json!("stopped"), json!("stop_requested")));
    assert_eq!((shown_in("scanning"), shown_in("stopped")), (vec![], vec![begun["id"].clone()]));
    assert_eq!((shown_in("done"), shown_in("failed")), (vec![], vec![]));
    assert_eq!((&ended["state"], &ended["failure"]["code"]), (&json!("stopped"), &json!("stop_requested")));
    assert_eq!(line.service.get(&format!("{path}?view=plc")).expect(200)["verdict_code"], 3);
    assert_eq!(line.service.get("/v1/scans").expect(200)["scans"], json!([]), "nothing half is kept");
}

#[test]
fn a_client_that_disconnects_does_not_affect_its_move() {
    let line = Line::ready(REAL);
    let body =
        json!({"m1": {"y_mm": 3.0}, "m2": {"y_mm": 3.0}, "speed_ratio": 0.2, "lease_id": line.lease}).to_string();
    let mut stream = line.service.connect();
    let head = format!(
        "POST /v1/moves HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all((head + &body).as_bytes()).expect("sent");
    let moves = super::until(&line.service, "/v1/moves", |list| list["moves"][0]["state"] == "moving");
    drop(stream);
    let path = format!("/v1/moves/{}?wait_s=30", id(&moves["moves"][0]));
    let mut waiting = line.service.connect();
    write!(waiting, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("sent");
    drop(waiting);
    assert_eq!(line.service.get(&path).expect(200)["state"], "done");
    let one = line.service.get("/v1/manipulators/m1").expect(200);
    assert!((one["reading"]["y"]["actual_mm"].as_f64().expect("a place") - 3.0).abs() < 0.1);
}
