//! Numbers as binary formats store them, and where they lie. Total on any bytes.

/// The kind of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Signed, one byte.
    I8,
    /// Unsigned, one byte.
    U8,
    /// Signed, two bytes.
    I16,
    /// Unsigned, two bytes.
    U16,
    /// Signed, four bytes.
    I32,
    /// Unsigned, four bytes.
    U32,
    /// Signed, eight bytes.
    I64,
    /// Unsigned, eight bytes.
    U64,
    /// Half precision.
    F16,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Kind {
    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

/// The order of a number's bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Endian {
    /// Least significant first.
    Little,
    /// Most significant first.
    Big,
}

/// A number's kind and byte order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Scalar {
    pub(super) kind: Kind,
    pub(super) endian: Endian,
}

impl Scalar {
    /// The number at `offset`; `None` where the bytes end before it does.
    pub(super) fn read(self, bytes: &[u8], offset: usize) -> Option<f64> {
        let rest = bytes.get(offset..)?;
        Some(match self.kind {
            Kind::I8 => f64::from(i8::from_le_bytes(*rest.first_chunk()?)),
            Kind::U8 => f64::from(*rest.first()?),
            Kind::I16 => f64::from(i16::from_le_bytes(self.ordered(rest)?)),
            Kind::U16 => f64::from(u16::from_le_bytes(self.ordered(rest)?)),
            Kind::I32 => f64::from(i32::from_le_bytes(self.ordered(rest)?)),
            Kind::U32 => f64::from(u32::from_le_bytes(self.ordered(rest)?)),
            Kind::I64 => i64::from_le_bytes(self.ordered(rest)?) as f64,
            Kind::U64 => u64::from_le_bytes(self.ordered(rest)?) as f64,
            Kind::F16 => half(u16::from_le_bytes(self.ordered(rest)?)),
            Kind::F32 => f64::from(f32::from_le_bytes(self.ordered(rest)?)),
            Kind::F64 => f64::from_le_bytes(self.ordered(rest)?),
        })
    }

    /// The first `N` bytes, least significant first.
    fn ordered<const N: usize>(self, bytes: &[u8]) -> Option<[u8; N]> {
        let mut bytes = *bytes.first_chunk::<N>()?;
        if self.endian == Endian::Big {
            bytes.reverse();
        }
        Some(bytes)
    }
}

/// The value of a number of half precision (IEEE 754 binary16): one bit of sign, five of exponent, ten of fraction.
fn half(bits: u16) -> f64 {
    let fraction = f64::from(bits & 0x3ff);
    let magnitude = match (bits >> 10) & 0x1f {
        0 => fraction * 2f64.powi(-24),
        0x1f if fraction == 0.0 => f64::INFINITY,
        0x1f => f64::NAN,
        exponent => (1024.0 + fraction) * 2f64.powi(i32::from(exponent) - 25),
    };
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_byte_orders_give_the_same_number() {
        let (little, big) = (Endian::Little, Endian::Big);
        let read = |kind, endian, bytes: &[u8]| Scalar { kind, endian }.read(bytes, 1);
        assert_eq!(read(Kind::F32, little, &[9, 0, 0, 0xc0, 0x3f]), Some(1.5));
        assert_eq!(read(Kind::F32, big, &[9, 0x3f, 0xc0, 0, 0]), Some(1.5));
        assert_eq!(read(Kind::I16, big, &[9, 0xff, 0xfe]), Some(-2.0));
        assert_eq!(read(Kind::U64, little, &[9, 1, 1, 0, 0, 0, 0, 0, 0]), Some(257.0));
        assert_eq!(read(Kind::F64, little, &[9, 0, 0]), None);
    }

    #[test]
    fn half_precision_is_read_with_its_small_and_its_special_values() {
        let read = |bits: u16| Scalar { kind: Kind::F16, endian: Endian::Little }.read(&bits.to_le_bytes(), 0);
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_953_125),
            (0x7bff, 65504.0),
            (0x0001, 2f64.powi(-24)),
            (0x0400, 2f64.powi(-14)),
            (0xfc00, f64::NEG_INFINITY),
        ] {
            assert_eq!(read(bits), Some(value), "{bits:x}");
        }
        assert!(read(0x7e00).is_some_and(f64::is_nan));
    }
}
