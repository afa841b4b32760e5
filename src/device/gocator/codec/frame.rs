//! Frames: the errors of malformed bytes, numbers at their offsets, a frame from its parts, and the division of a byte stream into
//! frames. The 16 bits after the size contain the type of a message and, in the topmost bit, whether it is the last of its group.
//!
//! Bytes are read directly into [`Splitter::room`], and frames are returned as borrowed slices. The buffer grows only with received
//! bytes, never because of a length field.

/// Types of messages in the protocol. The vendor's programming interface uses other numbers.
pub mod kind {
    /// Health values of the sensor.
    pub const HEALTH: u16 = 0;
    /// Time and encoder position of a frame.
    pub const STAMP: u16 = 1;
    /// x and z of every point.
    pub const PROFILE_POINT_CLOUD: u16 = 5;
    /// z at equal steps of x.
    pub const UNIFORM_PROFILE: u16 = 6;
    /// Brightness of every point.
    pub const PROFILE_INTENSITY: u16 = 7;
    /// z at equal steps of x and y.
    pub const UNIFORM_SURFACE: u16 = 8;
}

/// Why a frame is malformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The size of a frame is greater than allowed.
    #[error("a frame of {size} bytes, at most {limit} are allowed")]
    FrameTooLong {
        /// The size in the frame.
        size: u64,
        /// Greatest allowed size.
        limit: u64,
    },
    /// The size of a frame is less than the size of its head.
    #[error("a frame of {size} bytes, at least {least} are required")]
    FrameTooShort {
        /// The size in the frame.
        size: u64,
        /// Least allowed size.
        least: u64,
    },
    /// The size in a frame differs from its number of bytes.
    #[error("a frame states {size} bytes and has {found}")]
    SizeDiffers {
        /// The size in the frame.
        size: u64,
        /// Number of bytes.
        found: u64,
    },
    /// A field is beyond the end of the frame.
    #[error("message type {kind}: a field at byte {at} is beyond its {found} bytes")]
    EndsEarly {
        /// Type of the message, or id of the command.
        kind: u16,
        /// Offset of the field.
        at: usize,
        /// Number of bytes of the frame.
        found: usize,
    },
    /// A structure is shorter than its oldest form.
    #[error("message type {kind}: structures of {found} bytes, at least {least} are required")]
    StructTooShort {
        /// Type of the message, or id of the command.
        kind: u16,
        /// The size in the frame.
        found: u16,
        /// Size of the oldest form.
        least: u16,
    },
    /// There are fewer values than the counts in the frame state.
    #[error("message type {kind}: {rows} × {columns} values do not fit into the {found} bytes that follow")]
    CountsTooLarge {
        /// Type of the message.
        kind: u16,
        /// The count in the frame.
        rows: u32,
        /// The count in the frame.
        columns: u32,
        /// Number of bytes that follow.
        found: usize,
    },
    /// A scale is zero, so that every value would be the same.
    #[error("message type {kind}: a scale is 0")]
    ScaleZero {
        /// Type of the message.
        kind: u16,
    },
}

/// The bytes of a frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fields<'a> {
    pub(super) kind: u16,
    pub(super) bytes: &'a [u8],
}

impl<'a> Fields<'a> {
    fn array<const N: usize>(self, at: usize) -> Result<[u8; N], CodecError> {
        let found = self.bytes.get(at..).and_then(|rest| rest.first_chunk::<N>());
        found.copied().ok_or(CodecError::EndsEarly { kind: self.kind, at, found: self.bytes.len() })
    }

    pub(super) fn u8(self, at: usize) -> Result<u8, CodecError> {
        self.array(at).map(u8::from_le_bytes)
    }

    pub(super) fn u16(self, at: usize) -> Result<u16, CodecError> {
        self.array(at).map(u16::from_le_bytes)
    }

    pub(super) fn u32(self, at: usize) -> Result<u32, CodecError> {
        self.array(at).map(u32::from_le_bytes)
    }

    pub(super) fn i32(self, at: usize) -> Result<i32, CodecError> {
        self.array(at).map(i32::from_le_bytes)
    }

    pub(super) fn u64(self, at: usize) -> Result<u64, CodecError> {
        self.array(at).map(u64::from_le_bytes)
    }

    pub(super) fn i64(self, at: usize) -> Result<i64, CodecError> {
        self.array(at).map(i64::from_le_bytes)
    }

    /// The size of a structure from its field at `at`. Newer generations have longer structures.
    pub(super) fn struct_size(self, at: usize, least: u16) -> Result<usize, CodecError> {
        let found = self.u16(at)?;
        let size = (found >= least).then_some(usize::from(found));
        size.ok_or(CodecError::StructTooShort { kind: self.kind, found, least })
    }

    /// `rows` times `columns` values of `width` bytes from `start`. At most one row may be empty, because empty rows have no bytes
    /// that would limit their number.
    pub(super) fn values(self, start: usize, rows: u32, columns: u32, width: usize) -> Result<&'a [u8], CodecError> {
        let rest = self.bytes.get(start..).ok_or(CodecError::EndsEarly {
            kind: self.kind,
            at: start,
            found: self.bytes.len(),
        })?;
        let wanted = usize::try_from(u64::from(rows) * u64::from(columns)).ok().and_then(|n| n.checked_mul(width));
        let values = wanted.and_then(|wanted| rest.get(..wanted)).filter(|_| columns > 0 || rows <= 1);
        values.ok_or(CodecError::CountsTooLarge { kind: self.kind, rows, columns, found: rest.len() })
    }
}

/// The values of `rows` rows, each of `row_bytes`.
pub(super) fn rows(values: &[u8], rows: u32, row_bytes: usize) -> impl Iterator<Item = &[u8]> {
    (0..rows as usize).map(move |row| values.get(row * row_bytes..(row + 1) * row_bytes).unwrap_or_default())
}

/// Appends a frame to `out`: its size, then `word`, then what `body` appends.
pub(super) fn frame(word: u16, out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&word.to_le_bytes());
    body(out);
    // The frames of this program are far below 4 GiB; the reader would refuse a greater size.
    let size = u32::try_from(out.len() - start).unwrap_or(u32::MAX);
    if let Some(place) = out.get_mut(start..start + 4) {
        place.copy_from_slice(&size.to_le_bytes());
    }
}

/// Free space of the buffer before each read: fifty profiles of 1280 points.
const ROOM_BYTES: usize = 256 * 1024;
/// Size and type, the head of every frame.
const HEAD_BYTES: usize = 6;

/// Divides a byte stream into frames, each of which begins with its size.
#[derive(Debug)]
pub struct Splitter {
    bytes: Vec<u8>,
    /// Offset of the first frame that was not yet returned.
    start: usize,
    frame_bytes_max: usize,
}

impl Splitter {
    /// A splitter for frames of at most `frame_bytes_max` bytes.
    #[must_use]
    pub fn new(frame_bytes_max: usize) -> Self {
        Self { bytes: Vec::new(), start: 0, frame_bytes_max }
    }

    /// The buffer to which the next bytes are appended.
    pub fn room(&mut self) -> &mut Vec<u8> {
        if self.start > 0 {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.reserve(ROOM_BYTES);
        &mut self.bytes
    }

    /// The next complete frame, including its size; `None` if its last bytes have not been received yet.
    ///
    /// # Errors
    /// [`CodecError`] if the size is invalid. The stream can no longer be used, because the beginning of the next frame is unknown.
    pub fn next_frame(&mut self) -> Result<Option<&[u8]>, CodecError> {
        let waiting = self.bytes.get(self.start..).unwrap_or_default();
        let Some(head) = waiting.first_chunk::<4>() else { return Ok(None) };
        let size = u32::from_le_bytes(*head);
        if u64::from(size) > self.frame_bytes_max as u64 {
            return Err(CodecError::FrameTooLong { size: size.into(), limit: self.frame_bytes_max as u64 });
        }
        let size = size as usize;
        if size < HEAD_BYTES {
            return Err(CodecError::FrameTooShort { size: size as u64, least: HEAD_BYTES as u64 });
        }
        let Some(frame) = waiting.get(..size) else { return Ok(None) };
        self.start += size;
        Ok(Some(frame))
    }

    /// The capacity of the buffer, bytes.
    #[must_use]
    pub fn reserved_bytes(&self) -> usize {
        self.bytes.capacity()
    }
}

pub(super) const LAST: u16 = 0x8000;

pub(super) const fn flagged(kind: u16, last: bool) -> u16 {
    if last { kind | LAST } else { kind }
}

/// The form in which messages are written. Newer firmware has longer attributes; the decoder accepts every form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Generation {
    /// Firmware 4.
    #[default]
    Base,
    /// With the step of the stream, firmware 5.
    StreamStep,
    /// With the place in an array of sensors as well, firmware 5.3 and newer.
    Arrayed,
}

impl Generation {
    pub(super) const fn more_bytes(self) -> u16 {
        match self {
            Self::Base => 0,
            Self::StreamStep => 8,
            Self::Arrayed => 16,
        }
    }

    pub(super) fn encode(self, stream_step: i32, out: &mut Vec<u8>) {
        let attributes = [stream_step, 0, 1, 0];
        for attribute in attributes.iter().take(usize::from(self.more_bytes() / 4)) {
            out.extend_from_slice(&attribute.to_le_bytes());
        }
    }
}
