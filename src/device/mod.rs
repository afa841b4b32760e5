//! The guarantees of every device (the traits, checked by `contract`), and the adaptors, one folder each: the codec (bytes and
//! frames, pure) is separate from the link (sockets, deadlines).

pub(crate) mod clock;
pub mod contract;
mod error;
pub mod gocator;
mod manipulator;
pub mod modbus;
#[cfg(feature = "opcua")]
pub mod opcua;
mod sensor;
pub mod sequence;
pub mod simulated;
mod states;

pub use error::{DeviceError, Pending, ScanFault};
pub use manipulator::{
    Acknowledged, Action, AxisReading, AxisState, Command, CommandResult, Manipulator, Mode, Reading, Safety,
};
pub use sensor::{Profile, ProfileSensor, SensorDeadlines, SensorReading};
pub use sensor::{Stage, StageReading};
pub use sequence::FenceGate;
pub use states::{SameCode, StateCodes, StatePreset, States};
