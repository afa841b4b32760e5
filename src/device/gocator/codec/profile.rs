//! Profiles (message types 5 and 6) and their intensities (7): attributes, then the numbers of every profile.

use super::error::CodecError;
use super::fields::{Fields, frame, rows};
use super::message::{Generation, flagged, kind};
use super::scale::Scale;

/// Where the attributes begin; their own size stands before them.
const START: usize = 8;
const ATTRIBUTE_BYTES: u16 = 32;
const INTENSITY_ATTRIBUTE_BYTES: u16 = 24;
/// What the sensor calls the step of the stream that profiles come from.
const STREAM_STEP: i32 = 2;

/// Profiles of one width: as a point cloud (x and z of every point) or uniform (z at even steps of x).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Profiles<'a> {
    /// How many.
    pub count: u32,
    /// Points of each.
    pub width: u32,
    /// Along the laser line; of uniform profiles that of the index.
    pub x: Scale,
    /// Towards the sensor.
    pub z: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Of the camera.
    pub exposure_ns: u32,
    /// Which camera took them.
    pub camera: u8,
    /// The numbers, little-endian: x and z in turn, or z alone.
    pub values: &'a [u8],
}

impl<'a> Profiles<'a> {
    /// Of type 5 a point has two numbers, of type 6 one.
    pub(super) fn decode(fields: Fields<'a>, numbers: usize) -> Result<Self, CodecError> {
        let values_start = START + fields.struct_size(6, ATTRIBUTE_BYTES)?;
        let (count, width) = (fields.u32(8)?, fields.u32(12)?);
        let (x, z) = (Scale::decode(fields, 16, 24)?, Scale::decode(fields, 20, 28)?);
        let values = fields.values(values_start, count, width, 2 * numbers)?;
        let (source, exposure_ns, camera) = (fields.u8(32)?, fields.u32(33)?, fields.u8(37)?);
        Ok(Self { count, width, x, z, source, exposure_ns, camera, values })
    }

    /// Each profile of a point cloud as (x, z).
    pub fn point_clouds(&self) -> impl Iterator<Item = impl Iterator<Item = [i16; 2]> + use<'a>> + use<'a> {
        rows(self.values, self.count, 4 * self.width as usize).map(|row| {
            let (points, _) = row.as_chunks::<4>();
            points.iter().map(|&[x0, x1, z0, z1]| [i16::from_le_bytes([x0, x1]), i16::from_le_bytes([z0, z1])])
        })
    }

    /// Each uniform profile as z.
    pub fn uniform(&self) -> impl Iterator<Item = impl Iterator<Item = i16> + use<'a>> + use<'a> {
        rows(self.values, self.count, 2 * self.width as usize).map(numbers)
    }

    /// Appends the message; `kind` says of which of the two forms.
    pub fn encode(&self, kind: u16, generation: Generation, last: bool, out: &mut Vec<u8>) {
        frame(flagged(kind, last), out, |out| {
            out.extend_from_slice(&(ATTRIBUTE_BYTES + generation.more_bytes()).to_le_bytes());
            for number in [self.count, self.width, self.x.scale_nm, self.z.scale_nm] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            for number in [self.x.offset_um, self.z.offset_um] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            out.push(self.source);
            out.extend_from_slice(&self.exposure_ns.to_le_bytes());
            out.extend_from_slice(&[self.camera, 0, 0]);
            generation.encode(STREAM_STEP, out);
            out.extend_from_slice(self.values);
        });
    }
}

/// Brightness of every point of profiles; we pass over it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Intensity<'a> {
    /// How many profiles.
    pub count: u32,
    /// Points of each.
    pub width: u32,
    /// Along the laser line.
    pub x: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Of the camera.
    pub exposure_ns: u32,
    /// Which camera took them.
    pub camera: u8,
    /// A byte a point.
    pub values: &'a [u8],
}

impl<'a> Intensity<'a> {
    pub(super) fn decode(fields: Fields<'a>) -> Result<Self, CodecError> {
        let values_start = START + fields.struct_size(6, INTENSITY_ATTRIBUTE_BYTES)?;
        let (count, width) = (fields.u32(8)?, fields.u32(12)?);
        let x = Scale { scale_nm: fields.u32(16)?, offset_um: fields.i32(20)? };
        let values = fields.values(values_start, count, width, 1)?;
        let (source, exposure_ns, camera) = (fields.u8(24)?, fields.u32(25)?, fields.u8(29)?);
        Ok(Self { count, width, x, source, exposure_ns, camera, values })
    }

    /// Appends the message.
    pub fn encode(&self, generation: Generation, last: bool, out: &mut Vec<u8>) {
        frame(flagged(kind::PROFILE_INTENSITY, last), out, |out| {
            out.extend_from_slice(&(INTENSITY_ATTRIBUTE_BYTES + generation.more_bytes()).to_le_bytes());
            for number in [self.count, self.width, self.x.scale_nm] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            out.extend_from_slice(&self.x.offset_um.to_le_bytes());
            out.push(self.source);
            out.extend_from_slice(&self.exposure_ns.to_le_bytes());
            out.extend_from_slice(&[self.camera, 0, 0]);
            generation.encode(STREAM_STEP, out);
            out.extend_from_slice(self.values);
        });
    }
}

/// Little-endian numbers of 16 bits.
pub(super) fn numbers(row: &[u8]) -> impl Iterator<Item = i16> + use<'_> {
    let (pairs, _) = row.as_chunks::<2>();
    pairs.iter().map(|&pair| i16::from_le_bytes(pair))
}
