//! Latency and memory of uploads and of the offline command: the time from the last byte of an upload to the answer, the time of
//! `coaxis measure` from start to pose, and the peak memory of both, each with its goal. Runs the release program like a user, or
//! another build whose path is given (`cargo bench --bench ways -- PROGRAM`); prints a table.
//!
//! All times are measured in turns in one run and printed as medians, because machines are shared and noisy. Files are in memory
//! (`/dev/shm`), so that no disk affects the results.

#![expect(clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark prints and reads the clock")]

mod serving;
mod yardstick;

use coaxis::estimation::{Method, Progress, Settings, estimate};
use coaxis::scan::Scan;
use coaxis::scan::decode::{Format, Limits, Request, decode};
use coaxis::scan::encode::encode;
use coaxis::scan::slice::{SliceRequest, slice};
use serving::{Folder, Outcome, Serving, program};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;
use yardstick::{POINTS_COUNT, PROFILES_COUNT, large_scan, median, narrowed, sum, timed};

const ROUNDS_COUNT: usize = 9;

/// Goal: sums from the last byte of an upload to the first byte of its answer.
const ANSWER_SUMS_MAX: f64 = 60.0;
/// Goal: `coaxis measure` relative to decoding plus estimation, and the allowance for starting a process, ms.
const OFFLINE_RATIO_MAX: f64 = 1.2;
const OFFLINE_START_MS: f64 = 30.0;
/// Goal: peak memory relative to the stored coordinates, and the allowance for the program, MiB.
const MEMORY_RATIO_MAX: f64 = 2.5;
const MEMORY_PROGRAM_MIB: f64 = 64.0;

/// Times of one round, ms.
#[derive(Debug, Clone, Copy)]
struct Round {
    sum: f64,
    decode: f64,
    estimate: f64,
    offline: f64,
    upload: Upload,
}

/// Times of an upload, ms.
#[derive(Debug, Clone, Copy)]
struct Upload {
    /// From the first to the last byte sent.
    sending: f64,
    /// From the last byte sent to the first byte of the answer.
    answering: f64,
}

fn main() -> Outcome<()> {
    let scan = narrowed(&large_scan()?)?;
    let mut bytes = Vec::new();
    encode(&scan, Format::Ply, &mut bytes)?;
    let folder = Folder::new("ways")?;
    let file = folder.0.join("scan.ply");
    fs::write(&file, &bytes)?;

    let program = program();
    let offline_mib = offline_memory(&program, &file)?;
    let service = Serving::start(&program, &folder.0.join("data"), &[])?;
    upload(&service, &bytes)?;
    let service_mib = peak_mib(service.child.id())?;
    let mut rounds = Vec::new();
    for number in 0..ROUNDS_COUNT {
        renew(&mut bytes, number)?;
        rounds.push(Round {
            sum: timed(|| sum(&scan)),
            decode: timed(|| decoded(&bytes)),
            estimate: timed(|| estimate(&scan, &settings(), &Progress::default())),
            offline: offline(&program, &file)?,
            upload: upload(&service, &bytes)?,
        });
    }
    report(&rounds, &scan, offline_mib, service_mib);
    println!("{:<56} {:>9.1} MiB", "serve, peak after all rounds", peak_mib(service.child.id())?);
    Ok(())
}

fn report(rounds: &[Round], scan: &Scan, offline_mib: f64, service_mib: f64) {
    let middle = |of: fn(&Round) -> f64| median(rounds.iter().map(of).collect());
    let (sum_ms, answering_ms) = (middle(|r| r.sum), middle(|r| r.upload.answering));
    let offline_max_ms = OFFLINE_RATIO_MAX * middle(|r| r.decode + r.estimate) + OFFLINE_START_MS;
    let memory_max_mib = MEMORY_RATIO_MAX * (scan.columns().len() * 8) as f64 / MIB + MEMORY_PROGRAM_MIB;
    println!("{PROFILES_COUNT} profiles x {POINTS_COUNT} points, {} threads", rayon::current_num_threads());
    println!("{:<56} {:>9} {:>9}", "", "median", "goal");
    let line = |name: &str, value: f64, goal: f64, unit: &str| println!("{name:<56} {value:>9.1} {goal:>9.1} {unit}");
    let plain = |name: &str, value: f64| println!("{name:<56} {value:>9.1} {:>9} ms", "");
    plain("sum", sum_ms);
    plain("decode", middle(|r| r.decode));
    plain("estimate cylinder", middle(|r| r.estimate));
    plain("upload, first to last byte sent", middle(|r| r.upload.sending));
    line("upload, last byte sent to first byte of the answer", answering_ms, ANSWER_SUMS_MAX * sum_ms, "ms");
    line("the same in sums (median of the ratios)", middle(|r| r.upload.answering / r.sum), ANSWER_SUMS_MAX, "sums");
    line("measure, process start to pose", middle(|r| r.offline), offline_max_ms, "ms");
    line("measure, peak", offline_mib, memory_max_mib, "MiB");
    line("serve, peak after the first upload", service_mib, memory_max_mib, "MiB");
}

fn settings() -> Settings {
    Settings { method: Method::Cylinder, ..Settings::default() }
}

fn decoded(bytes: &[u8]) -> Option<usize> {
    let limits = Limits::default();
    let request = Request::new(&limits);
    let cloud = decode(Format::Ply, &mut &*bytes, &request).ok()?;
    slice(cloud, &SliceRequest::default(), &limits).ok().map(|scan| scan.columns().len())
}

/// Changes the last bits of the last point, so that the scan was never sent before.
fn renew(bytes: &mut [u8], number: usize) -> Outcome<()> {
    let lowest = bytes.len().checked_sub(4).and_then(|at| bytes.get_mut(at)).ok_or("the scan is empty")?;
    *lowest = u8::try_from(number)?;
    Ok(())
}

fn measure_command(program: &str, file: &Path) -> Command {
    let mut command = Command::new(program);
    command.args(["measure", "--method", "cylinder"]).arg(file).stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

/// From the start of the process to its line with the pose, ms.
fn offline(program: &str, file: &Path) -> Outcome<f64> {
    let start = Instant::now();
    let mut child = measure_command(program, file).spawn()?;
    read_line(child.stdout.take())?;
    let taken = start.elapsed().as_secs_f64() * 1e3;
    child.wait()?;
    Ok(taken)
}

/// The peak memory of a process when it has printed its pose. It waits for a second scan meanwhile.
fn offline_memory(program: &str, file: &Path) -> Outcome<f64> {
    let mut child = measure_command(program, file).arg("-").stdin(Stdio::piped()).spawn()?;
    read_line(child.stdout.take())?;
    let peak = peak_mib(child.id())?;
    drop(child.stdin.take());
    child.wait()?;
    Ok(peak)
}

fn read_line(from: Option<impl Read>) -> Outcome<String> {
    let mut line = String::new();
    BufReader::new(from.ok_or("no output")?).read_line(&mut line)?;
    if line.contains("accepted") { Ok(line) } else { Err(format!("not measured: {line}").into()) }
}

const MIB: f64 = (1 << 20) as f64;

/// The peak memory of a process so far.
fn peak_mib(process_id: u32) -> Outcome<f64> {
    let status = fs::read_to_string(format!("/proc/{process_id}/status"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("no VmHWM")?;
    Ok(line.trim().trim_end_matches("kB").trim().parse::<f64>()? / 1024.0)
}

/// Sends a scan as fast as the service receives it.
fn upload(service: &Serving, bytes: &[u8]) -> Outcome<Upload> {
    let mut stream = TcpStream::connect(&service.address)?;
    stream.set_nodelay(true)?;
    let head = format!(
        "POST /v1/measurements?method=cylinder HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/x-ply\r\n\
         Content-Length: {}\r\nConnection: close\r\n\r\n",
        bytes.len()
    );
    let start = Instant::now();
    stream.write_all(head.as_bytes())?;
    stream.write_all(bytes)?;
    let sent = Instant::now();
    let mut first = [0];
    stream.read_exact(&mut first)?;
    let answered = Instant::now();
    let mut rest = String::new();
    stream.read_to_string(&mut rest)?;
    if !rest.starts_with("TTP/1.1 201 ") {
        return Err(format!("not measured: {rest}").into());
    }
    let milliseconds = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
    Ok(Upload { sending: milliseconds(start, sent), answering: milliseconds(sent, answered) })
}
