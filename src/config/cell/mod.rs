//! The cell in the configuration: which adaptor each device has, where the manipulators stand and how far they may go, and how long
//! anything may take. The names of the keys end with their units.

mod check;
mod convert;
pub(super) mod settings;

pub use check::CellError;
pub use settings::{
    Cell, Lease, LinearLimits, Manipulator, ManipulatorAdaptor, ScanPath, Sensor, SensorAdaptor, Stage, StageAdaptor,
    SupportLimits, Timing, Together, Tolerances, TurnLimits,
};
