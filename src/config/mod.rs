//! Every limit and default in one place: a TOML file, then the environment, then flags, each over the one before. Values that cannot
//! be used are refused with their key, the value and what is allowed.

mod cell;
mod layers;
mod settings;

pub use cell::{
    Cell, CellError, Lease, LinearLimits, Manipulator, ManipulatorAdaptor, ScanPath, Sensor, SensorAdaptor, Stage,
    StageAdaptor, SupportLimits, Timing, Together, Tolerances, TurnLimits,
};
pub use layers::{ENVIRONMENT_PREFIX, Layers};
pub use settings::{Config, ConfigError, Limits, Log, LogFormat, Timeouts};
