//! A connection to one of the sensor's ports, read in frames, and the requests on the control channel: one at a time, each with its
//! deadline. After a request that was cancelled before its reply, the connection can no longer be used.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::device::error::DeviceError;

use super::codec::{
    CodecError, Command, Identity, Reply, Request, SensorState, Splitter, Status, VERSION_MAJOR, Version,
};
use super::settings::{Settings, duration};

/// The sensor that the channels connect to.
#[derive(Debug, Clone)]
pub(super) struct Peer {
    /// Its name in the configuration.
    pub(super) device: String,
    pub(super) host: String,
}

impl Peer {
    pub(super) fn lost(&self, cause: &impl ToString) -> DeviceError {
        DeviceError::LinkLost { device: self.device.clone(), cause: cause.to_string() }
    }

    pub(super) fn silent(&self, within: Duration) -> DeviceError {
        DeviceError::Silent { device: self.device.clone(), within }
    }

    pub(super) fn implausible(&self, what: &impl ToString) -> DeviceError {
        DeviceError::Implausible { device: self.device.clone(), what: what.to_string() }
    }
}

/// A connection with its received bytes.
#[derive(Debug)]
pub(super) struct Channel {
    pub(super) peer: Peer,
    pub(super) stream: TcpStream,
    splitter: Splitter,
}

impl Channel {
    pub(super) async fn open(
        peer: &Peer,
        port: u16,
        within: Duration,
        frame_bytes_max: usize,
    ) -> Result<Self, DeviceError> {
        let connecting = timeout(within, TcpStream::connect((peer.host.as_str(), port))).await;
        let place = format!("{}:{port}", peer.host);
        let stream = connecting
            .map_err(|_| peer.lost(&format!("no connection to {place} within {} ms", within.as_millis())))?
            .and_then(|stream| stream.set_nodelay(true).map(|()| stream))
            .map_err(|error| peer.lost(&format!("no connection to {place}: {error}")))?;
        Ok(Self { peer: peer.clone(), stream, splitter: Splitter::new(frame_bytes_max) })
    }

    /// Waits for more bytes. It can be dropped at any time without losing data.
    pub(super) async fn fill(&mut self) -> Result<(), DeviceError> {
        match self.stream.read_buf(self.splitter.room()).await {
            Ok(0) => Err(self.peer.lost(&"the sensor closed the connection")),
            Ok(_) => Ok(()),
            Err(error) => Err(self.peer.lost(&error)),
        }
    }

    /// Reads the bytes that have already arrived, and returns whether there were any.
    pub(super) fn fill_at_once(&mut self) -> Result<bool, DeviceError> {
        match self.stream.try_read_buf(self.splitter.room()) {
            Ok(0) => Err(self.peer.lost(&"the sensor closed the connection")),
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(self.peer.lost(&error)),
        }
    }

    /// The next complete frame of the received bytes.
    pub(super) fn frame(&mut self) -> Result<Option<&[u8]>, CodecError> {
        self.splitter.next_frame()
    }
}

/// The replies to the requests of coaxis are short.
const REPLY_BYTES_MAX: usize = 64 * 1024;

/// The payload of a reply, or the status of a refusal.
type Answer = Result<Vec<u8>, Status>;

/// The control channel of a sensor with the supported version of the protocol.
#[derive(Debug)]
pub(super) struct Control {
    channel: Channel,
    reply_within: Duration,
    start_stop_within: Duration,
}

impl Control {
    /// Connects and compares the versions.
    pub(super) async fn open(peer: &Peer, settings: &Settings) -> Result<Self, DeviceError> {
        let within = duration(settings.deadlines.connect_ms);
        let mut control = Self {
            channel: Channel::open(peer, settings.control_port, within, REPLY_BYTES_MAX).await?,
            reply_within: duration(settings.deadlines.reply_ms),
            start_stop_within: duration(settings.deadlines.start_stop_ms),
        };
        let payload = control.ask(Command::ProtocolVersion).await?;
        let Version { major, minor } = Version::decode(&payload).map_err(|error| peer.implausible(&error))?;
        if major == VERSION_MAJOR {
            return Ok(control);
        }
        Err(peer.implausible(&format!(
            "protocol version {major}.{minor}, only {VERSION_MAJOR} is supported (firmware 4 to 6)"
        )))
    }

    /// The identity of the sensor; in the old form if the sensor does not support the new one.
    pub(super) async fn identity(&mut self) -> Result<Identity, DeviceError> {
        let identity = match self.try_ask(Command::SystemInfoV2).await? {
            Ok(payload) => Identity::decode_v2(&payload),
            Err(Status::INVALID_COMMAND | Status::NOT_SUPPORTED) => {
                Identity::decode_v1(&self.ask(Command::SystemInfo).await?)
            }
            Err(status) => return Err(self.rejected(Command::SystemInfoV2, status)),
        };
        identity.map_err(|error| self.channel.peer.implausible(&error))
    }

    pub(super) async fn state(&mut self) -> Result<SensorState, DeviceError> {
        let payload = self.ask(Command::States).await?;
        SensorState::decode(&payload).map_err(|error| self.channel.peer.implausible(&error))
    }

    /// Sends a command and returns a reply of eight bytes unchanged.
    pub(super) async fn ticks(&mut self, command: Command) -> Result<[u8; 8], DeviceError> {
        let payload = self.ask(command).await?;
        let short = || self.channel.peer.implausible(&format!("{} bytes in answer to {command:?}", payload.len()));
        payload.first_chunk::<8>().copied().ok_or_else(short)
    }

    /// Sends a command; a refusal is an error.
    pub(super) async fn ask(&mut self, command: Command) -> Result<Vec<u8>, DeviceError> {
        self.try_ask(command).await?.map_err(|status| self.rejected(command, status))
    }

    fn rejected(&self, command: Command, status: Status) -> DeviceError {
        let device = self.channel.peer.device.clone();
        tracing::warn!(device, ?command, %status, "the sensor refused");
        DeviceError::Rejected { device, code: status.0.unsigned_abs() }
    }

    async fn try_ask(&mut self, command: Command) -> Result<Answer, DeviceError> {
        let within = match command {
            Command::Start | Command::Stop => self.start_stop_within,
            _ => self.reply_within,
        };
        let answered = timeout(within, self.exchange(command)).await;
        answered.unwrap_or_else(|_| Err(self.channel.peer.silent(within)))
    }

    async fn exchange(&mut self, command: Command) -> Result<Answer, DeviceError> {
        let mut request = Vec::new();
        Request { id: command.id(), payload: &[] }.encode(&mut request);
        let sent = self.channel.stream.write_all(&request).await;
        sent.map_err(|error| self.channel.peer.lost(&error))?;
        let peer = self.channel.peer.clone();
        loop {
            if let Some(frame) = self.channel.frame().map_err(|error| peer.implausible(&error))? {
                let reply = Reply::decode(frame).map_err(|error| peer.implausible(&error))?;
                if reply.id != command.id() {
                    return Err(
                        peer.implausible(&format!("an answer to {:#06x} was received for {command:?}", reply.id))
                    );
                }
                return Ok(if reply.status == Status::OK { Ok(reply.payload.to_vec()) } else { Err(reply.status) });
            }
            self.channel.fill().await?;
        }
    }
}
