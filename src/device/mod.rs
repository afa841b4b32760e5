//! What devices promise, and the adaptors that keep it: a folder each, codec (bytes and frames, pure) apart from link
//! (sockets, deadlines). Knows geometry, scan and motion; holds no business rules and must not know who asks.

pub mod contract;
mod error;
mod fence;
pub mod gocator;
mod manipulator;
pub mod modbus;
#[cfg(feature = "opcua")]
pub mod opcua;
mod sensor;
pub mod sequence;
pub mod simulated;
mod stage;
mod states;

pub use error::{DeviceError, ScanFault};
pub use fence::FenceGate;
pub use manipulator::{
    Acknowledged, Action, AxisReading, AxisState, Command, CommandResult, Manipulator, Mode, Reading, Safety,
};
pub use sensor::{Profile, ProfileSensor, SensorDeadlines, SensorReading};
pub use stage::{Stage, StageReading};
pub use states::{SameCode, StateCodes, StatePreset, States};

use std::pin::Pin;

/// What an adaptor will have done.
pub type Pending<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;
