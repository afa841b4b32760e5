//! The bytes of the Gocator protocol (firmware 4 to 6): from frames to what they say, and back. Pure: no socket, no clock.
//! Total on any bytes: every length is checked against the bytes that are there before it is believed, and nothing is reserved
//! on its word.
//!
//! ```text
//! bytes --Splitter--> frame --decode--> Message (borrowed from the frame) --encode--> the same bytes
//!                       |
//!                       +--- Request, Reply (control channel)
//! ```
//!
//! All numbers are little-endian. Every frame begins with its own size, that field included.

mod control;
mod error;
mod fields;
mod health;
mod info;
mod message;
mod profile;
mod scale;
mod splitter;
mod stamp;
mod surface;

pub use control::{Command, Reply, Request, Status, VERSION_MAJOR, VERSION_MINOR};
pub use error::CodecError;
pub use health::{Health, Indicator, indicator};
pub use info::{Identity, SensorState, Version};
pub use message::{Framed, Generation, Message, decode, kind};
pub use profile::{Intensity, Profiles};
pub use scale::{INVALID, Scale};
pub use splitter::Splitter;
pub use stamp::{Stamp, Stamps};
pub use surface::Surface;
