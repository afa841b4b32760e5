//! Manipulators and the linear stage behind a PLC that speaks Modbus TCP. A register map (`layout`, data) says where what is;
//! `words`, `status`, `command` and `crc` turn registers into readings and commands, pure; `link` and `block` wait and talk;
//! `server` is the other side, for a simulated PLC.
//!
//! ```text
//! Reading <- status <- words <- registers <- block <- link <- transport
//! Command -> command -> words -> registers -> block -> link -> transport
//! ```

mod block;
mod codes;
mod command;
mod crc;
mod error;
mod image;
mod layout;
mod link;
mod manipulator;
mod pulse;
mod server;
mod settings;
mod stage;
mod status;
mod words;

pub use codes::{Codes, CommandCodes, ModeCodes, ResultCodes};
pub use error::{LayoutError, MapError};
pub use layout::{AxisBits, CommandMap, Layout, SafetyBits, StatusFunction, StatusMap};
pub use link::{Dial, Transport};
pub use manipulator::ModbusManipulator;
pub use server::{Plc, serve};
pub use settings::{Settings, SettingsError, open, open_stage};
pub use stage::ModbusStage;
pub use words::{Numbers, Scales, WordOrder};

#[cfg(test)]
mod tests;
