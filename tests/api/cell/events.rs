//! Events: numbered without a gap, by polling and as a stream, with the same content and both resumable.

use super::{FAST, Line};
use crate::api::harness::{Folder, Running, start_on, start_with};
use coaxis::config::Config;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::time::Duration;

/// The events of a stream up to one named `last`.
fn stream(service: &Running, resume: Option<&str>, last: &str) -> Vec<Value> {
    let mut stream = service.connect();
    let resume = resume.map(|id| format!("Last-Event-ID: {id}\r\n")).unwrap_or_default();
    write!(stream, "GET /v1/events HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\n{resume}\r\n")
        .expect("sent");
    let mut events = Vec::new();
    let mut lines = BufReader::new(stream).lines().map(|line| line.expect("text"));
    let head: Vec<String> = lines.by_ref().take_while(|line| !line.is_empty()).collect();
    assert!(
        head.iter().any(|line| line.eq_ignore_ascii_case("content-type: text/event-stream; charset=utf-8")),
        "{head:?}"
    );
    for line in lines {
        if let Some(data) = line.strip_prefix("data: ") {
            events.push(serde_json::from_str::<Value>(data).expect("JSON"));
        }
        if line == format!("event: {last}") {
            break;
        }
    }
    events
}

fn polled(line: &Line, after: u64) -> Vec<Value> {
    let list = line.service.get(&format!("/v1/events?after={after}")).expect(200);
    list["events"].as_array().expect("events").clone()
}

fn instance(service: &Running) -> String {
    service.get("/v1/status").expect(200)["instance_id"].as_str().expect("an id").to_owned()
}

fn moved(line: &Line) {
    let begun = line.post("/v1/moves", &json!({"m1": {"y_mm": 4.0}, "m2": {"y_mm": 4.0}})).expect(201);
    assert_eq!(line.wait_for(&begun)["state"], "done");
}

#[test]
fn polling_returns_events_in_order_and_continues_after_a_number() {
    let line = Line::ready(FAST);
    moved(&line);
    let measured = line.measure();
    let events = polled(&line, 0);
    let numbers: Vec<_> = events.iter().map(|event| event["number"].as_u64().expect("a number")).collect();
    assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>());
    let position =
        |name: &str| events.iter().position(|event| event["event"] == name).unwrap_or_else(|| panic!("{name}"));
    let order =
        ["link_up", "lease_taken", "manual_done", "job_started", "job_ended", "job_progress", "measured"].map(position);
    assert!(order.is_sorted(), "{order:?}");
    assert_eq!(events[order[4]]["state"], "done");
    assert_eq!((&events[order[5]]["job_id"], &events[order[6]]["job_id"]), (&measured["id"], &measured["id"]));
    assert_eq!(events[order[6]]["verdict"], "accepted");
    assert_eq!(polled(&line, 3)[0]["number"], 4);
    let foreign = line.service.get("/v1/events?after=100000").expect(200);
    assert!(foreign["missed_count"].as_u64() >= Some(1) && foreign["events"][0]["number"] == 1);
}

#[test]
fn a_wait_for_an_event_ends_when_there_is_one() {
    let line = Line::ready(FAST);
    let newest = line.service.get("/v1/events?after=0").expect(200)["newest"].as_u64().expect("a number");
    let path = format!("/v1/events?after={newest}&wait_s=30");
    let told = std::thread::scope(|scope| {
        let waiting = scope.spawn(|| line.service.get(&path).expect(200));
        line.service.post("/v1/cell/stop", &[]).expect(200);
        waiting.join().expect("an answer")
    });
    assert_eq!(told["events"][0]["number"], newest + 1);
    line.service.get("/v1/events?wait_s=61").problem(400, "query_invalid");
    line.service.get("/v1/events?after=9223372036854775808").problem(400, "query_invalid");
    line.service.get_with("/v1/events", &[("last-event-id", "x")]).problem(400, "request_header_invalid");
    line.service.get_with("/v1/events", &[("accept", "image/png")]).problem(406, "not_acceptable");
}

#[test]
fn a_number_of_another_instance_is_reported_once_and_listeners_are_counted() {
    let (service, _folder) = start_with(|config| config.limits.listeners_max = 1);
    let mut stream = service.connect();
    stream.set_read_timeout(Some(Duration::from_secs(1))).expect("a timeout");
    write!(
        stream,
        "GET /v1/events HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\nLast-Event-ID: 5\r\n\r\n"
    )
    .expect("sent");
    // No event occurs within the timeout of the read: the stream waits.
    let lines: Vec<_> = BufReader::new(&stream).lines().map_while(Result::ok).take(1000).collect();
    assert_eq!(lines.iter().filter(|line| *line == "event: missed").count(), 1, "{} lines", lines.len());
    service.get("/v1/events?after=0&wait_s=1").problem(503, "busy");
    service.get("/v1/events?after=0").expect(200);
}

#[test]
fn the_stream_has_the_events_of_polling_and_continues_after_the_last_id() {
    let line = Line::ready(FAST);
    moved(&line);
    let (all, polled) = (stream(&line.service, None, "job_ended"), polled(&line, 0));
    assert!(!all.is_empty() && all == polled[..all.len()]);
    let resumed = stream(&line.service, Some(&format!("{}:2", instance(&line.service))), "job_ended");
    assert_eq!(resumed, all[2..]);
    // A browser that reconnects to the same address sends its last id in the header.
    let header = format!("{}:3", instance(&line.service));
    let later = line.service.get_with("/v1/events?after=1", &[("last-event-id", &header)]).expect(200);
    assert_eq!(later["events"][0]["number"], 4);
}

/// The id of the newest event of a stream when the stream reaches `number`.
fn told_id(service: &Running, number: u64) -> String {
    let mut stream = service.connect();
    write!(stream, "GET /v1/events HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\n\r\n").expect("sent");
    let mut lines = BufReader::new(stream).lines().map(|line| line.expect("text"));
    let ids = lines.by_ref().filter_map(|line| line.strip_prefix("id: ").map(str::to_owned));
    ids.into_iter().find(|id| id.ends_with(&format!(":{number}"))).expect("an id")
}

/// Both instances count from 1, so a number of the first also exists in the second, for a different event.
#[test]
fn resuming_after_an_event_from_before_a_restart_reports_missed_events() {
    let folder = Folder::new();
    let cell = |config: &mut Config| {
        config.cell.enabled = true;
        config.cell.simulated.time_factor = FAST;
    };
    let first = start_on(&folder, cell);
    let (id, before) = (told_id(&first, 2), instance(&first));
    first.stop();
    let second = start_on(&folder, cell);
    super::until(&second, "/v1/events", |list| list["newest"].as_u64() >= Some(3));
    for resumed in [id.as_str(), "2"] {
        let told = stream(&second, Some(resumed), "state_changed");
        assert!(told[0]["missed_count"].as_u64() >= Some(1), "{resumed}: {told:?}");
        assert_eq!(told[1]["number"], 1, "{resumed}");
    }
    let polled = |instance: &str| second.get(&format!("/v1/events?after=2&instance_id={instance}")).expect(200);
    let foreign = polled(&before);
    assert!(foreign["missed_count"].as_u64() >= Some(1) && foreign["events"][0]["number"] == 1, "{foreign}");
    let own = polled(&instance(&second));
    assert_eq!((&own["missed_count"], &own["events"][0]["number"]), (&json!(0), &json!(3)));
}
