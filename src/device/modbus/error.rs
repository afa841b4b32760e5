//! Why a register map cannot be used, and why registers cannot be understood.

use crate::device::states::SameCode;
use crate::motion::Axis;

/// Why a register map is refused, with the names that the configuration gives its fields.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LayoutError {
    /// More registers than one request can carry.
    #[error("{block}.count = {count}; one request carries 1 to {most} registers")]
    Count {
        /// `status` or `command`.
        block: &'static str,
        /// Registers.
        count: u16,
        /// What the protocol allows.
        most: u16,
    },
    /// The block does not fit into the 65536 registers that there are.
    #[error("{block}: {count} registers from {from} on end beyond register 65535")]
    BeyondLast {
        /// `status` or `command`.
        block: &'static str,
        /// First register.
        from: u32,
        /// Registers.
        count: u16,
    },
    /// A field is not within its block.
    #[error("{field} at offset {at} ends beyond the block of {count} registers")]
    Outside {
        /// Its name.
        field: String,
        /// Its offset.
        at: u16,
        /// Registers of the block.
        count: u16,
    },
    /// Two fields share a register.
    #[error("{first} and {second} both use offset {at}")]
    Overlap {
        /// One.
        first: String,
        /// The other.
        second: String,
        /// The offset that they share.
        at: u16,
    },
    /// The command block lies on the status block, in the same kind of registers.
    #[error("the command block lies on the status block; move command.base, or read the status by function 4")]
    BlocksOverlap,
    /// The device may act on a command before all of it is there.
    #[error("command.sequence must be the last register in use; {field} lies behind it")]
    SequenceNotLast {
        /// What lies behind it.
        field: String,
    },
    /// One number of two that belong together.
    #[error("status.snapshot and status.snapshot_copy are given together or not at all")]
    HalfSnapshot,
    /// Two words for the same number.
    #[error("{table}: {cause}")]
    SameCode {
        /// Which table.
        table: &'static str,
        /// Which words.
        cause: SameCode,
    },
    /// A register has 16 bits.
    #[error("{table}: {field} is bit {bit}; a register has bits 0 to 15")]
    BitOutside {
        /// Which table.
        table: &'static str,
        /// Its name.
        field: String,
        /// Its bit.
        bit: u8,
    },
    /// Two flags share a bit.
    #[error("{table}: {first} and {second} are both bit {bit}")]
    SameBit {
        /// Which table.
        table: &'static str,
        /// One.
        first: String,
        /// The other.
        second: String,
        /// The bit.
        bit: u8,
    },
    /// A scale that turns everything into nothing.
    #[error("numbers: the scale of {unit} is {scale}; it must be above 0 and at most 1")]
    Scale {
        /// `mm` or `deg`.
        unit: &'static str,
        /// As given.
        scale: f64,
    },
}

/// Why registers are no state or no command, or why a command cannot be put into registers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MapError {
    /// Fewer registers came than the map has.
    #[error("register {at} is missing")]
    Missing {
        /// Offset in the block.
        at: u16,
    },
    /// Another map, another device, or another word order.
    #[error("the magic is {found:#06x}, not {expected:#06x}; is the base right, and the device?")]
    Magic {
        /// Read.
        found: u16,
        /// As configured.
        expected: u16,
    },
    /// The device has written while it was read.
    #[error("torn read: snapshot {first} and its copy {second} differ")]
    Torn {
        /// The counter.
        first: u16,
        /// Its copy.
        second: u16,
    },
    /// A number that the table of codes does not have.
    #[error("{what} {code} is not in the table")]
    Code {
        /// Of what.
        what: &'static str,
        /// As read.
        code: u16,
    },
    /// Not a number, or one that is not possible.
    #[error("axis {} has {what} {value} {}; is the word order right?", axis.name(), axis.unit())]
    Value {
        /// Which.
        axis: Axis,
        /// Of what.
        what: &'static str,
        /// As read, in the units of the wire.
        value: f64,
    },
    /// Limits the wrong way round.
    #[error("axis {} has limits {lower} to {upper} {}; is the word order right?", axis.name(), axis.unit())]
    Limits {
        /// Which.
        axis: Axis,
        /// As read, in the units of the wire.
        lower: f64,
        /// As read, in the units of the wire.
        upper: f64,
    },
    /// A number that the registers cannot carry.
    #[error("{what} {value} of axis {} does not fit into the registers", axis.name())]
    Unfit {
        /// Which.
        axis: Axis,
        /// Target or speed.
        what: &'static str,
        /// In the units of the wire.
        value: f64,
    },
    /// 0 means that there was no command.
    #[error("a command needs a sequence number from 1 to 65535")]
    NoSequence,
    /// A device without a watchdog would move on without us.
    #[error("a watchdog of {ms} ms; it must be 1 to 65535 ms")]
    Watchdog {
        /// As asked.
        ms: u128,
    },
    /// The command has changed on its way.
    #[error("the CRC of the command is {found:#06x}, not {expected:#06x}")]
    Crc {
        /// As written.
        found: u16,
        /// Of what was written.
        expected: u16,
    },
}
