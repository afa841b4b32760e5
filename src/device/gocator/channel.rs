//! A connection to one of the sensor's ports: connected within a time, read into frames.

use super::codec::{CodecError, Splitter};
use crate::device::error::DeviceError;
use std::io;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;
use tokio::time::timeout;

/// Who is spoken to.
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

    pub(super) fn senseless(&self, what: &impl ToString) -> DeviceError {
        DeviceError::Implausible { device: self.device.clone(), what: what.to_string() }
    }
}

/// A connection and what has come over it.
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

    /// Waits for more bytes. Nothing is lost where it is dropped on the way.
    pub(super) async fn fill(&mut self) -> Result<(), DeviceError> {
        match self.stream.read_buf(self.splitter.room()).await {
            Ok(0) => Err(self.peer.lost(&"the sensor closed the connection")),
            Ok(_) => Ok(()),
            Err(error) => Err(self.peer.lost(&error)),
        }
    }

    /// Takes the bytes that are there already; whether there were any.
    pub(super) fn fill_at_once(&mut self) -> Result<bool, DeviceError> {
        match self.stream.try_read_buf(self.splitter.room()) {
            Ok(0) => Err(self.peer.lost(&"the sensor closed the connection")),
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(self.peer.lost(&error)),
        }
    }

    /// The next whole frame of what has come.
    pub(super) fn frame(&mut self) -> Result<Option<&[u8]>, CodecError> {
        self.splitter.next_frame()
    }
}
