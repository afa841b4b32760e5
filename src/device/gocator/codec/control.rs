//! The control channel: requests with a number, replies with the same number and a status, and what the sensor reports about itself
//! there: version, identity, state. Structures may be longer than the form known here; the bytes behind it are passed over.

use std::fmt;

use super::frame::{CodecError, Fields, frame};

/// The major version of the protocol of firmware 4 to 6.
pub const VERSION_MAJOR: u8 = 101;
/// The minor version of our server.
pub const VERSION_MINOR: u8 = 4;

/// What we ask, or answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Command {
    /// Version of the protocol.
    ProtocolVersion = 0x4511,
    /// Which sensor it is, old form.
    SystemInfo = 0x4002,
    /// Identity of the sensor, in structures that contain their size.
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

/// Up to the end of the role; newer ones have more behind.
const IDENTITY_BYTES: u16 = 52;
const MODEL_BYTES: usize = 32;

/// Version of the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Version {
    /// What both have to agree on.
    pub major: u8,
    /// What they need not.
    pub minor: u8,
}

impl Version {
    /// Reads a reply's payload.
    ///
    /// # Errors
    /// [`CodecError`] where it is too short.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::ProtocolVersion.id(), bytes: payload };
        Ok(Self { major: fields.u8(0)?, minor: fields.u8(1)? })
    }

    /// A reply's payload.
    #[must_use]
    pub fn encode(self) -> Vec<u8> {
        vec![self.major, self.minor]
    }
}

/// Which sensor it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Serial number.
    pub serial: u32,
    /// Its name, printable ASCII.
    pub model: String,
    /// Its firmware, most significant part first as the manual has it.
    pub firmware: [u8; 4],
}

impl Identity {
    /// Reads the payload of a reply to [`Command::SystemInfoV2`], whatever its structures' sizes.
    ///
    /// # Errors
    /// [`CodecError`] where it is too short.
    pub fn decode_v2(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::SystemInfoV2.id(), bytes: payload };
        let size = fields.struct_size(0, IDENTITY_BYTES)?;
        Self::decode(Fields { bytes: fields.values(2, 1, 1, size)?, ..fields })
    }

    /// Reads the payload of a reply to [`Command::SystemInfo`].
    ///
    /// # Errors
    /// [`CodecError`] where it is too short.
    pub fn decode_v1(payload: &[u8]) -> Result<Self, CodecError> {
        Self::decode(Fields { kind: Command::SystemInfo.id(), bytes: payload })
    }

    fn decode(fields: Fields<'_>) -> Result<Self, CodecError> {
        let name = fields.values(8, 1, 1, MODEL_BYTES)?;
        let model = name.iter().take_while(|byte| **byte != 0).filter(|byte| byte.is_ascii_graphic() || **byte == b' ');
        Ok(Self {
            serial: fields.u32(0)?,
            model: model.map(|byte| char::from(*byte)).collect(),
            firmware: fields.u32(40)?.to_le_bytes(),
        })
    }

    /// The payload of a reply to [`Command::SystemInfoV2`]: no other sensors, no buddies.
    #[must_use]
    pub fn encode_v2(&self, running: bool) -> Vec<u8> {
        let mut payload = IDENTITY_BYTES.to_le_bytes().to_vec();
        self.encode(running, &mut payload);
        payload.extend_from_slice(&0_u32.to_le_bytes());
        payload.extend_from_slice(&60_u16.to_le_bytes());
        payload.extend_from_slice(&0_u32.to_le_bytes());
        payload.extend_from_slice(&8_u16.to_le_bytes());
        payload
    }

    /// The payload of a reply to [`Command::SystemInfo`].
    #[must_use]
    pub fn encode_v1(&self, running: bool) -> Vec<u8> {
        let mut payload = Vec::new();
        self.encode(running, &mut payload);
        payload.extend_from_slice(&(-1_i32).to_le_bytes());
        payload.extend_from_slice(&0_u32.to_le_bytes());
        payload
    }

    fn encode(&self, running: bool, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.serial.to_le_bytes());
        out.extend_from_slice(&[127, 0, 0, 1]);
        let name = self.model.bytes().chain(std::iter::repeat(0)).take(MODEL_BYTES);
        out.extend(name);
        out.extend_from_slice(&self.firmware);
        out.extend_from_slice(&i32::from(running).to_le_bytes());
        out.extend_from_slice(&0_i32.to_le_bytes());
    }
}

/// What the sensor does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorState {
    /// The sensors of a system are in different states; it cannot be started.
    Conflict,
    /// It can be started.
    Ready,
    /// It takes frames.
    Running,
    /// Something newer.
    Other(i32),
}

impl SensorState {
    /// Reads a reply's payload; the other states are passed over.
    ///
    /// # Errors
    /// [`CodecError`] where it is too short.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::States.id(), bytes: payload };
        Ok(match fields.i32(4)? {
            -1 => Self::Conflict,
            0 => Self::Ready,
            1 => Self::Running,
            other => Self::Other(other),
        })
    }

    /// A reply's payload: this state, and ten others that are zero.
    #[must_use]
    pub fn encode(self) -> Vec<u8> {
        let state = match self {
            Self::Conflict => -1,
            Self::Ready => 0,
            Self::Running => 1,
            Self::Other(other) => other,
        };
        let numbers = [11, state].into_iter().chain([0; 10]);
        numbers.flat_map(i32::to_le_bytes).collect()
    }
}
