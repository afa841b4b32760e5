//! Simulated devices on the network, for trying coaxis or another client: `coaxis simulate gocator` is a sensor that sends the
//! profiles of a scan file or of a synthetic part at every start; `coaxis simulate plc` is a PLC with two manipulators and a stage,
//! with a flag for each protocol.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;

#[cfg(feature = "opcua")]
use crate::device::States;
use crate::device::gocator::codec::Identity;
use crate::device::gocator::server::{Form, ScanSource, Server, ServerSettings, Taken, View, taken_from};
use crate::device::gocator::{Deadlines, Extrinsic, Settings, Travel};
use crate::device::modbus::{Layout, Plc, serve};
#[cfg(feature = "opcua")]
use crate::device::opcua;
use crate::device::simulated::{Controller, ControllerSettings, StageSettings};
#[cfg(feature = "opcua")]
use crate::motion::Pair;
use crate::motion::{Axes, AxisLimits};
use crate::scan::Scan;
use crate::scan::decode::{Encoding, FormatClaims, Limits, Request, Sent, decode, find_format, inflate};
use crate::scan::slice::{SliceRequest, slice};
use crate::scan::synthetic::{Part, make};

use super::output::{Outcome, print};

const SERIAL: u32 = 40_959;
/// Size of a block read from a scan file, larger than the header that a reader needs.
const READ_BLOCK_BYTES: usize = 256 * 1024;

/// Be a Gocator sensor on the network until interrupted; it sends a scan at every start
#[derive(Debug, clap::Args)]
pub(super) struct GocatorArguments {
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
        _ => Err("the value must be point_cloud, uniform or surface".to_owned()),
    }
}

pub(super) fn run_gocator(arguments: &GocatorArguments) -> Outcome {
    arguments.check()?;
    let scan = arguments.scan()?;
    let taken = taken_from(&scan, &above().place()?, arguments.mm_per_tick, arguments.rate_hz)
        .ok_or("the mounting does not keep profiles in planes")?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve_gocator(arguments, &scan, taken))?;
    Ok(ExitCode::SUCCESS)
}

async fn serve_gocator(arguments: &GocatorArguments, scan: &Scan, taken: Vec<Taken>) -> Result<(), Box<dyn Error>> {
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

/// A mounting above the part with sensor X along rail Y, with which the profiles form a scan in the rail frame.
fn above() -> Extrinsic {
    Extrinsic {
        sensor_x: [0.0, 1.0, 0.0],
        sensor_y: [1.0, 0.0, 0.0],
        sensor_z: [0.0, 0.0, 1.0],
        mirrored: true,
        translation_mm: [0.0; 3],
    }
}

impl GocatorArguments {
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

    /// The deadlines for this rate: a surface is sent after all of its profiles, and slow profiles arrive singly.
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

    /// The addresses of the server, and the settings of a service that receives its profiles.
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
        // The time from the first to the last profile at this rate, but not faster than the simulated stage.
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

/// Median distance between the profiles, mm.
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

/// Serve a made PLC with two manipulators and a stage, until it is ended. It moves nothing but numbers
#[derive(Debug, clap::Args)]
#[group(id = "protocols", required = true, multiple = true)]
pub(super) struct PlcArguments {
    /// Serve it by Modbus TCP; port 0 takes a free one. m1 is at base 0, m2 at 256, the stage at 512, or unit ids 1, 2, 3
    #[arg(long, value_name = "ADDRESS")]
    modbus: Option<SocketAddr>,
    /// Serve it by OPC UA, anonymous and unencrypted; port 0 takes a free one. The nodes are in docs/opcua.md; no stage
    #[cfg(feature = "opcua")]
    #[arg(long, value_name = "ADDRESS")]
    opcua: Option<SocketAddr>,
}

pub(super) fn run_plc(arguments: &PlcArguments) -> Outcome {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(serve_all(arguments))?;
    Ok(ExitCode::SUCCESS)
}

/// Serves a separate PLC for each protocol.
async fn serve_all(arguments: &PlcArguments) -> Result<(), Box<dyn Error>> {
    let modbus = async {
        match arguments.modbus {
            Some(address) => serve_modbus(address).await,
            None => Ok(()),
        }
    };
    #[cfg(feature = "opcua")]
    let opcua = async {
        match arguments.opcua {
            Some(address) => serve_opcua(address).await,
            None => Ok(()),
        }
    };
    #[cfg(not(feature = "opcua"))]
    let opcua = std::future::ready(Ok(()));
    tokio::try_join!(modbus, opcua).map(|_| ())
}

async fn serve_modbus(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    let listener = TcpListener::bind(address).await.map_err(|error| format!("cannot listen on {address}: {error}"))?;
    print(&format!("modbus {}\n", listener.local_addr()?))?;
    let plc = Plc::new(Layout::default(), vec![manipulator(), manipulator(), stage()]);
    Ok(serve(listener, Arc::new(plc)).await?)
}

#[cfg(feature = "opcua")]
async fn serve_opcua(address: SocketAddr) -> Result<(), Box<dyn Error>> {
    let controllers = Pair { m1: manipulator(), m2: manipulator() };
    let plc = Arc::new(opcua::Plc::new(controllers, States::default().codes()));
    // The library requires a folder for keys, although there are none.
    let folder = std::env::temp_dir().join("coaxis-simulated-plc");
    let server = opcua::PlcServer::listen(address, &plc, &folder).await?;
    print(&format!("opcua opc.tcp://{}\n", server.address()))?;
    Ok(server.run().await?)
}

/// A manipulator with ±50 mm at 10 mm/s and ±12 degrees at 6 degrees/s, with known references.
fn manipulator() -> Controller {
    let linear = AxisLimits { lower: -50.0, upper: 50.0, speed: 10.0, acceleration: 50.0, jerk: 500.0, step: 50.0 };
    let turn = AxisLimits {
        lower: -12_f64.to_radians(),
        upper: 12_f64.to_radians(),
        speed: 6_f64.to_radians(),
        acceleration: 30_f64.to_radians(),
        jerk: 300_f64.to_radians(),
        step: 24_f64.to_radians(),
    };
    Controller::new(ControllerSettings::exact(Axes { x: linear, y: linear, z: linear, c: turn }))
}

/// A rail of 1200 mm at 200 mm/s on axis x; the other axes exist but are never moved.
fn stage() -> Controller {
    let rail = AxisLimits { lower: 0.0, upper: 1200.0, speed: 200.0, acceleration: 1e3, jerk: 1e4, step: 1200.0 };
    Controller::new(ControllerSettings::exact(Axes { x: rail, y: rail, z: rail, c: rail }))
}
