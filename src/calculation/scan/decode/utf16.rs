//! Text in UTF-16 with its mark as UTF-8, block by block: spreadsheets save "Unicode text" so.

use std::io::{self, BufRead, Read};

/// Units that are taken at once.
const BLOCK_UNITS: usize = 1 << 13;

/// Whether text begins with the mark of UTF-16 (and not of UTF-32).
pub(super) fn has_mark(head: &[u8]) -> bool {
    head.starts_with(b"\xfe\xff") || (head.starts_with(b"\xff\xfe") && !head.starts_with(b"\xff\xfe\0\0"))
}

/// The ASCII characters of text with a mark; what is another character becomes `?`.
pub(super) fn ascii_of(head: &[u8]) -> Vec<u8> {
    let is_big = head.starts_with(b"\xfe\xff");
    let units = head.as_chunks::<2>().0.iter().skip(1).map(|unit| unit_of(*unit, is_big));
    units.map(|unit| u8::try_from(unit).ok().filter(u8::is_ascii).unwrap_or(b'?')).collect()
}

fn unit_of(bytes: [u8; 2], is_big: bool) -> u16 {
    if is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
}

/// A reader of UTF-8 over one of UTF-16. The mark comes out as that of UTF-8; what is no character comes out as U+FFFD.
pub(super) struct Utf8<'a> {
    inner: &'a mut dyn BufRead,
    is_big: bool,
    /// The first half of a pair that the last block ended with.
    half: Option<u16>,
    text: Vec<u8>,
    used: usize,
}

impl<'a> Utf8<'a> {
    /// From the mark on.
    pub(super) fn new(inner: &'a mut dyn BufRead) -> io::Result<Self> {
        let is_big = inner.fill_buf()?.starts_with(b"\xfe");
        Ok(Self { inner, is_big, half: None, text: Vec::new(), used: 0 })
    }

    fn next_block(&mut self) -> io::Result<()> {
        self.text.clear();
        self.used = 0;
        let mut bytes = Vec::new();
        Read::take(&mut *self.inner, 2 * BLOCK_UNITS as u64).read_to_end(&mut bytes)?;
        let (units, odd) = bytes.as_chunks::<2>();
        let mut units: Vec<u16> =
            self.half.take().into_iter().chain(units.iter().map(|unit| unit_of(*unit, self.is_big))).collect();
        // Between two blocks a pair may be torn; at the end of the file it is.
        let is_half = |unit: &u16| (0xd800..0xdc00).contains(unit);
        if bytes.len() == 2 * BLOCK_UNITS {
            self.half = units.pop_if(|unit| is_half(unit));
        }
        let characters = char::decode_utf16(units).map(|unit| unit.unwrap_or(char::REPLACEMENT_CHARACTER));
        let odd = odd.first().map(|_| char::REPLACEMENT_CHARACTER);
        let mut buffer = [0; 4];
        for character in characters.chain(odd) {
            self.text.extend_from_slice(character.encode_utf8(&mut buffer).as_bytes());
        }
        Ok(())
    }
}

impl BufRead for Utf8<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.used >= self.text.len() {
            self.next_block()?;
        }
        Ok(self.text.get(self.used..).unwrap_or_default())
    }

    fn consume(&mut self, count: usize) {
        self.used = self.used.saturating_add(count).min(self.text.len());
    }
}

impl Read for Utf8<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let mut bytes = self.fill_buf()?;
        let count = bytes.read(into)?;
        self.consume(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_comes_back_from_both_byte_orders_also_across_blocks() {
        let text: String = "x,µ,\u{1f600}\n".repeat(BLOCK_UNITS / 3);
        for is_big in [false, true] {
            let units = std::iter::once(0xfeff).chain(text.encode_utf16());
            let bytes: Vec<u8> =
                units.flat_map(|unit: u16| if is_big { unit.to_be_bytes() } else { unit.to_le_bytes() }).collect();
            assert!(has_mark(&bytes));
            let mut read = String::new();
            Utf8::new(&mut bytes.as_slice()).expect("begins").read_to_string(&mut read).expect("reads");
            assert_eq!(read.strip_prefix('\u{feff}'), Some(text.as_str()));
            let mut cut = Vec::new();
            Utf8::new(&mut &bytes[..bytes.len() - 1]).expect("begins").read_to_end(&mut cut).expect("reads");
            assert!(cut.ends_with("\u{fffd}".as_bytes()));
        }
        assert!(!has_mark(b"\xff\xfe\0\0x\0\0\0") && !has_mark(b"x\0"));
    }
}
