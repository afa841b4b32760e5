//! Lines of text from a reader, one at a time in one buffer, none longer than allowed. Text in UTF-16 with a byte order mark, which
//! spreadsheets write as "Unicode text", is converted to UTF-8 block by block.

use super::error::DecodeError;
use super::limits::Limits;
use std::io::{self, BufRead, Read};

/// A reader that returns lines.
pub(super) struct Lines<'a> {
    reader: &'a mut dyn BufRead,
    buffer: Vec<u8>,
    number: u64,
    bytes_max: usize,
    /// The byte that ends a line.
    end: u8,
}

impl<'a> Lines<'a> {
    /// From the reader's current position.
    pub(super) fn new(reader: &'a mut dyn BufRead, limits: &Limits) -> Self {
        Self { reader, buffer: Vec::new(), number: 0, bytes_max: limits.line_bytes_max, end: b'\n' }
    }

    /// The same for text in which lines may end with CR alone, as old programs write it: the first line decides.
    pub(super) fn of_text(reader: &'a mut dyn BufRead, limits: &Limits) -> Result<Self, DecodeError> {
        let end = end_of_lines(reader.fill_buf()?);
        Ok(Self { end, ..Self::new(reader, limits) })
    }

    /// The same for a file with a text header, whatever follows it: its lines end with CR alone if the first line does.
    pub(super) fn of_header(reader: &'a mut dyn BufRead, limits: &Limits) -> Result<Self, DecodeError> {
        let head = reader.fill_buf()?;
        let first_end = head.iter().position(|byte| matches!(byte, b'\r' | b'\n')).and_then(|at| head.get(at..at + 2));
        let is_cr = matches!(first_end, Some([b'\r', behind]) if *behind != b'\n');
        Ok(Self { end: if is_cr { b'\r' } else { b'\n' }, ..Self::new(reader, limits) })
    }

    /// Whether only NUL, Ctrl-Z and blanks follow, with which some programs pad a file; all of them are then skipped. The check is
    /// made only if NUL or Ctrl-Z is next.
    ///
    /// # Errors
    /// [`DecodeError::NotText`] if other bytes follow a NUL.
    pub(super) fn is_padding(&mut self) -> Result<bool, DecodeError> {
        if !self.reader.fill_buf()?.first().is_some_and(|byte| is_fill(*byte)) {
            return Ok(false);
        }
        loop {
            let bytes = self.reader.fill_buf()?;
            if bytes.is_empty() {
                return Ok(true);
            }
            let used = bytes.iter().take_while(|byte| is_fill(**byte) || byte.is_ascii_whitespace()).count();
            if used < bytes.len() {
                return Err(DecodeError::NotText { line: self.number + 1 });
            }
            self.reader.consume(used);
        }
    }

    /// The number of the last returned line, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// The next line without its end (LF or CR LF, or CR if lines end so) and, for the first line, without a byte order mark;
    /// `None` at the end.
    pub(super) fn next_line(&mut self) -> Result<Option<&[u8]>, DecodeError> {
        self.buffer.clear();
        let read = self.reader.take(self.bytes_max as u64 + 2).read_until(self.end, &mut self.buffer)?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        let line = self.last_line();
        if line.len() > self.bytes_max {
            return Err(DecodeError::LineTooLong { line: self.number, limit: self.bytes_max });
        }
        Ok(Some(line))
    }

    /// The last returned line again.
    pub(super) fn last_line(&self) -> &[u8] {
        let mut line = self.buffer.as_slice();
        line = line.strip_suffix(b"\n").unwrap_or(line);
        line = line.strip_suffix(b"\r").unwrap_or(line);
        if self.number == 1 {
            line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
        }
        line
    }

    /// Whether the last returned line had an end.
    pub(super) fn has_end(&self) -> bool {
        self.buffer.last() == Some(&self.end)
    }

    /// The underlying reader, at the start of the next line.
    pub(super) fn into_reader(self) -> &'a mut dyn BufRead {
        self.reader
    }
}

/// Whether a byte is padding at the end of a file.
pub(super) fn is_fill(byte: u8) -> bool {
    matches!(byte, 0 | 0x1a)
}

/// CR if it ends the first line of a text and no LF follows nearby, otherwise LF.
fn end_of_lines(head: &[u8]) -> u8 {
    let behind_cr = head.iter().position(|byte| *byte == b'\r').and_then(|at| head.get(at + 1));
    if behind_cr.is_some_and(|byte| *byte != b'\r') && !head.contains(&b'\n') { b'\r' } else { b'\n' }
}

/// The fields of a line that blanks separate.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}

/// Text of a word; empty if it is not UTF-8.
pub(super) fn text(word: &[u8]) -> &str {
    str::from_utf8(word).unwrap_or_default()
}

/// Number of UTF-16 units that are converted at once.
const BLOCK_UNITS: usize = 1 << 13;

/// Whether text begins with the mark of UTF-16 (and not of UTF-32).
pub(super) fn has_mark(head: &[u8]) -> bool {
    head.starts_with(b"\xfe\xff") || (head.starts_with(b"\xff\xfe") && !head.starts_with(b"\xff\xfe\0\0"))
}

/// The ASCII characters of text with a byte order mark; other characters become `?`.
pub(super) fn ascii_of(head: &[u8]) -> Vec<u8> {
    let is_big = head.starts_with(b"\xfe\xff");
    let units = head.as_chunks::<2>().0.iter().skip(1).map(|unit| unit_of(*unit, is_big));
    units.map(|unit| u8::try_from(unit).ok().filter(u8::is_ascii).unwrap_or(b'?')).collect()
}

fn unit_of(bytes: [u8; 2], is_big: bool) -> u16 {
    if is_big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
}

/// Converts a reader of UTF-16 to UTF-8. The byte order mark becomes that of UTF-8; an invalid character becomes U+FFFD.
pub(super) struct Utf8<'a> {
    inner: &'a mut dyn BufRead,
    is_big: bool,
    /// The first half of a surrogate pair at the end of the last block.
    half: Option<u16>,
    text: Vec<u8>,
    used: usize,
}

impl<'a> Utf8<'a> {
    /// Starts at the byte order mark.
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
        // A surrogate pair may be split between two blocks; at the end of the file it is incomplete.
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
    fn line_ends_and_the_byte_order_mark_are_removed() {
        let mut bytes: &[u8] = b"\xef\xbb\xbfa\r\n\nb";
        let limits = Limits::default();
        let mut lines = Lines::new(&mut bytes, &limits);
        assert_eq!(lines.next_line().expect("reads"), Some(&b"a"[..]));
        assert_eq!(lines.next_line().expect("reads"), Some(&b""[..]));
        assert_eq!(lines.next_line().expect("reads"), Some(&b"b"[..]));
        assert_eq!(lines.next_line().expect("reads"), None);
    }

    #[test]
    fn lines_may_end_with_cr_alone() {
        let limits = Limits::default();
        for (text, expected) in [("a\rb\r", vec!["a", "b"]), ("a\r\nb", vec!["a", "b"]), ("a\rb\nc", vec!["a\rb", "c"])]
        {
            let mut bytes = text.as_bytes();
            let mut lines = Lines::of_text(&mut bytes, &limits).expect("reads");
            let mut found = Vec::new();
            while let Some(line) = lines.next_line().expect("reads") {
                found.push(String::from_utf8_lossy(line).into_owned());
            }
            assert_eq!(found, expected, "{text:?}");
        }
    }

    #[test]
    fn a_header_may_end_its_lines_with_cr_alone_before_any_bytes() {
        let limits = Limits::default();
        for (text, first, rest) in [("ply\rend\r\n\n", "ply", "\n\n"), ("ply\r\nend\r\n\n", "ply", "\n")] {
            let mut bytes = text.as_bytes();
            let mut lines = Lines::of_header(&mut bytes, &limits).expect("reads");
            assert_eq!(lines.next_line().expect("reads"), Some(first.as_bytes()));
            assert_eq!(lines.next_line().expect("reads"), Some(&b"end"[..]));
            assert_eq!(lines.into_reader().fill_buf().expect("reads"), rest.as_bytes(), "{text:?}");
        }
    }

    #[test]
    fn padding_is_skipped_at_the_end_only() {
        let limits = Limits::default();
        for (text, is_padding) in [("\0\0\n\0 ", true), (" \0", false), ("\u{1a}", true), ("", false)] {
            let mut bytes = text.as_bytes();
            assert_eq!(Lines::new(&mut bytes, &limits).is_padding().expect("reads"), is_padding, "{text:?}");
        }
        let error = Lines::new(&mut &b"\0\0\n1"[..], &limits).is_padding().expect_err("text after NUL");
        assert_eq!(error.code(), "not_text");
    }

    #[test]
    fn a_line_without_an_end_is_refused() {
        let mut bytes: &[u8] = &[b'7'; 100];
        let limits = Limits { line_bytes_max: 50, ..Limits::default() };
        let error = Lines::new(&mut bytes, &limits).next_line().expect_err("too long");
        assert!(matches!(error, DecodeError::LineTooLong { line: 1, limit: 50 }));
    }
}

#[cfg(test)]
mod utf16_tests {
    use super::*;

    #[test]
    fn text_is_converted_from_both_byte_orders_and_across_blocks() {
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
