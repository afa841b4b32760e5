//! A register that a device may not have: a number, or `"none"`, because TOML has no null.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Place {
    At(u16),
    Nowhere(Nowhere),
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Nowhere {
    None,
}

#[expect(clippy::ref_option, reason = "serde calls it so")]
pub(super) fn serialize<S: Serializer>(place: &Option<u16>, serializer: S) -> Result<S::Ok, S::Error> {
    place.map_or(Place::Nowhere(Nowhere::None), Place::At).serialize(serializer)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u16>, D::Error> {
    Ok(match Place::deserialize(deserializer)? {
        Place::At(at) => Some(at),
        Place::Nowhere(Nowhere::None) => None,
    })
}
