//! One Modbus TCP connection to a device: one request at a time, each by a deadline. After a deadline that has passed, a broken
//! transport or an answer to something else the connection is gone: a late answer must never be taken for another request's.
//! Nothing is ever sent again here.

use super::layout::StatusFunction;
use crate::device::Pending;
use crate::device::error::DeviceError;
use std::borrow::Cow;
use std::fmt::Debug;
use std::io;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::time::{Instant, timeout_at};
use tokio_modbus::client::{Client, Context, tcp};
use tokio_modbus::{Error, ExceptionCode, Request, Response, Slave};

/// What carries the bytes: a TCP stream, or a pipe in tests.
pub trait Transport: AsyncRead + AsyncWrite + Send + Unpin + Debug {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin + Debug> Transport for T {}

/// Makes a new connection.
pub type Dial = Box<dyn FnMut() -> Pending<'static, io::Result<Box<dyn Transport>>> + Send>;

/// How long what may take.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deadlines {
    /// To connect.
    pub(super) connect: Duration,
    /// For one reading or one command, with all requests that it takes.
    pub(super) reply: Duration,
}

/// A connection, or none.
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

    /// When what begins now has to be over.
    pub(super) fn deadline(&self) -> Instant {
        now() + self.deadlines.reply
    }

    /// Ends the connection; where there is none, harmless.
    pub(super) fn drop_connection(&mut self) {
        self.context = None;
    }

    /// A new connection, in place of any before.
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

    /// Registers from `at` on.
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
            Ok(response) => Err(self.implausible(format!("{count} registers were asked for, it sent {response:?}"))),
            Err(exception) => {
                Err(self.implausible(format!("exception to reading {count} registers at {at}: {exception}")))
            }
        }
    }

    /// Writes one register.
    pub(super) async fn write_one(&mut self, at: u16, word: u16, deadline: Instant) -> Result<(), DeviceError> {
        match self.call(Request::WriteSingleRegister(at, word), deadline).await? {
            Ok(Response::WriteSingleRegister(there, written)) if (there, written) == (at, word) => Ok(()),
            Ok(response) => Err(self.implausible(format!("{word} was written to {at}, it says {response:?}"))),
            Err(exception) => Err(self.implausible(format!("exception to writing register {at}: {exception}"))),
        }
    }

    /// Writes registers from `at` on, in one request.
    pub(super) async fn write(&mut self, at: u16, words: &[u16], deadline: Instant) -> Result<(), DeviceError> {
        match self.call(Request::WriteMultipleRegisters(at, Cow::Borrowed(words)), deadline).await? {
            Ok(Response::WriteMultipleRegisters(there, count)) if there == at && usize::from(count) == words.len() => {
                Ok(())
            }
            Ok(response) => {
                Err(self.implausible(format!("{} registers were written to {at}, it says {response:?}", words.len())))
            }
            Err(exception) if nothing_was_done(exception) => {
                Err(DeviceError::Rejected { device: self.name.clone(), code: u8::from(exception).into() })
            }
            Err(exception) => Err(self.implausible(format!("exception to a command: {exception}"))),
        }
    }

    /// What cannot be true ends the connection, too: what else is on its way may belong to it.
    pub(super) fn implausible(&mut self, what: String) -> DeviceError {
        self.drop_connection();
        DeviceError::Implausible { device: self.name.clone(), what }
    }

    /// One request and its answer. The connection is put back only after a whole answer to this request, so whoever drops
    /// this half-way drops the connection with it.
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
        // At the end of the stream the client asks the system for an error, which then has none.
        let cause = if error.raw_os_error() == Some(0) {
            "the device has closed the connection".to_owned()
        } else {
            error.to_string()
        };
        DeviceError::LinkLost { device: self.name.clone(), cause }
    }
}

/// Exceptions that come before anything is done (Modbus application protocol V1.1b3, 7). Others, as of a gateway that hears
/// nothing from the device behind it, leave it open.
const fn nothing_was_done(exception: ExceptionCode) -> bool {
    matches!(
        exception,
        ExceptionCode::IllegalFunction
            | ExceptionCode::IllegalDataAddress
            | ExceptionCode::IllegalDataValue
            | ExceptionCode::ServerDeviceBusy
    )
}

#[expect(
    clippy::disallowed_methods,
    reason = "links wait on tokio's clock, which tests pause; this is where they look at it"
)]
pub(super) fn now() -> Instant {
    Instant::now()
}
