//! What a simulated sensor sees: profiles in its own coordinates, as they fall due.

use super::super::extrinsic::Placement;
use crate::device::Pending;
use crate::scan::Scan;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// Ticks of the sensor's clock in a second.
const CLOCK_HZ: f64 = 1.024e6;

/// One profile as the sensor takes it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Taken {
    /// Ticks of the encoder.
    pub encoder: i64,
    /// Ticks of the sensor's clock.
    pub timestamp: u64,
    /// (x, z) in the sensor's coordinates, mm, along the laser line; `None` where nothing is seen.
    pub points: Vec<Option<[f64; 2]>>,
}

/// Where a sensor's profiles come from.
pub trait Source: Send {
    /// A scan begins, from its first profile.
    fn begin(&mut self);

    /// The next profile when it is due; `None` where no more will come.
    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>>;
}

/// The profiles of a scan, again at every start.
#[derive(Debug)]
pub struct ScanSource {
    profiles: Vec<Arc<Taken>>,
    next: usize,
    rate_hz: Option<f64>,
    began_at: Option<Instant>,
}

impl ScanSource {
    /// At so many profiles a second; as fast as they are taken where nothing is said.
    #[must_use]
    pub fn new(profiles: Vec<Taken>, rate_hz: Option<f64>) -> Self {
        let rate_hz = rate_hz.filter(|rate| rate.is_finite() && *rate > 0.0);
        Self { profiles: profiles.into_iter().map(Arc::new).collect(), next: 0, rate_hz, began_at: None }
    }

    /// When the next profile is due.
    fn due(&mut self) -> Option<Instant> {
        let rate_hz = self.rate_hz?;
        let began_at = *self.began_at.get_or_insert_with(now);
        began_at.checked_add(Duration::try_from_secs_f64(self.next as f64 / rate_hz).ok()?)
    }
}

#[expect(clippy::disallowed_methods, reason = "a sensor has a clock; tests can pause it")]
fn now() -> Instant {
    Instant::now()
}

impl Source for ScanSource {
    fn begin(&mut self) {
        (self.next, self.began_at) = (0, None);
    }

    fn next(&mut self) -> Pending<'_, Option<Arc<Taken>>> {
        Box::pin(async {
            let taken = Arc::clone(self.profiles.get(self.next)?);
            if let Some(due) = self.due() {
                sleep_until(due).await;
            }
            self.next += 1;
            Some(taken)
        })
    }
}

/// A scan of the rail frame as a sensor mounted like this takes it, its encoder at 0 at the first profile; `None` where the
/// mounting does not keep profiles in planes x = const.
#[must_use]
pub fn taken_from(scan: &Scan, placement: &Placement, mm_per_tick: f64, rate_hz: f64) -> Option<Vec<Taken>> {
    let first_x = scan.stations().first().map_or(0.0, |station| station.x);
    let (mut y, mut z) = (Vec::new(), Vec::new());
    let taken = scan.stations().iter().enumerate().map(|(index, station)| {
        scan.load(*station, &mut y, &mut z);
        let points = y.iter().zip(&z).map(|(y, z)| placement.to_sensor([*y, *z]).map(Some));
        Some(Taken {
            encoder: ((station.x - first_x) / mm_per_tick).round() as i64,
            timestamp: (index as f64 * CLOCK_HZ / rate_hz).round() as u64,
            points: points.collect::<Option<Vec<_>>>()?,
        })
    });
    taken.collect()
}
