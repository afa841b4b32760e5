//! Scans: from the bytes of a file to profiles in station order. Knows geometry; must not know how anything is estimated.
//!
//! ```text
//! bytes --decode--> Cloud --slice--> Scan --encode--> bytes
//!                     |                ^
//!                  (frame, region)  synthetic
//! ```
//!
//! A [`Cloud`] is what a file holds; a [`Scan`] is what an estimator takes: every profile in its own plane x = const.

mod cloud;
mod columns;
pub mod decode;
pub mod encode;
mod huge_pages;
pub mod missing;
mod rule;
pub mod slice;
pub mod synthetic;

pub use cloud::{Cloud, Labels, Stripe};
pub use columns::{Columns, Stretch};
pub use rule::{ProfileRule, RuleError};

use std::ops::Range;
use std::sync::Arc;

/// Where one profile's points lie in the columns of its [`Scan`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// The profile's plane, mm; the mean over its points where they differ.
    pub x: f64,
    /// First point.
    pub start: usize,
    /// One past the last point.
    pub end: usize,
}

/// Profiles in station order: x never decreases, every coordinate is finite, no profile is empty. Its points may be shared
/// with the scan that it was cut from.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    stations: Vec<Station>,
    columns: Arc<Columns>,
    rule: String,
    blanks: Vec<f64>,
}

/// Why profiles do not make a scan.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ScanError {
    /// There is no point at all.
    #[error("the scan holds no point")]
    Empty,
    /// A station is not where the one before it ends, has no point, lies behind its predecessor or beyond the columns.
    #[error("profile {index} does not follow the one before it")]
    Station {
        /// Its position in the scan.
        index: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point {index} of the scan is not finite")]
    NotFinite {
        /// Its position in the columns.
        index: usize,
    },
}

impl Scan {
    /// The one way to a scan. `rule` says in words how the profiles were told apart, e.g. `x_pitch_mm=0.5`.
    ///
    /// # Errors
    /// [`ScanError`] names the first profile or point that breaks what a scan promises.
    pub fn new(stations: Vec<Station>, columns: Columns, rule: String) -> Result<Self, ScanError> {
        let mut end = 0;
        let mut x = f64::NEG_INFINITY;
        for (index, station) in stations.iter().enumerate() {
            if station.start != end || station.end <= station.start || !station.x.is_finite() || station.x < x {
                return Err(ScanError::Station { index });
            }
            (end, x) = (station.end, station.x);
        }
        if stations.is_empty() {
            return Err(ScanError::Empty);
        }
        if end != columns.len() {
            return Err(ScanError::Station { index: stations.len() });
        }
        match columns.first_not_finite() {
            Some(index) => Err(ScanError::NotFinite { index }),
            None => Ok(Self { stations, columns: Arc::new(columns), rule, blanks: Vec::new() }),
        }
    }

    /// The same with the planes of profiles that were taken and hold no point, mm. They say where there is no part.
    #[must_use]
    pub fn with_blanks(self, mut blanks: Vec<f64>) -> Self {
        blanks.retain(|x| x.is_finite());
        blanks.sort_by(f64::total_cmp);
        blanks.dedup();
        Self { blanks, ..self }
    }

    /// The planes of profiles that hold no point, as far as they are known, in order of x.
    #[must_use]
    pub fn blanks(&self) -> &[f64] {
        &self.blanks
    }

    /// The profiles, in order of x.
    #[must_use]
    pub fn stations(&self) -> &[Station] {
        &self.stations
    }

    /// The profiles of these positions as a scan of their own, whose points are shared, not copied, and which knows of no
    /// blanks. `None` where there is none.
    #[must_use]
    pub fn part(&self, stations: Range<usize>) -> Option<Self> {
        let stations = self.stations.get(stations).filter(|stations| !stations.is_empty())?.to_vec();
        Some(Self { stations, columns: Arc::clone(&self.columns), rule: self.rule.clone(), blanks: Vec::new() })
    }

    /// Where its points lie in the columns.
    #[must_use]
    pub fn points(&self) -> Range<usize> {
        let (first, last) = (self.stations.first(), self.stations.last());
        first.map_or(0, |station| station.start)..last.map_or(0, |station| station.end)
    }

    /// The columns that hold its points, profile after profile; of a part those of the whole.
    #[must_use]
    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// How the profiles were told apart.
    #[must_use]
    pub fn rule(&self) -> &str {
        &self.rule
    }

    /// Copies a profile's points into `y` and `z` (cleared first), in double precision, millimetres.
    pub fn load(&self, station: Station, y: &mut Vec<f64>, z: &mut Vec<f64>) {
        self.columns.load(station.start..station.end, y, z);
    }
}
