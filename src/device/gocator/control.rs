//! Requests on the control channel, one at a time, each with its deadline. A request that was given up half-way costs the
//! connection: whoever asks takes it in hand and gives it back when the answer is there.

use super::channel::{Channel, Peer};
use super::codec::{Command, Identity, Reply, Request, SensorState, Status, VERSION_MAJOR, Version};
use super::settings::{Settings, duration};
use crate::device::error::DeviceError;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::time::timeout;

/// Replies that we ask for are short.
const REPLY_BYTES_MAX: usize = 64 * 1024;

/// A reply's payload, or the status by which the sensor refuses.
type Answer = Result<Vec<u8>, Status>;

/// The control channel of a sensor that speaks our version of the protocol.
#[derive(Debug)]
pub(super) struct Control {
    channel: Channel,
    reply_within: Duration,
    start_stop_within: Duration,
}

impl Control {
    /// Connects and agrees on the version.
    pub(super) async fn open(peer: &Peer, settings: &Settings) -> Result<Self, DeviceError> {
        let within = duration(settings.deadlines.connect_ms);
        let mut control = Self {
            channel: Channel::open(peer, settings.control_port, within, REPLY_BYTES_MAX).await?,
            reply_within: duration(settings.deadlines.reply_ms),
            start_stop_within: duration(settings.deadlines.start_stop_ms),
        };
        let payload = control.ask(Command::ProtocolVersion).await?;
        let Version { major, minor } = Version::decode(&payload).map_err(|error| peer.senseless(&error))?;
        if major == VERSION_MAJOR {
            return Ok(control);
        }
        Err(peer
            .senseless(&format!("protocol version {major}.{minor}, only {VERSION_MAJOR} is spoken (firmware 4 to 6)")))
    }

    /// Which sensor it is; in the old form where the sensor does not know the new one.
    pub(super) async fn identity(&mut self) -> Result<Identity, DeviceError> {
        let identity = match self.try_ask(Command::SystemInfoV2).await? {
            Ok(payload) => Identity::decode_v2(&payload),
            Err(Status::INVALID_COMMAND | Status::NOT_SUPPORTED) => {
                Identity::decode_v1(&self.ask(Command::SystemInfo).await?)
            }
            Err(status) => return Err(self.rejected(Command::SystemInfoV2, status)),
        };
        identity.map_err(|error| self.channel.peer.senseless(&error))
    }

    pub(super) async fn state(&mut self) -> Result<SensorState, DeviceError> {
        let payload = self.ask(Command::States).await?;
        SensorState::decode(&payload).map_err(|error| self.channel.peer.senseless(&error))
    }

    /// A reply of eight bytes, as they are.
    pub(super) async fn ticks(&mut self, command: Command) -> Result<[u8; 8], DeviceError> {
        let payload = self.ask(command).await?;
        let short = || self.channel.peer.senseless(&format!("{} bytes in answer to {command:?}", payload.len()));
        payload.first_chunk::<8>().copied().ok_or_else(short)
    }

    /// Asks; a refusal is an error.
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
            if let Some(frame) = self.channel.frame().map_err(|error| peer.senseless(&error))? {
                let reply = Reply::decode(frame).map_err(|error| peer.senseless(&error))?;
                if reply.id != command.id() {
                    return Err(peer.senseless(&format!("an answer to {:#06x} came to {command:?}", reply.id)));
                }
                return Ok(if reply.status == Status::OK { Ok(reply.payload.to_vec()) } else { Err(reply.status) });
            }
            self.channel.fill().await?;
        }
    }
}
