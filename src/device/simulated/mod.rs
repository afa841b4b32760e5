//! The simulated cell: devices that behave like real ones, with faults on demand, for tests and for trying coaxis without a
//! machine. Seeded, on tokio's clock.
//!
//! ```text
//! SimulatedManipulator x 2 --link--> Controller --mechanics--> clamps --+
//!                                                                       part -- where it really lies
//! SimulatedSensor -----------link--> Scanning, Eye <--------------------+
//! SimulatedStage ------------link--> Carriage --rail--> where the sensor is
//!                             |
//!                          Faults
//! ```
//!
//! What the sensor sees follows from where the clamps really are, not from what the encoders say.

mod carriage;
mod controller;
mod faults;
mod link;
mod manipulator;
mod mechanics;
mod part;
mod profiler;
mod rail;
mod record;
mod scanning;
mod servo;
mod settings;
mod stage;
mod world;

pub use carriage::{STAGE_OUT_OF_LIMITS, STAGE_STALLED, STAGE_WATCHDOG};
pub use controller::{Controller, ControllerSettings, Taken, code};
pub use faults::{Device, Fault, Struck};
pub use manipulator::SimulatedManipulator;
pub use profiler::SimulatedSensor;
pub use rail::Straightness;
pub use record::{Executed, Record};
pub use settings::{
    ManipulatorSettings, Mounting, PartSettings, SensorSettings, SettingError, Settings, StageSettings,
};
pub use stage::SimulatedStage;
pub use world::{FaultSwitch, World};
