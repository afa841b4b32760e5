//! Messages of the data and health channels by their types. Sixteen bits after the size hold the type and, topmost, whether the
//! message is the last of its group; a group is a frame.

use super::error::CodecError;
use super::fields::Fields;
use super::health::Health;
use super::profile::{Intensity, Profiles};
use super::stamp::Stamps;
use super::surface::Surface;

/// Types of messages on the wire. The vendor's program interface numbers them otherwise.
pub mod kind {
    /// Values about the sensor.
    pub const HEALTH: u16 = 0;
    /// When and where.
    pub const STAMP: u16 = 1;
    /// x and z of every point.
    pub const PROFILE_POINT_CLOUD: u16 = 5;
    /// z at even steps of x.
    pub const UNIFORM_PROFILE: u16 = 6;
    /// Brightness.
    pub const PROFILE_INTENSITY: u16 = 7;
    /// z at even steps of x and y.
    pub const UNIFORM_SURFACE: u16 = 8;
}

const LAST: u16 = 0x8000;

pub(super) const fn flagged(kind: u16, last: bool) -> u16 {
    if last { kind | LAST } else { kind }
}

/// How new the form is in which messages are written: attributes have grown at their end. Reading takes every form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Generation {
    /// Firmware 4.
    #[default]
    Base,
    /// With the step of the stream: firmware 5.
    StreamStep,
    /// And with the place in an array of sensors: firmware 5.3 and newer.
    Arrayed,
}

impl Generation {
    pub(super) const fn more_bytes(self) -> u16 {
        match self {
            Self::Base => 0,
            Self::StreamStep => 8,
            Self::Arrayed => 16,
        }
    }

    pub(super) fn encode(self, stream_step: i32, out: &mut Vec<u8>) {
        let attributes = [stream_step, 0, 1, 0];
        for attribute in attributes.iter().take(usize::from(self.more_bytes() / 4)) {
            out.extend_from_slice(&attribute.to_le_bytes());
        }
    }
}

/// What a message says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Message<'a> {
    /// Values about the sensor.
    Health(Health<'a>),
    /// When and where the group's frame was taken.
    Stamps(Stamps<'a>),
    /// Profiles with x and z of every point.
    PointClouds(Profiles<'a>),
    /// Profiles with z at even steps of x.
    Uniform(Profiles<'a>),
    /// Brightness of profiles.
    Intensity(Intensity<'a>),
    /// A surface.
    Surface(Surface<'a>),
    /// Something else, passed over.
    Other {
        /// Its type.
        kind: u16,
    },
}

/// A message in its group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Framed<'a> {
    /// The group ends with it.
    pub last: bool,
    /// What it says.
    pub message: Message<'a>,
}

/// Reads one whole message, its size included.
///
/// # Errors
/// [`CodecError`] where it is not what it says.
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
