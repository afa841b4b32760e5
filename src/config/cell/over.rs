//! Lets a configuration say as little about the cell as it likes: what it says goes over the defaults, key by key, although the
//! two manipulators have different ones.

use super::Cell;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use toml::{Table, Value};

/// Sections that know their own defaults, and are taken as they stand.
const WHOLE: [&str; 4] = ["modbus", "opcua", "gocator", "simulated"];

/// The default that differs between devices even there.
const BASE: &str = "base";

/// The cell that results.
pub(in super::super) fn over_default<'de, D: Deserializer<'de>>(text: D) -> Result<Cell, D::Error> {
    let said = Table::deserialize(text)?;
    let mut table = Table::try_from(Cell::default()).map_err(Error::custom)?;
    lay_over(&mut table, said);
    Cell::deserialize(table).map_err(|error| Error::custom(error.to_string().trim_end()))
}

fn lay_over(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(under)), Value::Table(mut over)) if WHOLE.contains(&key.as_str()) => {
                if let Some(base) = under.remove(BASE) {
                    over.entry(BASE).or_insert(base);
                }
                *under = over;
            }
            (Some(Value::Table(under)), Value::Table(over)) => lay_over(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}
