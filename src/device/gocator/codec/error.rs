//! Why bytes are no frame of the protocol.

/// What is wrong with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// A frame says that it is longer than is allowed.
    #[error("a frame of {size} bytes, at most {limit} are allowed")]
    FrameTooLong {
        /// As it says.
        size: u64,
        /// Most.
        limit: u64,
    },
    /// A frame says that it is shorter than its own head.
    #[error("a frame of {size} bytes, {least} are the least")]
    FrameTooShort {
        /// As it says.
        size: u64,
        /// Least.
        least: u64,
    },
    /// A frame's size is not that of its bytes.
    #[error("a frame says {size} bytes and has {found}")]
    SizeDiffers {
        /// As it says.
        size: u64,
        /// What is there.
        found: u64,
    },
    /// A field lies beyond the frame's end.
    #[error("message type {kind}: a field at byte {at} lies beyond its {found} bytes")]
    EndsEarly {
        /// Type of the message, or id of the command.
        kind: u16,
        /// Where the field begins.
        at: usize,
        /// Bytes there are.
        found: usize,
    },
    /// A structure is shorter than its oldest form.
    #[error("message type {kind}: structures of {found} bytes, {least} are the least")]
    StructTooShort {
        /// Type of the message, or id of the command.
        kind: u16,
        /// As it says.
        found: u16,
        /// Of the oldest form.
        least: u16,
    },
    /// There are fewer values than the counts promise.
    #[error("message type {kind}: {rows} × {columns} values do not fit into the {found} bytes that follow")]
    CountsTooLarge {
        /// Type of the message.
        kind: u16,
        /// As it says.
        rows: u32,
        /// As it says.
        columns: u32,
        /// Bytes that follow.
        found: usize,
    },
    /// A scale of zero: every value would be the same.
    #[error("message type {kind}: a scale is 0")]
    ScaleZero {
        /// Type of the message.
        kind: u16,
    },
}
