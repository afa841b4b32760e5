//! Memory that points may take. What a request can need is set aside before its file is read, so that many large requests at
//! once wait for each other instead of taking the memory of the machine.
//!
//! ```text
//! limits.memory_max_mb = 1/8 (at least 256 MiB) scans by the sensor + 1/4 uploads that are read while they come in + the rest
//! ```
//!
//! The shares are separate, so that a slow client cannot hold up a calculation, nor an upload the line's own scan.

use super::compute::ComputeError;
use crate::scan::decode::{DecodeError, Limits};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// What a point takes at most on its way from a file to a pose: 111 bytes were measured for double-precision points in no order.
const BYTES_PER_POINT: u64 = 128;
/// What a profile takes beside its points: its verdict, and the same as JSON.
const BYTES_PER_PROFILE: u64 = 640;
/// What a calculation takes whatever it calculates.
const BYTES_BESIDE: u64 = 32 << 20;
const MIB: u64 = 1 << 20;
/// For scans by the sensor at least: 1.3 million points.
const SENSOR_MIB_MIN: u64 = 256;
/// Bytes a point of a file of single-precision coordinates. Most text has more; packed formats and matrices may have fewer.
const FILE_BYTES_PER_POINT: u64 = 12;
/// What is set aside for the smallest file, points.
const POINTS_LEAST: usize = 100_000;
/// A file that held more points than were set aside for is read again with this many times as many: four readings reach the
/// largest scan from the smallest.
const MORE: usize = 6;
/// What a decoder may hold unpacked beside the points, bytes a point.
const UNPACKED_PER_POINT: u64 = 64;

/// A share of the memory.
#[derive(Debug, Clone)]
pub(in crate::service) struct Memory {
    free: Arc<Semaphore>,
    whole_mib: u32,
    /// Points for which all of it is enough, and no more than a scan may have.
    points_max: usize,
    profiles_max: usize,
    /// Whether a file for which it is too little has no other share to be read with.
    is_last: bool,
}

/// The shares.
#[derive(Debug)]
pub(in crate::service) struct MemoryShares {
    pub(in crate::service) sensor: Memory,
    pub(in crate::service) readers: Memory,
    pub(in crate::service) rest: Memory,
}

/// Memory that is set aside for one request.
#[derive(Debug)]
pub(in crate::service) struct Claim {
    permit: OwnedSemaphorePermit,
    points_max: usize,
    profiles_max: usize,
    /// Whether no file may have more points.
    is_most: bool,
}

impl MemoryShares {
    /// Of so many MiB, for scans within these limits.
    pub(in crate::service) fn of(whole_mib: u64, limits: &Limits) -> Self {
        let (sensor_mib, readers_mib) = ((whole_mib / 8).max(SENSOR_MIB_MIN), whole_mib / 4);
        Self {
            sensor: Memory::new(sensor_mib, limits, true),
            readers: Memory::new(readers_mib, limits, false),
            rest: Memory::new(whole_mib.saturating_sub(sensor_mib + readers_mib), limits, true),
        }
    }

    /// What is set aside now, bytes.
    pub(in crate::service) fn taken_bytes(&self) -> u64 {
        [&self.sensor, &self.readers, &self.rest].map(Memory::taken_bytes).iter().sum()
    }
}

impl Memory {
    fn new(whole_mib: u64, limits: &Limits, is_last: bool) -> Self {
        let whole_mib = u32::try_from(whole_mib).unwrap_or(u32::MAX);
        let (mut points_max, profiles_max) = (limits.points_max, limits.profiles_max);
        if need_mib(points_max, profiles_max) > whole_mib {
            let left = (u64::from(whole_mib) * MIB).saturating_sub(BYTES_BESIDE);
            let (profiles, all) = (wide(profiles_max), left / (BYTES_PER_POINT + BYTES_PER_PROFILE));
            let points = if all <= profiles { all } else { (left - profiles * BYTES_PER_PROFILE) / BYTES_PER_POINT };
            points_max = usize::try_from(points).unwrap_or(usize::MAX);
        }
        let free = Arc::new(Semaphore::new(usize::try_from(whole_mib).unwrap_or(Semaphore::MAX_PERMITS)));
        Self { free, whole_mib, points_max, profiles_max, is_last }
    }

    /// Sets aside what so many points need, as soon as it is free.
    pub(in crate::service) async fn claim(&self, points_count: usize) -> Result<Claim, ComputeError> {
        let points_max = self.within(points_count);
        let free = Arc::clone(&self.free).acquire_many_owned(self.need_mib(points_max)).await;
        // It is never closed; should it be, nobody can be served.
        free.map(|permit| self.claimed(permit, points_max)).map_err(|_| ComputeError::Panicked)
    }

    /// The same at once; `None` where it is not free.
    pub(in crate::service) fn try_claim(&self, points_count: usize) -> Option<Claim> {
        let points_max = self.within(points_count);
        let free = Arc::clone(&self.free).try_acquire_many_owned(self.need_mib(points_max)).ok()?;
        Some(self.claimed(free, points_max))
    }

    /// Sets aside all that is free, unless that is less than a quarter of the share.
    pub(in crate::service) fn claim_free(&self) -> Option<Claim> {
        let quarters = [4, 3, 2, 1].map(|quarters| self.points_max / 4 * quarters);
        quarters.into_iter().find_map(|points_count| self.try_claim(points_count))
    }

    fn taken_bytes(&self) -> u64 {
        u64::from(self.whole_mib).saturating_sub(wide(self.free.available_permits())) * MIB
    }

    fn within(&self, points_count: usize) -> usize {
        points_count.max(POINTS_LEAST).min(self.points_max)
    }

    fn need_mib(&self, points_count: usize) -> u32 {
        need_mib(points_count, self.profiles_max).min(self.whole_mib)
    }

    fn claimed(&self, permit: OwnedSemaphorePermit, points_max: usize) -> Claim {
        let is_most = self.is_last && points_max >= self.points_max;
        Claim { permit, points_max, profiles_max: self.profiles_max, is_most }
    }
}

impl Claim {
    /// What may be read within it.
    pub(in crate::service) fn limits(&self, limits: &Limits) -> Limits {
        let inflated_bytes_max = limits.inflated_bytes_max.min(UNPACKED_PER_POINT * wide(self.points_max));
        Limits { points_max: self.points_max, inflated_bytes_max, ..limits.clone() }
    }

    /// Whether a file was refused only because less was set aside than may be.
    pub(in crate::service) fn is_outgrown(&self, error: &DecodeError) -> bool {
        !self.is_most && matches!(error, DecodeError::TooManyPoints { .. } | DecodeError::InflatedTooLarge { .. })
    }

    /// How many points to claim for after this claim was too small.
    pub(in crate::service) fn more(&self) -> usize {
        self.points_max.saturating_mul(MORE)
    }

    /// Gives back what so many points do not need.
    pub(in crate::service) fn keep_for(&mut self, points_count: usize) {
        let needed = usize::try_from(need_mib(points_count, self.profiles_max)).unwrap_or(usize::MAX);
        let unneeded = self.permit.num_permits().saturating_sub(needed);
        drop(self.permit.split(unneeded));
    }
}

/// How many points a file of so many bytes is expected to hold.
pub(in crate::service) fn points_expected(bytes_count: u64) -> usize {
    usize::try_from(bytes_count / FILE_BYTES_PER_POINT).unwrap_or(usize::MAX)
}

fn need_mib(points_count: usize, profiles_max: usize) -> u32 {
    let profiles_count = wide(points_count.min(profiles_max));
    let points = wide(points_count).saturating_mul(BYTES_PER_POINT);
    let bytes = points.saturating_add(profiles_count.saturating_mul(BYTES_PER_PROFILE)).saturating_add(BYTES_BESIDE);
    u32::try_from(bytes.div_ceil(MIB)).unwrap_or(u32::MAX)
}

fn wide(count: usize) -> u64 {
    u64::try_from(count).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_default_there_is_room_for_the_largest_scan_that_may_be() {
        let limits = Limits::default();
        let shares = MemoryShares::of(crate::config::Config::default().limits.memory_max_mb, &limits);
        assert_eq!(shares.rest.points_max, limits.points_max);
        assert!(shares.readers.points_max > 7_000_000, "{}", shares.readers.points_max);
        assert!(shares.sensor.points_max > 3_000_000, "{}", shares.sensor.points_max);
    }

    #[tokio::test]
    async fn what_is_not_free_is_waited_for_and_what_is_not_needed_is_given_back() {
        let limits = Limits::default();
        let memory = MemoryShares::of(1024, &limits).rest;
        let mut whole = memory.claim(usize::MAX).await.expect("free");
        assert_eq!(memory.taken_bytes(), u64::from(whole.permit.num_permits() as u32) * MIB);
        assert!(memory.taken_bytes() > 500 * MIB, "all but a remainder");
        assert!(memory.try_claim(1_000_000).is_none(), "nothing is free");
        whole.keep_for(1_000_000);
        assert_eq!(memory.taken_bytes(), 216 * MIB, "122 for the points, 61 for the profiles, 32 beside");
        let second = memory.try_claim(1_000_000).expect("free again");
        assert!(memory.try_claim(2_000_000).is_none());
        drop((whole, second));
        assert_eq!(memory.taken_bytes(), 0);
    }

    #[tokio::test]
    async fn a_scan_by_the_sensor_takes_what_is_free_but_no_less_than_a_quarter() {
        let memory = MemoryShares::of(4096, &Limits::default()).sensor;
        let first = memory.claim_free().expect("all");
        assert!(first.is_most);
        assert!(memory.claim_free().is_none(), "the first one may need all");
        let mut first = first;
        first.keep_for(500_000);
        let second = memory.claim_free().expect("half");
        assert!(!second.is_most && second.points_max > 1_000_000, "{}", second.points_max);
    }

    #[tokio::test]
    async fn a_file_that_holds_more_than_was_expected_is_known_by_its_refusal() {
        let limits = Limits { points_max: 1_000_000, ..Limits::default() };
        let memory = MemoryShares::of(4096, &limits).rest;
        let refused = DecodeError::TooManyPoints { limit: 0 };
        assert!(memory.claim(points_expected(4_000_000)).await.expect("free").is_outgrown(&refused));
        assert!(!memory.claim(usize::MAX).await.expect("free").is_outgrown(&refused), "no scan may have more");
        let reader = MemoryShares::of(4096, &limits).readers.try_claim(usize::MAX).expect("free");
        assert!(reader.is_outgrown(&refused), "it can be read later");
        assert!(!memory.claim(0).await.expect("free").is_outgrown(&DecodeError::Empty));
        // Also where next to nothing was expected, the next claim is larger.
        assert_eq!(memory.claim(0).await.expect("free").more(), 600_000);
    }
}
