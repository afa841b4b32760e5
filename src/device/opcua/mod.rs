//! Manipulators behind an OPC UA server, which most PLCs have. `settings` and `layout` give the places of the nodes, `codec`
//! converts their values (pure), `session` and `link` communicate, and `server` is the other side, for trying coaxis without a
//! machine.
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

/// A manipulator that is reached over OPC UA. It is not connected yet.
///
/// # Errors
/// [`SettingRefusal`] names the setting that cannot be used.
pub fn open(name: &str, settings: &Settings) -> Result<Box<dyn Manipulator>, SettingRefusal> {
    Ok(Box::new(OpcuaManipulator::new(name, settings)?))
}

/// Access to private parts for the fuzz targets.
#[cfg(fuzzing)]
pub mod fuzzing {
    use super::server::plc;
    use super::{codec, layout::Node, nodes};
    use crate::device::{Reading, States};
    use opcua::types::{BinaryDecodable, ContextOwned, DataValue, DateTime};

    /// Reads an answer in which values are replaced by those of `bytes`: the index of a value, the value in OPC UA's binary
    /// encoding, and so on.
    pub fn read(mut bytes: &[u8], valid: &Reading) -> Option<Reading> {
        let codes = States::default().codes();
        let value = |node| plc::value(node, valid, 8, codes).map(|value| (node, DataValue::from(value)));
        let mut values: Vec<_> = Node::reading().filter_map(value).collect();
        let mut written: Vec<_> =
            nodes::asked_of_commands().into_iter().map(|(node, _)| (node, DataValue::null())).collect();
        let (owned, mut count) = (ContextOwned::default(), 0);
        while let Some((index, rest)) = bytes.split_first().filter(|_| count < 64) {
            bytes = rest;
            let Ok(value) = DataValue::decode(&mut bytes, &owned.context()) else { break };
            let of = usize::from(index & 0x7F);
            let list = if index & 0x80 == 0 { &mut values } else { &mut written };
            if let Some((_, place)) = list.get_mut(of) {
                *place = value;
            }
            count += 1;
        }
        let _ = (codec::whole(&values), codec::age(&values, &DateTime::null()), nodes::units(&values));
        let _ = (nodes::writable(&written), plc::command(&written));
        codec::reading(&values, codes).ok()
    }
}

#[cfg(test)]
mod tests;
