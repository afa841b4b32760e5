//! The control channel: requests with a number, replies with the same number and a status.

use super::error::CodecError;
use super::fields::{Fields, frame};
use std::fmt;

/// Firmware 4 to 6 all say this major version of the protocol.
pub const VERSION_MAJOR: u8 = 101;
/// What our server says.
pub const VERSION_MINOR: u8 = 4;

/// What we ask, or answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Command {
    /// Version of the protocol.
    ProtocolVersion = 0x4511,
    /// Which sensor it is, old form.
    SystemInfo = 0x4002,
    /// Which sensor it is, in structures that say their size.
    SystemInfoV2 = 0x4010,
    /// Whether it runs.
    States = 0x4525,
    /// Video, range, profile or surface.
    Mode = 0x1005,
    /// The clock.
    Timestamp = 0x100A,
    /// The encoder.
    Encoder = 0x101C,
    /// Take frames; the laser goes on.
    Start = 0x100D,
    /// Take no more.
    Stop = 0x1001,
    /// Nothing, but that we live.
    Ping = 0x100E,
}

impl Command {
    /// Every one.
    pub const ALL: [Self; 10] = [
        Self::ProtocolVersion,
        Self::SystemInfo,
        Self::SystemInfoV2,
        Self::States,
        Self::Mode,
        Self::Timestamp,
        Self::Encoder,
        Self::Start,
        Self::Stop,
        Self::Ping,
    ];

    /// Its number on the wire.
    #[must_use]
    pub const fn id(self) -> u16 {
        self as u16
    }

    /// The one of this number.
    #[must_use]
    pub fn from_id(id: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|command| command.id() == id)
    }
}

/// How a request fared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub i32);

impl Status {
    /// Done.
    pub const OK: Self = Self(1);
    /// Failed, without a reason.
    pub const FAILED: Self = Self(0);
    /// Not in this state.
    pub const INVALID_STATE: Self = Self(-1000);
    /// No such command.
    pub const INVALID_COMMAND: Self = Self(-998);
    /// Not on this sensor.
    pub const NOT_SUPPORTED: Self = Self(-996);
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self.0 {
            1 => "ok",
            0 => "failed",
            -992 => "simulation buffer empty",
            -996 => "not supported",
            -997 => "invalid parameter",
            -998 => "invalid command",
            -999 => "item not found",
            -1000 => "invalid state",
            _ => "unknown status",
        };
        write!(f, "{name} ({})", self.0)
    }
}

/// A request as the sensor gets it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request<'a> {
    /// Number of the command.
    pub id: u16,
    /// What follows.
    pub payload: &'a [u8],
}

impl<'a> Request<'a> {
    /// Reads a whole frame.
    ///
    /// # Errors
    /// [`CodecError`] where it is shorter than a head.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CodecError> {
        let id = Fields { kind: 0, bytes }.u16(4)?;
        Ok(Self { id, payload: bytes.get(6..).unwrap_or_default() })
    }

    /// Appends the frame.
    pub fn encode(&self, out: &mut Vec<u8>) {
        frame(self.id, out, |out| out.extend_from_slice(self.payload));
    }
}

/// A reply as we get it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    /// Number of the command that it answers.
    pub id: u16,
    /// How it fared.
    pub status: Status,
    /// What follows; nothing, often, where it failed.
    pub payload: &'a [u8],
}

impl<'a> Reply<'a> {
    /// Reads a whole frame.
    ///
    /// # Errors
    /// [`CodecError`] where it is shorter than a reply's head.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CodecError> {
        let id = Fields { kind: 0, bytes }.u16(4)?;
        let status = Status(Fields { kind: id, bytes }.i32(6)?);
        Ok(Self { id, status, payload: bytes.get(10..).unwrap_or_default() })
    }

    /// Appends the frame.
    pub fn encode(&self, out: &mut Vec<u8>) {
        frame(self.id, out, |out| {
            out.extend_from_slice(&self.status.0.to_le_bytes());
            out.extend_from_slice(self.payload);
        });
    }
}
