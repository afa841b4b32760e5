//! The LZF compression of PCD files: bytes in, bytes out, never more than asked for.
//!
//! A control byte below 32 announces that many literals and one; any other a copy from what was already written:
//! three bits of length (7: the next byte adds to it) and thirteen bits of distance.

/// Most bytes that one byte of input can become: three make a copy of 264.
const RATIO_MAX: usize = 88;

/// Unpacks `packed` into exactly `size` bytes; `None` where it holds more, fewer, or nonsense.
pub(super) fn unpack(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    if size > packed.len().saturating_mul(RATIO_MAX) {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut input = packed.iter();
    while let Some(&control) = input.next() {
        let control = usize::from(control);
        if control < 32 {
            let rest = input.as_slice();
            out.extend_from_slice(rest.get(..=control)?);
            input = rest.get(control + 1..)?.iter();
        } else {
            let length = match control >> 5 {
                7 => 7 + usize::from(*input.next()?),
                length => length,
            } + 2;
            let distance = ((control & 0x1f) << 8) + usize::from(*input.next()?) + 1;
            copy_within(&mut out, distance, length)?;
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

/// Repeats `length` bytes from `distance` before the end; the two may overlap, which repeats a pattern.
fn copy_within(out: &mut Vec<u8>, distance: usize, length: usize) -> Option<()> {
    let start = out.len().checked_sub(distance)?;
    if distance >= length {
        out.extend_from_within(start..start + length);
    } else {
        for at in start..start + length {
            let byte = *out.get(at)?;
            out.push(byte);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_overlapping_copies_unpack() {
        // "abc", then 9 bytes from 3 back: the pattern three times more.
        let packed = [2, b'a', b'b', b'c', 7 << 5, 0, 2];
        assert_eq!(unpack(&packed, 12).as_deref(), Some(&b"abcabcabcabc"[..]));
        assert_eq!(unpack(&[0, b'x', 1 << 5, 0], 4).as_deref(), Some(&b"xxxx"[..]));
    }

    #[test]
    fn nonsense_is_refused() {
        assert_eq!(unpack(&[5, 1, 2], 6), None, "literals beyond the end");
        assert_eq!(unpack(&[0, 1, 32, 9], 4), None, "copy from before the start");
        assert_eq!(unpack(&[0, 1], 2), None, "too few");
        assert_eq!(unpack(&[1, 1, 1], 1), None, "too many");
        assert_eq!(unpack(&[0, 1], usize::MAX), None, "a size that no such input can have");
    }
}
