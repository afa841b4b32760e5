//! Gocator laser profile sensors, firmware 4 to 6, by their native protocol, without the maker's library.
//!
//! ```text
//! codec (bytes, pure) <- channel <- control, health, running <- link: a ProfileSensor
//!                     <- assembly (groups, gaps, travel, extrinsic; pure)
//!                     <- server: a simulated sensor with the same protocol
//! ```
//!
//! Tested with bytes that the maker's own library wrote, never with hardware: docs/gocator.md.

mod assembly;
mod channel;
pub mod codec;
mod extrinsic;
mod health;
mod link;
mod running;
pub mod server;
mod settings;
mod travel;

pub use extrinsic::{Extrinsic, ExtrinsicError, Placement};
pub use link::{Gocator, open};
pub use settings::{Deadlines, Settings, SettingsError};
pub use travel::{Travel, TravelError};
