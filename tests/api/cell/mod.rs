//! The cell as a client uses it: a service on simulated devices, prepared by requests. The truth is that of the simulated
//! part.

#![expect(clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "tests may fail")]

mod events;
mod health;
mod laser;
mod lease;
mod refusals;
mod repeated;
mod restart;
mod stop;
mod story;

use crate::api::harness::{Answer, Folder, Running, start_with};
use coaxis::config::Config;
use coaxis::geometry::AxisLine;
use serde_json::{Value, json};

/// Simulated seconds per second in tests that do not observe a motion.
pub(crate) const FAST: f64 = 50.0;
/// The speed of a real machine.
pub(crate) const REAL: f64 = 1.0;

/// A service with a simulated cell: the lease is taken and the manipulators are enabled; references may be missing.
pub(crate) struct Line {
    pub(crate) service: Running,
    pub(crate) lease: String,
    _folder: Folder,
}

/// A service with a simulated cell in its initial state.
pub(crate) fn untouched(time_factor: f64) -> (Running, Folder) {
    untouched_with(time_factor, |_| {})
}

pub(crate) fn untouched_with(time_factor: f64, change: impl FnOnce(&mut Config)) -> (Running, Folder) {
    let (service, folder) = start_with(|config| {
        config.cell.enabled = true;
        config.cell.simulated.time_factor = time_factor;
        change(config);
    });
    until(&service, "/v1/cell", |cell| cell["state"] == "idle" && all_up(cell));
    (service, folder)
}

/// Repeats a request until the answer is as expected.
pub(crate) fn until(service: &Running, path: &str, so: impl Fn(&Value) -> bool) -> Value {
    let mut after = 0;
    for _ in 0..60 {
        let answer = service.get(path).expect(200);
        if so(&answer) {
            return answer;
        }
        // The next attempt follows an event; this is a bounded wait, not a sleep.
        let events = service.get(&format!("/v1/events?after={after}&wait_s=1")).expect(200);
        after = events["newest"].as_u64().expect("a number");
    }
    panic!("{path} does not come to what is waited for: {}", service.get(path).text());
}

impl Line {
    pub(crate) fn ready(time_factor: f64) -> Self {
        Self::ready_with(time_factor, |_| {})
    }

    pub(crate) fn ready_with(time_factor: f64, change: impl FnOnce(&mut Config)) -> Self {
        let (service, folder) = untouched_with(time_factor, change);
        let lease = service.post_json("/v1/cell/lease", &json!({"holder": "test", "ttl_s": 60})).expect(201);
        let lease = lease["lease_id"].as_str().expect("an id").to_owned();
        let line = Self { service, lease, _folder: folder };
        for manipulator in ["m1", "m2"] {
            line.act(&format!("/v1/manipulators/{manipulator}/enable")).expect(200);
        }
        until(&line.service, "/v1/cell", |cell| {
            cell["reasons"].as_array().is_some_and(|reasons| reasons.iter().all(|one| one["code"] == "not_homed"))
        });
        line
    }

    /// A command without a body.
    pub(crate) fn act(&self, path: &str) -> Answer {
        self.service.post_with(path, &[("lease-id", &self.lease)], &[])
    }

    /// A JSON document, with the lease in the header.
    pub(crate) fn post(&self, path: &str, body: &Value) -> Answer {
        let headers = [("content-type", "application/json"), ("lease-id", self.lease.as_str())];
        self.service.post_with(path, &headers, body.to_string().as_bytes())
    }

    /// The move after its end.
    pub(crate) fn wait_for(&self, begun: &Value) -> Value {
        self.service.get(&format!("/v1/moves/{}?wait_s=50", id(begun))).expect(200)
    }

    /// An accepted measurement by the sensor after its end.
    pub(crate) fn measure(&self) -> Value {
        let begun = self.post("/v1/measurements", &json!({"source": "sensor"})).expect(201);
        assert_eq!((begun["state"].as_str(), &begun["verdict"]), (Some("scanning"), &Value::Null));
        let measured = self.service.get(&format!("/v1/measurements/{}?wait_s=50", id(&begun))).expect(200);
        assert_eq!(
            (measured["state"].as_str(), measured["verdict"].as_str()),
            (Some("done"), Some("accepted")),
            "{measured}"
        );
        measured
    }

    /// The true position of the part.
    pub(crate) fn truth(&self) -> AxisLine {
        self.service.world.as_ref().expect("a simulated cell").truth()
    }

    /// A move of some ten seconds at the speed of a real machine.
    pub(crate) fn long_move(&self) -> Value {
        let targets = json!({"m1": {"y_mm": 20.0}, "m2": {"y_mm": 20.0}, "speed_ratio": 0.1});
        self.post("/v1/moves", &targets).expect(201)
    }
}

/// Whether every device answers.
fn all_up(cell: &Value) -> bool {
    cell["devices"].as_array().is_some_and(|devices| devices.iter().all(|device| device["link"] == "up"))
}

pub(crate) fn id(document: &Value) -> &str {
    document["id"].as_str().expect("an id")
}

pub(crate) fn number(document: &Value, pointer: &str) -> f64 {
    document.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} in {document}"))
}
