//! Latency of a stop to every device while the service is fully loaded: two clients measure large scans
//! without a pause, and two hundred connections are idle. Prints the percentiles of a thousand stops, as measured by the
//! client and by the service, with the goal.
//!
//!   cargo bench --bench stop [-- PROGRAM]

#![expect(clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark prints and reads the clock")]

mod serving;

use coaxis::scan::decode::Format;
use coaxis::scan::encode::encode;
use coaxis::scan::synthetic::{Part, make};
use serde_json::Value;
use serving::{Folder, Outcome, Serving, program};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

const PROFILES_COUNT: usize = 5000;
const POINTS_COUNT: usize = 1280;
const STOPS_COUNT: usize = 1000;
const MEASURING_COUNT: usize = 2;
const IDLE_COUNT: usize = 200;
/// The service ends idle connections after ten seconds; they are opened again before.
const IDLE_FOR: Duration = Duration::from_secs(8);
/// Goal: ms from the request to "stop sent to every device" at the 99th percentile.
const STOP_MS_MAX: f64 = 50.0;

fn main() -> Outcome<()> {
    let mut scan = Vec::new();
    let part = Part { profiles_count: PROFILES_COUNT, points_count: POINTS_COUNT, ..Part::with_interference(1) };
    encode(&make(&part)?.0, Format::Ply, &mut scan)?;
    let folder = Folder::new("stop")?;
    let service = Serving::start(&program(), &folder.0.join("data"), &[])?;
    let (ended, measured_count) = (AtomicBool::new(false), AtomicU64::new(0));
    let (address, bytes) = (service.address.as_str(), scan.as_slice());
    let stops = thread::scope(|scope| {
        for _ in 0..MEASURING_COUNT {
            scope.spawn(|| measure_until(&ended, address, bytes, &measured_count));
        }
        scope.spawn(|| idle_until(&ended, address));
        let stops = stop_often(address, &measured_count).map_err(|error| error.to_string());
        ended.store(true, Ordering::Relaxed);
        stops
    })?;
    report(&stops, measured_count.load(Ordering::Relaxed));
    Ok(())
}

/// Times of one stop, ms.
struct Stop {
    /// From the first byte of the request to the last of the answer.
    answered: f64,
    /// From its arrival until it was sent to every device, as reported by the service.
    sent: f64,
}

fn stop_often(address: &str, measured_count: &AtomicU64) -> Outcome<Vec<Stop>> {
    // The stops begin when both clients are measuring.
    while measured_count.load(Ordering::Relaxed) < MEASURING_COUNT as u64 {
        thread::park_timeout(Duration::from_millis(10));
    }
    (0..STOPS_COUNT).map(|_| stop(address)).collect()
}

fn stop(address: &str) -> Outcome<Stop> {
    let start = Instant::now();
    let answer = exchange(
        address,
        b"POST /v1/cell/stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
        &[],
    )?;
    let answered = start.elapsed().as_secs_f64() * 1e3;
    let (head, body) = answer.split_once("\r\n\r\n").ok_or("no answer")?;
    if !head.starts_with("HTTP/1.1 200 ") {
        return Err(format!("not stopped: {answer}").into());
    }
    let sent = serde_json::from_str::<Value>(body)?.get("sent_ms").and_then(Value::as_f64).ok_or("no sent_ms")?;
    Ok(Stop { answered, sent })
}

fn measure_until(ended: &AtomicBool, address: &str, scan: &[u8], measured_count: &AtomicU64) {
    let head = format!(
        "POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/x-ply\r\nContent-Length: {}\r\n\
         Connection: close\r\n\r\n",
        scan.len()
    );
    while !ended.load(Ordering::Relaxed) {
        let answer = exchange(address, head.as_bytes(), scan).unwrap_or_default();
        measured_count.fetch_add(u64::from(answer.starts_with("HTTP/1.1 201 ")), Ordering::Relaxed);
    }
}

fn idle_until(ended: &AtomicBool, address: &str) {
    while !ended.load(Ordering::Relaxed) {
        let idle: Vec<_> = (0..IDLE_COUNT).map(|_| TcpStream::connect(address)).collect();
        let until = Instant::now() + IDLE_FOR;
        while Instant::now() < until && !ended.load(Ordering::Relaxed) {
            thread::park_timeout(Duration::from_millis(100));
        }
        drop(idle);
    }
}

fn exchange(address: &str, head: &[u8], body: &[u8]) -> Outcome<String> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    stream.write_all(head)?;
    stream.write_all(body)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer)
}

fn report(stops: &[Stop], measured_count: u64) {
    println!("{} stops, {measured_count} measurements meanwhile, {IDLE_COUNT} idle connections", stops.len());
    println!("{:<40} {:>8} {:>8} {:>8} {:>8}", "ms", "median", "99 %", "most", "goal");
    let line = |name: &str, of: fn(&Stop) -> f64, goal: &str| {
        let mut values: Vec<f64> = stops.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get(((values.len() - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN);
        println!("{name:<40} {:>8.2} {:>8.2} {:>8.2} {goal:>8}", at(0.5), at(0.99), at(1.0));
    };
    line("request to the end of the answer", |stop| stop.answered, &format!("{STOP_MS_MAX:.0}"));
    line("arrival to sent to every device", |stop| stop.sent, &format!("{STOP_MS_MAX:.0}"));
}
