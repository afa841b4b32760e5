//! Sections square to an axis that was found in a cloud: a frame whose X lies along the axis, the points near the surface in
//! that frame, and groups of neighbours along it. Enough to make the same sections again from the same scan.

use crate::geometry::{Axis, Frame};
use crate::scan::{Columns, Grouping, Scan, Station};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// Points of a section: twice what a profile needs to be judged by default, so that holes leave enough of them.
const POINTS: usize = 40;
/// Most sections. More clusters do not improve the covariance.
const SECTIONS_MAX: usize = 512;
/// Points as far from the surface as this share of the radius belong to the surroundings of the part: on the far side of the
/// axis everything is a whole radius away, and clamps are nearer than that.
const NEAR: f64 = 0.5;
/// Points beyond the ends of the part by this share of its length are left to be judged.
const BEYOND: f64 = 0.05;

/// How sections were cut from the points of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SectionCut {
    /// The frame of the sections in the coordinates of the scan; X lies along the axis.
    pub frame: Frame,
    /// Least and largest distance from X of the points that are kept, mm.
    pub distance_mm: [f64; 2],
    /// Least and largest x of the points that are kept, mm.
    pub x_mm: [f64; 2],
}

impl SectionCut {
    /// About an axis and a radius; `extent` is where the part begins and ends along the axis, from its point, mm. `None` where
    /// the direction is none.
    pub(super) fn about(axis: &Axis, radius: f64, [first, last]: [f64; 2]) -> Option<Self> {
        let beyond = BEYOND * (last - first);
        let distance_mm = [(1.0 - NEAR) * radius, (1.0 + NEAR) * radius];
        Some(Self { frame: Frame::along(axis).ok()?, distance_mm, x_mm: [first - beyond, last + beyond] })
    }

    /// The sections; `None` where no point is kept.
    #[must_use]
    pub fn apply(&self, of: &Scan) -> Option<Scan> {
        let mut points = self.points(of)?;
        let sections_count = (points.len() / POINTS).clamp(1, SECTIONS_MAX);
        // By all coordinates, so that the order of the file does not matter.
        let by_x = |a: &[f64; 3], b: &[f64; 3]| {
            a.iter().zip(b).fold(Ordering::Equal, |order, (a, b)| order.then_with(|| a.total_cmp(b)))
        };
        points.par_sort_unstable_by(by_x);
        let (count, mut rest) = (points.len(), points.as_mut_slice());
        let (mut sections, mut stations) = (Vec::with_capacity(sections_count), Vec::with_capacity(sections_count));
        let mut start = 0;
        for index in 0..sections_count {
            let end = (index + 1) * count / sections_count;
            let (section, after) = rest.split_at_mut((end - start).min(rest.len()));
            rest = after;
            let Some([x, ..]) = section.get(section.len() / 2).copied() else { continue };
            stations.push(Station { x, start: std::mem::replace(&mut start, end), end });
            sections.push(section);
        }
        // In the order in which a sensor would give them.
        sections.into_par_iter().for_each(|section| section.sort_by_cached_key(|[_, y, z]| ordered(y.atan2(*z))));
        let [own_x, ys, zs] =
            [0, 1, 2].map(|axis| -> Vec<f64> { points.iter().filter_map(|point| point.get(axis)).copied().collect() });
        let scan = Scan::new(stations, Columns::F64 { y: ys, z: zs }, "sections square to the axis".to_owned()).ok()?;
        let lattice = self.frame.steps(of.lattice());
        let rotation = self.frame.rotation().ok()?;
        let origin = rotation * (Vector3::from(of.origin()) - Vector3::from(self.frame.origin_mm));
        Some(
            scan.with_own_x(own_x)
                .ok()?
                .with_grouping(Grouping::Chosen)
                .with_lattice(lattice)
                .with_origin(origin.into()),
        )
    }

    /// The points that are kept, in the frame of the sections.
    fn points(&self, scan: &Scan) -> Option<Vec<[f64; 3]>> {
        let rotation = self.frame.rotation().ok()?;
        let origin = Vector3::from(self.frame.origin_mm);
        let ([nearest, farthest], [first, last]) = (self.distance_mm, self.x_mm);
        let placed = |point: [f64; 3]| -> [f64; 3] { (rotation * (Vector3::from(point) - origin)).into() };
        let is_kept = |[x, y, z]: &[f64; 3]| {
            (first..=last).contains(x) && (nearest * nearest..=farthest * farthest).contains(&(y * y + z * z))
        };
        let points: Vec<[f64; 3]> =
            scan.stations().iter().flat_map(|station| scan.points_of(station).map(placed).filter(is_kept)).collect();
        (!points.is_empty()).then_some(points)
    }
}

/// Bits that order like the numbers.
fn ordered(value: f64) -> i64 {
    let bits = value.to_bits().cast_signed();
    if bits < 0 { i64::MIN - bits } else { bits }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sections_do_not_depend_on_the_order_of_the_points() {
        let axis = Axis { point_mm: [5.0, -3.0, 100.0], direction: [0.0, 0.6, 0.8] };
        let frame = Frame::along(&axis).expect("an axis");
        let rotation = frame.rotation().expect("a frame").transpose();
        let place = |i: usize| {
            let (angle, along) = (i as f64 * 0.7, i as f64 * 0.13 - 60.0);
            let point = nalgebra::Vector3::new(along, 20.0 * angle.sin(), 20.0 * angle.cos());
            (rotation * point + Vector3::from(axis.point_mm)).into()
        };
        let points: Vec<[f64; 3]> = (0..1000).map(place).collect();
        let scan_of = |order: &dyn Fn(usize) -> usize| {
            let points: Vec<[f64; 3]> = (0..1000).map(|i| points[order(i)]).collect();
            let columns = Columns::F64 {
                y: points.iter().map(|[_, y, _]| *y).collect(),
                z: points.iter().map(|[.., z]| *z).collect(),
            };
            let station = Station { x: 0.0, start: 0, end: 1000 };
            let scan = Scan::new(vec![station], columns, "one".to_owned()).expect("a scan");
            scan.with_own_x(points.iter().map(|[x, ..]| *x).collect()).expect("finite")
        };
        let cut = SectionCut::about(&axis, 20.0, [-60.0, 70.0]).expect("a direction");
        let sections = cut.apply(&scan_of(&|i| i)).expect("points");
        assert_eq!(sections.stations().len(), 25);
        assert!(sections.stations().iter().all(|station| station.end - station.start == 40));
        assert_eq!(cut.apply(&scan_of(&|i| (i * 617) % 1000)).expect("points"), sections);
        for station in sections.stations() {
            assert!(sections.points_of(station).all(|[_, y, z]| (y.hypot(z) - 20.0).abs() < 1e-9));
        }
    }
}
