//! What is counted, as text for Prometheus. A recorder of its own: two services in one process do not mix. Must not know
//! how anything is done.

use crate::service::{Load, Verdict};
use axum::http::{Method, StatusCode};
use metrics::{Key, KeyName, Label, Level, Metadata, Recorder, SharedString, Unit};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};

const REQUESTS: &str = "coaxis_http_requests_total";
const REQUEST_SECONDS: &str = "coaxis_http_request_duration_seconds";
const BODY_BYTES: &str = "coaxis_http_received_body_bytes_total";
const MEASUREMENTS: &str = "coaxis_measurements_total";
const MEASUREMENT_SECONDS: &str = "coaxis_measurement_duration_seconds";
const RUNNING: &str = "coaxis_measurements_running";
const QUEUED: &str = "coaxis_measurements_queued";
const CELL_ALIVE: &str = "coaxis_cell_alive";

/// Upper bounds of the buckets of a duration, seconds.
const SECONDS: [f64; 12] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0, 30.0];

/// Methods that have a series of their own. A client may invent others without end.
const METHODS: [&str; 9] = ["GET", "POST", "PUT", "HEAD", "OPTIONS", "DELETE", "PATCH", "TRACE", "CONNECT"];

static METADATA: Metadata<'static> = Metadata::new("coaxis", Level::INFO, None);

/// The service's counters.
pub(super) struct Metrics {
    recorder: PrometheusRecorder,
    handle: PrometheusHandle,
}

impl std::fmt::Debug for Metrics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Metrics")
    }
}

impl Metrics {
    /// All at zero.
    pub(super) fn new() -> Self {
        let builder = PrometheusBuilder::new();
        // Refused only for an empty list of bounds.
        let builder = match builder.set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &SECONDS) {
            Ok(builder) => builder,
            Err(_) => PrometheusBuilder::new(),
        };
        let recorder = builder.build_recorder();
        describe(&recorder);
        let handle = recorder.handle();
        Self { recorder, handle }
    }

    /// A request was answered.
    pub(super) fn answered(&self, method: &Method, route: &str, status: StatusCode, seconds: f64) {
        let method = Label::new("method", method_name(method));
        let route = Label::new("route", route.to_owned());
        let status = Label::new("status", status.as_str().to_owned());
        self.histogram(REQUEST_SECONDS, vec![method.clone(), route.clone()], seconds);
        self.add(REQUESTS, vec![method, route, status], 1);
    }

    /// A body was received, as sent.
    pub(super) fn received(&self, bytes_count: u64) {
        self.add(BODY_BYTES, Vec::new(), bytes_count);
    }

    /// A measurement was recorded.
    pub(super) fn measured(&self, verdict: Verdict, method: &'static str, seconds: f64) {
        self.histogram(MEASUREMENT_SECONDS, vec![Label::new("method", method)], seconds);
        self.add(MEASUREMENTS, vec![Label::new("method", method), Label::new("verdict", verdict.name())], 1);
    }

    /// Everything as text, with what runs and waits at this moment, and whether the cell lives, where there is one.
    pub(super) fn render(&self, load: Load, cell_alive: Option<bool>) -> String {
        if let Some(alive) = cell_alive {
            self.set(CELL_ALIVE, usize::from(alive));
        }
        self.set(RUNNING, load.running_count);
        self.set(QUEUED, load.queued_count);
        self.handle.run_upkeep();
        self.handle.render()
    }

    fn add(&self, name: &'static str, labels: Vec<Label>, value: u64) {
        self.recorder.register_counter(&Key::from_parts(name, labels), &METADATA).increment(value);
    }

    fn histogram(&self, name: &'static str, labels: Vec<Label>, value: f64) {
        self.recorder.register_histogram(&Key::from_parts(name, labels), &METADATA).record(value);
    }

    fn set(&self, name: &'static str, value: usize) {
        // A few calculations; every such number is a whole f64.
        let value = u32::try_from(value).map_or(f64::INFINITY, f64::from);
        self.recorder.register_gauge(&Key::from_name(name), &METADATA).set(value);
    }
}

fn method_name(method: &Method) -> &'static str {
    METHODS.into_iter().find(|name| *name == method.as_str()).unwrap_or("other")
}

fn describe(recorder: &PrometheusRecorder) {
    let text = |text: &'static str| SharedString::const_str(text);
    let counter = |name, help| recorder.describe_counter(KeyName::from_const_str(name), None, text(help));
    counter(REQUESTS, "Requests answered, by method, route and status.");
    counter(BODY_BYTES, "Bytes of scans received, as sent.");
    counter(MEASUREMENTS, "Measurements recorded, by method and verdict.");
    let seconds =
        |name, help| recorder.describe_histogram(KeyName::from_const_str(name), Some(Unit::Seconds), text(help));
    seconds(REQUEST_SECONDS, "From the header lines of a request to its answer.");
    seconds(MEASUREMENT_SECONDS, "From the beginning of the reading to the end of the calculation.");
    recorder.describe_gauge(KeyName::from_const_str(RUNNING), None, text("Calculations that run."));
    recorder.describe_gauge(KeyName::from_const_str(QUEUED), None, text("Calculations that wait for their turn."));
    recorder.describe_gauge(
        KeyName::from_const_str(CELL_ALIVE),
        None,
        text("1 while the cell takes requests, else 0."),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_counted_is_told_with_its_labels() {
        let metrics = Metrics::new();
        metrics.answered(&Method::GET, "/v1/status", StatusCode::OK, 0.002);
        metrics.measured(Verdict::Refused, "section_line", 0.02);
        let text = metrics.render(Load { running_count: 1, queued_count: 0 }, Some(false));
        for line in [
            r#"coaxis_http_requests_total{method="GET",route="/v1/status",status="200"} 1"#,
            r#"coaxis_measurements_total{method="section_line",verdict="refused"} 1"#,
            "coaxis_measurements_running 1",
            "coaxis_cell_alive 0",
            r#"coaxis_http_request_duration_seconds_bucket{method="GET",route="/v1/status",le="0.0025"} 1"#,
        ] {
            assert!(text.contains(line), "{line} is missing in\n{text}");
        }
    }

    #[test]
    fn methods_that_clients_invent_share_one_series() {
        let metrics = Metrics::new();
        for number in 0..100 {
            let invented = Method::from_bytes(format!("METHOD{number}").as_bytes()).expect("a token");
            metrics.answered(&invented, "none", StatusCode::NOT_FOUND, 0.001);
        }
        let text = metrics.render(Load { running_count: 0, queued_count: 0 }, None);
        assert!(!text.contains("METHOD") && !text.contains("coaxis_cell_alive 0"), "{text}");
        assert!(text.contains(r#"coaxis_http_requests_total{method="other",route="none",status="404"} 100"#), "{text}");
    }
}
