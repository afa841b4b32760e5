//! Start, stop and restart of the service; the answers to probes and polling clients.

use crate::api::bodies::exact_csv;
use crate::api::harness::{Folder, rest, start, start_on};
use insta::assert_json_snapshot;
use serde_json::{Value, json};
use std::io::{Read, Write};

#[test]
fn the_status_is_flat_with_fixed_keys_below_512_bytes() {
    let (service, _folder) = start();
    let keys = |status: &Value| status.as_object().expect("flat").keys().cloned().collect::<Vec<_>>();
    let empty = service.get("/v1/status").expect(200);
    assert_eq!(empty["last_measurement_id"], Value::Null);
    let measurement = service.post("/v1/measurements", &exact_csv()).expect(201);
    let answer = service.get("/v1/status");
    let status = answer.expect(200);
    assert!(answer.body.len() < 480, "{} bytes leave no space for larger numbers", answer.body.len());
    assert_eq!(keys(&status), keys(&empty));
    let text = answer.text();
    let places: Vec<_> = [
        "state",
        "instance_id",
        "sequence",
        "version",
        "started_at",
        "now_at",
        "running_count",
        "queued_count",
        "running_max_count",
        "queue_max_count",
        "cell_state",
        "last_measurement_id",
        "last_verdict",
        "last_created_at",
    ]
    .map(|key| text.find(&format!("\"{key}\":")).expect(key))
    .to_vec();
    assert!(places.is_sorted() && places.len() == keys(&status).len(), "{text}");
    assert_eq!(status["last_measurement_id"], measurement["id"]);
    assert_eq!(status["instance_id"], empty["instance_id"]);
    assert!(status["sequence"].as_u64() > empty["sequence"].as_u64());
    assert_json_snapshot!("status", status, {
        ".instance_id" => "[id]", ".started_at" => "[time]", ".now_at" => "[time]",
        ".last_measurement_id" => "[id]", ".last_created_at" => "[time]", ".version" => "[version]",
    });
}

#[test]
fn probes_and_counters_answer() {
    let (service, _folder) = start();
    assert_eq!(service.get("/health/live").expect(200), json!({"status": "ok"}));
    assert_eq!(service.get("/health/ready").expect(200), json!({"status": "ok"}));
    service.post("/v1/measurements", &exact_csv()).expect(201);
    let text = service.get("/metrics").text();
    for line in [
        r#"coaxis_measurements_total{method="cylinder",verdict="accepted"} 1"#,
        r#"coaxis_http_requests_total{method="POST",route="/v1/measurements",status="201"} 1"#,
        &format!("coaxis_http_received_body_bytes_total {}", exact_csv().len()),
        "coaxis_measurements_running 0",
        "coaxis_measurements_queued 0",
    ] {
        assert!(text.contains(line), "{line} is missing in\n{text}");
    }
}

#[test]
fn a_request_under_way_is_finished_when_the_service_shuts_down() {
    let (service, _folder) = start();
    let body = exact_csv();
    let (first, second) = body.split_at(body.len() / 2);
    let mut stream = service.connect();
    let head = format!(
        "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: {}\r\nExpect: 100-continue\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).expect("sent");
    // The service reads the body once it asks for it.
    let mut go_on = [0; b"HTTP/1.1 100 Continue\r\n\r\n".len()];
    stream.read_exact(&mut go_on).expect("asked for the body");
    stream.write_all(first).expect("sent");
    service.begin_to_stop();
    stream.write_all(second).expect("still listening");
    assert!(rest(&mut stream).starts_with("HTTP/1.1 201 "));
    service.wait();
}

#[test]
fn acknowledged_records_exist_after_a_restart() {
    let folder = Folder::new();
    let path = "/v1/measurements?request_id=before";
    let service = start_on(&folder, |_| {});
    let measurement = service.post(path, &exact_csv()).expect(201);
    let instance = service.get("/v1/status").expect(200)["instance_id"].clone();
    service.put("/v1/recipes/a", &[], &json!({"points_min": 33})).expect(201);
    service.stop();

    let service = start_on(&folder, |_| {});
    let id = measurement["id"].as_str().expect("an id");
    assert_eq!(service.get(&format!("/v1/measurements/{id}")).expect(200), measurement);
    assert_eq!(service.post(path, &exact_csv()).expect(200), measurement);
    assert_eq!(service.get("/v1/recipes/a").expect(200)["recipe"], json!({"points_min": 33}));
    let status = service.get("/v1/status").expect(200);
    assert_eq!(status["last_measurement_id"], id);
    assert_ne!(status["instance_id"], instance);
}

#[test]
fn a_valid_request_id_is_kept_and_any_other_is_replaced() {
    let (service, _folder) = start();
    let given = service.get_with("/v1/status", &[("x-request-id", "line-7.42")]);
    assert_eq!(given.header("x-request-id"), "line-7.42");
    for odd in ["two words", &"a".repeat(200), ""] {
        let answer = service.get_with("/v1/nothing", &[("x-request-id", odd)]);
        let made = answer.problem(404, "route_unknown")["request_id"].clone();
        assert_eq!(made.as_str().expect("an id").len(), 36, "{made}");
    }
}

#[test]
fn no_address_redirects_and_every_wrong_method_lists_the_allowed_ones() {
    let (service, _folder) = start();
    for path in ["/v1/measurements/", "/docs/", "/", "/v2/status"] {
        service.get(path).problem(404, "route_unknown");
    }
    let answer = service.delete("/v1/measurements");
    answer.problem(405, "method_not_allowed");
    assert_eq!(answer.header("allow"), "POST,GET,HEAD");
    let post = service.post("/v1/status", b"");
    post.problem(405, "method_not_allowed");
    assert_json_snapshot!("method_not_allowed", post.json(), { ".request_id" => "[id]" });
}
