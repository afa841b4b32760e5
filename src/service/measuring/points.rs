//! Reads the points of a kept or uploaded file within the memory that is set aside for them, and hands them to a calculation.

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

/// A file of points, and what is known of it.
#[derive(Debug)]
pub(in crate::service) struct PointFile {
    pub(in crate::service) file: File,
    pub(in crate::service) bytes_count: u64,
    /// Points of it, where it was read before.
    pub(in crate::service) points_count: Option<u64>,
    /// Bytes as they were sent, where they were unpacked.
    pub(in crate::service) sent: Option<Sent>,
    pub(in crate::service) origin: Origin,
    pub(in crate::service) resolved: Resolved,
}

/// Where the points of a scan are.
#[derive(Debug)]
pub(in crate::service) enum Points {
    /// In memory that is set aside for them.
    Read(Box<ReadPoints>),
    /// In their file.
    InFile(Box<PointFile>),
}

/// Points that were read on the way, or why they cannot be.
#[derive(Debug)]
pub(in crate::service) struct ReadPoints {
    pub(in crate::service) decoded: Result<Decoded, DecodeError>,
    pub(in crate::service) claim: Claim,
}

/// What a calculation on points is given besides them.
#[derive(Debug)]
pub(in crate::service) struct Context<'a> {
    pub(in crate::service) stop: &'a Stop,
    /// When it began.
    pub(in crate::service) watch: Stopwatch,
}

/// What became of the reading of a file.
pub(in crate::service) enum Attempt<T, W> {
    /// It was read, or cannot be.
    Over(Result<T, ServiceError>),
    /// More has to be set aside.
    Outgrown(Box<PointFile>, W),
}

/// A file whose reading fails as soon as the calculation is told to stop.
struct StoppableFile<'a> {
    file: &'a File,
    stop: &'a Stop,
}

impl Read for StoppableFile<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.stop.is_stopped() {
            return Err(io::Error::other("the calculation was told to stop"));
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

    /// A file that was read before has as many points as then; of any other its length says more or less how many.
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
    fn a_file_is_not_read_on_once_its_points_are_not_wanted() {
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
        file.decode(&limits, &stop).expect_err("told to stop");
        std::fs::remove_file(path).expect("removed");
    }
}
