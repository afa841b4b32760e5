//! A stream of bytes into frames. Bytes are read straight into [`Splitter::room`]; frames come out borrowed. The buffer grows
//! as bytes come and never on the word of a length.

use super::error::CodecError;

/// Bytes that a read has room for: fifty profiles of 1280 points.
const ROOM_BYTES: usize = 256 * 1024;
/// Size and type, which every frame has.
const HEAD_BYTES: usize = 6;

/// Cuts a stream into frames, each of which begins with its size.
#[derive(Debug)]
pub struct Splitter {
    bytes: Vec<u8>,
    /// Where the first frame that was not handed out begins.
    start: usize,
    frame_bytes_max: usize,
}

impl Splitter {
    /// For frames of at most `frame_bytes_max` bytes.
    #[must_use]
    pub fn new(frame_bytes_max: usize) -> Self {
        Self { bytes: Vec::new(), start: 0, frame_bytes_max }
    }

    /// Where the next bytes are to be appended.
    pub fn room(&mut self) -> &mut Vec<u8> {
        if self.start > 0 {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.reserve(ROOM_BYTES);
        &mut self.bytes
    }

    /// The next whole frame, its size included; `None` where its last bytes are still to come.
    ///
    /// # Errors
    /// [`CodecError`] where the size cannot be. The stream is lost then: nobody knows where the next frame begins.
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

    /// Bytes that the buffer holds room for.
    #[must_use]
    pub fn reserved_bytes(&self) -> usize {
        self.bytes.capacity()
    }
}
