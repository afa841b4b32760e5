//! Registers as numbers: 32-bit numbers in two registers (order of words and bytes, meaning of the bits), and the CRC of a block:
//! CRC-16/MODBUS, high byte first, polynomial 0x8005 reflected, start 0xFFFF (Modbus over serial line, specification V1.02,
//! 6.2.2). Pure.

use serde::{Deserialize, Serialize};

use crate::motion::Axis;

use super::error::LayoutError;

/// The order of the four bytes of a number; A is the most significant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WordOrder {
    /// High word first: 12.5 is 0x4148, 0x0000.
    #[default]
    Abcd,
    /// Low word first.
    Cdab,
    /// High word first, bytes swapped in each word.
    Badc,
    /// Low word first, bytes swapped in each word.
    Dcba,
}

impl WordOrder {
    /// All word orders.
    pub const ALL: [Self; 4] = [Self::Abcd, Self::Cdab, Self::Badc, Self::Dcba];

    /// The two registers of a number's bits.
    #[must_use]
    pub fn registers(self, bits: u32) -> [u16; 2] {
        let [a, b, c, d] = bits.to_be_bytes();
        let word = |high: u8, low: u8| u16::from_be_bytes([high, low]);
        match self {
            Self::Abcd => [word(a, b), word(c, d)],
            Self::Cdab => [word(c, d), word(a, b)],
            Self::Badc => [word(b, a), word(d, c)],
            Self::Dcba => [word(d, c), word(b, a)],
        }
    }

    /// The bits of a number in two registers.
    #[must_use]
    pub const fn bits(self, registers: [u16; 2]) -> u32 {
        let [first, second] = registers;
        let ([p, q], [r, s]) = (first.to_be_bytes(), second.to_be_bytes());
        u32::from_be_bytes(match self {
            Self::Abcd => [p, q, r, s],
            Self::Cdab => [r, s, p, q],
            Self::Badc => [q, p, s, r],
            Self::Dcba => [s, r, q, p],
        })
    }
}

/// The number format of positions, limits and speeds. In the registers they are in mm and degrees (and these per second).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Numbers {
    /// IEEE 754 single precision: a resolution of 0.00012 mm at 2 m.
    #[default]
    F32,
    /// A whole number of counts.
    I32(Scales),
}

/// The size of one count of a whole number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scales {
    /// mm, or mm/s.
    pub mm: f64,
    /// Degrees, or degrees/s.
    pub deg: f64,
}

impl Default for Scales {
    fn default() -> Self {
        Self { mm: 0.001, deg: 0.0001 }
    }
}

impl Scales {
    const fn of(self, axis: Axis) -> f64 {
        match axis {
            Axis::X | Axis::Y | Axis::Z => self.mm,
            Axis::C => self.deg,
        }
    }
}

impl Numbers {
    /// # Errors
    /// [`LayoutError::Scale`].
    pub(super) fn check(self) -> Result<(), LayoutError> {
        let Self::I32(Scales { mm, deg }) = self else { return Ok(()) };
        let wrong = [("mm", mm), ("deg", deg)].into_iter().find(|(_, scale)| !(*scale > 0.0 && *scale <= 1.0));
        wrong.map_or(Ok(()), |(unit, scale)| Err(LayoutError::Scale { unit, scale }))
    }

    /// The bits of a value in the units of the registers; `None` if the value cannot be represented.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the range is checked, the bits are meant"
    )]
    pub fn bits(self, axis: Axis, value: f64) -> Option<u32> {
        match self {
            Self::F32 => Some(value as f32).filter(|value| value.is_finite()).map(f32::to_bits),
            Self::I32(scales) => {
                let counts = (value / scales.of(axis)).round();
                (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&counts).then_some(counts as i32 as u32)
            }
        }
    }

    /// The value of bits in the units of the registers; it may be NaN.
    #[must_use]
    pub fn value(self, axis: Axis, bits: u32) -> f64 {
        match self {
            Self::F32 => f64::from(f32::from_bits(bits)),
            Self::I32(scales) => f64::from(bits.cast_signed()) * scales.of(axis),
        }
    }
}

/// The CRC of registers.
pub(super) fn crc16(registers: impl IntoIterator<Item = u16>) -> u16 {
    registers.into_iter().flat_map(u16::to_be_bytes).fold(0xFFFF, |crc, byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xA001 } else { crc >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// 12.5 = 1.1001b * 2^3: sign 0, exponent 130 = 10000010b, fraction 1001 and zeros: 0x41480000. -0.15625 = -1.01b * 2^-3:
    /// 0xBE200000. The nearest single-precision number to 1.1 is 0x3F8CCCCD, which has four different bytes.
    #[test]
    fn every_word_order_matches_its_letters() {
        let made = |value: f64, order: WordOrder| order.registers(Numbers::F32.bits(Axis::X, value).expect("finite"));
        assert_eq!(made(12.5, WordOrder::Abcd), [0x4148, 0x0000]);
        assert_eq!(made(12.5, WordOrder::Cdab), [0x0000, 0x4148]);
        assert_eq!(made(12.5, WordOrder::Badc), [0x4841, 0x0000]);
        assert_eq!(made(12.5, WordOrder::Dcba), [0x0000, 0x4841]);
        assert_eq!(made(-0.156_25, WordOrder::Abcd), [0xBE20, 0x0000]);
        assert_eq!(made(1.1, WordOrder::Abcd), [0x3F8C, 0xCCCD]);
        assert_eq!(made(1.1, WordOrder::Cdab), [0xCCCD, 0x3F8C]);
        assert_eq!(made(1.1, WordOrder::Badc), [0x8C3F, 0xCDCC]);
        assert_eq!(made(1.1, WordOrder::Dcba), [0xCDCC, 0x8C3F]);
    }

    /// 12.5 mm are 12500 = 0x30D4 counts of 1 µm; -1 mm is the two's complement of 1000 = 0x3E8: 0xFFFFFC18.
    #[test]
    fn integers_are_counts_of_their_scale() {
        let numbers = Numbers::I32(Scales::default());
        assert_eq!(numbers.bits(Axis::X, 12.5), Some(0x30D4));
        assert_eq!(numbers.bits(Axis::Z, -1.0), Some(0xFFFF_FC18));
        assert_eq!(numbers.bits(Axis::C, 12.5), Some(125_000));
        assert!((numbers.value(Axis::Z, 0xFFFF_FC18) + 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_value_out_of_range_has_no_bits() {
        for value in [f64::NAN, f64::INFINITY, 1e39] {
            assert_eq!(Numbers::F32.bits(Axis::X, value), None);
            assert_eq!(Numbers::I32(Scales::default()).bits(Axis::X, value), None);
        }
        assert_eq!(Numbers::I32(Scales::default()).bits(Axis::X, 2_147_484.0), None);
    }

    proptest! {
        #[test]
        fn bits_are_recovered_in_every_word_order(bits: u32) {
            for order in WordOrder::ALL {
                prop_assert_eq!(order.bits(order.registers(bits)), bits);
            }
        }

        #[test]
        fn integers_are_recovered_exactly(counts: i32) {
            let numbers = Numbers::I32(Scales::default());
            for axis in Axis::ALL {
                let bits = counts.cast_unsigned();
                prop_assert_eq!(numbers.bits(axis, numbers.value(axis, bits)), Some(bits));
            }
        }
    }
}

#[cfg(test)]
mod crc_tests {
    use super::*;

    #[test]
    fn the_crc_of_the_published_frame_is_reproduced() {
        // Modbus over serial line, V1.02, example: the frame 02 07 ends with 41 12, low byte first.
        assert_eq!(crc16([0x0207]), 0x1241);
    }

    #[test]
    fn one_changed_bit_changes_the_crc() {
        let registers = [0_u16, 5, 0xF, 1, 0x4148, 0];
        let whole = crc16(registers);
        for bit in 0..registers.len() * 16 {
            let mut changed = registers;
            changed[bit / 16] ^= 1 << (bit % 16);
            assert_ne!(crc16(changed), whole, "bit {bit}");
        }
    }
}
