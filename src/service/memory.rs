//! Memory for points. The maximum that a request can need is reserved before its file is read, so that many large requests at
//! once wait for each other instead of exhausting the memory of the machine.
//!
//! ```text
//! limits.memory_max_mb = 1/8 (at least 256 MiB) scans by the sensor + 1/4 uploads that are read on arrival + the rest
//! ```
//!
//! The shares are separate, so that a slow client cannot delay a calculation, nor an upload the scans of the sensor.

use super::compute::ComputeError;
use crate::scan::decode::{DecodeError, Limits};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Maximum memory per point from file to pose: 111 bytes were measured for double-precision points in random order.
const BYTES_PER_POINT: u64 = 128;
/// Memory per profile besides its points: its verdict, and the same as JSON.
const BYTES_PER_PROFILE: u64 = 640;
/// Fixed memory of a calculation.
const BYTES_BESIDE: u64 = 32 << 20;
const MIB: u64 = 1 << 20;
/// Minimum share for scans by the sensor: 1.3 million points.
const SENSOR_MIB_MIN: u64 = 256;
/// Bytes per point of a file of single-precision coordinates. Most text has more; compressed formats and matrices may have fewer.
const FILE_BYTES_PER_POINT: u64 = 12;
/// Points reserved for the smallest file.
const POINTS_LEAST: usize = 100_000;
/// A file with more points than were reserved is read again with this factor: four attempts reach the largest scan from the
/// smallest.
const MORE: usize = 6;
/// Maximum decompressed data that a decoder keeps besides the points, bytes per point.
const UNPACKED_PER_POINT: u64 = 64;

/// A share of the memory.
#[derive(Debug, Clone)]
pub(in crate::service) struct Memory {
    free: Arc<Semaphore>,
    whole_mib: u32,
    /// Points that the share is sufficient for, limited to the maximum of a scan.
    points_max: usize,
    profiles_max: usize,
    /// Whether a file that does not fit cannot be read with another share.
    is_last: bool,
}

/// The shares.
#[derive(Debug)]
pub(in crate::service) struct MemoryShares {
    pub(in crate::service) sensor: Memory,
    pub(in crate::service) readers: Memory,
    pub(in crate::service) rest: Memory,
}

/// Memory reserved for one request.
#[derive(Debug)]
pub(in crate::service) struct Claim {
    permit: OwnedSemaphorePermit,
    points_max: usize,
    profiles_max: usize,
    /// Whether no file may have more points.
    is_most: bool,
}

impl MemoryShares {
    /// Divides `whole_mib` MiB for scans within these limits.
    pub(in crate::service) fn of(whole_mib: u64, limits: &Limits) -> Self {
        let (sensor_mib, readers_mib) = ((whole_mib / 8).max(SENSOR_MIB_MIN), whole_mib / 4);
        Self {
            sensor: Memory::new(sensor_mib, limits, true),
            readers: Memory::new(readers_mib, limits, false),
            rest: Memory::new(whole_mib.saturating_sub(sensor_mib + readers_mib), limits, true),
        }
    }

    /// Memory reserved now, bytes.
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

    /// Reserves memory for this many points as soon as it is free.
    pub(in crate::service) async fn claim(&self, points_count: usize) -> Result<Claim, ComputeError> {
        let points_max = self.within(points_count);
        let free = Arc::clone(&self.free).acquire_many_owned(self.need_mib(points_max)).await;
        // The semaphore is never closed; if it were, no request could be served.
        free.map(|permit| self.claimed(permit, points_max)).map_err(|_| ComputeError::Panicked)
    }

    /// Reserves at once, or returns `None` if the memory is not free.
    pub(in crate::service) fn try_claim(&self, points_count: usize) -> Option<Claim> {
        let points_max = self.within(points_count);
        let free = Arc::clone(&self.free).try_acquire_many_owned(self.need_mib(points_max)).ok()?;
        Some(self.claimed(free, points_max))
    }

    /// Reserves all free memory, unless that is less than a quarter of the share.
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
    /// The limits for reading within this reservation.
    pub(in crate::service) fn limits(&self, limits: &Limits) -> Limits {
        let inflated_bytes_max = limits.inflated_bytes_max.min(UNPACKED_PER_POINT * wide(self.points_max));
        Limits { points_max: self.points_max, inflated_bytes_max, ..limits.clone() }
    }

    /// Whether a file was refused only because less was reserved than is allowed.
    pub(in crate::service) fn is_outgrown(&self, error: &DecodeError) -> bool {
        !self.is_most && matches!(error, DecodeError::TooManyPoints { .. } | DecodeError::InflatedTooLarge { .. })
    }

    /// How many points to reserve after this reservation was too small.
    pub(in crate::service) fn more(&self) -> usize {
        self.points_max.saturating_mul(MORE)
    }

    /// Releases the memory that this many points do not need.
    pub(in crate::service) fn keep_for(&mut self, points_count: usize) {
        let needed = usize::try_from(need_mib(points_count, self.profiles_max)).unwrap_or(usize::MAX);
        let unneeded = self.permit.num_permits().saturating_sub(needed);
        drop(self.permit.split(unneeded));
    }
}

/// How many points a file of this size is expected to contain.
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
    fn the_default_memory_is_sufficient_for_the_largest_allowed_scan() {
        let limits = Limits::default();
        let shares = MemoryShares::of(crate::config::Config::default().limits.memory_max_mb, &limits);
        assert_eq!(shares.rest.points_max, limits.points_max);
        assert!(shares.readers.points_max > 7_000_000, "{}", shares.readers.points_max);
        assert!(shares.sensor.points_max > 3_000_000, "{}", shares.sensor.points_max);
    }

    #[tokio::test]
    async fn a_claim_waits_for_memory_and_releases_what_it_does_not_need() {
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
    async fn a_scan_by_the_sensor_claims_all_free_memory_but_at_least_a_quarter() {
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
    async fn a_file_with_more_points_than_expected_is_recognised_by_its_refusal() {
        let limits = Limits { points_max: 1_000_000, ..Limits::default() };
        let memory = MemoryShares::of(4096, &limits).rest;
        let refused = DecodeError::TooManyPoints { limit: 0 };
        assert!(memory.claim(points_expected(4_000_000)).await.expect("free").is_outgrown(&refused));
        assert!(!memory.claim(usize::MAX).await.expect("free").is_outgrown(&refused), "no scan may have more");
        let reader = MemoryShares::of(4096, &limits).readers.try_claim(usize::MAX).expect("free");
        assert!(reader.is_outgrown(&refused), "it can be read later");
        assert!(!memory.claim(0).await.expect("free").is_outgrown(&DecodeError::Empty));
        // The next reservation is larger even if next to nothing was expected.
        assert_eq!(memory.claim(0).await.expect("free").more(), 600_000);
    }
}
