//! Counters and gauges as text for Prometheus. Each service has its own recorder, so that two in one process do not mix.

use super::connections::ConnectionsCount;
use crate::service::{Load, Verdict};
use crate::store::Usage;
use axum::http::{Method, StatusCode};
use metrics::{Counter, Key, KeyName, Label, Level, Metadata, Recorder, SharedString, Unit};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};

const REQUESTS: &str = "coaxis_http_requests_total";
const REQUEST_SECONDS: &str = "coaxis_http_request_duration_seconds";
const BODY_BYTES: &str = "coaxis_http_received_body_bytes_total";
const MEASUREMENTS: &str = "coaxis_measurements_total";
const MEASUREMENT_SECONDS: &str = "coaxis_measurement_duration_seconds";
const RUNNING: &str = "coaxis_measurements_running";
const QUEUED: &str = "coaxis_measurements_queued";
const CELL_ALIVE: &str = "coaxis_cell_alive";
const CONNECTIONS: &str = "coaxis_connections";
const CONNECTIONS_MAX: &str = "coaxis_connections_max";
const CONNECTIONS_REFUSED: &str = "coaxis_connections_refused_total";
const UPLOADS: &str = "coaxis_uploads";
const UPLOADS_MAX: &str = "coaxis_uploads_max";
const MEMORY: &str = "coaxis_memory_admitted_bytes";
const MEMORY_MAX: &str = "coaxis_memory_admitted_bytes_max";
const LISTENERS: &str = "coaxis_listeners";
const LISTENERS_MAX: &str = "coaxis_listeners_max";
const DATABASE_BYTES: &str = "coaxis_database_bytes";
const DISK_FREE_BYTES: &str = "coaxis_disk_free_bytes";
const DISK_TOTAL_BYTES: &str = "coaxis_disk_total_bytes";

/// Upper bounds of the histogram buckets of durations, seconds.
const SECONDS: [f64; 12] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0, 30.0];

/// Methods with their own series. Clients could otherwise create any number of series.
const METHODS: [&str; 9] = ["GET", "POST", "PUT", "HEAD", "OPTIONS", "DELETE", "PATCH", "TRACE", "CONNECT"];

static METADATA: Metadata<'static> = Metadata::new("coaxis", Level::INFO, None);

/// Present values of the gauges.
#[derive(Debug, Clone, Copy)]
pub(in crate::http) struct Levels {
    /// Calculations.
    pub(in crate::http) load: Load,
    /// Whether the cell is alive, if there is one.
    pub(in crate::http) cell_alive: Option<bool>,
    /// Open connections.
    pub(in crate::http) connections: ConnectionsCount,
    /// Maximum of open connections: general and reserved ones.
    pub(in crate::http) connections_max: (u64, u64),
    /// Uploads under way, and their maximum.
    pub(in crate::http) uploads: (u64, u64),
    /// Memory reserved for points, and its maximum, bytes.
    pub(in crate::http) memory: (u64, u64),
    /// Waiting clients, and their maximum.
    pub(in crate::http) listeners: (u64, u64),
    /// Disk space, if it could be determined.
    pub(in crate::http) usage: Option<Usage>,
}

/// The service's counters.
pub(in crate::http) struct Metrics {
    recorder: PrometheusRecorder,
    handle: PrometheusHandle,
}

impl std::fmt::Debug for Metrics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Metrics")
    }
}

impl Metrics {
    /// All counters at zero.
    pub(in crate::http) fn new() -> Self {
        let builder = PrometheusBuilder::new();
        // This fails only for an empty list of bounds.
        let builder = match builder.set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &SECONDS) {
            Ok(builder) => builder,
            Err(_) => PrometheusBuilder::new(),
        };
        let recorder = builder.build_recorder();
        describe(&recorder);
        let handle = recorder.handle();
        Self { recorder, handle }
    }

    /// Counts an answered request.
    pub(in crate::http) fn answered(&self, method: &Method, route: &str, status: StatusCode, seconds: f64) {
        let method = Label::new("method", method_name(method));
        let route = Label::new("route", route.to_owned());
        let status = Label::new("status", status.as_str().to_owned());
        self.histogram(REQUEST_SECONDS, vec![method.clone(), route.clone()], seconds);
        self.add(REQUESTS, vec![method, route, status], 1);
    }

    /// Counts a received body, as sent.
    pub(in crate::http) fn received(&self, bytes_count: u64) {
        self.add(BODY_BYTES, Vec::new(), bytes_count);
    }

    /// Counts a recorded measurement.
    pub(in crate::http) fn measured(&self, verdict: Verdict, method: &'static str, seconds: f64) {
        self.histogram(MEASUREMENT_SECONDS, vec![Label::new("method", method)], seconds);
        self.add(MEASUREMENTS, vec![Label::new("method", method), Label::new("verdict", verdict.name())], 1);
    }

    /// All counters and the present gauges as text.
    pub(in crate::http) fn render(&self, levels: &Levels) -> String {
        if let Some(alive) = levels.cell_alive {
            self.set(CELL_ALIVE, u64::from(alive));
        }
        let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        self.set(RUNNING, wide(levels.load.running_count));
        self.set(QUEUED, wide(levels.load.queued_count));
        self.set_place(CONNECTIONS, "general", levels.connections.general);
        self.set_place(CONNECTIONS, "reserved", levels.connections.reserved);
        self.set_place(CONNECTIONS_MAX, "general", levels.connections_max.0);
        self.set_place(CONNECTIONS_MAX, "reserved", levels.connections_max.1);
        self.counter(CONNECTIONS_REFUSED, Vec::new()).absolute(levels.connections.refused);
        let places = [
            (UPLOADS, UPLOADS_MAX, levels.uploads),
            (LISTENERS, LISTENERS_MAX, levels.listeners),
            (MEMORY, MEMORY_MAX, levels.memory),
        ];
        for (name, name_max, (count, most)) in places {
            self.set(name, count);
            self.set(name_max, most);
        }
        if let Some(Usage { database_bytes, disk_free_bytes, disk_total_bytes }) = levels.usage {
            self.set(DATABASE_BYTES, database_bytes);
            self.set(DISK_FREE_BYTES, disk_free_bytes);
            self.set(DISK_TOTAL_BYTES, disk_total_bytes);
        }
        self.handle.run_upkeep();
        self.handle.render()
    }

    fn add(&self, name: &'static str, labels: Vec<Label>, value: u64) {
        self.counter(name, labels).increment(value);
    }

    fn counter(&self, name: &'static str, labels: Vec<Label>) -> Counter {
        self.recorder.register_counter(&Key::from_parts(name, labels), &METADATA)
    }

    fn histogram(&self, name: &'static str, labels: Vec<Label>, value: f64) {
        self.recorder.register_histogram(&Key::from_parts(name, labels), &METADATA).record(value);
    }

    fn set(&self, name: &'static str, value: u64) {
        self.set_labelled(name, Vec::new(), value);
    }

    fn set_place(&self, name: &'static str, place: &'static str, value: u64) {
        self.set_labelled(name, vec![Label::new("place", place)], value);
    }

    fn set_labelled(&self, name: &'static str, labels: Vec<Label>, value: u64) {
        // Exact up to 2^53, which is 9 PB.
        self.recorder.register_gauge(&Key::from_parts(name, labels), &METADATA).set(value as f64);
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
    counter(CONNECTIONS_REFUSED, "Connections that were closed because every reserved place was being answered.");
    let gauge = |name, help| recorder.describe_gauge(KeyName::from_const_str(name), None, text(help));
    gauge(RUNNING, "Calculations that run.");
    gauge(QUEUED, "Calculations that wait for their turn.");
    gauge(CELL_ALIVE, "1 while the cell takes requests, else 0.");
    gauge(CONNECTIONS, "Connections that are open; reserved ones are used when a client finds no general one.");
    gauge(CONNECTIONS_MAX, "Connections that may be open.");
    gauge(UPLOADS, "Scans that are coming in.");
    gauge(UPLOADS_MAX, "Scans that may come in at a time.");
    gauge(LISTENERS, "Event streams and requests that wait for an end.");
    gauge(LISTENERS_MAX, "Event streams and requests that may wait at a time.");
    let bytes = |name, help| {
        recorder.describe_gauge(KeyName::from_const_str(name), Some(Unit::Bytes), text(help));
    };
    bytes(DATABASE_BYTES, "Size of the database with its write-ahead log.");
    bytes(DISK_FREE_BYTES, "Free space on the disk of the data folder that the service may use.");
    bytes(DISK_TOTAL_BYTES, "Size of the disk of the data folder.");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn levels(cell_alive: Option<bool>) -> Levels {
        Levels {
            load: Load { running_count: 1, queued_count: 0 },
            cell_alive,
            connections: ConnectionsCount { general: 7, reserved: 2, refused: 3 },
            connections_max: (512, 32),
            uploads: (4, 128),
            listeners: (5, 200),
            memory: (1 << 20, 1 << 32),
            usage: Some(Usage { database_bytes: 4096, disk_free_bytes: 1 << 40, disk_total_bytes: 1 << 41 }),
        }
    }

    #[test]
    fn places_and_disk_space_are_reported_with_their_maximum() {
        let text = Metrics::new().render(&levels(None));
        for line in [
            r#"coaxis_connections{place="general"} 7"#,
            r#"coaxis_connections{place="reserved"} 2"#,
            r#"coaxis_connections_max{place="general"} 512"#,
            "coaxis_connections_refused_total 3",
            "coaxis_uploads 4",
            "coaxis_uploads_max 128",
            "coaxis_listeners 5",
            "coaxis_memory_admitted_bytes 1048576",
            "coaxis_memory_admitted_bytes_max 4294967296",
            "coaxis_database_bytes 4096",
            "coaxis_disk_free_bytes 1099511627776",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is missing in\n{text}");
        }
    }

    #[test]
    fn counters_are_reported_with_their_labels() {
        let metrics = Metrics::new();
        metrics.answered(&Method::GET, "/v1/status", StatusCode::OK, 0.002);
        metrics.measured(Verdict::Refused, "section_line", 0.02);
        let text = metrics.render(&levels(Some(false)));
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
    fn unknown_methods_share_one_series() {
        let metrics = Metrics::new();
        for number in 0..100 {
            let invented = Method::from_bytes(format!("METHOD{number}").as_bytes()).expect("a token");
            metrics.answered(&invented, "none", StatusCode::NOT_FOUND, 0.001);
        }
        let text = metrics.render(&levels(None));
        assert!(!text.contains("METHOD") && !text.contains("coaxis_cell_alive 0"), "{text}");
        assert!(text.contains(r#"coaxis_http_requests_total{method="other",route="none",status="404"} 100"#), "{text}");
    }
}
