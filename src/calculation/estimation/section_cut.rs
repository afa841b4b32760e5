//! Sections perpendicular to an axis that was found in a cloud: a frame whose X lies along the axis, the points near the surface in
//! that frame, and groups of neighbours along it. The data suffice to repeat the same sections from the same scan.

use crate::geometry::{Axis, Frame};
use crate::scan::{Columns, Grouping, Scan, Station, Stretch, columns};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use std::ops::Range;

/// Points of a section: twice the default minimum of a profile, so that enough remain if there are holes.
const POINTS: usize = 40;
/// Most sections. More clusters do not improve the covariance.
const SECTIONS_MAX: usize = 512;
/// Points at least this share of the radius away from the surface belong to the background of the part: points on the far side of
/// the axis are a full radius away, and clamps are nearer than that.
const NEAR: f64 = 0.5;
/// Points are first sorted into this many stretches of x, several a section, so that few of them have to be compared.
const STRETCHES: usize = 4096;
/// Points in one piece of work, and stretches in one.
const CHUNK: usize = 1 << 16;
const STRETCHES_AT_ONCE: usize = 64;
/// Points beyond the ends of the part by up to this share of its length are included and judged.
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
    /// The cut about an axis and a radius; `extent` is the interval of the part along the axis, from its point, mm. `None` if the
    /// direction is invalid.
    pub(super) fn about(axis: &Axis, radius: f64, [first, last]: [f64; 2]) -> Option<Self> {
        let beyond = BEYOND * (last - first);
        let distance_mm = [(1.0 - NEAR) * radius, (1.0 + NEAR) * radius];
        Some(Self { frame: Frame::along(axis).ok()?, distance_mm, x_mm: [first - beyond, last + beyond] })
    }

    /// The sections; `None` if no points remain.
    #[must_use]
    pub fn apply(&self, of: &Scan) -> Option<Scan> {
        let kept = self.kept(of)?;
        let ends: Vec<usize> = kept.ends();
        let count = ends.last().copied().filter(|count| *count > 0)?;
        let sections_count = (count / POINTS).clamp(1, SECTIONS_MAX);
        let start_of = |index: usize| index * count / sections_count;
        let middle_of = |index: usize| start_of(index) + (start_of(index + 1) - start_of(index)) / 2;
        let ranks: Vec<usize> = (0..sections_count).flat_map(|index| [start_of(index), middle_of(index)]).collect();
        let points = kept.arranged(&ends, &ranks);
        let station = |index: usize| {
            let [x, ..] = points.get(middle_of(index)).copied()?;
            Some(Station { x, start: start_of(index), end: start_of(index + 1) })
        };
        let stations: Vec<Station> = (0..sections_count).filter_map(station).collect();
        let ends: Vec<usize> = stations.iter().map(|station| station.end).collect();
        let [mut own_x, mut ys, mut zs] = [0, 1, 2].map(|_| columns::zeroed::<f64>(count));
        let columns: Vec<_> = split(&mut own_x, &ends).zip(split(&mut ys, &ends)).zip(split(&mut zs, &ends)).collect();
        stations.par_iter().zip(columns).for_each(|(station, ((own_x, ys), zs))| {
            let section = points.get(station.start..station.end).unwrap_or_default();
            for (point, ((own_x, y), z)) in by_angle(section).zip(own_x.iter_mut().zip(ys).zip(zs)) {
                [*own_x, *y, *z] = point;
            }
        });
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
    fn kept(&self, scan: &Scan) -> Option<Kept> {
        let rotation = self.frame.rotation().ok()?;
        let Range { start, end } = scan.points();
        let starts: Vec<usize> = (start..end).step_by(CHUNK).collect();
        let chunk = |start: usize| self.chunk(scan, rotation, start..(start + CHUNK).min(end));
        Some(Kept { chunks: starts.into_par_iter().map(chunk).collect() })
    }

    /// Those at these positions of the columns.
    fn chunk(&self, scan: &Scan, rotation: Matrix3<f64>, positions: Range<usize>) -> Chunk {
        let origin = Vector3::from(self.frame.origin_mm);
        let ([nearest, farthest], [first, last]) = (self.distance_mm, self.x_mm);
        let per_stretch = STRETCHES as f64 / (last - first);
        let is_kept = |[x, y, z]: &[f64; 3]| {
            (first..=last).contains(x) && (nearest * nearest..=farthest * farthest).contains(&(y * y + z * z))
        };
        let mut points = Vec::with_capacity(positions.len());
        let mut keep = |point: [f64; 3]| {
            let placed: [f64; 3] = (rotation * (Vector3::from(point) - origin)).into();
            if is_kept(&placed) {
                points.push(placed);
            }
        };
        let before = scan.stations().partition_point(|station| station.end <= positions.start);
        for station in scan.stations().iter().skip(before).take_while(|station| station.start < positions.end) {
            let range = station.start.max(positions.start)..station.end.min(positions.end);
            let within = range.start - station.start..range.end - station.start;
            let own_x = scan.own_x(station).and_then(|own_x| own_x.get(within));
            match scan.columns().stretch(range) {
                Stretch::F32 { y, z } => visit(station.x, own_x, y, z, &mut keep),
                Stretch::F64 { y, z } => visit(station.x, own_x, y, z, &mut keep),
            }
        }
        // The cast saturates and increases monotonically with x.
        let stretch_of = |[x, ..]: &[f64; 3]| (((x - first) * per_stretch) as usize).min(STRETCHES - 1);
        let mut ends = vec![0; STRETCHES];
        for point in &points {
            if let Some(count) = ends.get_mut(stretch_of(point)) {
                *count += 1;
            }
        }
        let mut next = starts(&mut ends);
        let mut ordered = vec![[0.0; 3]; points.len()];
        for point in points {
            let Some(next) = next.get_mut(stretch_of(&point)) else { continue };
            if let Some(place) = ordered.get_mut(*next) {
                *place = point;
            }
            *next += 1;
        }
        Chunk { points: ordered, ends }
    }
}

/// Passes points in their stored precision, which takes half the time of requesting them one by one.
fn visit<T: Copy + Into<f64>>(x: f64, own_x: Option<&[f64]>, y: &[T], z: &[T], mut each: impl FnMut([f64; 3])) {
    let points = y.iter().zip(z);
    match own_x {
        Some(own_x) => own_x.iter().zip(points).for_each(|(&x, (&y, &z))| each([x, y.into(), z.into()])),
        None => points.for_each(|(&y, &z)| each([x, y.into(), z.into()])),
    }
}

/// Some of the points that are kept, in order of their stretches.
struct Chunk {
    points: Vec<[f64; 3]>,
    /// End index of each stretch.
    ends: Vec<usize>,
}

impl Chunk {
    fn stretch(&self, index: usize) -> &[[f64; 3]] {
        let start = index.checked_sub(1).and_then(|before| self.ends.get(before)).copied().unwrap_or(0);
        self.ends.get(index).and_then(|end| self.points.get(start..*end)).unwrap_or_default()
    }
}

/// The points that are kept.
struct Kept {
    chunks: Vec<Chunk>,
}

impl Kept {
    /// End index of each stretch among all points.
    fn ends(&self) -> Vec<usize> {
        (0..STRETCHES).map(|index| self.chunks.iter().filter_map(|chunk| chunk.ends.get(index)).sum()).collect()
    }

    /// The points, with the points of these ranks at their sorted positions in x, and smaller ones before and larger ones after
    /// them. Consumes the chunks, so that the points are not in memory three times.
    fn arranged(self, ends: &[usize], ranks: &[usize]) -> Vec<[f64; 3]> {
        let mut points = columns::zeroed::<[f64; 3]>(ends.last().copied().unwrap_or(0));
        let stretches: Vec<_> = split(&mut points, ends).zip(ends).enumerate().collect();
        stretches.into_par_iter().with_min_len(STRETCHES_AT_ONCE).for_each(|(index, (stretch, end))| {
            let mut rest = &mut *stretch;
            for piece in self.chunks.iter().map(|chunk| chunk.stretch(index)) {
                let Some((place, after)) = rest.split_at_mut_checked(piece.len()) else { break };
                place.copy_from_slice(piece);
                rest = after;
            }
            let start = end - stretch.len();
            let [first, last] = [start, *end].map(|position| ranks.partition_point(|rank| *rank < position));
            select(stretch, start, ranks.get(first..last).unwrap_or_default());
        });
        points
    }
}

/// Places the points of these ranks at their sorted positions, with smaller ones before and larger ones after them; the first of
/// the points has the rank `start`.
fn select(points: &mut [[f64; 3]], start: usize, ranks: &[usize]) {
    let (before, [rank, after @ ..]) = ranks.split_at(ranks.len() / 2) else { return };
    let points_count = points.len();
    let Some(place) = rank.checked_sub(start).filter(|place| *place < points_count) else { return };
    let (below, _, above) = points.select_nth_unstable_by(place, by_coordinates);
    if points_count > CHUNK {
        rayon::join(|| select(below, start, before), || select(above, rank + 1, after));
    } else {
        select(below, start, before);
        select(above, rank + 1, after);
    }
}

/// Compares all coordinates, x first, so that the order of the file has no effect.
fn by_coordinates(a: &[f64; 3], b: &[f64; 3]) -> Ordering {
    a.iter().zip(b).fold(Ordering::Equal, |order, (a, b)| order.then_with(|| a.total_cmp(b)))
}

/// The points of a section in the order of a sensor, by angle; those in one direction by their coordinates.
fn by_angle(section: &[[f64; 3]]) -> impl Iterator<Item = [f64; 3]> {
    // Angle and position share 64 bits, which sort in half the time of two numbers.
    let position_bits = usize::BITS - section.len().leading_zeros();
    let steps = 2.0_f64.powi(61_u32.saturating_sub(position_bits).cast_signed());
    let key = |(position, [_, y, z]): (usize, &[f64; 3])| {
        (((turn(*y, *z) + 2.0) * steps) as u64) << position_bits | position as u64
    };
    let mut keys: Vec<u64> = section.iter().enumerate().map(key).collect();
    keys.sort_unstable();
    let positions = (1_u64 << position_bits) - 1;
    let point = move |key: u64| section.get((key & positions) as usize).copied().unwrap_or_default();
    for alike in keys.chunk_by_mut(|a, b| a >> position_bits == b >> position_bits).filter(|alike| alike.len() > 1) {
        alike.sort_unstable_by(|a, b| by_coordinates(&point(*a), &point(*b)));
    }
    keys.into_iter().map(point)
}

/// Increases with the angle from Z towards Y, −2 to 2 for −180° to 180°, and takes less time to calculate.
fn turn(y: f64, z: f64) -> f64 {
    let share = y / (y.abs() + z.abs());
    if z < 0.0 { 2.0_f64.copysign(y) - share } else { share }
}

/// Start indices of consecutive groups of these sizes; the sizes become the end indices.
fn starts(sizes: &mut [usize]) -> Vec<usize> {
    let mut end = 0;
    let start = |size: &mut usize| {
        let start = end;
        end += *size;
        *size = end;
        start
    };
    sizes.iter_mut().map(start).collect()
}

/// The pieces that end there, one after the other.
fn split<'a, T>(mut values: &'a mut [T], ends: &'a [usize]) -> impl Iterator<Item = &'a mut [T]> {
    let mut start = 0;
    ends.iter().map(move |end| {
        let size = (end - start).min(values.len());
        let (piece, rest) = std::mem::take(&mut values).split_at_mut(size);
        (values, start) = (rest, *end);
        piece
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_increase_with_the_angle() {
        let angles: Vec<f64> = (-180..=180).map(|degrees| f64::from(degrees).to_radians()).collect();
        let turns: Vec<f64> = angles.iter().map(|angle| turn(3.0 * angle.sin(), 3.0 * angle.cos())).collect();
        assert!(turns.is_sorted_by(|a, b| a < b), "{turns:?}");
        assert_eq!(
            [turns[0], turns[90], turns[180], turns[270], turns[360]].map(f64::round),
            [-2.0, -1.0, 0.0, 1.0, 2.0]
        );
    }

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

    /// More points than one unit of work: each at its own x, on a lattice, and all at one x.
    #[test]
    fn sections_contain_the_points_in_order_of_x() {
        const COUNT: usize = 150_000;
        let axis = Axis { point_mm: [0.0; 3], direction: [1.0, 0.0, 0.0] };
        let cut = SectionCut::about(&axis, 20.0, [0.0, 1500.0]).expect("a direction");
        let places: [fn(usize) -> f64; 3] = [|i| i as f64 * 0.01, |i| (i / 700) as f64, |_| 750.0];
        for place in places {
            let scan_of = |order: &dyn Fn(usize) -> usize| {
                let angle = |i: usize| order(i) as f64 * 0.7;
                let y = (0..COUNT).map(|i| 20.0 * angle(i).sin()).collect();
                let z = (0..COUNT).map(|i| 20.0 * angle(i).cos()).collect();
                let station = Station { x: 0.0, start: 0, end: COUNT };
                let scan = Scan::new(vec![station], Columns::F64 { y, z }, "one".to_owned()).expect("a scan");
                scan.with_own_x((0..COUNT).map(|i| place(order(i))).collect()).expect("finite")
            };
            let sections = cut.apply(&scan_of(&|i| i)).expect("points");
            assert_eq!((sections.stations().len(), sections.points()), (SECTIONS_MAX, 0..COUNT));
            let mut last = f64::NEG_INFINITY;
            for station in sections.stations() {
                let mut points: Vec<[f64; 3]> = sections.points_of(station).collect();
                assert!(points.iter().map(|[_, y, z]| y.atan2(*z)).is_sorted_by(|a, b| *a <= b + 1e-12));
                points.sort_by(by_coordinates);
                assert!(points[0][0] >= last);
                assert_eq!(station.x, points[points.len() / 2][0]);
                last = points[points.len() - 1][0];
            }
            assert_eq!(cut.apply(&scan_of(&|i| (i * 7919) % COUNT)).expect("points"), sections);
        }
    }
}
