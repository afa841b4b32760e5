//! Messages of the data and health channels by their types; the last message of a group is marked. This file has the stamps (type
//! 1: time and encoder position of a frame) and the health values (type 0: numbered values about the sensor itself).

use super::frame::{CodecError, Fields, LAST, flagged, frame, kind, rows};
use super::profile::{Intensity, Profiles, Surface};

/// The content of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Message<'a> {
    /// Values about the sensor.
    Health(Health<'a>),
    /// Time and encoder position of the group's frame.
    Stamps(Stamps<'a>),
    /// Profiles with x and z of every point.
    PointClouds(Profiles<'a>),
    /// Profiles with z at equal steps of x.
    Uniform(Profiles<'a>),
    /// Brightness of profiles.
    Intensity(Intensity<'a>),
    /// A surface.
    Surface(Surface<'a>),
    /// Another message, which is ignored.
    Other {
        /// Its type.
        kind: u16,
    },
}

/// A message with its mark of the end of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Framed<'a> {
    /// Whether it is the last message of its group.
    pub last: bool,
    /// Its content.
    pub message: Message<'a>,
}

/// Decodes one complete message, including its size.
///
/// # Errors
/// [`CodecError`] if its size or content is invalid.
pub fn decode(frame: &[u8]) -> Result<Framed<'_>, CodecError> {
    let head = Fields { kind: 0, bytes: frame };
    let (size, control) = (head.u32(0)?, head.u16(4)?);
    if size as usize != frame.len() {
        return Err(CodecError::SizeDiffers { size: size.into(), found: frame.len() as u64 });
    }
    let fields = Fields { kind: control & !LAST, bytes: frame };
    let message = match fields.kind {
        kind::HEALTH => Message::Health(Health::decode(fields)?),
        kind::STAMP => Message::Stamps(Stamps::decode(fields)?),
        kind::PROFILE_POINT_CLOUD => Message::PointClouds(Profiles::decode(fields, 2)?),
        kind::UNIFORM_PROFILE => Message::Uniform(Profiles::decode(fields, 1)?),
        kind::PROFILE_INTENSITY => Message::Intensity(Intensity::decode(fields)?),
        kind::UNIFORM_SURFACE => Message::Surface(Surface::decode(fields)?),
        kind => Message::Other { kind },
    };
    Ok(Framed { last: control & LAST != 0, message })
}

/// Bytes before the first stamp.
const START: usize = 14;
/// Size of the oldest stamps; newer ones are longer.
const STAMP_BYTES: u16 = 56;

/// Time and encoder position of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stamp {
    /// Frame number without gaps.
    pub frame_index: u64,
    /// Time of the sensor's clock; 1.024 of its ticks are a microsecond.
    pub timestamp: u64,
    /// Ticks of the encoder.
    pub encoder: i64,
    /// Ticks of the encoder at its last index pulse.
    pub encoder_at_z: i64,
    /// Digital inputs, as bits.
    pub status: u64,
    /// Serial number of the sensor.
    pub serial: u32,
}

/// The stamps of a group, one per profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps<'a> {
    /// 0 main, 1 buddy.
    pub source: u8,
    count: u32,
    stamp_bytes: usize,
    values: &'a [u8],
}

impl<'a> Stamps<'a> {
    pub(super) fn decode(fields: Fields<'a>) -> Result<Self, CodecError> {
        let stamp_bytes = fields.struct_size(10, STAMP_BYTES)?;
        let count = fields.u32(6)?;
        let values = fields.values(START, count, 1, stamp_bytes)?;
        Ok(Self { source: fields.u8(12)?, count, stamp_bytes, values })
    }

    /// Number of stamps.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Iterates over the stamps.
    pub fn iter(&self) -> impl Iterator<Item = Stamp> + '_ {
        rows(self.values, self.count, self.stamp_bytes)
            .filter_map(|bytes| Stamp::decode(Fields { kind: kind::STAMP, bytes }).ok())
    }

    /// Appends the message.
    pub fn encode(source: u8, stamps: &[Stamp], last: bool, out: &mut Vec<u8>) {
        frame(flagged(kind::STAMP, last), out, |out| {
            out.extend_from_slice(&u32::try_from(stamps.len()).unwrap_or(u32::MAX).to_le_bytes());
            out.extend_from_slice(&STAMP_BYTES.to_le_bytes());
            out.extend_from_slice(&[source, 0]);
            stamps.iter().for_each(|stamp| stamp.encode(out));
        });
    }
}

impl Stamp {
    fn decode(fields: Fields<'_>) -> Result<Self, CodecError> {
        Ok(Self {
            frame_index: fields.u64(0)?,
            timestamp: fields.u64(8)?,
            encoder: fields.i64(16)?,
            encoder_at_z: fields.i64(24)?,
            status: fields.u64(32)?,
            serial: fields.u32(40)?,
        })
    }

    fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.frame_index.to_le_bytes());
        out.extend_from_slice(&self.timestamp.to_le_bytes());
        out.extend_from_slice(&self.encoder.to_le_bytes());
        out.extend_from_slice(&self.encoder_at_z.to_le_bytes());
        out.extend_from_slice(&self.status.to_le_bytes());
        out.extend_from_slice(&self.serial.to_le_bytes());
        out.extend_from_slice(&[0; 12]);
    }
}

const INDICATOR_BYTES: usize = 16;

/// Ids of the indicators that coaxis uses.
pub mod indicator {
    /// Ticks of the encoder.
    pub const ENCODER: u32 = 1003;
    /// Temperature in hundredths of °C.
    pub const TEMPERATURE: u32 = 2002;
    /// 1 while the sensor is running.
    pub const STATE: u32 = 20000;
    /// Number of profiles that it could not compute.
    pub const PROCESSING_DROPS: u32 = 21000;
    /// Number of profiles that it could not send.
    pub const NETWORK_DROPS: u32 = 21005;
    /// Number of triggers that it could not serve.
    pub const TRIGGER_DROPS: u32 = 21010;
}

/// One value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indicator {
    /// Id of the indicator.
    pub id: u32,
    /// Instance, if there are several of the same id.
    pub instance: u32,
    /// The value in the unit of its id.
    pub value: i64,
}

/// Values about the sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Health<'a> {
    /// 0 main, 1 buddy.
    pub source: u8,
    count: u32,
    values: &'a [u8],
}

impl<'a> Health<'a> {
    pub(super) fn decode(fields: Fields<'a>) -> Result<Self, CodecError> {
        let count = fields.u32(6)?;
        Ok(Self { source: fields.u8(10)?, count, values: fields.values(START, count, 1, INDICATOR_BYTES)? })
    }

    /// Iterates over the values.
    pub fn iter(&self) -> impl Iterator<Item = Indicator> + '_ {
        rows(self.values, self.count, INDICATOR_BYTES).filter_map(|bytes| {
            let fields = Fields { kind: kind::HEALTH, bytes };
            let (id, instance) = (fields.u32(0).ok()?, fields.u32(4).ok()?);
            Some(Indicator { id, instance, value: fields.i64(8).ok()? })
        })
    }

    /// Appends the message.
    pub fn encode(source: u8, indicators: &[Indicator], out: &mut Vec<u8>) {
        frame(flagged(kind::HEALTH, true), out, |out| {
            out.extend_from_slice(&u32::try_from(indicators.len()).unwrap_or(u32::MAX).to_le_bytes());
            out.extend_from_slice(&[source, 0, 0, 0]);
            for Indicator { id, instance, value } in indicators {
                out.extend_from_slice(&id.to_le_bytes());
                out.extend_from_slice(&instance.to_le_bytes());
                out.extend_from_slice(&value.to_le_bytes());
            }
        });
    }
}
