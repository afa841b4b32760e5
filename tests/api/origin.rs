//! The check of host and origin: requests from pages of other sites are refused, those from programs and from the
//! service's own pages are accepted.

use crate::api::bodies::exact_csv;
use crate::api::harness::{Answer, start, start_with};
use crate::timed::cell::{FAST, Line, untouched};

const HOSTILE: &str = "http://attacker.example";

fn status(answer: &str) -> &str {
    answer.get(9..12).unwrap_or_default()
}

#[test]
fn a_page_of_another_site_reads_nothing_and_stops_and_moves_nothing() {
    let line = Line::ready(FAST);
    let service = &line.service;
    let lease = ("lease-id", line.lease.as_str());
    let json = ("content-type", "application/json");
    let body = br#"{"m1": {"y_mm": 1.0}}"#;
    for origin in [("origin", HOSTILE), ("origin", "null"), ("sec-fetch-site", "cross-site")] {
        service.post_with("/v1/cell/stop", &[origin], &[]).problem(403, "origin_foreign");
        service.post_with("/v1/moves", &[origin, lease, json], body).problem(403, "origin_foreign");
        service.post_with("/v1/measurements", &[origin], &exact_csv()).problem(403, "origin_foreign");
    }
    service.get_with("/v1/cell", &[("origin", HOSTILE)]).problem(403, "origin_foreign");
    assert_eq!(service.get("/v1/moves").expect(200)["moves"], serde_json::json!([]));
    let own = format!("http://{}", service.address);
    service.post_with("/v1/cell/stop", &[("origin", &own), ("sec-fetch-site", "same-origin")], &[]).expect(200);
    for path in ["/openapi.json", "/docs", "/docs/swagger-ui.css"] {
        assert_eq!(service.get_with(path, &[("origin", HOSTILE)]).status, 200, "{path}");
    }
}

#[test]
fn a_foreign_host_is_refused_unless_it_is_configured() {
    let (service, _folder) = start_with(|config| config.hosts = vec!["line3.example".to_owned()]);
    let ask = |host: &str| {
        service.raw(format!("GET /v1/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes())
    };
    for host in ["localhost", "localhost:8080", "127.0.0.1", "192.168.7.1:8080", "[::1]:8080", "line3.example"] {
        assert_eq!(status(&ask(host)), "200", "{host}");
    }
    let refused = ask("rebound.attacker.example:8080");
    assert!(
        status(&refused) == "421" && refused.contains("host_unknown") && refused.contains("COAXIS_HOSTS"),
        "{refused}"
    );
    let absolute =
        "GET http://rebound.attacker.example/v1/status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    assert_eq!(status(&service.raw(absolute.as_bytes())), "421");
}

#[test]
fn a_request_of_http_1_1_needs_a_host_and_one_of_http_1_0_does_not() {
    let (service, _folder) = start();
    let without = service.raw(b"GET /v1/status HTTP/1.1\r\nConnection: close\r\n\r\n");
    assert!(status(&without) == "400" && without.contains("host_invalid"), "{without}");
    let twice =
        service.raw(b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    assert_eq!(status(&twice), "400", "{twice}");
    assert_eq!(status(&service.raw(b"GET /v1/status HTTP/1.0\r\n\r\n")), "200");
}

#[test]
fn a_body_in_a_transfer_coding_other_than_chunks_is_refused() {
    let (service, folder) = start();
    let ask = |coding: &str, body: &str| {
        let head = "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nTransfer-Encoding:";
        service.raw(format!("{head} {coding}\r\n\r\n{body}").as_bytes())
    };
    assert_eq!(status(&ask("gzip", "1,2,3\n")), "400", "its end cannot be determined");
    let packed = ask("gzip, chunked", "6\r\n1,2,3\n\r\n0\r\n\r\n");
    assert!(status(&packed) == "501" && packed.contains("transfer_coding_unsupported"), "{packed}");
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn a_moving_command_accepts_only_json() {
    let line = Line::ready(FAST);
    let lease = ("lease-id", line.lease.as_str());
    let plain = ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"];
    for path in ["/v1/moves", "/v1/manipulators/m1/home", "/v1/manipulators/m1/enable", "/v1/cell/reset"] {
        for kind in plain {
            let answer = line.service.post_with(path, &[lease, ("content-type", kind)], br#"{"m1": {"y_mm": 1.0}}"#);
            answer.problem(415, "content_type_unsupported");
        }
    }
    // As text it is not an order but a scan, and not a valid one.
    let order = br#"{"source": "sensor"}"#;
    let answer = line.service.post_with("/v1/measurements", &[lease, ("content-type", "text/plain")], order);
    assert!((400..500).contains(&answer.status), "{}", answer.text());
    assert_eq!(line.service.get("/v1/measurements?state=scanning").expect(200)["measurements"], serde_json::json!([]));
}

#[test]
fn every_answer_forbids_content_sniffing_and_scripts() {
    let (service, _folder) = untouched(FAST);
    let measured = service.post("/v1/measurements", &exact_csv()).expect(201);
    let id = measured["id"].as_str().expect("an id");
    let paths = [
        "/v1/status",
        "/v1/cell",
        "/health/live",
        "/metrics",
        "/openapi.json",
        "/docs",
        "/docs/swagger-ui-bundle.js",
        "/nothing",
        "/v1/measurements?limit=x",
    ];
    let of_one =
        ["", "/profiles", "/plots/section.svg", "/plots/end_view.svg"].map(|end| format!("/v1/measurements/{id}{end}"));
    let check = |path: &str, answer: &Answer| {
        let policy = answer.header("content-security-policy");
        assert!(policy.contains("default-src 'none'") && policy.contains("frame-ancestors"), "{path}: {policy}");
        assert!(!policy.contains("script-src 'unsafe-inline'"), "{path}: {policy}");
        assert_eq!(answer.header("x-content-type-options"), "nosniff", "{path}");
        assert!(!answer.header("content-type").is_empty(), "{path}");
    };
    for path in paths.into_iter().chain(of_one.iter().map(String::as_str)) {
        check(path, &service.get(path));
    }
    let scan = measured["provenance"]["scan_id"].as_str().expect("a scan");
    let content = service.get(&format!("/v1/scans/{scan}/content"));
    check("content", &content);
    assert!(content.header("content-disposition").starts_with("attachment"));
}
