//! The bytes of the Gocator protocol (firmware 4 to 6): frames and their contents. Pure: no socket, no clock.
//! The functions accept any bytes: every length is compared with the available bytes before it is used, and no memory is allocated
//! because of a length field.
//!
//! ```text
//! bytes --Splitter--> frame --decode--> Message (borrowed from the frame) --encode--> the same bytes
//!                       |
//!                       +--- Request, Reply (control channel)
//! ```
//!
//! All numbers are little-endian. Every frame begins with its own size, that field included.

mod control;
mod frame;
mod message;
mod profile;

pub use control::{Command, Identity, Reply, Request, SensorState, Status, VERSION_MAJOR, VERSION_MINOR, Version};
pub use frame::{CodecError, Generation, Splitter, kind};
pub use message::{Framed, Health, Indicator, Message, Stamp, Stamps, decode, indicator};
pub use profile::{INVALID, Intensity, Profiles, Scale, Surface};
