//! A simulated sensor that serves the protocol on its three channels to any number of clients. Its profiles come from a [`Source`];
//! faults can be injected.
//!
//! - Control: one reply for each request, until the client disconnects. An unknown request is refused by its status, and so is the
//!   first frame of the manufacturer's client, which has the form of an older protocol; that client accepts the refusal.
//! - Data: the profiles of the source, sent to every connected client from start to stop. A client gets complete messages or none;
//!   one that does not read for long is disconnected.
//! - Health: the state of the sensor, at once, after each change, and periodically.

mod source;

pub use source::{Form, ScanSource, Source, Taken, View, taken_from};

use std::io;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

use super::codec::{
    Command, Health, Identity, Indicator, Reply, Request, SensorState, Splitter, Status, VERSION_MAJOR, VERSION_MINOR,
    Version, indicator,
};

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

/// A simulated sensor. Dropping it closes all of its connections.
#[derive(Debug)]
pub struct Server {
    shared: Arc<Shared>,
    ports: Ports,
    tasks: JoinSet<()>,
}

impl Server {
    /// Starts listening and serving.
    ///
    /// # Errors
    /// An error of the operating system for a port.
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

    /// The ports on which it listens.
    #[must_use]
    pub fn ports(&self) -> Ports {
        self.ports
    }

    /// Replaces the injected faults by these.
    pub fn inject(&self, faults: Faults) {
        self.shared.faults.send_replace(faults);
    }

    /// A channel that shows whether it is running.
    #[must_use]
    pub fn running(&self) -> watch::Receiver<bool> {
        self.shared.running.subscribe()
    }

    /// Serves until the process ends, or one of its tasks fails.
    pub async fn serve(mut self) {
        let _ended = self.tasks.join_next().await;
    }
}

const REQUEST_BYTES_MAX: usize = 64 * 1024;
/// The mode "profile".
const MODE_PROFILE: i32 = 2;

/// Serves every client.
pub(super) async fn serve_control(shared: Arc<Shared>, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => { clients.spawn(converse(Arc::clone(&shared), stream)); }
                Err(error) => return tracing::warn!(%error, "the control channel is closed"),
            },
            Some(_) = clients.join_next() => {}
        }
    }
}

/// Serves a client until it closes the connection, or sends an invalid frame.
async fn converse(shared: Arc<Shared>, mut stream: TcpStream) {
    let mut splitter = Splitter::new(REQUEST_BYTES_MAX);
    let mut replies = Vec::new();
    loop {
        match stream.read_buf(splitter.room()).await {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        loop {
            match splitter.next_frame() {
                Ok(Some(frame)) => answer(&shared, frame, &mut replies),
                Ok(None) => break,
                Err(_) => return,
            }
        }
        if stream.write_all(&replies).await.is_err() {
            return;
        }
        replies.clear();
    }
}

fn answer(shared: &Shared, frame: &[u8], out: &mut Vec<u8>) {
    let Ok(request) = Request::decode(frame) else { return };
    let (status, payload) = match Command::from_id(request.id) {
        Some(command) => act(shared, command),
        None => (Status::INVALID_COMMAND, Vec::new()),
    };
    Reply { id: request.id, status, payload: &payload }.encode(out);
}

/// Executes a command and returns status and payload of the reply.
fn act(shared: &Shared, command: Command) -> (Status, Vec<u8>) {
    let running = *shared.running.borrow();
    let payload = match command {
        Command::ProtocolVersion => Version { major: VERSION_MAJOR, minor: VERSION_MINOR }.encode(),
        Command::SystemInfo => shared.settings.identity.encode_v1(running),
        Command::SystemInfoV2 => shared.settings.identity.encode_v2(running),
        Command::States => if running { SensorState::Running } else { SensorState::Ready }.encode(),
        Command::Mode => MODE_PROFILE.to_le_bytes().to_vec(),
        Command::Timestamp => shared.timestamp.load(Ordering::Relaxed).to_le_bytes().to_vec(),
        Command::Encoder => shared.encoder.load(Ordering::Relaxed).to_le_bytes().to_vec(),
        Command::Start if running || shared.faults.borrow().refuse_start => return (Status::INVALID_STATE, Vec::new()),
        Command::Start => {
            shared.running.send_replace(true);
            Vec::new()
        }
        Command::Stop => {
            shared.running.send_replace(false);
            Vec::new()
        }
        Command::Ping => Vec::new(),
    };
    (Status::OK, payload)
}

/// Longest time that a client may delay the others.
const WRITE_WITHIN: Duration = Duration::from_secs(2);

pub(super) struct Feed {
    shared: Arc<Shared>,
    /// Non-blocking; clients are accepted when a scan starts, so that each gets its first frame.
    listener: std::net::TcpListener,
    source: Box<dyn Source>,
    clients: Vec<TcpStream>,
}

impl Feed {
    pub(super) fn new(shared: Arc<Shared>, listener: std::net::TcpListener, source: Box<dyn Source>) -> Self {
        Self { shared, listener, source, clients: Vec::new() }
    }

    /// Sends one scan after another.
    pub(super) async fn run(mut self) {
        let mut running = self.shared.running.subscribe();
        while running.wait_for(|running| *running).await.is_ok() {
            self.source.begin();
            self.accept_clients();
            match self.shared.settings.view.form {
                Form::PointCloud | Form::Uniform => self.send_profiles(&mut running).await,
                Form::Surface => self.send_surface(&mut running).await,
            }
            // A sensor without further profiles continues to run until it is stopped.
            if running.wait_for(|running| !*running).await.is_err() {
                return;
            }
        }
    }

    /// Accepts the clients that have connected.
    fn accept_clients(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            let usable = stream.set_nonblocking(true).and_then(|()| TcpStream::from_std(stream));
            self.clients.extend(usable.and_then(|stream| stream.set_nodelay(true).map(|()| stream)));
        }
    }

    async fn send_profiles(&mut self, running: &mut watch::Receiver<bool>) {
        let (mut frame, mut message) = (0, Vec::new());
        while let Some(taken) = self.next(running, frame).await {
            if self.shared.faults.borrow().skip_frame != Some(frame) {
                message.clear();
                self.shared.settings.view.profile(&taken, frame + 1, &mut message);
                self.send(&message).await;
            }
            frame += 1;
        }
    }

    async fn send_surface(&mut self, running: &mut watch::Receiver<bool>) {
        let (mut rows, mut first) = (Vec::new(), None);
        while let Some(taken) = self.next(running, rows.len() as u64).await {
            rows.push(self.shared.settings.view.row(&taken));
            first.get_or_insert(taken);
        }
        if let Some(first) = first.filter(|_| *running.borrow()) {
            let mut message = Vec::new();
            self.shared.settings.view.surface(&first, &rows, &mut message);
            self.send(&message).await;
        }
    }

    /// The next profile, unless the sensor is stopped or has a fault at this frame.
    async fn next(&mut self, running: &mut watch::Receiver<bool>, frame: u64) -> Option<Arc<Taken>> {
        // With a source that never waits and without clients, the stop must still be polled.
        tokio::task::coop::consume_budget().await;
        let Faults { stall_at, end_at, .. } = *self.shared.faults.borrow();
        if end_at == Some(frame) {
            self.shared.running.send_replace(false);
        }
        let seen = async {
            if stall_at == Some(frame) {
                std::future::pending::<()>().await;
            }
            self.source.next().await
        };
        let taken = tokio::select! {
            biased;
            _ = running.wait_for(|running| !*running) => None,
            taken = seen => taken,
        }?;
        self.shared.encoder.store(taken.encoder, Ordering::Relaxed);
        self.shared.timestamp.store(taken.timestamp, Ordering::Relaxed);
        Some(taken)
    }

    async fn send(&mut self, message: &[u8]) {
        let mut kept = Vec::with_capacity(self.clients.len());
        for mut client in self.clients.drain(..) {
            if matches!(timeout(WRITE_WITHIN, client.write_all(message)).await, Ok(Ok(()))) {
                kept.push(client);
            }
        }
        self.clients = kept;
    }
}

/// Temperature in hundredths of °C.
const TEMPERATURE: i64 = 4_100;

/// Sends health messages to every client.
pub(super) async fn serve_health(shared: Arc<Shared>, listener: TcpListener) {
    let mut clients = JoinSet::new();
    loop {
        tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => { clients.spawn(tell(Arc::clone(&shared), stream)); }
                Err(error) => return tracing::warn!(%error, "the health channel is closed"),
            },
            Some(_) = clients.join_next() => {}
        }
    }
}

async fn tell(shared: Arc<Shared>, mut stream: TcpStream) {
    let (mut faults, mut running) = (shared.faults.subscribe(), shared.running.subscribe());
    loop {
        let message = message(&shared);
        if !shared.faults.borrow().health_silent && stream.write_all(&message).await.is_err() {
            return;
        }
        tokio::select! {
            () = sleep(shared.settings.health_period) => {}
            changed = faults.changed() => if changed.is_err() { return },
            changed = running.changed() => if changed.is_err() { return },
        }
    }
}

fn message(shared: &Shared) -> Vec<u8> {
    let usual = [
        (indicator::ENCODER, shared.encoder.load(Ordering::Relaxed)),
        (indicator::TEMPERATURE, TEMPERATURE),
        (indicator::STATE, i64::from(*shared.running.borrow())),
    ];
    let injected = shared.faults.borrow().indicators.clone();
    let indicators: Vec<Indicator> =
        usual.into_iter().chain(injected).map(|(id, value)| Indicator { id, instance: 0, value }).collect();
    let mut out = Vec::new();
    Health::encode(0, &indicators, &mut out);
    out
}

/// The addresses, the identity and the data form of a simulated sensor.
#[derive(Debug, Clone)]
pub struct ServerSettings {
    /// Address to listen on.
    pub listen: IpAddr,
    /// Port of the control channel; 0 selects any.
    pub control_port: u16,
    /// Port of the data channel; 0 selects any.
    pub data_port: u16,
    /// Port of the health channel; 0 selects any.
    pub health_port: u16,
    /// Its identity.
    pub identity: Identity,
    /// The form in which it sends its profiles.
    pub view: View,
    /// Interval between two health messages.
    pub health_period: Duration,
}

/// Faults that are injected. Frames count from 0 within a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Faults {
    /// A start is refused because of the state.
    pub refuse_start: bool,
    /// This frame is taken but not sent.
    pub skip_frame: Option<u64>,
    /// From this frame on nothing is sent, although the sensor reports that it is running.
    pub stall_at: Option<u64>,
    /// At this frame the sensor stops by itself.
    pub end_at: Option<u64>,
    /// Additional health indicators: id and value.
    pub indicators: Vec<(u32, i64)>,
    /// No health messages are sent.
    pub health_silent: bool,
}

/// The data that the tasks of a sensor share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) settings: ServerSettings,
    pub(super) running: watch::Sender<bool>,
    pub(super) faults: watch::Sender<Faults>,
    /// Encoder position of the newest frame.
    pub(super) encoder: AtomicI64,
    pub(super) timestamp: AtomicU64,
}
