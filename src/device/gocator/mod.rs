//! Gocator laser profile sensors, firmware 4 to 6, by their native protocol, without the manufacturer's library.
//!
//! ```text
//! codec (bytes, pure) <- channel <- control, health, running <- link: a ProfileSensor
//!                     <- assembly (groups, gaps, travel, extrinsic; pure)
//!                     <- server: a simulated sensor with the same protocol
//! ```
//!
//! Tested with bytes that the manufacturer's own library wrote, never with hardware: docs/gocator.md.

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

/// Access to private parts for the fuzz targets.
#[cfg(fuzzing)]
pub mod fuzzing {
    use super::assembly::Assembly;
    use super::codec::{Message, Splitter, decode};
    use super::health::HealthStatus;
    use super::{Placement, Travel};
    use crate::device::Profile;

    /// The profiles in a stream of frames, up to the first message that does not belong to a scan.
    pub fn assemble(
        stream: &[u8],
        frame_bytes_max: usize,
        placement: Placement,
        travel: Travel,
        expected_count: u64,
    ) -> Vec<Profile> {
        let mut splitter = Splitter::new(frame_bytes_max);
        splitter.room().extend_from_slice(stream);
        let mut assembly = Assembly::new(placement, travel, expected_count);
        let mut wellness = HealthStatus::default();
        wellness.begin_scan();
        while let Ok(Some(frame)) = splitter.next_frame() {
            let Ok(framed) = decode(frame) else { break };
            if let Message::Health(health) = &framed.message {
                wellness.take(health);
            }
            if assembly.take(&framed).is_err() {
                break;
            }
        }
        let _ = (wellness.fault(), wellness.temperature_c());
        assembly.take_ready()
    }
}
