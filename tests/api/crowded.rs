//! More clients than there are places: stop, health checks and the lease holder get through, no client takes all places,
//! and slow clients are disconnected.

use crate::api::bodies::{exact_csv, large_npy};
use crate::api::harness::{Running, rest, start, start_with};
use crate::timed::cell::{FAST, Line};
use coaxis::config::Config;
use std::io::{Read, Write};
use std::net::TcpStream;

/// Places of the services here; one of them is occupied by the client that the harness keeps connected.
const GENERAL: usize = 4;
const RESERVED: usize = 2;

fn few_places(config: &mut Config) {
    config.limits.connections_max = GENERAL as u64;
    config.limits.connections_reserved = RESERVED as u64;
    config.limits.peer_share_percent = 100;
}

const SILENT: &[u8] = b"";
const HALF_A_HEAD: &[u8] = b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Never";
const TRICKLING: &[u8] = b"POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n1,2,3\n";

/// Connections that send this and then nothing, more than there are places of any kind.
fn crowd(service: &Running, bytes: &[u8]) -> Vec<TcpStream> {
    let mut crowd = Vec::new();
    for _ in 0..GENERAL + 3 * RESERVED {
        let mut stream = service.connect();
        // A connection that was displaced meanwhile is closed.
        let _ = stream.write_all(bytes);
        crowd.push(stream);
    }
    until(service, "all places are taken", |service| {
        service.counter("coaxis_connections{place=\"general\"}") >= GENERAL as f64
    });
    crowd
}

/// Retries until the condition is true, a bounded number of times; waiting for events, which are rare here, serves as the pause.
fn until(service: &Running, what: &str, so: impl Fn(&Running) -> bool) {
    let mut after = 0;
    for _ in 0..30 {
        if so(service) {
            return;
        }
        let events = service.get(&format!("/v1/events?after={after}&wait_s=1")).expect(200);
        after = events["newest"].as_u64().expect("a number");
    }
    panic!("{what}: it does not come to that");
}

fn ask(service: &Running, request_line: &str, header: &str) -> String {
    service.raw(format!("{request_line} HTTP/1.1\r\nHost: localhost\r\n{header}\r\n").as_bytes())
}

#[test]
fn stop_health_and_the_lease_holder_get_through_while_all_places_are_occupied() {
    let line = Line::ready_with(FAST, few_places);
    let service = &line.service;
    let lease = format!("Lease-Id: {}\r\n", line.lease);
    for bytes in [SILENT, HALF_A_HEAD, TRICKLING] {
        let crowd = crowd(service, bytes);
        for _ in 0..10 {
            let stopped = ask(service, "POST /v1/cell/stop", "");
            assert!(stopped.starts_with("HTTP/1.1 200 ") && stopped.contains("unconfirmed_axes"), "{stopped}");
            assert!(stopped.to_ascii_lowercase().contains("connection: close"), "{stopped}");
        }
        for (request_line, header) in [
            ("GET /health/live", ""),
            ("GET /health/ready", ""),
            ("GET /v1/cell", lease.as_str()),
            (&format!("POST /v1/cell/lease?lease_id={}", line.lease), ""),
        ] {
            let answer = ask(service, request_line, header);
            assert!(answer.starts_with("HTTP/1.1 200 "), "{request_line}: {answer}");
        }
        for (request_line, header) in [
            ("GET /v1/cell", ""),
            ("GET /v1/cell", "Lease-Id: l-00000000-0000-7000-8000-000000000000\r\n"),
            ("GET /v1/cell/stop", ""),
            ("POST /v1/measurements", "Content-Length: 100000\r\n"),
        ] {
            let answer = ask(service, request_line, header);
            assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("\"busy\""), "{request_line}: {answer}");
            assert!(answer.contains("retry-after: 1"), "{answer}");
        }
        drop(crowd);
        until(service, "the places are free again", |service| {
            service.counter("coaxis_connections{place=\"general\"}") < 2.0
        });
    }
    assert!(ask(service, "GET /v1/cell", "Connection: close\r\n").starts_with("HTTP/1.1 200 "));
}

#[test]
fn a_client_that_does_not_read_its_answer_loses_its_connection() {
    let (service, _folder) = start_with(|config| config.timeouts.response_idle_ms = 200);
    let scan = service.post("/v1/scans", &large_npy()).expect(201);
    let path = format!("/v1/scans/{}/content", scan["id"].as_str().expect("an id"));
    let request = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n");
    // More answers than fit into the buffers of the operating system.
    let never_reads: Vec<_> = (0..8)
        .map(|_| {
            let mut stream = service.connect();
            stream.write_all(request.repeat(20).as_bytes()).expect("sent");
            stream
        })
        .collect();
    until(&service, "they are closed", |service| service.counter("coaxis_connections{place=\"general\"}") < 2.0);
    drop(never_reads);
    let mut reads = service.connect();
    reads.write_all(request.replace("\r\n\r\n", "\r\nConnection: close\r\n\r\n").as_bytes()).expect("sent");
    let mut answer = Vec::new();
    reads.read_to_end(&mut answer).expect("an answer");
    assert!(answer.len() > large_npy().len(), "one that reads gets all of it: {}", answer.len());
}

#[test]
fn one_address_gets_its_share_of_the_connections_and_the_others_still_find_places() {
    let (service, _folder) = start_with(|config| config.limits.connections_max = 8);
    service.get("/v1/status").expect(200);
    let crowd: Vec<_> = (0..8).map(|_| service.connect()).collect();
    until(&service, "the share is taken", |service| service.counter("coaxis_connections{place=\"reserved\"}") >= 4.0);
    let request = b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let refused = service.raw(request);
    assert!(refused.starts_with("HTTP/1.1 503 ") && refused.contains("\"peer_share_percent\":50"), "{refused}");
    let mut other = service.connect_from([127, 0, 0, 2]);
    other.write_all(request).expect("sent");
    assert!(rest(&mut other).starts_with("HTTP/1.1 200 "));
    drop(crowd);
}

#[test]
fn one_address_gets_its_share_of_the_uploads_and_of_the_waits() {
    let (service, folder) = start_with(|config| {
        config.limits.uploads_max = 2;
        config.limits.listeners_max = 2;
    });
    let body = exact_csv();
    let upload = |path: &str| {
        let length = body.len();
        format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n")
    };
    let mut slow = service.connect();
    slow.write_all(upload("/v1/scans").as_bytes()).expect("sent");
    slow.write_all(&body[..100]).expect("sent");
    while folder.scan_files_count() == 0 {
        service.get("/v1/status").expect(200);
    }
    assert_eq!(service.post("/v1/scans", &body).problem(503, "busy")["uploads_max_count"], 1);
    let mut other = service.connect_from([127, 0, 0, 2]);
    other.write_all(&[upload("/v1/measurements").as_bytes(), &body].concat()).expect("sent");
    let answer = rest(&mut other);
    assert!(answer.starts_with("HTTP/1.1 201 "), "{answer}");
    slow.write_all(&body[100..]).expect("sent");
    assert!(rest(&mut slow).starts_with("HTTP/1.1 2"));

    let listen = b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\nAccept: text/event-stream\r\n\r\n";
    let listens = |mut stream: TcpStream| {
        stream.write_all(listen).expect("sent");
        let mut status = [0; 12];
        stream.read_exact(&mut status).expect("an answer");
        (stream, String::from_utf8_lossy(&status).into_owned())
    };
    let (_first, status) = listens(service.connect());
    assert_eq!(status, "HTTP/1.1 200");
    service.get("/v1/events?after=0&wait_s=1").problem(503, "busy");
    assert_eq!(listens(service.connect_from([127, 0, 0, 2])).1, "HTTP/1.1 200");
}

#[test]
fn places_and_disk_space_are_counted() {
    let (service, _folder) = start();
    service.post("/v1/scans", &exact_csv()).expect(201);
    assert_eq!(service.counter("coaxis_connections{place=\"general\"}"), 1.0);
    assert_eq!(service.counter("coaxis_connections_max{place=\"reserved\"}"), 128.0);
    assert_eq!(service.counter("coaxis_uploads"), 0.0);
    assert_eq!((service.counter("coaxis_listeners"), service.counter("coaxis_listeners_max")), (0.0, 200.0));
    assert!(service.counter("coaxis_database_bytes") >= 4096.0);
    let (free, total) = (service.counter("coaxis_disk_free_bytes"), service.counter("coaxis_disk_total_bytes"));
    assert!(0.0 < free && free <= total, "{free} of {total}");
}
