//! A thinned copy of a scan that still stands for the whole of it: every so many profiles, every so many points of each.
//! A regular stride keeps the share of every feature; a grid of equal areas would multiply the outliers.

use crate::scan::{Scan, Station, Stretch};

/// At most `profiles_max` profiles of at most `points_max` points, evenly spread.
pub(super) struct Sample {
    pub(super) stations: Vec<Station>,
    pub(super) y: Vec<f64>,
    pub(super) z: Vec<f64>,
}

impl Sample {
    pub(super) fn take(scan: &Scan, used: &[bool], profiles_max: usize, points_max: usize) -> Self {
        let usable: Vec<&Station> =
            scan.stations().iter().zip(used).filter(|(_, used)| **used).map(|(station, _)| station).collect();
        let mut sample = Self { stations: Vec::new(), y: Vec::new(), z: Vec::new() };
        for station in spread(usable.len(), profiles_max).filter_map(|index| usable.get(index)) {
            let start = sample.y.len();
            let places = spread(station.end - station.start, points_max);
            for [y, z] in places.filter_map(|place| scan.columns().get(station.start + place)) {
                sample.y.push(y);
                sample.z.push(z);
            }
            sample.stations.push(Station { x: station.x, start, end: sample.y.len() });
        }
        sample
    }

    /// The points of one of the sample's profiles.
    pub(super) fn points(&self, station: &Station) -> (&[f64], &[f64]) {
        let range = station.start..station.end;
        (self.y.get(range.clone()).unwrap_or_default(), self.z.get(range).unwrap_or_default())
    }

    /// The same, for the sums.
    pub(super) fn stretch(&self, station: &Station) -> Stretch<'_> {
        let (y, z) = self.points(station);
        Stretch::F64 { y, z }
    }

    /// The sample without the points that `taken` says are spoken for; profiles that are left empty go.
    pub(super) fn without(&self, taken: impl Fn(f64, f64, f64) -> bool) -> Self {
        let mut rest = Self { stations: Vec::new(), y: Vec::new(), z: Vec::new() };
        for station in &self.stations {
            let start = rest.y.len();
            let (y, z) = self.points(station);
            for (&y, &z) in y.iter().zip(z).filter(|(y, z)| !taken(station.x, **y, **z)) {
                rest.y.push(y);
                rest.z.push(z);
            }
            if rest.y.len() > start {
                rest.stations.push(Station { x: station.x, start, end: rest.y.len() });
            }
        }
        rest
    }
}

/// `most` indices spread evenly over `count`, or all of them.
pub(super) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |i| (2 * i + 1) * count / (2 * taken))
}
