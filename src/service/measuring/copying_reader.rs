//! A reader that passes on every block that was read through it, in order, and the rest of the source when it is finished.

use std::io::{self, BufRead, ErrorKind, Read};
use std::mem;

/// Reading in large blocks needs fewer calls; a scan has megabytes.
pub(in crate::service) const READ_BLOCK_BYTES: usize = 256 << 10;

/// Reads `source` block by block. `hand_on` takes a block that was read and returns one to be filled, with any content.
pub(in crate::service) struct CopyingReader<R, F> {
    source: R,
    hand_on: F,
    block: Vec<u8>,
    read_count: usize,
    /// Reported by [`CopyingReader::finish`]; the reader's consumer only sees the end of the data.
    failure: Option<io::Error>,
}

impl<R: Read, F: FnMut(Vec<u8>) -> io::Result<Vec<u8>>> CopyingReader<R, F> {
    pub(in crate::service) fn new(source: R, hand_on: F) -> Self {
        Self { source, hand_on, block: Vec::new(), read_count: 0, failure: None }
    }

    /// Reads the rest of the source and passes it on.
    ///
    /// # Errors
    /// The first error of the source or of the receiver, including earlier ones.
    pub(in crate::service) fn finish(mut self) -> io::Result<()> {
        loop {
            match self.fill_buf().map(<[u8]>::len) {
                Ok(0) | Err(_) => return self.failure.map_or(Ok(()), Err),
                Ok(count) => self.consume(count),
            }
        }
    }

    /// The first error so far.
    pub(in crate::service) fn into_failure(self) -> Option<io::Error> {
        self.failure
    }

    fn next_block(&mut self) -> io::Result<()> {
        self.read_count = 0;
        let mut block = mem::take(&mut self.block);
        if !block.is_empty() {
            block = (self.hand_on)(block)?;
        }
        fill(&mut self.source, &mut block)?;
        self.block = block;
        Ok(())
    }
}

/// Fills a block completely; it is shorter only at the end of the source.
pub(in crate::service) fn fill(source: &mut impl Read, block: &mut Vec<u8>) -> io::Result<()> {
    block.resize(READ_BLOCK_BYTES, 0);
    let mut count = 0;
    while let Some(rest) = block.get_mut(count..).filter(|rest| !rest.is_empty()) {
        match source.read(rest) {
            Ok(0) => break,
            Ok(more) => count += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    block.truncate(count);
    Ok(())
}

impl<R: Read, F: FnMut(Vec<u8>) -> io::Result<Vec<u8>>> BufRead for CopyingReader<R, F> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.failure.is_none() && self.read_count >= self.block.len() {
            self.failure = self.next_block().err();
        }
        match &self.failure {
            Some(failure) => Err(failure.kind().into()),
            None => Ok(self.block.get(self.read_count..).unwrap_or_default()),
        }
    }

    fn consume(&mut self, count: usize) {
        self.read_count = self.read_count.saturating_add(count).min(self.block.len());
    }
}

impl<R: Read, F: FnMut(Vec<u8>) -> io::Result<Vec<u8>>> Read for CopyingReader<R, F> {
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

    /// Three and a half blocks, with content that does not repeat with the block length.
    fn content() -> Vec<u8> {
        (0..3 * READ_BLOCK_BYTES + 77).map(|i| (i % 251) as u8).collect()
    }

    #[test]
    fn every_byte_is_passed_on_once_even_if_the_reader_is_read_in_part() {
        let content = content();
        for read_bytes in [0, 1, READ_BLOCK_BYTES, READ_BLOCK_BYTES + 1, content.len()] {
            let mut handed_on = Vec::new();
            let mut reader = CopyingReader::new(content.as_slice(), |block: Vec<u8>| {
                handed_on.extend_from_slice(&block);
                Ok(block)
            });
            let mut read = vec![0; read_bytes];
            reader.read_exact(&mut read).expect("as many bytes");
            reader.finish().expect("finished");
            assert_eq!(read, content[..read_bytes]);
            assert_eq!(handed_on, content);
        }
    }

    #[test]
    fn an_error_of_the_receiver_ends_the_reading_and_is_reported_at_the_end() {
        let content = content();
        let mut reader = CopyingReader::new(content.as_slice(), |_| Err(io::Error::other("no room")));
        let error = io::copy(&mut reader, &mut io::sink()).expect_err("it fails");
        assert_ne!(error.to_string(), "no room");
        assert_eq!(reader.finish().expect_err("reported").to_string(), "no room");
    }
}
