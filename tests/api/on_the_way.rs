//! Large uploads, which are decoded while they are received: the results equal those of a stored scan, whatever the client does
//! during the upload.

use crate::api::bodies::{encoded, exact_csv, gzip, large_npy};
use crate::api::harness::{Folder, Running, rest, start, start_with};
use coaxis::estimation::{Method, Progress, Settings};
use coaxis::http::MeasurementDocument;
use coaxis::scan::decode::{Format, Limits};
use coaxis::scan::synthetic::Part;
use coaxis::service::{Origin, Recipe, measure_offline};
use serde_json::{Value, json};
use std::io::Write;
use std::net::TcpStream;

/// Enough bytes for decoding to begin: a few of the blocks in which uploads are read.
const BEGUN_BYTES: usize = 700_000;

/// Begins to send a measurement; returns the rest of the body.
fn begin<'a>(service: &Running, body: &'a [u8], header: &str) -> (TcpStream, &'a [u8]) {
    let mut stream = service.connect();
    let head = format!(
        "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\n{header}Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let (first, second) = body.split_at(BEGUN_BYTES);
    stream.write_all(&[head.as_bytes(), first].concat()).expect("sent");
    (stream, second)
}

/// A large table.
fn large_csv() -> Vec<u8> {
    let body = encoded(&Part { profiles_count: 100, ..Part::with_interference(3) }, Format::Csv);
    assert!(body.len() > 2 * BEGUN_BYTES, "{}", body.len());
    body
}

/// A large scan that compression hardly reduces.
fn large_packed() -> Vec<u8> {
    let body = gzip(&large_npy());
    assert!(body.len() > 2 * BEGUN_BYTES, "{}", body.len());
    body
}

/// Waits until all files of the upload are deleted.
fn wait_until_empty(service: &Running, folder: &Folder) {
    while folder.scan_files_count() > 0 {
        service.get("/v1/status").expect(200);
    }
}

/// All calculated values to the last digit: numbers are written so that they are read back bit for bit.
fn calculated(measurement: &Value) -> String {
    ["method", "pose", "uncertainty", "conditioning", "profiles", "residuals", "refusal"]
        .map(|part| format!("{part}: {}\n", measurement[part]))
        .concat()
}

#[test]
fn upload_stored_scan_and_offline_call_give_the_same_bits_with_every_method() {
    let (service, _folder) = start();
    for (format, part) in [(Format::Ply, Part::with_interference(3)), (Format::Csv, Part::with_interference(4))] {
        let body = encoded(&part, format);
        assert!(body.len() > BEGUN_BYTES);
        for method in Method::ALL {
            let path = format!("/v1/measurements?method={}", method.name());
            let uploaded = service.post(&path, &body).expect(201);
            let packed = service.post(&path, &gzip(&body)).expect(201);
            let order = json!({"scan_id": uploaded["provenance"]["scan_id"], "method": method.name()});
            let kept = service.post_json("/v1/measurements", &order).expect(201);
            let recipe = Recipe { method: Some(method), ..Recipe::default() };
            let resolved = recipe.resolve(&Settings::default()).expect("a recipe");
            let (limits, progress) = (Limits::default(), Progress::default());
            let offline = measure_offline(Box::new(body.as_slice()), &Origin::default(), &resolved, &limits, &progress);
            let offline = MeasurementDocument::from(&offline.expect("measured").measurement);
            let offline = serde_json::to_value(offline).expect("JSON");
            for other in [&packed, &kept, &offline] {
                assert_eq!(calculated(&uploaded), calculated(other), "{format} {}", method.name());
                assert_eq!(uploaded["provenance"]["scan_sha256"], other["provenance"]["scan_sha256"]);
            }
        }
    }
}

#[test]
fn invalid_bytes_are_reported_after_the_upload_is_complete_and_leave_nothing_behind() {
    let (service, folder) = start();
    let mut body = large_csv();
    let wrong = body[..BEGUN_BYTES].iter().rposition(|byte| *byte == b'\n').expect("lines") + 1;
    body[wrong] = b'?';
    let line = body[..wrong].iter().filter(|byte| **byte == b'\n').count() + 1;
    let refused = service.post("/v1/measurements", &body).problem(422, "number_invalid");
    assert_eq!(refused["line"], line);
    assert_eq!(service.post("/v1/scans", &gzip(&body)).problem(422, "number_invalid")["line"], line);
    // Damage of the compression is reported before errors of the bytes, which were decompressed until then.
    let mut packed = large_packed();
    let middle = packed.len() / 2;
    packed.truncate(middle);
    service.post("/v1/measurements", &packed).problem(422, "compression_invalid");
    assert_eq!(folder.scan_files_count(), 0);
    service.post("/v1/measurements", &exact_csv()).expect(201);
}

#[test]
fn an_upload_whose_client_disconnects_leaves_nothing_behind() {
    let (service, folder) = start();
    for body in [large_csv(), large_packed()] {
        let (stream, _rest) = begin(&service, &body, "");
        drop(stream);
        wait_until_empty(&service, &folder);
    }
    assert_eq!(service.get("/v1/measurements").expect(200)["measurements"], json!([]));
}

#[test]
fn an_upload_that_stalls_is_refused_and_leaves_nothing_behind() {
    let (service, folder) = start_with(|config| config.timeouts.body_idle_ms = 50);
    for body in [large_csv(), large_packed()] {
        let (mut stream, _rest) = begin(&service, &body, "");
        let answer = rest(&mut stream);
        assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("\"idle_ms\":50"), "{answer}");
        assert_eq!(folder.scan_files_count(), 0);
    }
}

#[test]
fn a_body_that_turns_out_too_large_is_refused_during_the_upload() {
    let (service, folder) = start_with(|config| config.limits.body_bytes_max = 1_000_000);
    let body = large_csv();
    let head =
        "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n";
    let chunk = format!("{:x}\r\n", body.len());
    let answer = service.raw(&[head.as_bytes(), chunk.as_bytes(), &body, b"\r\n0\r\n\r\n"].concat());
    assert!(answer.starts_with("HTTP/1.1 413 ") && answer.contains("\"body_too_large\""), "{answer}");
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn an_answered_request_gets_the_same_answer_whatever_is_uploaded_again() {
    let (service, _folder) = start();
    let path = "/v1/measurements?request_id=large-1";
    let body = large_csv();
    let first = service.post(path, &body).expect(201);
    assert_eq!(service.post(path, &body).expect(200), first);
    assert_eq!(service.post(path, &gzip(&body)).expect(200), first);
    let mut other = body;
    other[BEGUN_BYTES] = b'?';
    service.post(path, &other).problem(422, "request_id_reused");
}

#[test]
fn more_slow_clients_than_readers_do_not_block_other_clients() {
    let (service, folder) = start_with(|config| {
        config.limits.measurements_running_max = 1;
        config.limits.threads = 1;
    });
    let (plain, packed) = (large_csv(), large_packed());
    let bodies = [&plain, &packed, &plain, &packed, &plain];
    let mut slow: Vec<_> = bodies.iter().map(|body| begin(&service, body, "")).collect();
    while folder.scan_files_count() < bodies.len() {
        service.get("/v1/status").expect(200);
    }
    let large = service.post("/v1/measurements", &large_npy()).expect(201);
    service.post("/v1/measurements", &exact_csv()).expect(201);
    service.get("/health/ready").expect(200);
    for (stream, rest) in &mut slow {
        stream.write_all(rest).expect("sent");
    }
    for ((stream, _), body) in slow.iter_mut().zip(bodies) {
        let answer = rest(stream);
        assert!(answer.starts_with("HTTP/1.1 201 "), "{answer}");
        let same = *body == packed;
        let digest = large["provenance"]["scan_sha256"].as_str().expect("a digest");
        assert_eq!(answer.contains(digest), same, "{answer}");
    }
    assert_eq!(folder.scan_files_count(), 3);
}
