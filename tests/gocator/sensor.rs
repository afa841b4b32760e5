//! Shared by the tests of the link: a simulated sensor on loopback, and settings to connect to it.

use coaxis::device::gocator::codec::{Generation, Identity, Scale};
use coaxis::device::gocator::server::{Form, ScanSource, Server, ServerSettings, Source, Taken, View};
use coaxis::device::gocator::{Deadlines, Extrinsic, Gocator, Settings, Travel};
use std::net::{IpAddr, Ipv4Addr};
use std::time::Duration;

pub(crate) const PROFILES: usize = 400;
pub(crate) const POINTS: usize = 640;
pub(crate) const SERIAL: u32 = 40_959;
/// Distance of the profiles along the rail.
pub(crate) const STEP_MM: f64 = 0.5;
const MM_PER_TICK: f64 = 0.01;

/// X to rail Y, Y along the rail, Z up, seen from above: left-handed.
pub(crate) fn above() -> Extrinsic {
    Extrinsic {
        sensor_x: [0.0, 1.0, 0.0],
        sensor_y: [1.0, 0.0, 0.0],
        sensor_z: [0.0, 0.0, 1.0],
        mirrored: true,
        translation_mm: [0.0, 0.0, 0.0],
    }
}

/// A round part at even steps of x, with missing points.
pub(crate) fn taken() -> Vec<Taken> {
    let point = |profile: usize, point: usize| {
        let x = 0.25 * (point as f64) - 80.0;
        let z = (200.0_f64.powi(2) - x * x).sqrt() - 190.0 + 0.01 * profile as f64;
        (!(7 * point + profile).is_multiple_of(13)).then_some([x, z])
    };
    (0..PROFILES)
        .map(|profile| Taken {
            encoder: 1_000 + (profile as f64 * STEP_MM / MM_PER_TICK) as i64,
            timestamp: 5_000 + 1_024 * profile as u64,
            points: (0..POINTS).map(|at| point(profile, at)).collect(),
        })
        .collect()
}

/// Steps of x and z of 9 and 8 µm; the uniform forms have a step for each point.
pub(crate) fn view(form: Form) -> View {
    let x = match form {
        Form::PointCloud => Scale { scale_nm: 9_000, offset_um: -150 },
        Form::Uniform | Form::Surface => Scale { scale_nm: 250_000, offset_um: -80_000 },
    };
    View {
        form,
        generation: Generation::Base,
        x,
        y: Scale { scale_nm: (STEP_MM * 1e6) as u32, offset_um: -12_345 },
        z: Scale { scale_nm: 8_000, offset_um: 2_500 },
        width: POINTS as u32,
        serial: SERIAL,
    }
}

pub(crate) async fn serve(view: View, taken: Vec<Taken>, rate_hz: Option<f64>) -> Server {
    serve_source(view, Box::new(ScanSource::new(taken, rate_hz))).await
}

pub(crate) async fn serve_source(view: View, source: Box<dyn Source>) -> Server {
    serve_told(view, source, Duration::from_millis(50)).await
}

/// A sensor that reports its health when it changes, and otherwise with this period.
pub(crate) async fn serve_told(view: View, source: Box<dyn Source>, health_period: Duration) -> Server {
    let settings = ServerSettings {
        listen: IpAddr::V4(Ipv4Addr::LOCALHOST),
        control_port: 0,
        data_port: 0,
        health_port: 0,
        identity: Identity { serial: SERIAL, model: "Gocator 2350".to_owned(), firmware: [4, 8, 26, 44] },
        view,
        health_period,
    };
    Server::bind(settings, source).await.expect("a port")
}

pub(crate) fn settings(server: &Server) -> Settings {
    let ports = server.ports();
    Settings {
        host: "127.0.0.1".to_owned(),
        control_port: ports.control,
        data_port: ports.data,
        health_port: ports.health,
        serial: Some(SERIAL),
        travel: Some(Travel::Encoder { mm_per_tick: MM_PER_TICK, start_mm: 100.0, zero_ticks: None }),
        extrinsic: Some(above()),
        ..Settings::default()
    }
}

/// Settings with a short timeout for profiles.
pub(crate) fn impatient(server: &Server) -> Settings {
    let deadlines = Deadlines { first_profile_ms: 200, next_profile_ms: 200, ..Deadlines::default() };
    Settings { deadlines, ..settings(server) }
}

pub(crate) fn sensor(settings: &Settings) -> Gocator {
    Gocator::new("profiler", settings).expect("settings")
}
