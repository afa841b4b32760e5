//! The configuration with all limits and defaults: a TOML file, the environment, and flags, each overriding the previous ones. An
//! invalid value is refused with its key, the value and the allowed range.

mod cell;
mod layers;
mod settings;

pub use cell::{
    Cell, CellError, Lease, LinearLimits, Manipulator, ManipulatorAdaptor, ScanPath, Sensor, SensorAdaptor, Stage,
    StageAdaptor, SupportLimits, Timing, Together, Tolerances, TurnLimits,
};
pub use layers::{ENVIRONMENT_PREFIX, Layers};
pub use settings::{Config, ConfigError, Limits, Log, LogFormat, Timeouts};
