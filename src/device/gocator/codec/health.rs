//! Health (message type 0): numbered values about the sensor itself.

use super::error::CodecError;
use super::fields::{Fields, frame, rows};
use super::message::{flagged, kind};

const START: usize = 14;
const INDICATOR_BYTES: usize = 16;

/// Ids of the indicators that we know.
pub mod indicator {
    /// Ticks of the encoder.
    pub const ENCODER: u32 = 1003;
    /// Hundredths of °C.
    pub const TEMPERATURE: u32 = 2002;
    /// 1 where it runs.
    pub const STATE: u32 = 20000;
    /// Profiles that it could not compute.
    pub const PROCESSING_DROPS: u32 = 21000;
    /// Profiles that it could not send.
    pub const NETWORK_DROPS: u32 = 21005;
    /// Triggers that it could not take.
    pub const TRIGGER_DROPS: u32 = 21010;
}

/// One value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Indicator {
    /// Which.
    pub id: u32,
    /// Of which of several.
    pub instance: u32,
    /// In the unit of its id.
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

    /// Each value.
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
