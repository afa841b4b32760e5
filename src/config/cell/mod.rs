//! The cell in the configuration: the adaptor of each device, the positions and limits of the manipulators, and all deadlines. The
//! names of the keys end with their units.

mod check;
mod convert;
pub(super) mod settings;

pub use check::CellError;
pub use settings::{
    Cell, Lease, LinearLimits, Manipulator, ManipulatorAdaptor, ScanPath, Sensor, SensorAdaptor, Stage, StageAdaptor,
    SupportLimits, Timing, Together, Tolerances, TurnLimits,
};
