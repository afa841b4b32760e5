//! Manipulators and the linear stage behind a PLC that speaks Modbus TCP. The register map (`layout`, data) gives the position of
//! each field; `words`, `status` and `command` convert registers into readings and commands, pure; `link` has the connection;
//! `server` is the other side, for a simulated PLC.
//!
//! ```text
//! Reading <- status <- words <- registers <- block <- link <- transport
//! Command -> command -> words -> registers -> block -> link -> transport
//! ```

mod adaptor;
mod codes;
mod command;
mod error;
mod layout;
mod link;
mod server;
mod settings;
mod status;
mod words;

pub use adaptor::ModbusManipulator;
pub use adaptor::ModbusStage;
pub use codes::{Codes, CommandCodes, ModeCodes, ResultCodes};
pub use error::{LayoutError, MapError};
pub use layout::{AxisBits, CommandMap, Layout, SafetyBits, StatusFunction, StatusMap};
pub use link::{Dial, Transport};
pub use server::{Plc, serve};
pub use settings::{Settings, SettingsError, open, open_stage};
pub use words::{Numbers, Scales, WordOrder};

#[cfg(test)]
mod tests;
