//! From the sensor's 16-bit numbers to millimetres and back: mm = offset_um / 1000 + raw · scale_nm / 10⁶.

use super::error::CodecError;
use super::fields::Fields;
use serde::{Deserialize, Serialize};

/// What stands where the sensor saw nothing.
pub const INVALID: i16 = i16::MIN;

/// How numbers of the sensor become millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scale {
    /// One step, nm.
    pub scale_nm: u32,
    /// Where zero lies, µm.
    pub offset_um: i32,
}

impl Scale {
    /// From its two numbers at these places of a message.
    pub(super) fn decode(fields: Fields<'_>, scale_at: usize, offset_at: usize) -> Result<Self, CodecError> {
        let (scale_nm, offset_um) = (fields.u32(scale_at)?, fields.i32(offset_at)?);
        if scale_nm == 0 { Err(CodecError::ScaleZero { kind: fields.kind }) } else { Ok(Self { scale_nm, offset_um }) }
    }

    /// One step, mm.
    #[must_use]
    pub fn step_mm(self) -> f64 {
        f64::from(self.scale_nm) / 1e6
    }

    /// Where zero lies, mm.
    #[must_use]
    pub fn offset_mm(self) -> f64 {
        f64::from(self.offset_um) / 1e3
    }

    /// The coordinate of a place, mm; [`INVALID`] is for the caller to see.
    #[must_use]
    pub fn mm(self, raw: f64) -> f64 {
        self.offset_mm() + raw * self.step_mm()
    }

    /// The nearest number of a coordinate; [`INVALID`] where there is none, half a step off at most.
    #[must_use]
    pub fn raw(self, mm: f64) -> i16 {
        let steps = ((mm - self.offset_mm()) / self.step_mm()).round();
        let inside = steps.abs() <= f64::from(i16::MAX);
        if inside { steps as i16 } else { INVALID }
    }

    /// The finest scale, no finer than `finest_nm`, about the middle of `least` to `most` (mm) that reaches both.
    #[must_use]
    pub fn covering(least: f64, most: f64, finest_nm: u32) -> Self {
        let middle_um = (0.5 * (least + most) * 1e3).round();
        let reach_mm = 0.5 * (most - least) + 1e-3;
        let needed_nm = (reach_mm * 1e6 / f64::from(i16::MAX)).ceil();
        Self { scale_nm: (needed_nm as u32).max(finest_nm), offset_um: middle_um as i32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinate_comes_back_within_half_a_step_and_what_is_out_of_reach_is_invalid() {
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
    fn a_covering_scale_reaches_both_ends_and_is_no_finer_than_asked() {
        for (least, most) in [(-188.0, 188.0), (68.3, 206.0), (5.0, 5.0), (-1e3, 400.0)] {
            let scale = Scale::covering(least, most, 8_000);
            assert!(scale.scale_nm >= 8_000);
            for mm in [least, most] {
                assert_ne!(scale.raw(mm), INVALID, "{mm} of {least} to {most}");
            }
        }
    }
}
