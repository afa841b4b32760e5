//! The register map as data: the position and the encoding of each field. The default is map v1 of docs/modbus.md; other maps are a
//! matter of configuration.

mod check;

use serde::{Deserialize, Serialize};

use crate::motion::Axes;

use super::codes::Codes;
use super::words::{Numbers, WordOrder};

/// The register map. All offsets count from the base of their block.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Layout {
    /// The status block, which the device writes.
    pub status: StatusMap,
    /// The command block, which coaxis writes.
    pub command: CommandMap,
    /// The number format of positions, limits and speeds.
    pub numbers: Numbers,
    /// The order of the bytes of 32-bit numbers.
    pub word_order: WordOrder,
    /// The numbers of states, modes, results and commands.
    pub codes: Codes,
}

/// The Modbus function for reading the status.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatusFunction {
    /// Function 3, holding registers.
    Holding,
    /// Function 4, input registers.
    #[default]
    Input,
}

/// The status block, read in one request. A field that the device does not have is `"none"`, if that is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StatusMap {
    /// The function for reading it.
    pub function: StatusFunction,
    /// Its first register.
    pub base: u16,
    /// The number of registers.
    pub count: u16,
    /// The register of a number that identifies the map, or none.
    #[serde(with = "place")]
    pub magic: Option<u16>,
    /// The value of that number.
    pub magic_value: u16,
    /// A counter that increases while the device's program runs.
    pub heartbeat: u16,
    /// The heartbeat of coaxis as the device has received it, or none. It is not read, only provided by the simulated PLC.
    #[serde(with = "place")]
    pub heartbeat_echo: Option<u16>,
    /// The mode.
    pub mode: u16,
    /// The safety functions, see [`SafetyBits`].
    pub safety: u16,
    /// State of the device.
    pub state: u16,
    /// Sequence number of the newest command that the device has received.
    pub sequence: u16,
    /// Result of that command.
    pub result: u16,
    /// Fault code, two registers.
    pub fault_code: u16,
    /// Bits of the axes, see [`AxisBits`].
    pub axis_flags: u16,
    /// State of each axis.
    pub axis_states: Axes<u16>,
    /// Actual position of each axis, two registers.
    pub actual: Axes<u16>,
    /// The commanded position of each axis, two registers.
    pub commanded: Axes<u16>,
    /// Lower limits, two registers.
    pub lower: Axes<u16>,
    /// Upper limits, two registers.
    pub upper: Axes<u16>,
    /// Greatest speeds, two registers.
    pub speed: Axes<u16>,
    /// Milliseconds since the device started, two registers, or none. It is not read, only provided by the simulated PLC.
    #[serde(with = "place")]
    pub uptime: Option<u16>,
    /// A counter written before the rest of the block, or none.
    #[serde(with = "place")]
    pub snapshot: Option<u16>,
    /// The same counter written after the rest, or none. If the two differ, the block was read while it was written.
    #[serde(with = "place")]
    pub snapshot_copy: Option<u16>,
    /// The bits of `safety`.
    pub safety_bits: SafetyBits,
    /// The bits of `axis_flags`.
    pub axis_bits: AxisBits,
}

impl Default for StatusMap {
    fn default() -> Self {
        Self {
            function: StatusFunction::Input,
            base: 0,
            count: 64,
            magic: Some(0),
            magic_value: 0x4D01,
            heartbeat: 1,
            heartbeat_echo: Some(2),
            mode: 3,
            safety: 4,
            state: 5,
            sequence: 6,
            result: 7,
            fault_code: 8,
            axis_flags: 10,
            axis_states: Axes { x: 11, y: 12, z: 13, c: 14 },
            actual: pairs_from(16),
            commanded: pairs_from(24),
            lower: pairs_from(32),
            upper: pairs_from(40),
            speed: pairs_from(48),
            uptime: Some(56),
            snapshot: Some(62),
            snapshot_copy: Some(63),
            safety_bits: SafetyBits::default(),
            axis_bits: AxisBits::default(),
        }
    }
}

/// The bits of the safety functions; a set bit means that motion is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "named as the safety functions are")]
pub struct SafetyBits {
    pub emergency_stop_ok: u8,
    pub guard_closed: u8,
    pub drives_ready: u8,
    pub remote_enabled: u8,
}

impl Default for SafetyBits {
    fn default() -> Self {
        Self { emergency_stop_ok: 0, guard_closed: 1, drives_ready: 2, remote_enabled: 3 }
    }
}

/// The bits of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(missing_docs, reason = "named as in the reading")]
pub struct AxisBits {
    pub homed: Axes<u8>,
    pub in_position: Axes<u8>,
    pub fault: Axes<u8>,
    pub limit_hit: Axes<u8>,
}

impl Default for AxisBits {
    fn default() -> Self {
        let from = |first| Axes { x: first, y: first + 1, z: first + 2, c: first + 3 };
        Self { homed: from(0), in_position: from(4), fault: from(8), limit_hit: from(12) }
    }
}

/// The command block: holding registers, written in one request by function 16; the heartbeat is also written by itself by function
/// 6.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CommandMap {
    /// Its first register.
    pub base: u16,
    /// The number of registers.
    pub count: u16,
    /// The heartbeat of coaxis.
    pub heartbeat: u16,
    /// The code of the command.
    pub command: u16,
    /// The axes of the command.
    pub axis_mask: u16,
    /// Flags, or none.
    #[serde(with = "place")]
    pub flags: Option<u16>,
    /// Targets, two registers.
    pub targets: Axes<u16>,
    /// Speeds, two registers.
    pub speeds: Axes<u16>,
    /// Milliseconds that the device continues to move without a heartbeat of coaxis, or none if its watchdog is set in the device.
    #[serde(with = "place")]
    pub watchdog_ms: Option<u16>,
    /// CRC-16 of the registers before it, with 0 in place of the heartbeat, or none.
    #[serde(with = "place")]
    pub crc: Option<u16>,
    /// The low 16 bits of the fencing token, or none.
    #[serde(with = "place")]
    pub fence: Option<u16>,
    /// The sequence number. It is the last register in use, so that the command is complete when it changes.
    pub sequence: u16,
    /// The bits of `axis_mask`.
    pub axis_bits: Axes<u8>,
    /// The bit of `flags` that arms a motion.
    pub armed_bit: u8,
}

impl Default for CommandMap {
    fn default() -> Self {
        Self {
            base: 128,
            count: 24,
            heartbeat: 0,
            command: 1,
            axis_mask: 2,
            flags: Some(3),
            targets: pairs_from(4),
            speeds: pairs_from(12),
            watchdog_ms: Some(20),
            crc: Some(21),
            fence: Some(22),
            sequence: 23,
            axis_bits: Axes { x: 0, y: 1, z: 2, c: 3 },
            armed_bit: 0,
        }
    }
}

/// Four numbers of two registers each, in consecutive registers.
const fn pairs_from(first: u16) -> Axes<u16> {
    Axes { x: first, y: first + 2, z: first + 4, c: first + 6 }
}

/// A register that a device may not have: a number, or `"none"`, because TOML has no null.
mod place {
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
}
