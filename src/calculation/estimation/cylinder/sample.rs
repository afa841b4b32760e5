//! A thinned copy of a scan that still stands for the whole of it: every so many profiles, every so many points of each.
//! A regular stride keeps the share of every feature; a grid of equal areas would multiply the outliers.

use super::profile::ProfilePoints;
use super::resolution;
use crate::scan::{Scan, Station, Stretch};

/// At most `profiles_max` profiles of at most `points_max` points, evenly spread.
#[derive(Debug, Clone, Default)]
pub(super) struct Sample {
    pub(super) stations: Vec<Station>,
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
    /// Whether any of its points has an x of its own.
    has_own_x: bool,
    /// Standard deviation that the resolution of the coordinates makes, mm.
    resolution: f64,
}

impl Sample {
    pub(super) fn take(scan: &Scan, used: &[bool], profiles_max: usize, points_max: usize) -> Self {
        let usable: Vec<&Station> =
            scan.stations().iter().zip(used).filter(|(_, used)| **used).map(|(station, _)| station).collect();
        let mut sample = Self { resolution: resolution::standard(scan.lattice()), ..Self::default() };
        for station in spread(usable.len(), profiles_max).filter_map(|index| usable.get(index)) {
            let places = spread(station.end - station.start, points_max);
            sample.push(station.x, places.filter_map(|place| scan.point(station, station.start + place)));
        }
        sample
    }

    /// Adds a profile at `x`, unless it has no point.
    pub(super) fn push(&mut self, x: f64, points: impl Iterator<Item = [f64; 3]>) {
        let start = self.y.len();
        for [own_x, y, z] in points {
            self.has_own_x |= own_x != x;
            self.x.push(own_x);
            self.y.push(y);
            self.z.push(z);
        }
        let end = self.y.len();
        if end > start {
            self.stations.push(Station { x, start, end });
        }
    }

    /// Standard deviation that the resolution of the coordinates makes, mm: no scatter is less.
    pub(super) fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.y.len()
    }

    /// The points of one of the sample's profiles.
    pub(super) fn points(&self, station: &Station) -> impl Iterator<Item = [f64; 3]> + Clone + '_ {
        let range = station.start..station.end;
        let [x, y, z] = [&self.x, &self.y, &self.z].map(|values| values.get(range.clone()).unwrap_or_default());
        x.iter().zip(y).zip(z).map(|((&x, &y), &z)| [x, y, z])
    }

    /// One of these points.
    pub(super) fn point(&self, index: usize) -> Option<[f64; 3]> {
        Some([*self.x.get(index)?, *self.y.get(index)?, *self.z.get(index)?])
    }

    /// The same, for the sums.
    pub(super) fn profile(&self, station: &Station) -> ProfilePoints<'_> {
        let range = station.start..station.end;
        let [x, y, z] = [&self.x, &self.y, &self.z].map(|values| values.get(range.clone()).unwrap_or_default());
        ProfilePoints { x: station.x, own_x: self.has_own_x.then_some(x), points: Stretch::F64 { y, z } }
    }

    /// The sample without the points that `taken` says are spoken for; profiles that are left empty go.
    pub(super) fn without(&self, taken: impl Fn([f64; 3]) -> bool) -> Self {
        let mut rest = Self { resolution: self.resolution, ..Self::default() };
        for station in &self.stations {
            rest.push(station.x, self.points(station).filter(|point| !taken(*point)));
        }
        rest
    }
}

/// `most` indices spread evenly over `count`, or all of them.
pub(super) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |i| (2 * i + 1) * count / (2 * taken))
}
