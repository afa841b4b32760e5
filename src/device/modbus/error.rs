//! The errors of an invalid register map, and of registers that cannot be decoded.

use crate::device::states::SameCode;
use crate::motion::Axis;

/// Why a register map is refused. The messages use the names of the fields in the configuration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// More registers than one request can carry.
    #[error("{block}.count = {count}; one request carries 1 to {most} registers")]
    Count {
        /// `status` or `command`.
        block: &'static str,
        /// Number of registers.
        count: u16,
        /// The limit of the protocol.
        most: u16,
    },
    /// The block ends beyond the last of the 65536 registers.
    #[error("{block}: {count} registers from {from} on end beyond register 65535")]
    BeyondLast {
        /// `status` or `command`.
        block: &'static str,
        /// First register.
        from: u32,
        /// Number of registers.
        count: u16,
    },
    /// A field is not within its block.
    #[error("{field} at offset {at} ends beyond the block of {count} registers")]
    Outside {
        /// Its name.
        field: String,
        /// Its offset.
        at: u16,
        /// Number of registers of the block.
        count: u16,
    },
    /// Two fields share a register.
    #[error("{first} and {second} both use offset {at}")]
    Overlap {
        /// One field.
        first: String,
        /// The other field.
        second: String,
        /// Their common offset.
        at: u16,
    },
    /// The command block overlaps the status block in the same kind of registers.
    #[error("the command block overlaps the status block; move command.base, or read the status by function 4")]
    BlocksOverlap,
    /// The device could execute a command before it is complete.
    #[error("command.sequence must be the last register in use; {field} is after it")]
    SequenceNotLast {
        /// The field after the sequence number.
        field: String,
    },
    /// Only one of the two snapshot counters is given.
    #[error("status.snapshot and status.snapshot_copy are given together or not at all")]
    HalfSnapshot,
    /// Two words have the same number.
    #[error("{table}: {cause}")]
    SameCode {
        /// The table.
        table: &'static str,
        /// The words and their number.
        cause: SameCode,
    },
    /// A register has 16 bits.
    #[error("{table}: {field} is bit {bit}; a register has bits 0 to 15")]
    BitOutside {
        /// The table.
        table: &'static str,
        /// Its name.
        field: String,
        /// Its bit.
        bit: u8,
    },
    /// Two flags share a bit.
    #[error("{table}: {first} and {second} are both bit {bit}")]
    SameBit {
        /// The table.
        table: &'static str,
        /// One flag.
        first: String,
        /// The other flag.
        second: String,
        /// Their common bit.
        bit: u8,
    },
    /// A scale that is not within its range.
    #[error("numbers: the scale of {unit} is {scale}; it must be above 0 and at most 1")]
    Scale {
        /// `mm` or `deg`.
        unit: &'static str,
        /// The given scale.
        scale: f64,
    },
}

/// Why registers are not a valid status or command, or why a command cannot be encoded.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// Fewer registers were received than the map has.
    #[error("register {at} is missing")]
    Missing {
        /// Offset in the block.
        at: u16,
    },
    /// Another map, another device, or another word order.
    #[error("the magic is {found:#06x}, not {expected:#06x}; check the base and the address")]
    Magic {
        /// The value that was read.
        found: u16,
        /// The configured value.
        expected: u16,
    },
    /// The device has written the block while it was read.
    #[error("torn read: snapshot {first} and its copy {second} differ")]
    Torn {
        /// The counter.
        first: u16,
        /// Its copy.
        second: u16,
    },
    /// The table of codes does not contain this number.
    #[error("{what} {code} is not in the table")]
    Code {
        /// The kind of code.
        what: &'static str,
        /// The value that was read.
        code: u16,
    },
    /// The value is not a number, or is not possible.
    #[error("axis {} has {what} {value} {}; check the word order", axis.name(), axis.unit())]
    Value {
        /// The axis.
        axis: Axis,
        /// The kind of value.
        what: &'static str,
        /// The value that was read, in the units of the registers.
        value: f64,
    },
    /// The lower limit is above the upper one.
    #[error("axis {} has limits {lower} to {upper} {}; check the word order", axis.name(), axis.unit())]
    Limits {
        /// The axis.
        axis: Axis,
        /// The value that was read, in the units of the registers.
        lower: f64,
        /// The value that was read, in the units of the registers.
        upper: f64,
    },
    /// The registers cannot represent this value.
    #[error("{what} {value} of axis {} does not fit into the registers", axis.name())]
    Unfit {
        /// The axis.
        axis: Axis,
        /// Target or speed.
        what: &'static str,
        /// The value, in the units of the registers.
        value: f64,
    },
    /// The sequence number is 0, which means that there was no command.
    #[error("a command needs a sequence number from 1 to 65535")]
    NoSequence,
    /// A device without a watchdog would continue to move after a lost link.
    #[error("the watchdog is {ms} ms; it must be 1 to 65535 ms")]
    Watchdog {
        /// The requested time.
        ms: u128,
    },
    /// The command was changed during the transmission.
    #[error("the CRC of the command is {found:#06x}, not {expected:#06x}")]
    Crc {
        /// The CRC in the registers.
        found: u16,
        /// The calculated CRC.
        expected: u16,
    },
}
