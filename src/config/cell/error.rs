//! Why a cell cannot be, with dotted keys.

use crate::cell::SettingsError;
use crate::device::{gocator, modbus, simulated};
use crate::motion::ArrangementError;

/// Why a cell cannot be.
#[derive(Debug, thiserror::Error)]
pub enum CellError {
    /// A number beyond what can work.
    #[error("cell.{key} must be between {least} and {most}, got {value}")]
    OutOfRange {
        /// Dotted name below `cell`.
        key: String,
        /// What was given.
        value: f64,
        /// Least.
        least: f64,
        /// Greatest.
        most: f64,
    },
    /// Two numbers in the wrong order.
    #[error("cell.{key} must be below {beside}, got {value} and {limit}")]
    NotBelow {
        /// Dotted name below `cell`.
        key: String,
        /// Name of the other.
        beside: &'static str,
        /// What was given.
        value: f64,
        /// What the other is.
        limit: f64,
    },
    /// The simulation cannot be so.
    #[error("cell.simulated.{0}")]
    Simulated(#[from] simulated::SettingError),
    /// A device behind Modbus cannot be so.
    #[error("cell.{key}.{cause}")]
    Modbus {
        /// The device.
        key: &'static str,
        /// Why not.
        cause: modbus::SettingsError,
    },
    /// A device behind OPC UA cannot be so.
    #[cfg(feature = "opcua")]
    #[error("cell.{key}.opcua.{cause}")]
    Opcua {
        /// The device.
        key: &'static str,
        /// Why not.
        cause: crate::device::opcua::SettingRefusal,
    },
    /// The sensor cannot be so.
    #[error("cell.sensor.gocator: {0}")]
    Gocator(#[from] gocator::SettingsError),
    /// Simulated devices beside real ones.
    #[error(
        "cell: {simulated} would be simulated beside {real}; name an adaptor for each, or allow it with cell.simulated_beside_real = true"
    )]
    Mixed {
        /// Which are simulated.
        simulated: String,
        /// Which are not.
        real: String,
    },
    /// Two names for one machine.
    #[error("cell.{first} and cell.{second} are the same device; give each its own {what}")]
    SameDevice {
        /// One.
        first: &'static str,
        /// The other.
        second: &'static str,
        /// What tells them apart.
        what: &'static str,
    },
    /// This program was built without OPC UA.
    #[error("cell.{key}.adaptor = \"opcua\": this program was built without OPC UA; build it with the feature opcua")]
    OpcuaNotBuilt {
        /// The device.
        key: &'static str,
    },
    /// The manipulators cannot stand so.
    #[error("cell.manipulators: {0}")]
    Arrangement(#[from] ArrangementError),
    /// The times do not go together.
    #[error("cell.timing: {0}")]
    Settings(#[from] SettingsError),
}
