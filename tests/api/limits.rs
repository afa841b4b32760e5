//! Requests that are too large or too slow are refused with the limit in the problem, and the service continues.

use crate::api::bodies::{exact_csv, gzip, large_npy};
use crate::api::harness::{BLOCKING_THREADS, rest, start, start_with};
use std::io::{Read, Write};
use std::sync::Barrier;
use std::time::Duration;

#[test]
fn an_announced_length_beyond_the_limit_is_refused_before_the_body_is_read() {
    let (service, folder) = start_with(|config| config.limits.body_bytes_max = 2000);
    let head =
        "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999999999\r\nConnection: close\r\n\r\n";
    let answer = service.raw(head.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 413 ") && answer.contains("\"announced_bytes\":999999999"), "{answer}");
    let refused = service.post("/v1/measurements", &exact_csv());
    assert_eq!(refused.problem(413, "body_too_large")["bytes_max"], 2000);
    let chunked =
        "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n";
    let mut bytes = chunked.as_bytes().to_vec();
    bytes.extend_from_slice(format!("{:x}\r\n{}\r\n0\r\n\r\n", 3000, "1".repeat(3000)).as_bytes());
    let answer = service.raw(&bytes);
    assert!(answer.contains("\"body_too_large\""), "{answer}");
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn a_client_with_expect_100_continue_gets_the_refusal_instead() {
    let (service, _folder) = start_with(|config| config.limits.body_bytes_max = 2000);
    let head = |length: usize| {
        format!(
            "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
        )
    };
    let answer = service.raw(head(5000).as_bytes());
    assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
    let mut stream = service.connect();
    let body = b"0,0,0\n".repeat(10);
    stream.write_all(head(body.len()).as_bytes()).expect("sent");
    let mut go_ahead = [0; 25];
    std::io::Read::read_exact(&mut stream, &mut go_ahead).expect("a go-ahead");
    assert_eq!(&go_ahead, b"HTTP/1.1 100 Continue\r\n\r\n");
    stream.write_all(&body).expect("sent");
    assert!(rest(&mut stream).starts_with("HTTP/1.1 201 "));
}

#[test]
fn slow_header_lines_end_the_connection() {
    let (service, _folder) = start_with(|config| config.timeouts.header_ms = 50);
    let answer = service.raw(b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Never");
    assert_eq!(answer, "", "closed without an answer");
    service.get("/v1/status").expect(200);
}

#[test]
fn a_slow_body_is_408_and_leaves_nothing_behind() {
    let head = "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\nConnection: close\r\n\r\n1,2,3\n";
    let (service, folder) = start_with(|config| {
        config.timeouts.body_idle_ms = 50;
        config.limits.bytes_per_s_min = 0;
    });
    let answer = service.raw(head.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("\"idle_ms\":50"), "{answer}");
    assert_eq!(folder.scan_files_count(), 0);
    let packed = head.replace("Connection", "Content-Encoding: gzip\r\nConnection");
    let answer = service.raw(packed.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("\"idle_ms\":50"), "{answer}");
    assert_eq!(folder.scan_files_count(), 0);
    let (service, _folder) = start_with(|config| config.timeouts.body_total_ms = 50);
    let answer = service.raw(head.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("\"total_ms\":50"), "{answer}");
}

#[test]
fn a_body_that_trickles_is_408_with_the_minimum_speed() {
    let (service, folder) = start_with(|config| {
        config.timeouts.body_idle_ms = 200;
        config.limits.bytes_per_s_min = 1000;
    });
    let mut stream = service.connect();
    let head = "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\nConnection: close\r\n\r\n";
    stream.write_all(head.as_bytes()).expect("sent");
    stream.set_read_timeout(Some(Duration::from_millis(20))).expect("a timeout");
    let mut answer = Vec::new();
    // A byte whenever no answer came for a moment: the pauses are far below the maximum pause.
    for _ in 0..500 {
        let mut piece = [0; 4096];
        match stream.read(&mut piece) {
            Ok(0) => break,
            Ok(count) => answer.extend_from_slice(&piece[..count]),
            Err(_) => drop(stream.write_all(b"1")),
        }
    }
    let answer = String::from_utf8_lossy(&answer);
    assert!(answer.starts_with("HTTP/1.1 408 ") && answer.contains("\"bytes_per_s_min\":1000"), "{answer}");
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn a_body_that_breaks_off_leaves_nothing_behind() {
    let (service, folder) = start();
    let mut stream = service.connect();
    let head = "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n1,2,3\n";
    stream.write_all(head.as_bytes()).expect("sent");
    stream.shutdown(std::net::Shutdown::Write).expect("half closed");
    rest(&mut stream);
    service.stop();
    assert_eq!(folder.scan_files_count(), 0);
}

#[test]
fn addresses_header_lines_and_json_have_a_maximum_length() {
    let (service, _folder) = start();
    let long = service.get(&format!("/v1/scans?cursor={}", "a".repeat(5000)));
    assert_eq!(long.problem(414, "url_too_long")["url_bytes_max"], 4096);
    let headers = service.get_with("/v1/scans", &[("x-long", &"a".repeat(17_000))]);
    assert_eq!(headers.problem(431, "headers_too_large")["header_bytes_max"], 16_384);
    let text = "a".repeat(70_000);
    let recipe = service.put("/v1/recipes/a", &[], &serde_json::json!({ "description": text }));
    assert_eq!(recipe.problem(413, "body_too_large")["bytes_max"], 65_536);
    let order = serde_json::json!({ "scan_id": text });
    service.post_json("/v1/measurements", &order).problem(413, "body_too_large");
}

#[test]
fn points_and_profiles_have_a_maximum_number() {
    let (service, _folder) = start_with(|config| config.scan.points_max = 700);
    assert_eq!(service.post("/v1/measurements", &exact_csv()).problem(413, "too_many_points")["points_max"], 700);
    let (service, _folder) = start_with(|config| config.scan.profiles_max = 11);
    assert_eq!(service.post("/v1/measurements", &exact_csv()).problem(413, "too_many_profiles")["profiles_max"], 11);
    let (service, _folder) = start_with(|config| config.scan.points_per_profile_max = 59);
    service.post("/v1/measurements", &exact_csv()).problem(413, "profile_too_long");
}

#[test]
fn a_full_queue_answers_busy_with_a_retry_time() {
    const CLIENTS: usize = 12;
    let (service, _folder) = start_with(|config| {
        config.limits.measurements_running_max = 1;
        config.limits.queue_max = 0;
    });
    let body = large_npy();
    let together = Barrier::new(CLIENTS);
    let answers: Vec<_> = std::thread::scope(|scope| {
        let ask = || {
            together.wait();
            service.post("/v1/measurements", &body)
        };
        let threads: Vec<_> = (0..CLIENTS).map(|_| scope.spawn(ask)).collect();
        threads.into_iter().map(|thread| thread.join().expect("answered")).collect()
    });
    assert!(answers.iter().any(|answer| answer.status == 201));
    let busy: Vec<_> = answers.iter().filter(|answer| answer.status != 201).collect();
    assert!(!busy.is_empty(), "twelve at once are more than one at a time");
    for answer in busy {
        assert_eq!(answer.problem(503, "busy")["running_max_count"], 1);
        assert_eq!(answer.header("retry-after"), "1");
    }
    service.post("/v1/measurements", &body).expect(201);
}

/// A matrix of z as half-precision numbers: two bytes per point, so that the length of the file suggests far fewer points.
fn height_map(rows: usize, columns: usize) -> Vec<u8> {
    // 42.0: a flat surface.
    half_precision(rows, columns, std::iter::repeat_n([0x40, 0x51], rows * columns).flatten())
}

/// A NumPy file of half-precision numbers.
fn half_precision(rows: usize, columns: usize, content: impl Iterator<Item = u8>) -> Vec<u8> {
    let header = format!("{{'descr': '<f2', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    let header = format!("{header:117}\n");
    let length = u16::try_from(header.len()).expect("short").to_le_bytes();
    [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes()].concat().into_iter().chain(content).collect()
}

/// An archive that decompresses to some fifty times its size, with repetitions so far apart that only a second
/// compression uses them.
fn packed_once() -> Vec<u8> {
    const PERIOD: usize = 96 << 10;
    const REPEATS: usize = 64;
    let noise = |place: usize| place.wrapping_mul(2_654_435_761).to_le_bytes()[3];
    let byte = |place: usize| if place.is_multiple_of(120) { noise(place % PERIOD) } else { 0 };
    let array = half_precision(PERIOD * REPEATS / 6, 3, (0..PERIOD * REPEATS).map(byte));
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("scan.npy", zip::write::SimpleFileOptions::default()).expect("begun");
    zip.write_all(&array).expect("memory takes it");
    zip.finish().expect("ended").into_inner()
}

#[test]
fn a_file_with_more_points_than_its_length_suggests_is_read() {
    let (service, _folder) = start();
    let body = height_map(400, 2000);
    let answer = service.post("/v1/measurements?format=npy&x_pitch_mm=1&y_pitch_mm=0.1", &body).expect(201);
    assert_eq!(answer["provenance"]["points_count"], 800_000);
    let text = String::from_utf8(service.get("/metrics").body).expect("text");
    assert!(text.contains("coaxis_memory_admitted_bytes 0"), "all of it is given back");
}

#[test]
fn the_memory_limit_of_points_limits_their_number() {
    let (service, _folder) = start_with(|config| config.limits.memory_max_mb = 1024);
    let body = height_map(2500, 2000);
    let refused = service.post("/v1/measurements?format=npy&x_pitch_mm=1&y_pitch_mm=0.1", &body);
    let points_max = refused.problem(413, "too_many_points")["points_max"].as_u64().expect("a number");
    assert!(
        (3_000_000..3_700_000).contains(&points_max),
        "{points_max}: 480 MiB at 128 bytes a point, and the profiles"
    );
}

#[test]
fn a_calculation_beyond_its_time_limit_is_stopped_and_reported() {
    let (service, _folder) = start_with(|config| {
        config.timeouts.calculation_ms = 10;
        config.limits.measurements_running_max = 1;
        config.limits.queue_max = 0;
    });
    let body = large_npy();
    let problem = service.post("/v1/measurements", &body).problem(422, "calculation_too_long");
    assert_eq!((problem["deadline_ms"].as_u64(), problem["retryable"].as_bool()), (Some(10), Some(false)));
    // Its place is free again soon, because the calculation was stopped.
    // A refusal takes a millisecond, so the attempts take seconds.
    let is_taken = |_| service.post("/v1/measurements", &exact_csv()).status != 503;
    assert!((0..10_000).any(is_taken), "the calculation goes on");
}

#[test]
fn the_ratio_of_a_doubly_compressed_body_refers_to_the_bytes_sent() {
    let (service, _folder) = start();
    let once = packed_once();
    let twice = zstd::encode_all(once.as_slice(), 19).expect("packed");
    assert!(twice.len() * 5 < once.len(), "{} of {}", twice.len(), once.len());
    let read = service.post("/v1/scans?format=npz", &once);
    assert!(matches!(read.status, 200 | 201), "{} {}", read.status, read.text());
    assert_eq!(service.post("/v1/scans?format=npz", &twice).problem(413, "inflate_ratio")["ratio_max"], 100);
}

/// The head of a compressed upload and the first half of its body, and the other half.
fn packed_upload() -> (Vec<u8>, Vec<u8>) {
    let body = gzip(&exact_csv());
    let (first, second) = body.split_at(body.len() / 2);
    let head = format!(
        "POST /v1/scans HTTP/1.1\r\nHost: localhost\r\nContent-Encoding: gzip\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    ([head.as_bytes(), first].concat(), second.to_vec())
}

#[test]
fn more_simultaneous_compressed_uploads_than_threads_are_all_received() {
    let (service, folder) = start();
    let (begin, end) = packed_upload();
    let mut streams: Vec<_> = (0..3 * BLOCKING_THREADS).map(|_| service.connect()).collect();
    for stream in &mut streams {
        stream.write_all(&begin).expect("sent");
    }
    service.get("/health/ready").expect(200);
    for stream in &mut streams {
        stream.write_all(&end).expect("sent");
    }
    for stream in &mut streams {
        let answer = rest(stream);
        assert!(answer.starts_with("HTTP/1.1 20"), "{answer}");
    }
    assert_eq!(folder.scan_files_count(), 1, "they are all the same scan");
}

#[test]
fn too_many_uploads_are_answered_busy_with_a_retry_time() {
    let (service, folder) = start_with(|config| config.limits.uploads_max = 1);
    let (begin, end) = packed_upload();
    let mut stream = service.connect();
    stream.write_all(&begin).expect("sent");
    while folder.scan_files_count() == 0 {
        service.get("/v1/status").expect(200);
    }
    let busy = service.post("/v1/scans", &exact_csv());
    assert_eq!(busy.problem(503, "busy")["uploads_max_count"], 1);
    assert_eq!(busy.header("retry-after"), "1");
    stream.write_all(&end).expect("sent");
    assert!(rest(&mut stream).starts_with("HTTP/1.1 201 "));
    service.post("/v1/scans", &exact_csv()).expect(200);
}
