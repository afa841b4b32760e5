//! A scan by the sensor's protocol, from the last profile on the wire to the answer: a simulated Gocator in this process
//! sends a synthetic part at a constant rate, the service receives it, and a client waits for the measurement. The benchmark prints
//! the time from the last profile to the answer, the share of a core that the service used while receiving profiles, the number of
//! lost profiles, and the difference between the pose and that of the same scan as a file.
//!
//!   cargo bench --bench sensor [-- PROGRAM]

#![expect(clippy::print_stdout, clippy::disallowed_methods, reason = "a benchmark prints and reads the clock")]

mod serving;

use coaxis::device::Pending;
use coaxis::device::gocator::codec::Identity;
use coaxis::device::gocator::server::{Form, ScanSource, Server, ServerSettings, Source, Taken, View, taken_from};
use coaxis::device::gocator::{Extrinsic, Settings, Travel};
use coaxis::scan::Scan;
use coaxis::scan::decode::Format;
use coaxis::scan::encode::encode;
use coaxis::scan::synthetic::{Part, make};
use serde_json::{Value, json};
use serving::{Folder, Outcome, Serving, program};
use std::collections::BTreeMap;
use std::fs;
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// Goal: ms from the last profile to the answer, if the sensor's final report of losses arrives at once.
const ANSWER_MS_MAX: f64 = 50.0;
/// The sensor's steps of 9 and 8 µm move the pose by a twentieth of its uncertainty from noise of 50 µm; five times that.
const SHARE_OF_UNCERTAINTY_MAX: f64 = 0.25;
const MM_PER_TICK: f64 = 0.001;
const X_FROM_MM: f64 = 200.0;
const LENGTH_MM: f64 = 400.0;
/// The stage arrives before the last profile, so that the measurement does not wait for it.
const STAGE_TIME_FACTOR: f64 = 20.0;
/// The sensor's health is read once a second between scans; before that, a further scan may be refused and has to be repeated.
const BETWEEN_SCANS: Duration = Duration::from_millis(1_200);
/// Unit of processor time in /proc.
const TICKS_PER_SECOND: f64 = 100.0;
const POSE: [&str; 5] = ["deflection_deg", "pitch_deg", "y_ref_mm", "z_ref_mm", "radius_mm"];

/// A repeated measurement.
struct Trial {
    profiles_count: usize,
    points_count: usize,
    rate_hz: f64,
    /// Period of the sensor's reports of losses; a complete scan waits for one.
    health_period: Duration,
    runs_count: usize,
}

const TRIALS: [Trial; 3] = [
    Trial {
        profiles_count: 400,
        points_count: 640,
        rate_hz: 400.0,
        health_period: Duration::from_millis(5),
        runs_count: 20,
    },
    Trial {
        profiles_count: 5000,
        points_count: 1280,
        rate_hz: 5000.0,
        health_period: Duration::from_millis(5),
        runs_count: 5,
    },
    Trial {
        profiles_count: 400,
        points_count: 640,
        rate_hz: 400.0,
        health_period: Duration::from_secs(1),
        runs_count: 5,
    },
];

fn main() -> Outcome<()> {
    let program = program();
    let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    println!(
        "| profiles x points, a second, health every | runs | answer after the last profile, ms: median, worst | \
              of which estimation, median | share of one core while they came | came in a second, least | lost | \
              pose, kept scan measured again | pose, file that was never sent |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for trial in &TRIALS {
        let line = Line::ready(trial, &program, &runtime)?;
        let mut runs = Vec::new();
        for _ in 0..trial.runs_count {
            thread::park_timeout(BETWEEN_SCANS);
            match line.run(trial) {
                Ok(run) => runs.push(run),
                Err(error) => println!("<!-- {error} -->"),
            }
        }
        report(trial, &runs);
    }
    println!(
        "\nGoals: answer within {ANSWER_MS_MAX} ms, less than 1 core, nothing lost, the pose of the kept scan the same \
              to the last bit, that of the file within {SHARE_OF_UNCERTAINTY_MAX} of its standard uncertainty (a twentieth \
              is what steps of 9 and 8 µm do beside 50 µm of noise)."
    );
    Ok(())
}

/// Results of one scan.
struct Run {
    answered_ms: f64,
    estimation_ms: f64,
    core_share: f64,
    rate_hz: f64,
    lost_count: u64,
    /// Largest difference between the pose and that of the stored scan after an upload, and that of the original scan, in
    /// standard uncertainties.
    kept_share: f64,
    made_share: f64,
}

/// The time of the first and last profile, and the processor time of the service at these moments.
#[derive(Debug, Clone, Copy, Default)]
struct Marks {
    service: Option<u32>,
    began: Option<(Instant, f64)>,
    sent: Option<(Instant, f64)>,
}

/// The profiles of a scan, with the time at which the last of them was sent.
struct Watched {
    inner: ScanSource,
    profiles_count: usize,
    taken_count: usize,
    marks: Arc<Mutex<Marks>>,
}

impl Watched {
    fn note(&self, place: fn(&mut Marks) -> &mut Option<(Instant, f64)>) {
        let mut marks = self.marks.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let cpu_s = marks.service.and_then(|service| cpu_s(service).ok()).unwrap_or(f64::NAN);
        *place(&mut marks) = Some((now, cpu_s));
    }
}

impl Source for Watched {
    fn begin(&mut self) {
        self.taken_count = 0;
        self.inner.begin();
        self.note(|marks| &mut marks.began);
    }

    /// The next profile is requested when the previous one is written.
    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>> {
        if self.taken_count == self.profiles_count {
            self.note(|marks| &mut marks.sent);
        }
        self.taken_count += 1;
        self.inner.next()
    }
}

/// Processor time that a process has used, s.
fn cpu_s(process: u32) -> Outcome<f64> {
    let text = fs::read_to_string(format!("/proc/{process}/stat"))?;
    let (_, fields) = text.rsplit_once(')').ok_or("no end of the name")?;
    let ticks = fields.split_whitespace().skip(11).take(2).map(str::parse::<f64>).sum::<Result<f64, _>>()?;
    Ok(ticks / TICKS_PER_SECOND)
}

/// A sensor, a service that receives its scans, and the lease.
struct Line {
    service: Serving,
    lease: String,
    marks: Arc<Mutex<Marks>>,
    /// The original scan, binary PLY.
    made: Vec<u8>,
    _sensor: Server,
    _folder: Folder,
}

impl Line {
    fn ready(trial: &Trial, program: &str, runtime: &Runtime) -> Outcome<Self> {
        let scan = part(trial)?;
        let mut made = Vec::new();
        encode(&scan, Format::Ply, &mut made)?;
        let marks = Arc::new(Mutex::new(Marks::default()));
        let sensor = sensor(trial, &scan, Arc::clone(&marks), runtime)?;
        let folder = Folder::new("sensor")?;
        let configuration = configuration(trial, &sensor, &folder)?;
        let configuration = configuration.to_str().ok_or("a path in plain text")?;
        let service = Serving::start(program, &folder.0.join("data"), &["--config", configuration])?;
        marks.lock().unwrap_or_else(PoisonError::into_inner).service = Some(service.child.id());
        let mut line = Self { service, lease: String::new(), marks, made, _sensor: sensor, _folder: folder };
        line.wait_until_idle()?;
        let lease = line.post("/v1/cell/lease", "application/json", br#"{"holder": "bench", "ttl_s": 60}"#)?;
        line.lease = lease.get("lease_id").and_then(Value::as_str).ok_or("no lease")?.to_owned();
        Ok(line)
    }

    /// Waits until every device answers.
    fn wait_until_idle(&self) -> Outcome<()> {
        for after in 0..100 {
            let cell = self.get("/v1/cell")?;
            let all_up = cell.get("devices").and_then(Value::as_array);
            let all_up = all_up.is_some_and(|all| all.iter().all(|device| device.get("link") == Some(&json!("up"))));
            if cell.get("state") == Some(&json!("idle")) && all_up {
                return Ok(());
            }
            self.get(&format!("/v1/events?after={after}&wait_s=1"))?;
        }
        Err(format!("the cell does not get ready: {}", self.get("/v1/cell")?).into())
    }

    fn run(&self, trial: &Trial) -> Outcome<Run> {
        let order = json!({"source": "sensor", "lease_id": self.lease, "profiles_count": trial.profiles_count});
        let begun = self.post("/v1/measurements", "application/json", order.to_string().as_bytes())?;
        let id = begun.get("id").and_then(Value::as_str).ok_or("no id")?;
        let measured = self.get(&format!("/v1/measurements/{id}?wait_s=50"))?;
        let answered = Instant::now();
        if measured.get("verdict") != Some(&json!("accepted")) {
            return Err(format!("not measured: {measured}").into());
        }
        let marks = *self.marks.lock().unwrap_or_else(PoisonError::into_inner);
        let ((began, cpu_before), (sent, cpu_after)) = marks.began.zip(marks.sent).ok_or("the sensor sent nothing")?;
        let came_s = sent.duration_since(began).as_secs_f64();
        let total_count = measured.pointer("/profiles/total_count").and_then(Value::as_u64).ok_or("no profiles")?;
        let scan_id = measured.pointer("/provenance/scan_id").and_then(Value::as_str).ok_or("no scan")?;
        let kept = self.bytes(&format!("/v1/scans/{scan_id}/content"))?;
        let again = |ply: &[u8]| self.post("/v1/measurements?format=ply", "application/octet-stream", ply);
        Ok(Run {
            answered_ms: answered.duration_since(sent).as_secs_f64() * 1e3,
            estimation_ms: measured.get("duration_ms").and_then(Value::as_f64).ok_or("no duration")?,
            core_share: (cpu_after - cpu_before) / came_s,
            rate_hz: trial.profiles_count as f64 / came_s,
            lost_count: (trial.profiles_count as u64).saturating_sub(total_count),
            kept_share: apart(&measured, &again(&kept)?)?,
            made_share: apart(&measured, &again(&self.made)?)?,
        })
    }

    fn get(&self, path: &str) -> Outcome<Value> {
        Ok(serde_json::from_slice(&self.bytes(path)?)?)
    }

    fn bytes(&self, path: &str) -> Outcome<Vec<u8>> {
        let mut answer = ureq::get(format!("http://{}{path}", self.service.address)).call()?;
        Ok(answer.body_mut().with_config().limit(u64::MAX).read_to_vec()?)
    }

    fn post(&self, path: &str, kind: &str, body: &[u8]) -> Outcome<Value> {
        let request = ureq::post(format!("http://{}{path}", self.service.address));
        let request = request.header("content-type", kind);
        let mut answer = request.config().http_status_as_error(false).build().send(body)?;
        let text = answer.body_mut().with_config().limit(u64::MAX).read_to_vec()?;
        if !answer.status().is_success() {
            return Err(format!("{path}: {}", String::from_utf8_lossy(&text)).into());
        }
        Ok(serde_json::from_slice(&text)?)
    }
}

/// Largest difference of two poses, in standard uncertainties.
fn apart(one: &Value, other: &Value) -> Outcome<f64> {
    let mut largest: f64 = 0.0;
    for field in POSE {
        let number = |document: &Value, part: &str| {
            let pointer = format!("{part}/{field}");
            document.pointer(&pointer).and_then(Value::as_f64).ok_or(format!("no {pointer}"))
        };
        let difference = number(one, "/pose")? - number(other, "/pose")?;
        largest = largest.max(difference.abs() / number(one, "/uncertainty/standard")?);
    }
    Ok(largest)
}

fn part(trial: &Trial) -> Outcome<Scan> {
    let part = Part {
        profiles_count: trial.profiles_count,
        points_count: trial.points_count,
        x_start_mm: X_FROM_MM,
        length_mm: LENGTH_MM,
        ..Part::with_interference(1)
    };
    Ok(make(&part)?.0)
}

/// The mounting that transforms the sensor's data to the rail frame: above the part, its X to rail Y.
fn above() -> Extrinsic {
    Extrinsic {
        sensor_x: [0.0, 1.0, 0.0],
        sensor_y: [1.0, 0.0, 0.0],
        sensor_z: [0.0, 0.0, 1.0],
        mirrored: true,
        translation_mm: [0.0; 3],
    }
}

fn sensor(trial: &Trial, scan: &Scan, marks: Arc<Mutex<Marks>>, runtime: &Runtime) -> Outcome<Server> {
    let taken =
        taken_from(scan, &above().place()?, MM_PER_TICK, trial.rate_hz).ok_or("profiles out of their planes")?;
    let view = View::reaching(&taken, Form::PointCloud, LENGTH_MM / trial.profiles_count as f64);
    let settings = ServerSettings {
        listen: IpAddr::V4(Ipv4Addr::LOCALHOST),
        control_port: 0,
        data_port: 0,
        health_port: 0,
        identity: Identity { serial: 1, model: "Gocator simulated".to_owned(), firmware: [4, 0, 0, 0] },
        view,
        health_period: trial.health_period,
    };
    let profiles_count = taken.len();
    let inner = ScanSource::new(taken, Some(trial.rate_hz));
    let source = Watched { inner, profiles_count, taken_count: 0, marks };
    Ok(runtime.block_on(Server::bind(settings, Box::new(source)))?)
}

/// The service's configuration: this sensor, and simulated devices otherwise.
fn configuration(trial: &Trial, sensor: &Server, folder: &Folder) -> Outcome<PathBuf> {
    let ports = sensor.ports();
    let settings = Settings {
        host: Ipv4Addr::LOCALHOST.to_string(),
        control_port: ports.control,
        data_port: ports.data,
        health_port: ports.health,
        travel: Some(Travel::Encoder { mm_per_tick: MM_PER_TICK, start_mm: X_FROM_MM, zero_ticks: None }),
        extrinsic: Some(above()),
        ..Settings::default()
    };
    let section =
        toml::to_string(&BTreeMap::from([("gocator", settings)]))?.replace("[gocator", "[cell.sensor.gocator");
    let text = format!(
        "[cell]\nsimulated_beside_real = true\n\n[cell.scan]\nx_from_mm = {X_FROM_MM:?}\nx_to_mm = {:?}\n\
         speed_mm_s = 200.0\nprofiles_count = {}\n\n[cell.simulated]\ntime_factor = {STAGE_TIME_FACTOR:?}\n\n\
         [cell.sensor]\nadaptor = \"gocator\"\n\n{section}",
        X_FROM_MM + LENGTH_MM,
        trial.profiles_count
    );
    let path = folder.0.join("coaxis.toml");
    fs::write(&path, text)?;
    Ok(path)
}

fn report(trial: &Trial, runs: &[Run]) {
    let sorted = |of: fn(&Run) -> f64| {
        let mut values: Vec<f64> = runs.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        move |share: f64| values.get(((values.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN)
    };
    let (answered, estimation) = (sorted(|run| run.answered_ms), sorted(|run| run.estimation_ms));
    let (core, rate) = (sorted(|run| run.core_share), sorted(|run| run.rate_hz));
    let (kept, made) = (sorted(|run| run.kept_share), sorted(|run| run.made_share));
    println!(
        "| {} x {}, {:.0}, {} ms | {} of {} | {:.1}, {:.1} | {:.0} | {:.2} | {:.0} | {} | {} | {:.3} |",
        trial.profiles_count,
        trial.points_count,
        trial.rate_hz,
        trial.health_period.as_millis(),
        runs.len(),
        trial.runs_count,
        answered(0.5),
        answered(1.0),
        estimation(0.5),
        core(1.0),
        rate(0.0),
        runs.iter().map(|run| run.lost_count).sum::<u64>(),
        kept(1.0),
        made(1.0)
    );
}
