//! The measured data: profiles (message types 5 and 6), their intensities (7) and uniform surfaces (8, rows of z at equal steps of
//! x and y). Each message has attributes, followed by the numbers of every profile or row.
//!
//! The 16-bit numbers of the sensor become millimetres as mm = offset_um / 1000 + raw · scale_nm / 10⁶.

use serde::{Deserialize, Serialize};

use super::frame::{CodecError, Fields, Generation, flagged, frame, kind, rows};

/// Offset of the attributes; their size precedes them.
const START: usize = 8;
const ATTRIBUTE_BYTES: u16 = 32;
const INTENSITY_ATTRIBUTE_BYTES: u16 = 24;
/// The sensor's id of the step of the stream that profiles come from.
const STREAM_STEP: i32 = 2;

/// Profiles of equal width: as a point cloud (x and z of every point) or uniform (z at equal steps of x).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Profiles<'a> {
    /// Number of profiles.
    pub count: u32,
    /// Points of each profile.
    pub width: u32,
    /// Scale along the laser line; for uniform profiles, of the index.
    pub x: Scale,
    /// Scale towards the sensor.
    pub z: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Camera exposure.
    pub exposure_ns: u32,
    /// The camera that took them.
    pub camera: u8,
    /// The numbers, little-endian: x and z alternating, or only z.
    pub values: &'a [u8],
}

impl<'a> Profiles<'a> {
    /// Decodes a message. A point has two numbers in type 5, and one in type 6.
    pub(super) fn decode(fields: Fields<'a>, numbers: usize) -> Result<Self, CodecError> {
        let values_start = START + fields.struct_size(6, ATTRIBUTE_BYTES)?;
        let (count, width) = (fields.u32(8)?, fields.u32(12)?);
        let (x, z) = (Scale::decode(fields, 16, 24)?, Scale::decode(fields, 20, 28)?);
        let values = fields.values(values_start, count, width, 2 * numbers)?;
        let (source, exposure_ns, camera) = (fields.u8(32)?, fields.u32(33)?, fields.u8(37)?);
        Ok(Self { count, width, x, z, source, exposure_ns, camera, values })
    }

    /// Each profile of a point cloud, as (x, z).
    pub fn point_clouds(&self) -> impl Iterator<Item = impl Iterator<Item = [i16; 2]> + use<'a>> + use<'a> {
        rows(self.values, self.count, 4 * self.width as usize).map(|row| {
            let (points, _) = row.as_chunks::<4>();
            points.iter().map(|&[x0, x1, z0, z1]| [i16::from_le_bytes([x0, x1]), i16::from_le_bytes([z0, z1])])
        })
    }

    /// Each uniform profile, as z.
    pub fn uniform(&self) -> impl Iterator<Item = impl Iterator<Item = i16> + use<'a>> + use<'a> {
        rows(self.values, self.count, 2 * self.width as usize).map(numbers)
    }

    /// Appends the message; `kind` is the message type, 5 or 6.
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

/// Brightness of every point of profiles; coaxis ignores it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Intensity<'a> {
    /// Number of profiles.
    pub count: u32,
    /// Points of each profile.
    pub width: u32,
    /// Scale along the laser line.
    pub x: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Camera exposure.
    pub exposure_ns: u32,
    /// The camera that took them.
    pub camera: u8,
    /// One byte per point.
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

/// Decodes little-endian 16-bit numbers.
pub(super) fn numbers(row: &[u8]) -> impl Iterator<Item = i16> + use<'_> {
    let (pairs, _) = row.as_chunks::<2>();
    pairs.iter().map(|&pair| i16::from_le_bytes(pair))
}

/// The number that marks a point without a measurement.
pub const INVALID: i16 = i16::MIN;

/// Conversion of the sensor's numbers to millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// One step, nm.
    pub scale_nm: u32,
    /// Coordinate of the number zero, µm.
    pub offset_um: i32,
}

impl Scale {
    /// Decodes a scale from the offsets of its two numbers in a message.
    pub(super) fn decode(fields: Fields<'_>, scale_at: usize, offset_at: usize) -> Result<Self, CodecError> {
        let (scale_nm, offset_um) = (fields.u32(scale_at)?, fields.i32(offset_at)?);
        if scale_nm == 0 { Err(CodecError::ScaleZero { kind: fields.kind }) } else { Ok(Self { scale_nm, offset_um }) }
    }

    /// One step, mm.
    #[must_use]
    pub fn step_mm(self) -> f64 {
        f64::from(self.scale_nm) / 1e6
    }

    /// Coordinate of the number zero, mm.
    #[must_use]
    pub fn offset_mm(self) -> f64 {
        f64::from(self.offset_um) / 1e3
    }

    /// The coordinate of a number, mm. The caller must check for [`INVALID`].
    #[must_use]
    pub fn mm(self, raw: f64) -> f64 {
        self.offset_mm() + raw * self.step_mm()
    }

    /// The number nearest to a coordinate, at most half a step away; [`INVALID`] if the coordinate is out of range.
    #[must_use]
    pub fn raw(self, mm: f64) -> i16 {
        let steps = ((mm - self.offset_mm()) / self.step_mm()).round();
        let inside = steps.abs() <= f64::from(i16::MAX);
        if inside { steps as i16 } else { INVALID }
    }

    /// The finest scale, but not finer than `finest_nm`, that is centred between `least` and `most` (mm) and covers both.
    #[must_use]
    pub fn covering(least: f64, most: f64, finest_nm: u32) -> Self {
        let middle_um = (0.5 * (least + most) * 1e3).round();
        let reach_mm = 0.5 * (most - least) + 1e-3;
        let needed_nm = (reach_mm * 1e6 / f64::from(i16::MAX)).ceil();
        Self { scale_nm: (needed_nm as u32).max(finest_nm), offset_um: middle_um as i32 }
    }
}

/// Size of the attributes in the oldest form, without a rotation.
const SURFACE_ATTRIBUTE_BYTES: u16 = 40;
/// Size of the attributes with a rotation, which is the form that is written.
const SURFACE_ATTRIBUTE_BYTES_WRITTEN: u16 = 44;
/// The sensor's id of the step of the stream that surfaces come from.
const SURFACE_STREAM_STEP: i32 = 3;

/// A uniform surface: rows of z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Surface<'a> {
    /// Number of rows.
    pub rows_count: u32,
    /// Points of each row.
    pub width: u32,
    /// Scale along the laser line, of the index in the row.
    pub x: Scale,
    /// Scale along the travel, of the index of the row.
    pub y: Scale,
    /// Scale towards the sensor.
    pub z: Scale,
    /// 0 top, 1 bottom, 2 top left, 3 top right.
    pub source: u8,
    /// Camera exposure.
    pub exposure_ns: u32,
    /// The numbers, little-endian.
    pub values: &'a [u8],
}

impl<'a> Surface<'a> {
    pub(super) fn decode(fields: Fields<'a>) -> Result<Self, CodecError> {
        let values_start = START + fields.struct_size(6, SURFACE_ATTRIBUTE_BYTES)?;
        let (rows_count, width) = (fields.u32(8)?, fields.u32(12)?);
        let scale = |scale_at, offset_at| Scale::decode(fields, scale_at, offset_at);
        let (x, y, z) = (scale(16, 28)?, scale(20, 32)?, scale(24, 36)?);
        let values = fields.values(values_start, rows_count, width, 2)?;
        Ok(Self { rows_count, width, x, y, z, source: fields.u8(40)?, exposure_ns: fields.u32(41)?, values })
    }

    /// Each row, as z.
    pub fn rows(&self) -> impl Iterator<Item = impl Iterator<Item = i16> + use<'a>> + use<'a> {
        rows(self.values, self.rows_count, 2 * self.width as usize).map(numbers)
    }

    /// Appends the message.
    pub fn encode(&self, generation: Generation, last: bool, out: &mut Vec<u8>) {
        frame(flagged(kind::UNIFORM_SURFACE, last), out, |out| {
            out.extend_from_slice(&(SURFACE_ATTRIBUTE_BYTES_WRITTEN + generation.more_bytes()).to_le_bytes());
            for number in [self.rows_count, self.width, self.x.scale_nm, self.y.scale_nm, self.z.scale_nm] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            for number in [self.x.offset_um, self.y.offset_um, self.z.offset_um] {
                out.extend_from_slice(&number.to_le_bytes());
            }
            out.push(self.source);
            out.extend_from_slice(&self.exposure_ns.to_le_bytes());
            out.extend_from_slice(&[0; 7]);
            generation.encode(SURFACE_STREAM_STEP, out);
            out.extend_from_slice(self.values);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinate_is_recovered_within_half_a_step_and_is_invalid_out_of_range() {
        let scale = Scale { scale_nm: 9_000, offset_um: -150 };
        for step in -1000..1000 {
            let mm = f64::from(step) * 0.29;
            let back = scale.mm(scale.raw(mm).into());
            assert!((back - mm).abs() <= 0.0045 + 1e-12, "{mm} became {back}");
        }
        for mm in [300.0, -300.0, f64::NAN, f64::INFINITY, f64::MIN] {
            assert_eq!(scale.raw(mm), INVALID, "{mm}");
        }
    }

    #[test]
    fn a_covering_scale_covers_both_ends_and_is_not_finer_than_requested() {
        for (least, most) in [(-188.0, 188.0), (68.3, 206.0), (5.0, 5.0), (-1e3, 400.0)] {
            let scale = Scale::covering(least, most, 8_000);
            assert!(scale.scale_nm >= 8_000);
            for mm in [least, most] {
                assert_ne!(scale.raw(mm), INVALID, "{mm} of {least} to {most}");
            }
        }
    }
}
