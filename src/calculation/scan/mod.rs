//! Scans: from the bytes of a file to profiles in station order.
//!
//! ```text
//! bytes --decode--> Cloud --slice--> Scan --encode--> bytes
//!                     |                ^
//!                  (frame, region)  synthetic
//! ```
//!
//! A [`Cloud`] is the content of a file. A [`Scan`] is the input of an estimator: points with individual x, y and z, and the
//! profiles to which they belong.

mod cloud;
pub(crate) mod columns;
pub mod decode;
pub mod encode;
pub mod missing;
mod rule;
pub mod slice;
pub mod synthetic;

pub use cloud::{Cloud, Labels, Stripe};
pub use columns::{Columns, Stretch};
pub use rule::{ProfileRule, RuleError};

use std::ops::Range;
use std::sync::Arc;

/// Range of one profile's points in the columns of its [`Scan`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Station {
    /// The x of the profile, mm; the median over its points if they differ.
    pub x: f64,
    /// Index of the first point.
    pub start: usize,
    /// Index after the last point.
    pub end: usize,
}

/// Points grouped into profiles. The x of the profiles never decreases, every coordinate is finite, no profile is empty. If the
/// points of a profile do not share their x, every point has an individual x. The points may be shared with the scan from which
/// this one was cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    stations: Vec<Station>,
    columns: Arc<Columns>,
    /// The x of every point, mm, in the order of the columns; `None` if every profile lies in one plane.
    own_x: Option<Arc<Vec<f64>>>,
    grouping: Grouping,
    lattice: [f64; 3],
    origin: [f64; 3],
    rule: String,
    blanks: Vec<f64>,
}

/// The origin of the grouping of points into profiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Grouping {
    /// From the file, the sensor or the caller.
    #[default]
    Given,
    /// The x that points share, which may also be the lattice of another sensor.
    SharedX,
    /// Slabs along the rail that the caller requested: the sensor need not have taken the points of one slab together.
    Slabs,
    /// The points came without profiles and were grouped by this module.
    Chosen,
}

/// Why profiles do not form a scan.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ScanError {
    /// There are no points.
    #[error("the scan contains no point")]
    Empty,
    /// A station does not start at the end of the previous one, has no point, has a smaller x than the previous one, or lies beyond
    /// the columns.
    #[error("profile {index} does not follow the one before it")]
    Station {
        /// Index of the station in the scan.
        index: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("point {index} of the scan is not finite")]
    NotFinite {
        /// Index of the point in the columns.
        index: usize,
    },
}

impl Scan {
    /// A scan from its profiles. `rule` states in words how the profiles were separated, e.g. `x_pitch_mm=0.5`.
    ///
    /// # Errors
    /// [`ScanError`] names the first profile or point that is not valid.
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
            None => {
                let (columns, grouping) = (Arc::new(columns), Grouping::default());
                let (own_x, lattice, origin, blanks) = (None, [0.0; 3], [0.0; 3], Vec::new());
                Ok(Self { stations, columns, own_x, grouping, lattice, origin, rule, blanks })
            }
        }
    }

    /// The same scan with an x for every point, in the order of the columns, mm.
    ///
    /// # Errors
    /// [`ScanError::NotFinite`] names the first x that is not finite or that is missing.
    pub fn with_own_x(self, own_x: Vec<f64>) -> Result<Self, ScanError> {
        let index = columns::first_not_finite(&own_x).unwrap_or(own_x.len().min(self.columns.len()));
        if index != self.columns.len() || own_x.len() != index {
            return Err(ScanError::NotFinite { index });
        }
        Ok(Self { own_x: Some(Arc::new(own_x)), ..self })
    }

    /// The same scan with another origin of its grouping.
    #[must_use]
    pub fn with_grouping(self, grouping: Grouping) -> Self {
        Self { grouping, ..self }
    }

    /// The origin of its grouping.
    #[must_use]
    pub fn grouping(&self) -> Grouping {
        self.grouping
    }

    /// The same scan with the steps of a lattice of the x, y and z of its points, mm; 0 without a lattice.
    #[must_use]
    pub fn with_lattice(self, lattice: [f64; 3]) -> Self {
        Self { lattice, ..self }
    }

    /// The steps of the lattice of the x, y and z of its points, mm; 0 without a lattice.
    #[must_use]
    pub fn lattice(&self) -> [f64; 3] {
        self.lattice
    }

    /// The same scan in a frame in which the origin of the rail frame is at this point, mm.
    #[must_use]
    pub fn with_origin(self, origin: [f64; 3]) -> Self {
        Self { origin, ..self }
    }

    /// Position of the origin of the rail frame, mm.
    #[must_use]
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Whether every profile lies in one plane x = const.
    #[must_use]
    pub fn is_planar(&self) -> bool {
        self.own_x.is_none()
    }

    /// The same scan with the planes of profiles that were measured and have no point, mm. They show that the part is absent there.
    #[must_use]
    pub fn with_blanks(self, mut blanks: Vec<f64>) -> Self {
        blanks.retain(|x| x.is_finite());
        blanks.sort_by(f64::total_cmp);
        blanks.dedup();
        Self { blanks, ..self }
    }

    /// The planes of profiles without a point, as far as they are known, in order of x.
    #[must_use]
    pub fn blanks(&self) -> &[f64] {
        &self.blanks
    }

    /// The profiles, in order of x.
    #[must_use]
    pub fn stations(&self) -> &[Station] {
        &self.stations
    }

    /// The profiles with these indices as a separate scan without blanks, whose points are shared, not copied. `None` if the range
    /// is empty.
    #[must_use]
    pub fn part(&self, stations: Range<usize>) -> Option<Self> {
        let stations = self.stations.get(stations).filter(|stations| !stations.is_empty())?.to_vec();
        Some(Self { stations, blanks: Vec::new(), ..self.clone() })
    }

    /// Range of its points in the columns.
    #[must_use]
    pub fn points(&self) -> Range<usize> {
        let (first, last) = (self.stations.first(), self.stations.last());
        first.map_or(0, |station| station.start)..last.map_or(0, |station| station.end)
    }

    /// The columns that contain its points, profile by profile; a part has the columns of the complete scan.
    #[must_use]
    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// The point at an index of the columns, which belongs to this profile, mm.
    #[must_use]
    pub fn point(&self, station: &Station, index: usize) -> Option<[f64; 3]> {
        let [y, z] = self.columns.get(index)?;
        Some([self.x_of(station, index), y, z])
    }

    /// The x of the point at an index of the columns, which belongs to this profile, mm.
    #[must_use]
    pub fn x_of(&self, station: &Station, index: usize) -> f64 {
        self.own_x.as_ref().and_then(|own_x| own_x.get(index)).copied().unwrap_or(station.x)
    }

    /// The points of a profile, mm.
    pub fn points_of<'a>(&'a self, station: &Station) -> impl Iterator<Item = [f64; 3]> + use<'a> {
        let station = *station;
        (station.start..station.end).filter_map(move |index| self.point(&station, index))
    }

    /// The first point, mm, and every point at a distance of `stride` from the previous one, without reading those between.
    pub fn every_nth_point(&self, stride: usize) -> impl Iterator<Item = [f64; 3]> {
        let (first, stride) = (self.points().start, stride.max(1));
        self.stations.iter().flat_map(move |station| {
            let passed = station.start - first;
            let start = first + passed.next_multiple_of(stride);
            (start..station.end).step_by(stride).filter_map(|index| self.point(station, index))
        })
    }

    /// The x of the points of a profile if they differ; `None` if the profile lies in one plane.
    #[must_use]
    pub fn own_x(&self, station: &Station) -> Option<&[f64]> {
        self.own_x.as_ref()?.get(station.start..station.end)
    }

    /// How the profiles were separated.
    #[must_use]
    pub fn rule(&self) -> &str {
        &self.rule
    }

    /// Copies a profile's points into `y` and `z` (which are cleared first), in double precision, millimetres.
    pub fn load(&self, station: Station, y: &mut Vec<f64>, z: &mut Vec<f64>) {
        self.columns.load(station.start..station.end, y, z);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_nth_point_is_counted_over_all_profiles_of_a_part() {
        let ends = [3, 4, 11, 12, 20];
        let starts = [0].into_iter().chain(ends);
        let stations = starts.zip(ends).zip(0..).map(|((start, end), x)| Station { x: f64::from(x), start, end });
        let y: Vec<f64> = (0..20).map(f64::from).collect();
        let scan = Scan::new(stations.collect(), Columns::F64 { z: y.clone(), y }, String::new()).expect("a scan");
        let part = scan.part(1..5).expect("profiles");
        for stride in 0..25 {
            let all = part.stations().iter().flat_map(|station| part.points_of(station));
            let expected: Vec<[f64; 3]> = all.step_by(stride.max(1)).collect();
            assert_eq!(part.every_nth_point(stride).collect::<Vec<_>>(), expected);
        }
    }
}
