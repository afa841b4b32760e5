//! A simulated sensor that speaks the protocol: control, data and health, as many clients as come. What it sees comes from a
//! [`Source`]. Faults on demand.

mod answers;
mod feed;
mod form;
mod health;
mod source;

pub use form::{Form, View};
pub use source::{ScanSource, Source, Taken, taken_from};

use super::codec::Identity;
use answers::serve_control;
use feed::Feed;
use health::serve_health;
use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// Where it listens, who it says it is, and how it sends what it sees.
#[derive(Debug, Clone)]
pub struct ServerSettings {
    /// Address.
    pub listen: IpAddr,
    /// Port of the control channel; 0 takes any.
    pub control_port: u16,
    /// Port of the data channel; 0 takes any.
    pub data_port: u16,
    /// Port of the health channel; 0 takes any.
    pub health_port: u16,
    /// Who it is.
    pub identity: Identity,
    /// How it sends what it sees.
    pub view: View,
    /// From health message to health message.
    pub health_period: Duration,
}

/// What goes wrong on purpose. Frames count from 0 within a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    /// Start is refused: the wrong state.
    pub refuse_start: bool,
    /// This frame is taken and not sent.
    pub skip_frame: Option<u64>,
    /// From this frame on nothing comes, and the sensor says that it runs.
    pub stall_at: Option<u64>,
    /// At this frame the sensor stops by itself.
    pub end_at: Option<u64>,
    /// Indicators of health beside the usual ones: id and value.
    pub indicators: Vec<(u32, i64)>,
    /// Health falls silent.
    pub health_silent: bool,
}

/// What the tasks of a sensor share.
#[derive(Debug)]
struct Shared {
    settings: ServerSettings,
    running: watch::Sender<bool>,
    faults: watch::Sender<Faults>,
    /// Of the newest frame.
    encoder: AtomicI64,
    timestamp: AtomicU64,
}

/// The ports that a simulated sensor listens on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ports {
    /// Control channel.
    pub control: u16,
    /// Data channel.
    pub data: u16,
    /// Health channel.
    pub health: u16,
}

/// A simulated sensor; it vanishes with all its connections when this is dropped.
#[derive(Debug)]
pub struct Server {
    shared: Arc<Shared>,
    ports: Ports,
    tasks: JoinSet<()>,
}

impl Server {
    /// Listens, and serves from now on.
    ///
    /// # Errors
    /// What the operating system says of a port.
    pub async fn bind(settings: ServerSettings, source: Box<dyn Source>) -> io::Result<Self> {
        let control = TcpListener::bind((settings.listen, settings.control_port)).await?;
        let health = TcpListener::bind((settings.listen, settings.health_port)).await?;
        let data = TcpListener::bind((settings.listen, settings.data_port)).await?;
        let ports = Ports {
            control: control.local_addr()?.port(),
            data: data.local_addr()?.port(),
            health: health.local_addr()?.port(),
        };
        let shared = Arc::new(Shared {
            settings,
            running: watch::Sender::new(false),
            faults: watch::Sender::default(),
            encoder: AtomicI64::new(0),
            timestamp: AtomicU64::new(0),
        });
        let mut tasks = JoinSet::new();
        tasks.spawn(serve_control(Arc::clone(&shared), control));
        tasks.spawn(serve_health(Arc::clone(&shared), health));
        tasks.spawn(Feed::new(Arc::clone(&shared), data.into_std()?, source).run());
        Ok(Self { shared, ports, tasks })
    }

    /// Where it listens.
    #[must_use]
    pub fn ports(&self) -> Ports {
        self.ports
    }

    /// Has these things go wrong from now on, and no others.
    pub fn inject(&self, faults: Faults) {
        self.shared.faults.send_replace(faults);
    }

    /// Whether it runs, as it changes.
    #[must_use]
    pub fn running(&self) -> watch::Receiver<bool> {
        self.shared.running.subscribe()
    }

    /// Serves until the process ends, or one of the tasks cannot go on.
    pub async fn serve(mut self) {
        let _ended = self.tasks.join_next().await;
    }
}
