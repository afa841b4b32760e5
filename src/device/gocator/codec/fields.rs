//! Numbers at their places in a frame, and a frame from its parts.

use super::error::CodecError;

/// A frame's bytes.
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

    /// The size of a structure that has grown over the generations, as it says itself at `at`.
    pub(super) fn struct_size(self, at: usize, least: u16) -> Result<usize, CodecError> {
        let found = self.u16(at)?;
        let size = (found >= least).then_some(usize::from(found));
        size.ok_or(CodecError::StructTooShort { kind: self.kind, found, least })
    }

    /// `rows` times `columns` values of `width` bytes from `start`. Empty rows count nothing: there may be one.
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
    // Nothing of ours comes near 4 GiB; were it longer, the reader would refuse the size.
    let size = u32::try_from(out.len() - start).unwrap_or(u32::MAX);
    if let Some(place) = out.get_mut(start..start + 4) {
        place.copy_from_slice(&size.to_le_bytes());
    }
}
