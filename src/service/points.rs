//! Reads the points of a kept or uploaded file within the memory that is set aside for them, and hands them to a calculation.

use super::Service;
use super::clock::Stopwatch;
use super::compute::{Compute, Place};
use super::error::ServiceError;
use super::measure::{Decoded, MeasureError};
use super::memory::{Claim, points_expected};
use super::recipe::Resolved;
use super::scans::Origin;
use super::tee::READ_BLOCK_BYTES;
use crate::estimation::Stop;
use crate::scan::decode::{DecodeError, Limits, Sent};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek};

/// A file of points, and what is known of it.
#[derive(Debug)]
pub(super) struct PointFile {
    pub(super) file: File,
    pub(super) bytes_count: u64,
    /// Points of it, where it was read before.
    pub(super) points_count: Option<u64>,
    /// Bytes as they were sent, where they were unpacked.
    pub(super) sent: Option<Sent>,
    pub(super) origin: Origin,
    pub(super) resolved: Resolved,
}

/// Where the points of a scan are.
#[derive(Debug)]
pub(super) enum Points {
    /// In memory that is set aside for them.
    Read(Box<ReadPoints>),
    /// In their file.
    InFile(Box<PointFile>),
}

/// Points that were read on the way, or why they cannot be.
#[derive(Debug)]
pub(super) struct ReadPoints {
    pub(super) decoded: Result<Decoded, DecodeError>,
    pub(super) claim: Claim,
}

/// What a calculation on points is given besides them.
#[derive(Debug)]
pub(super) struct Context<'a> {
    pub(super) stop: &'a Stop,
    /// When it began.
    pub(super) watch: Stopwatch,
}

/// What became of the reading of a file.
enum Attempt<T, W> {
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
    fn decode(&mut self, limits: &Limits, stop: &Stop) -> Result<Decoded, DecodeError> {
        self.file.rewind()?;
        let mut reader = BufReader::with_capacity(READ_BLOCK_BYTES, StoppableFile { file: &self.file, stop });
        super::measure::read(&mut reader, &self.origin.claims(), &self.resolved, limits, self.sent.as_ref())
    }

    /// A file that was read before has as many points as then; of any other its length says more or less how many.
    fn points_expected(&self) -> usize {
        let known = self.points_count.map_or(0, |count| usize::try_from(count).unwrap_or(usize::MAX));
        known.max(points_expected(self.bytes_count))
    }
}

impl Service {
    /// Has `work` done on points when it is the turn of `place` and there is memory for them: first what a file of this size mostly
    /// needs, and where it needs more, [`Claim::more`] until that is what any file may need.
    pub(super) async fn with_points<T: Send + 'static>(
        &self,
        (queue, place): (&Compute, Place),
        points: Points,
        work: impl FnOnce(Decoded, &Context<'_>) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let clock = self.clock;
        let (mut file, mut work) = match points {
            Points::InFile(file) => (file, work),
            Points::Read(read) => {
                let ReadPoints { decoded, claim } = *read;
                let work = move |stop: &Stop| {
                    let _claim = claim;
                    work(decoded.map_err(MeasureError::from)?, &Context { stop, watch: clock.start() })
                };
                return queue.run_in(queue.take_turn(&place).await?, work).await?;
            }
        };
        let mut points_count = file.points_expected();
        loop {
            // The turn first: memory of this share is then given back without waiting for anything else.
            let turn = queue.take_turn(&place).await?;
            let mut claim = self.memory.rest.claim(points_count).await?;
            let (limits, more) = (claim.limits(&self.capacity.scan), claim.more());
            let attempt = move |stop: &Stop| {
                let context = Context { stop, watch: clock.start() };
                match file.decode(&limits, stop) {
                    Err(error) if claim.is_outgrown(&error) => Attempt::Outgrown(file, work),
                    Err(error) => Attempt::Over(Err(MeasureError::from(error).into())),
                    Ok(decoded) => {
                        claim.keep_for(decoded.cloud.columns.len());
                        Attempt::Over(work(decoded, &context))
                    }
                }
            };
            match queue.run_in(turn, attempt).await? {
                Attempt::Over(outcome) => return outcome,
                Attempt::Outgrown(back, again) => {
                    (file, work, points_count) = (back, again, more);
                }
            }
        }
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
