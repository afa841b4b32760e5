//! What the sensor says about itself on the control channel: version, identity, state. Structures may be longer than we know
//! them; what is behind our part is passed over.

use super::control::Command;
use super::error::CodecError;
use super::fields::Fields;

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
    /// Sensors of a system disagree; it cannot be started.
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
