//! The simulated cell: devices that behave like real ones, with faults on demand, for tests and for trying coaxis without a
//! machine. It is seeded and uses tokio's clock.
//!
//! ```text
//! SimulatedManipulator x 2 --link--> Controller --mechanics--> clamps --+
//!                                                                       part: its true place
//! SimulatedSensor -----------link--> Scanning, ProfileMaker <--------------------+
//! SimulatedStage ------------link--> Carriage --rail--> position of the sensor
//!                             |
//!                          Faults
//! ```
//!
//! The profiles follow from the true positions of the clamps, not from the readings of the encoders.

mod adaptors;
mod controller;
mod drives;
mod faults;
mod part;
mod rail;
mod scanning;
mod settings;
mod world;

pub use adaptors::{SimulatedManipulator, SimulatedSensor, SimulatedStage};
pub use controller::{CommandReceipt, Controller, ControllerSettings, Executed, Record, code};
pub use drives::{STAGE_OUT_OF_LIMITS, STAGE_STALLED, STAGE_WATCHDOG};
pub use faults::{Device, Fault, Struck};
pub use rail::Straightness;
pub use settings::{
    ManipulatorSettings, Mounting, PartSettings, SensorSettings, SettingError, Settings, StageSettings,
};
pub use world::{FaultSwitch, World};
