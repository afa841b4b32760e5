//! Uniform surfaces (message type 8): rows of z at even steps of x and y.

use super::error::CodecError;
use super::fields::{Fields, frame, rows};
use super::message::{Generation, flagged, kind};
use super::profile::numbers;
use super::scale::Scale;

const START: usize = 8;
/// Of the oldest form, without a rotation.
const ATTRIBUTE_BYTES: u16 = 40;
/// With a rotation; what we write.
const ATTRIBUTE_BYTES_WRITTEN: u16 = 44;
/// What the sensor calls the step of the stream that surfaces come from.
const STREAM_STEP: i32 = 3;

/// Rows of z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Surface<'a> {
    /// How many rows.
    pub rows_count: u32,
    /// Points of each.
    pub width: u32,
    /// Along the laser line, by the index in the row.
    pub x: Scale,
    /// Along the travel, by the index of the row.
    pub y: Scale,
    /// Towards the sensor.
    pub z: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Of the camera.
    pub exposure_ns: u32,
    /// The numbers, little-endian.
    pub values: &'a [u8],
}

impl<'a> Surface<'a> {
    pub(super) fn decode(fields: Fields<'a>) -> Result<Self, CodecError> {
        let values_start = START + fields.struct_size(6, ATTRIBUTE_BYTES)?;
        let (rows_count, width) = (fields.u32(8)?, fields.u32(12)?);
        let scale = |scale_at, offset_at| Scale::decode(fields, scale_at, offset_at);
        let (x, y, z) = (scale(16, 28)?, scale(20, 32)?, scale(24, 36)?);
        let values = fields.values(values_start, rows_count, width, 2)?;
        Ok(Self { rows_count, width, x, y, z, source: fields.u8(40)?, exposure_ns: fields.u32(41)?, values })
    }

    /// Each row as z.
    pub fn rows(&self) -> impl Iterator<Item = impl Iterator<Item = i16> + use<'a>> + use<'a> {
        rows(self.values, self.rows_count, 2 * self.width as usize).map(numbers)
    }

    /// Appends the message.
    pub fn encode(&self, generation: Generation, last: bool, out: &mut Vec<u8>) {
        frame(flagged(kind::UNIFORM_SURFACE, last), out, |out| {
            out.extend_from_slice(&(ATTRIBUTE_BYTES_WRITTEN + generation.more_bytes()).to_le_bytes());
            for number in [self.rows_count, self.width, self.x.scale_nm, self.y.scale_nm, self.z.scale_nm] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            for number in [self.x.offset_um, self.y.offset_um, self.z.offset_um] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            out.push(self.source);
            out.extend_from_slice(&self.exposure_ns.to_le_bytes());
            out.extend_from_slice(&[0; 7]);
            generation.encode(STREAM_STEP, out);
            out.extend_from_slice(self.values);
        });
    }
}
