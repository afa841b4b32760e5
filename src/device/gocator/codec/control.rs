//! The control channel: requests with a command number, replies with the same number and a status, and the sensor's reports about
//! itself: version, identity, state. Structures may be longer than the form known here; their additional bytes are ignored.

use std::fmt;

use super::frame::{CodecError, Fields, frame};

/// The major version of the protocol of firmware 4 to 6.
pub const VERSION_MAJOR: u8 = 101;
/// The minor version that the simulated server reports.
pub const VERSION_MINOR: u8 = 4;

/// The commands that coaxis sends, and the simulated server answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u16)]
pub enum Command {
    /// Version of the protocol.
    ProtocolVersion = 0x4511,
    /// Identity of the sensor, old form.
    SystemInfo = 0x4002,
    /// Identity of the sensor, in structures that contain their size.
    SystemInfoV2 = 0x4010,
    /// State of the sensor.
    States = 0x4525,
    /// Mode of the sensor: video, range, profile or surface.
    Mode = 0x1005,
    /// Time of the sensor's clock.
    Timestamp = 0x100A,
    /// Position of the encoder.
    Encoder = 0x101C,
    /// Start taking frames, with the laser on.
    Start = 0x100D,
    /// Stop taking frames.
    Stop = 0x1001,
    /// No action; it only shows that the client is alive.
    Ping = 0x100E,
}

impl Command {
    /// All commands.
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

    /// Its number in the protocol.
    #[must_use]
    pub const fn id(self) -> u16 {
        self as u16
    }

    /// The command with this number.
    #[must_use]
    pub fn from_id(id: u16) -> Option<Self> {
        Self::ALL.into_iter().find(|command| command.id() == id)
    }
}

/// The result of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status(pub i32);

impl Status {
    /// The request was executed.
    pub const OK: Self = Self(1);
    /// The request failed, without a reason.
    pub const FAILED: Self = Self(0);
    /// The state of the sensor does not allow the request.
    pub const INVALID_STATE: Self = Self(-1000);
    /// The command does not exist.
    pub const INVALID_COMMAND: Self = Self(-998);
    /// This sensor does not support the command.
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

/// A request as the sensor receives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request<'a> {
    /// Number of the command.
    pub id: u16,
    /// The bytes after the head.
    pub payload: &'a [u8],
}

impl<'a> Request<'a> {
    /// Decodes a complete frame.
    ///
    /// # Errors
    /// [`CodecError`] if it is shorter than a head.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, CodecError> {
        let id = Fields { kind: 0, bytes }.u16(4)?;
        Ok(Self { id, payload: bytes.get(6..).unwrap_or_default() })
    }

    /// Appends the frame.
    pub fn encode(&self, out: &mut Vec<u8>) {
        frame(self.id, out, |out| out.extend_from_slice(self.payload));
    }
}

/// A reply as the client receives it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply<'a> {
    /// Number of the command that it answers.
    pub id: u16,
    /// Result of the request.
    pub status: Status,
    /// The bytes after the head; often none if the request failed.
    pub payload: &'a [u8],
}

impl<'a> Reply<'a> {
    /// Decodes a complete frame.
    ///
    /// # Errors
    /// [`CodecError`] if it is shorter than a reply's head.
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

/// Size up to the end of the role; newer structures are longer.
const IDENTITY_BYTES: u16 = 52;
const MODEL_BYTES: usize = 32;

/// Version of the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Version {
    /// The part on which client and sensor must agree.
    pub major: u8,
    /// The part that may differ.
    pub minor: u8,
}

impl Version {
    /// Decodes the payload of a reply.
    ///
    /// # Errors
    /// [`CodecError`] if it is too short.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::ProtocolVersion.id(), bytes: payload };
        Ok(Self { major: fields.u8(0)?, minor: fields.u8(1)? })
    }

    /// Encodes the payload of a reply.
    #[must_use]
    pub fn encode(self) -> Vec<u8> {
        vec![self.major, self.minor]
    }
}

/// The identity of a sensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Identity {
    /// Serial number.
    pub serial: u32,
    /// Model name, printable ASCII.
    pub model: String,
    /// Firmware version, the most significant part first, as in the manual.
    pub firmware: [u8; 4],
}

impl Identity {
    /// Decodes the payload of a reply to [`Command::SystemInfoV2`], whose structures may have any size.
    ///
    /// # Errors
    /// [`CodecError`] if it is too short.
    pub fn decode_v2(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::SystemInfoV2.id(), bytes: payload };
        let size = fields.struct_size(0, IDENTITY_BYTES)?;
        Self::decode(Fields { bytes: fields.values(2, 1, 1, size)?, ..fields })
    }

    /// Decodes the payload of a reply to [`Command::SystemInfo`].
    ///
    /// # Errors
    /// [`CodecError`] if it is too short.
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

    /// Encodes the payload of a reply to [`Command::SystemInfoV2`], without other sensors and buddies.
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

    /// Encodes the payload of a reply to [`Command::SystemInfo`].
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

/// The state of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorState {
    /// The sensors of a system are in different states, so that it cannot be started.
    Conflict,
    /// It can be started.
    Ready,
    /// It is taking frames.
    Running,
    /// A state of a newer firmware.
    Other(i32),
}

impl SensorState {
    /// Decodes the payload of a reply; only the first state is used.
    ///
    /// # Errors
    /// [`CodecError`] if it is too short.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        let fields = Fields { kind: Command::States.id(), bytes: payload };
        Ok(match fields.i32(4)? {
            -1 => Self::Conflict,
            0 => Self::Ready,
            1 => Self::Running,
            other => Self::Other(other),
        })
    }

    /// Encodes the payload of a reply: this state, and ten others that are zero.
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
