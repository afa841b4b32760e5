//! A scan without some of its points. In: which points of a used profile stay. Out: a scan of its own, and a solution of that
//! put back in the places of the whole.

use super::kernel::Inner;
use super::solve::Solution;
use super::sums::Sums;
use crate::scan::{Columns, Scan, Station};
use rayon::prelude::*;

/// Profiles that are gone through at a time, so that what is left of them is not held twice.
const CHUNK: usize = 128;

/// What is left of a scan.
pub(super) struct Rest {
    pub(super) scan: Scan,
    /// All of its profiles serve.
    pub(super) used: Vec<bool>,
    /// Which profiles of the whole they are.
    kept: Vec<usize>,
    whole_count: usize,
}

impl Rest {
    /// The points of the used profiles that stay, by a rule made for each profile; `None` where none does.
    pub(super) fn of<S: Fn([f64; 3]) -> bool>(
        scan: &Scan,
        used: &[bool],
        rule: impl Fn(usize, Station) -> S + Sync,
    ) -> Option<Self> {
        let serving = scan.stations().iter().zip(used).enumerate().filter(|(_, (_, used))| **used);
        let serving: Vec<(usize, Station)> = serving.map(|(index, (station, _))| (index, *station)).collect();
        let left = |&(index, station): &(usize, Station)| -> Vec<[f64; 3]> {
            let stays = rule(index, station);
            scan.points_of(&station).filter(|point| stays(*point)).collect()
        };
        let (mut columns, mut stations, mut kept) = (empty_like(scan.columns()), Vec::new(), Vec::new());
        let mut own_x = Vec::new();
        for some in serving.chunks(CHUNK) {
            let left: Vec<Vec<[f64; 3]>> = some.par_iter().map(left).collect();
            for ((index, station), points) in some.iter().zip(left).filter(|(_, points)| !points.is_empty()) {
                let start = columns.len();
                extend(&mut columns, &points);
                if !scan.is_planar() {
                    own_x.extend(points.iter().map(|[x, ..]| x));
                }
                stations.push(Station { x: station.x, start, end: columns.len() });
                kept.push(*index);
            }
        }
        let mut scan_left = Scan::new(stations, columns, scan.rule().to_owned()).ok()?.with_grouping(scan.grouping());
        if !scan.is_planar() {
            scan_left = scan_left.with_own_x(own_x).ok()?;
        }
        let used = vec![true; scan_left.stations().len()];
        Some(Self { scan: scan_left, used, kept, whole_count: scan.stations().len() })
    }

    /// A solution of what is left, with its profiles in their places of the whole.
    pub(super) fn restore(&self, mut solution: Solution) -> Solution {
        let mut profiles = vec![Sums::zero(); self.whole_count];
        let mut inner = vec![Inner::none(); self.whole_count];
        for ((index, sums), counts) in self.kept.iter().zip(&solution.profiles).zip(&solution.inner) {
            if let (Some(sums_of), Some(inner_of)) = (profiles.get_mut(*index), inner.get_mut(*index)) {
                (*sums_of, *inner_of) = (*sums, *counts);
            }
        }
        (solution.profiles, solution.inner) = (profiles, inner);
        solution
    }
}

fn empty_like(columns: &Columns) -> Columns {
    match columns {
        Columns::F32 { .. } => Columns::F32 { y: Vec::new(), z: Vec::new() },
        Columns::F64 { .. } => Columns::F64 { y: Vec::new(), z: Vec::new() },
    }
}

fn extend(columns: &mut Columns, points: &[[f64; 3]]) {
    match columns {
        // They were of single precision before.
        Columns::F32 { y, z } => {
            y.extend(points.iter().map(|[_, y, _]| *y as f32));
            z.extend(points.iter().map(|[.., z]| *z as f32));
        }
        Columns::F64 { y, z } => {
            y.extend(points.iter().map(|[_, y, _]| y));
            z.extend(points.iter().map(|[.., z]| z));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_keeps_its_bits_and_its_place() {
        let columns = Columns::F32 { y: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6], z: vec![1.1, 1.2, 1.3, 1.4, 1.5, 1.6] };
        let station = |x: f64, start: usize| Station { x, start, end: start + 2 };
        let stations = vec![station(0.0, 0), station(1.0, 2), station(2.0, 4)];
        let scan = Scan::new(stations, columns, "by hand".to_owned()).expect("a scan");
        let rest = Rest::of(&scan, &[true, true, false], |index, _| move |[_, y, _]: [f64; 3]| index == 1 && y > 0.35);
        let rest = rest.expect("a point");
        assert_eq!(*rest.scan.columns(), Columns::F32 { y: vec![0.4], z: vec![1.4] });
        assert_eq!((rest.kept, rest.whole_count), (vec![1], 3));
        assert!(Rest::of(&scan, &[true; 3], |_, _| |_: [f64; 3]| false).is_none());
    }
}
