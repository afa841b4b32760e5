//! Manipulators behind an OPC UA server, as most PLCs have one. `settings` and `layout` say where things are, `codec` what they
//! mean (pure), `session` and `link` talk, `server` is the other side, for trying without a machine.
//!
//! ```text
//! Settings -> layout (browse paths) -> session (connected, node ids) -> link (Manipulator)
//!                                                                          |
//!                               Command, Reading <----- codec -----> values of nodes
//! ```

mod codec;
mod layout;
mod link;
mod nodes;
mod security;
mod server;
mod session;
mod settings;

pub use link::OpcuaManipulator;
pub use security::SecurityError;
pub use security::{Policy, Security};
pub use server::{Plc, PlcServer, ServeError, device_path, serve};
pub use settings::{SettingRefusal, Settings};

use super::manipulator::Manipulator;

/// A manipulator that is reached over OPC UA. Connects nothing yet.
///
/// # Errors
/// [`SettingRefusal`] names the setting that cannot be used.
pub fn open(name: &str, settings: &Settings) -> Result<Box<dyn Manipulator>, SettingRefusal> {
    Ok(Box::new(OpcuaManipulator::new(name, settings)?))
}

#[cfg(test)]
mod tests;
