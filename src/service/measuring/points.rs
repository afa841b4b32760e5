//! Reads the points of a stored or uploaded file within the memory reserved for them, and passes them to a calculation.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek};

use super::order::Origin;
use crate::estimation::Stop;
use crate::scan::decode::{DecodeError, Limits, Sent};
use crate::service::clock::Stopwatch;
use crate::service::error::ServiceError;
use crate::service::memory::{Claim, points_expected};

use super::copying_reader::READ_BLOCK_BYTES;
use super::pipeline::Decoded;
use super::recipe::Resolved;

/// A file of points, and its known properties.
#[derive(Debug)]
pub(in crate::service) struct PointFile {
    pub(in crate::service) file: File,
    pub(in crate::service) bytes_count: u64,
    /// Number of its points, if it was read before.
    pub(in crate::service) points_count: Option<u64>,
    /// Count of the bytes as sent, if they were decompressed.
    pub(in crate::service) sent: Option<Sent>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) resolved: Resolved,
}

/// Location of the points of a scan.
#[derive(Debug)]
pub(in crate::service) enum Points {
    /// In reserved memory.
    Read(Box<ReadPoints>),
    /// In their file.
    InFile(Box<PointFile>),
}

/// Points that were read during the upload, or why they cannot be read.
#[derive(Debug)]
pub(in crate::service) struct ReadPoints {
    pub(in crate::service) decoded: Result<Decoded, DecodeError>,
    pub(in crate::service) claim: Claim,
}

/// Context of a calculation on points.
#[derive(Debug)]
pub(in crate::service) struct Context<'a> {
    pub(in crate::service) stop: &'a Stop,
    /// Running since its start.
    pub(in crate::service) watch: Stopwatch,
}

/// Result of an attempt to read a file.
pub(in crate::service) enum Attempt<T, W> {
    /// The final result: it was read, or it cannot be read.
    Over(Result<T, ServiceError>),
    /// More memory has to be reserved.
    Outgrown(Box<PointFile>, W),
}

/// A file whose reading fails as soon as the calculation is stopped.
struct StoppableFile<'a> {
    file: &'a File,
    stop: &'a Stop,
}

impl Read for StoppableFile<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.stop.is_stopped() {
            return Err(io::Error::other("the calculation was stopped"));
        }
        self.file.read(buffer)
    }
}

impl PointFile {
    pub(in crate::service) fn decode(&mut self, limits: &Limits, stop: &Stop) -> Result<Decoded, DecodeError> {
        self.file.rewind()?;
        let mut reader = BufReader::with_capacity(READ_BLOCK_BYTES, StoppableFile { file: &self.file, stop });
        super::pipeline::read(&mut reader, &self.origin.claims(), &self.resolved, limits, self.sent.as_ref())
    }

    /// The number of points from an earlier reading; otherwise an estimate from the file's length.
    pub(in crate::service) fn points_expected(&self) -> usize {
        let known = self.points_count.map_or(0, |count| usize::try_from(count).unwrap_or(usize::MAX));
        known.max(points_expected(self.bytes_count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Settings;
    use crate::service::Recipe;

    #[test]
    fn the_reading_of_a_file_stops_with_its_calculation() {
        let path = std::env::temp_dir().join(format!("coaxis-points-{}", std::process::id()));
        std::fs::write(&path, "0,1,2\n0,2,3\n1,1,2\n").expect("written");
        let mut file = PointFile {
            file: File::open(&path).expect("there"),
            bytes_count: 18,
            points_count: None,
            sent: None,
            origin: Origin::default(),
            resolved: Recipe::default().resolve(&Settings::default()).expect("the defaults hold"),
        };
        let (limits, stop) = (Limits::default(), Stop::default());
        assert_eq!(file.decode(&limits, &stop).expect("read").cloud.columns.len(), 3);
        stop.stop();
        file.decode(&limits, &stop).expect_err("stopped");
        std::fs::remove_file(path).expect("removed");
    }
}
