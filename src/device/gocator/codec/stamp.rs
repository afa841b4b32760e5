//! Stamps (message type 1): when and where the frame of a group was taken.

use super::error::CodecError;
use super::fields::{Fields, frame, rows};
use super::message::{flagged, kind};

/// Bytes before the first stamp.
const START: usize = 14;
/// Of the oldest stamps; newer ones have more behind.
const STAMP_BYTES: u16 = 56;

/// When and where a frame was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stamp {
    /// Counts frames without a gap.
    pub frame_index: u64,
    /// The sensor's clock; 1.024 of these ticks are a microsecond.
    pub timestamp: u64,
    /// Ticks of the encoder.
    pub encoder: i64,
    /// Ticks of the encoder at its last index pulse.
    pub encoder_at_z: i64,
    /// Inputs, as bits.
    pub status: u64,
    /// Of the sensor.
    pub serial: u32,
}

/// Stamps of a group, one a profile.
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

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> u32 {
        self.count
    }

    /// Each.
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
