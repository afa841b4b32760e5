//! `coaxis simulate gocator`: a sensor that is none, to try a cell or another client against. On every start it sends the
//! profiles of a scan file or of a synthetic part.

use super::{Outcome, print};
use crate::device::gocator::codec::Identity;
use crate::device::gocator::server::{Form, ScanSource, Server, ServerSettings, Taken, View, taken_from};
use crate::device::gocator::{Deadlines, Extrinsic, Settings, Travel};
use crate::device::simulated::StageSettings;
use crate::scan::Scan;
use crate::scan::decode::{Encoding, FormatClaims, Limits, Request, Sent, decode, find_format, inflate};
use crate::scan::slice::{SliceRequest, slice};
use crate::scan::synthetic::{Part, make};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

const SERIAL: u32 = 40_959;
/// Above what a scan file needs that one reads with.
const READ_BLOCK_BYTES: usize = 256 * 1024;

/// Be a Gocator sensor on the network until interrupted; it sends a scan at every start
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Address to listen on
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    listen: IpAddr,
    /// Port of the control channel; 0 takes any
    #[arg(long, value_name = "PORT", default_value_t = 3190)]
    control_port: u16,
    /// Port of the data channel; 0 takes any
    #[arg(long, value_name = "PORT", default_value_t = 3196)]
    data_port: u16,
    /// Port of the health channel; 0 takes any
    #[arg(long, value_name = "PORT", default_value_t = 3194)]
    health_port: u16,
    /// Scan file to send; without one, a synthetic part with screw holes, straight holes and clamps
    #[arg(long, value_name = "FILE")]
    scan: Option<PathBuf>,
    /// The same seed makes the same part
    #[arg(long, default_value_t = 1, conflicts_with = "scan")]
    seed: u64,
    /// Profiles a second
    #[arg(long, value_name = "HZ", default_value_t = 200.0)]
    rate_hz: f64,
    /// Output: `point_cloud`, `uniform` or `surface`
    #[arg(long, value_name = "FORM", default_value = "point_cloud", value_parser = form)]
    form: Form,
    /// Travel for one tick of its encoder
    #[arg(long, value_name = "MM", default_value_t = 0.001)]
    mm_per_tick: f64,
}

fn form(text: &str) -> Result<Form, String> {
    match text {
        "point_cloud" => Ok(Form::PointCloud),
        "uniform" => Ok(Form::Uniform),
        "surface" => Ok(Form::Surface),
        _ => Err("say point_cloud, uniform or surface".to_owned()),
    }
}

pub(super) fn run(arguments: &Arguments) -> Outcome {
    arguments.check()?;
    let scan = arguments.scan()?;
    let taken = taken_from(&scan, &above().place()?, arguments.mm_per_tick, arguments.rate_hz)
        .ok_or("the mounting does not keep profiles in planes")?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve(arguments, &scan, taken))?;
    Ok(ExitCode::SUCCESS)
}

async fn serve(arguments: &Arguments, scan: &Scan, taken: Vec<Taken>) -> Result<(), Box<dyn Error>> {
    let profiles_count = taken.len();
    let settings = arguments.server(scan, &taken);
    let source = ScanSource::new(taken, Some(arguments.rate_hz));
    let listening = Server::bind(settings, Box::new(source)).await;
    let server = listening.map_err(|error| format!("cannot listen on {}: {error}", arguments.listen))?;
    print(&arguments.greeting(&server, scan, profiles_count)?)?;
    tokio::select! {
        () = server.serve() => Err("a channel could not be kept open".into()),
        interrupted = tokio::signal::ctrl_c() => Ok(interrupted?),
    }
}

/// The mounting that makes a scan in the rail frame from what the sensor sees: above the part, its X to rail Y.
fn above() -> Extrinsic {
    Extrinsic {
        sensor_x: [0.0, 1.0, 0.0],
        sensor_y: [1.0, 0.0, 0.0],
        sensor_z: [0.0, 0.0, 1.0],
        mirrored: true,
        translation_mm: [0.0; 3],
    }
}

impl Arguments {
    fn check(&self) -> Result<(), String> {
        for (name, value, least, most) in
            [("rate-hz", self.rate_hz, 0.1, 10_000.0), ("mm-per-tick", self.mm_per_tick, 1e-6, 10.0)]
        {
            if !(least..=most).contains(&value) {
                return Err(format!("{name} must be between {least} and {most}, got {value}"));
            }
        }
        Ok(())
    }

    fn scan(&self) -> Result<Scan, Box<dyn Error>> {
        match &self.scan {
            Some(path) => read(path).map_err(|error| format!("{}: {error}", path.display()).into()),
            None => Ok(make(&Part::with_interference(self.seed))?.0),
        }
    }

    fn server(&self, scan: &Scan, taken: &[Taken]) -> ServerSettings {
        let view = View { serial: SERIAL, ..View::reaching(taken, self.form, step_mm(scan)) };
        ServerSettings {
            listen: self.listen,
            control_port: self.control_port,
            data_port: self.data_port,
            health_port: self.health_port,
            identity: Identity { serial: SERIAL, model: "Gocator simulated".to_owned(), firmware: [4, 0, 0, 0] },
            view,
            health_period: Duration::from_secs(1),
        }
    }

    /// The deadlines that the rate needs: a surface comes after all of its profiles, and slow profiles come one by one.
    fn deadlines(&self, profiles_count: usize) -> Deadlines {
        let usual = Deadlines::default();
        let periods_ms = |count: f64| (count * 1000.0 / self.rate_hz).ceil() as u32;
        let until_first = if self.form == Form::Surface { profiles_count as f64 } else { 1.0 };
        Deadlines {
            first_profile_ms: usual.first_profile_ms.saturating_add(periods_ms(until_first)),
            next_profile_ms: usual.next_profile_ms.saturating_add(periods_ms(1.0)),
            ..usual
        }
    }

    /// Where it listens, and the settings that turn what it sends into the scan again.
    fn greeting(&self, server: &Server, scan: &Scan, profiles_count: usize) -> Result<String, Box<dyn Error>> {
        let ports = server.ports();
        let start_mm = scan.stations().first().map_or(0.0, |station| station.x);
        let settings = Settings {
            host: self.listen.to_string(),
            control_port: ports.control,
            data_port: ports.data,
            health_port: ports.health,
            travel: Some(Travel::Encoder { mm_per_tick: self.mm_per_tick, start_mm, zero_ticks: None }),
            extrinsic: Some(above()),
            deadlines: self.deadlines(profiles_count),
            ..Settings::default()
        };
        let sensor = BTreeMap::from([("gocator", toml::Value::try_from(settings)?), ("adaptor", "gocator".into())]);
        let end_mm = scan.stations().last().map_or(start_mm, |station| station.x);
        // From first to last profile in the time that so many take, but no faster than the simulated stage goes.
        let seconds = profiles_count.saturating_sub(1).max(1) as f64 / self.rate_hz;
        let speed_mm_s = ((end_mm - start_mm).abs() / seconds).min(StageSettings::default().speed_mm_s);
        let way = BTreeMap::from([
            ("x_from_mm", toml::Value::from(start_mm)),
            ("x_to_mm", end_mm.into()),
            ("profiles_count", i64::try_from(profiles_count)?.into()),
            ("speed_mm_s", speed_mm_s.into()),
        ]);
        let cell = BTreeMap::from([
            ("simulated_beside_real", true.into()),
            ("sensor", toml::Value::try_from(sensor)?),
            ("scan", toml::Value::try_from(way)?),
        ]);
        let document = toml::to_string(&BTreeMap::from([("cell", cell)]))?;
        Ok(format!(
            "# {profiles_count} profiles at every start; the configuration of a service that takes them.\n\
             # simulated_beside_real lets it stand beside the simulated stage and manipulators.\n\
             {document}"
        ))
    }
}

/// Middle of the steps between profiles, mm.
fn step_mm(scan: &Scan) -> f64 {
    let (first, last) = (scan.stations().first(), scan.stations().last());
    let length_mm = last.zip(first).map_or(0.0, |(last, first)| last.x - first.x);
    length_mm / scan.stations().len().saturating_sub(1).max(1) as f64
}

fn read(path: &Path) -> Result<Scan, Box<dyn Error>> {
    let limits = Limits::default();
    let mut packed = BufReader::with_capacity(READ_BLOCK_BYTES, File::open(path)?);
    let encoding = Encoding::sniff(packed.fill_buf()?);
    let sent = Sent::default();
    let mut bytes: Box<dyn BufRead> = match encoding {
        Some(encoding) => {
            Box::new(BufReader::with_capacity(READ_BLOCK_BYTES, inflate(encoding, packed, &limits, &sent)?))
        }
        None => Box::new(packed),
    };
    let file_name = path.file_name().and_then(|name| name.to_str());
    let claims = FormatClaims { file_name, ..FormatClaims::default() };
    let format = find_format(&claims, bytes.fill_buf()?)?;
    let request = Request { sent: encoding.is_some().then_some(&sent), ..Request::new(&limits) };
    let cloud = decode(format, &mut bytes, &request)?;
    Ok(slice(cloud, &SliceRequest::default(), &limits)?)
}
