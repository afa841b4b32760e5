//! One Modbus TCP connection to a device, with one request at a time, each with a deadline. After a missed deadline, a broken
//! transport or an answer to another request the connection is closed, because a late answer must never be attributed to a later
//! request. No request is sent again here.
//!
//! A [`Block`] is the registers of one device over such a link: its status, which is read in one request, the heartbeat of coaxis,
//! and commands, which are written once. The heartbeat of the device must change: a communication processor may answer for a
//! program that has stopped, and its registers then remain constant.

use std::borrow::Cow;
use std::fmt::Debug;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::{Instant, sleep, timeout_at};
use tokio_modbus::client::{Client, Context, tcp};
use tokio_modbus::{Error, ExceptionCode, Request, Response, Slave};

use crate::device::clock::now;
use crate::device::error::{DeviceError, Pending};
use crate::device::manipulator::Command;

use super::command::encode;
use super::error::MapError;
use super::layout::{Layout, StatusFunction};
use super::status::StatusRegisters;

/// The transport of the bytes: a TCP stream, or a pipe in tests.
pub trait Transport: AsyncRead + AsyncWrite + Send + Unpin + Debug {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + Debug> Transport for T {}

/// Opens a new connection.
pub type Dial = Box<dyn FnMut() -> Pending<'static, io::Result<Box<dyn Transport>>> + Send>;

/// The deadlines of a link.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deadlines {
    /// Time for connecting.
    pub(super) connect: Duration,
    /// Time for one reading or one command, with all of its requests.
    pub(super) reply: Duration,
}

/// The connection, if there is one.
pub(super) struct Link {
    name: String,
    dial: Dial,
    unit: Slave,
    deadlines: Deadlines,
    context: Option<Context>,
}

impl Link {
    pub(super) fn new(name: &str, dial: Dial, unit_id: u8, deadlines: Deadlines) -> Self {
        Self { name: name.to_owned(), dial, unit: Slave(unit_id), deadlines, context: None }
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// The deadline of a call that begins now.
    pub(super) fn deadline(&self) -> Instant {
        now() + self.deadlines.reply
    }

    /// Closes the connection, if there is one.
    pub(super) fn drop_connection(&mut self) {
        self.context = None;
    }

    /// Opens a new connection in place of the previous one.
    pub(super) async fn connect(&mut self) -> Result<(), DeviceError> {
        self.drop_connection();
        let within = self.deadlines.connect;
        match timeout_at(now() + within, (self.dial)()).await {
            Ok(Ok(transport)) => self.context = Some(tcp::attach_slave(transport, self.unit)),
            Ok(Err(error)) => return Err(self.lost(&error)),
            Err(_) => return Err(DeviceError::Silent { device: self.name.clone(), within }),
        }
        Ok(())
    }

    /// Reads registers from `at` on.
    pub(super) async fn read(
        &mut self,
        function: StatusFunction,
        at: u16,
        count: u16,
        deadline: Instant,
    ) -> Result<Vec<u16>, DeviceError> {
        let request = match function {
            StatusFunction::Holding => Request::ReadHoldingRegisters(at, count),
            StatusFunction::Input => Request::ReadInputRegisters(at, count),
        };
        match self.call(request, deadline).await? {
            Ok(Response::ReadHoldingRegisters(words) | Response::ReadInputRegisters(words))
                if words.len() == usize::from(count) =>
            {
                Ok(words)
            }
            Ok(response) => {
                Err(self.implausible(format!("{count} registers were requested, the device sent {response:?}")))
            }
            Err(exception) => {
                Err(self.implausible(format!("exception to reading {count} registers at {at}: {exception}")))
            }
        }
    }

    /// Writes one register.
    pub(super) async fn write_one(&mut self, at: u16, word: u16, deadline: Instant) -> Result<(), DeviceError> {
        match self.call(Request::WriteSingleRegister(at, word), deadline).await? {
            Ok(Response::WriteSingleRegister(there, written)) if (there, written) == (at, word) => Ok(()),
            Ok(response) => {
                Err(self.implausible(format!("{word} was written to {at}, the device answered {response:?}")))
            }
            Err(exception) => Err(self.implausible(format!("exception to writing register {at}: {exception}"))),
        }
    }

    /// Writes registers from `at` on, in one request.
    pub(super) async fn write(&mut self, at: u16, words: &[u16], deadline: Instant) -> Result<(), DeviceError> {
        match self.call(Request::WriteMultipleRegisters(at, Cow::Borrowed(words)), deadline).await? {
            Ok(Response::WriteMultipleRegisters(there, count)) if there == at && usize::from(count) == words.len() => {
                Ok(())
            }
            Ok(response) => Err(self.implausible(format!(
                "{} registers were written to {at}, the device answered {response:?}",
                words.len()
            ))),
            Err(exception) if nothing_was_done(exception) => {
                Err(DeviceError::Rejected { device: self.name.clone(), code: u8::from(exception).into() })
            }
            Err(exception) => Err(self.implausible(format!("exception to a command: {exception}"))),
        }
    }

    /// Closes the connection after an implausible answer, because further bytes may belong to it.
    pub(super) fn implausible(&mut self, what: String) -> DeviceError {
        self.drop_connection();
        DeviceError::Implausible { device: self.name.clone(), what }
    }

    /// Sends one request and receives its answer. The connection is put back only after a complete answer to this request, so that
    /// dropping this future half-way also drops the connection.
    async fn call(
        &mut self,
        request: Request<'_>,
        deadline: Instant,
    ) -> Result<Result<Response, ExceptionCode>, DeviceError> {
        let Some(mut context) = self.context.take() else {
            return Err(DeviceError::LinkLost { device: self.name.clone(), cause: "not connected".to_owned() });
        };
        match timeout_at(deadline, context.call(request)).await {
            Ok(Ok(answer)) => {
                self.context = Some(context);
                Ok(answer)
            }
            Ok(Err(Error::Transport(error))) => Err(self.lost(&error)),
            Ok(Err(Error::Protocol(error))) => Err(self.implausible(error.to_string())),
            Err(_) => Err(DeviceError::Silent { device: self.name.clone(), within: self.deadlines.reply }),
        }
    }

    fn lost(&self, error: &io::Error) -> DeviceError {
        // At the end of the stream the client asks the system for an error, but there is none.
        let cause = if error.raw_os_error() == Some(0) {
            "the device has closed the connection".to_owned()
        } else {
            error.to_string()
        };
        DeviceError::LinkLost { device: self.name.clone(), cause }
    }
}

/// Exceptions that mean that nothing was executed (Modbus application protocol V1.1b3, 7). Others, e.g. of a gateway that gets no
/// answer from the device behind it, leave this unknown.
const fn nothing_was_done(exception: ExceptionCode) -> bool {
    matches!(
        exception,
        ExceptionCode::IllegalFunction
            | ExceptionCode::IllegalDataAddress
            | ExceptionCode::IllegalDataValue
            | ExceptionCode::ServerDeviceBusy
    )
}

/// Pause before a torn status is read again. An immediate reading would also be torn, because a PLC writes the block in a cycle of
/// some ms.
const TORN_PAUSE: Duration = Duration::from_millis(5);

/// The block of registers of a device.
pub(super) struct Block {
    link: Link,
    layout: Layout,
    base: u16,
    pulse: Pulse,
    torn_reads_max: u8,
    heartbeat: u16,
}

impl Block {
    pub(super) const fn new(link: Link, layout: Layout, base: u16, pulse: Pulse, torn_reads_max: u8) -> Self {
        Self { link, layout, base, pulse, torn_reads_max, heartbeat: 0 }
    }

    pub(super) fn name(&self) -> &str {
        self.link.name()
    }

    /// Connects and reads. It writes nothing.
    pub(super) async fn connect<T>(&mut self, decode: Decode<T>) -> Result<T, DeviceError> {
        self.link.connect().await?;
        let deadline = self.link.deadline();
        self.status(decode, deadline).await
    }

    /// Writes the heartbeat and reads.
    pub(super) async fn read<T>(&mut self, decode: Decode<T>) -> Result<T, DeviceError> {
        let deadline = self.link.deadline();
        self.heartbeat = self.heartbeat.wrapping_add(1);
        let at = self.layout.command.base + self.base + self.layout.command.heartbeat;
        self.link.write_one(at, self.heartbeat, deadline).await?;
        self.status(decode, deadline).await
    }

    /// Writes a command, once.
    pub(super) async fn command(&mut self, command: &Command) -> Result<(), DeviceError> {
        let heartbeat = self.heartbeat.wrapping_add(1);
        let registers = encode(&self.layout, command, heartbeat).map_err(|error| DeviceError::Unsupported {
            device: self.name().to_owned(),
            what: format!("encode this command: {error}"),
        })?;
        self.heartbeat = heartbeat;
        let deadline = self.link.deadline();
        self.link.write(self.layout.command.base + self.base, &registers, deadline).await
    }

    /// Reads the status, and repeats this a few times if it is torn.
    async fn status<T>(&mut self, decode: Decode<T>, deadline: Instant) -> Result<T, DeviceError> {
        let map = self.layout.status;
        let mut torn_count = 0;
        loop {
            let registers = self.link.read(map.function, map.base + self.base, map.count, deadline).await?;
            let status = StatusRegisters { layout: &self.layout, registers: &registers };
            match status.head().and_then(|head| Ok((head.heartbeat, decode(status)?))) {
                Ok((heartbeat, state)) => {
                    self.alive(heartbeat)?;
                    return Ok(state);
                }
                Err(MapError::Torn { .. }) if torn_count < self.torn_reads_max => {
                    torn_count += 1;
                    sleep(TORN_PAUSE).await;
                }
                Err(error) => return Err(self.link.implausible(error.to_string())),
            }
        }
    }

    fn alive(&mut self, heartbeat: u16) -> Result<(), DeviceError> {
        self.pulse.stands(heartbeat, now()).map_or(Ok(()), |age| {
            let what = format!(
                "its heartbeat has been {heartbeat} for {} ms; check that the device's program is running",
                age.as_millis()
            );
            Err(self.link.implausible(what))
        })
    }
}

/// Converts a status block.
pub(super) type Decode<T> = fn(StatusRegisters<'_>) -> Result<T, MapError>;

/// The last heartbeat, and since when it has had this value. It is kept across connections.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pulse {
    stale: Duration,
    seen: Option<(u16, Instant)>,
}

impl Pulse {
    pub(super) const fn new(stale: Duration) -> Self {
        Self { stale, seen: None }
    }

    /// How long it has stayed the same, if that is too long.
    pub(super) fn stands(&mut self, heartbeat: u16, now: Instant) -> Option<Duration> {
        match self.seen {
            Some((last, since)) if last == heartbeat => Some(now - since).filter(|age| *age > self.stale),
            _ => {
                self.seen = Some((heartbeat, now));
                None
            }
        }
    }
}
