//! Pieces of the surface that are separated by gaps about the axis. A support that crosses the circle far from the arc dominates
//! the radius with a few points, and the scatter does not show it. [`part_directions`] returns the directions about the axis that
//! belong to the part, and [`Subset`] is a scan without the points in other directions, from which a solution is mapped back to the
//! complete scan.

use super::kernel::Inner;
use super::normal_equations::Sums;
use super::patches::{Directions, Surface};
use super::solve::Solution;
use crate::estimation::statistics;
use crate::scan::{Columns, Scan, Station};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Bins about the axis, of a degree.
const BINS: usize = 360;
/// A gap is at least this wide, in bins,
const GAP: usize = 20;
/// In a gap no bin has more than this share of the points of the fullest bin. Points beyond the first gap from a piece are
/// separate.
const STRAY: f64 = 0.02;
/// A piece beyond a gap with a smaller share of the points does not belong to the part.
const PIECE_MIN: f64 = 0.1;
/// Margin beside a piece, in bins.
const MARGIN: usize = 5;
/// The points beyond are left out if an error of one standard deviation, common to all of them, would move the fit by this share of
/// its own standard deviation. On a long arc a stray point has no effect, on a short one it dominates the radius.
const PULL_MIN: f64 = 0.1;

/// Points about an axis by their direction, counted from the first point of a connected piece.
struct Circle {
    bins: [usize; BINS],
    /// Bin of the direction −π, relative to the first bin.
    turn: usize,
    /// Number of bins up to the end of the last piece that counts.
    length: usize,
}

/// The directions from the first piece that counts to the last one; `None` if points outside them have no effect.
pub(super) fn part_directions(surface: &Surface, sigma: f64) -> Option<Directions> {
    let reach = statistics::TUKEY_C * sigma;
    let circle = Circle::of(surface.near.iter().filter(|point| point.d.abs() < reach).map(|point| point.angle))?;
    if circle.pull() * (surface.thinned() as f64).sqrt() < PULL_MIN {
        return None;
    }
    let bin = TAU / BINS as f64;
    let first = (circle.turn as f64 - MARGIN as f64) * bin - PI;
    Some(surface.directions(first, (circle.length + 2 * MARGIN) as f64 * bin))
}

impl Circle {
    /// `None` if no piece counts.
    fn of(angles: impl Iterator<Item = f64>) -> Option<Self> {
        let mut bins = [0_usize; BINS];
        for angle in angles {
            let place = ((angle + PI) / TAU * BINS as f64) as usize;
            if let Some(bin) = bins.get_mut(place.min(BINS - 1)) {
                *bin += 1;
            }
        }
        Self::of_bins(bins)
    }

    fn of_bins(mut bins: [usize; BINS]) -> Option<Self> {
        let all: usize = bins.iter().sum();
        // The circle is cut in its widest gap, so that no piece extends across the last bin.
        let seam = after_widest_gap(&bins);
        bins.rotate_left(seam);
        let pieces = pieces(&bins);
        let mut counting = pieces.iter().filter(|piece| piece.points_count as f64 >= PIECE_MIN * all as f64);
        let first = counting.next()?;
        let last = counting.next_back().unwrap_or(first);
        bins.rotate_left(first.start);
        Some(Self { bins, turn: (seam + first.start) % BINS, length: last.end - first.start })
    }

    /// The shift of the fit towards the points beyond, in its own standard deviations, if they are off by one of theirs.
    fn pull(&self) -> f64 {
        let lever = |(bin, count): (usize, &usize)| {
            let angle = (bin as f64 + 0.5 - 0.5 * self.length as f64) / BINS as f64 * TAU;
            (*count as f64, angle.cos())
        };
        let members = || self.bins.iter().enumerate().take(self.length).map(lever);
        let beyond = self.bins.iter().enumerate().take(BINS.saturating_sub(GAP)).skip(self.length + GAP).map(lever);
        let (count, sum) = members().fold((0.0, 0.0), |(all, sum), (count, cos)| (all + count, sum + count * cos));
        let mean = sum / f64::max(count, 1.0);
        let known: f64 = members().map(|(count, cos)| count * (cos - mean).powi(2)).sum();
        let pull: f64 = beyond.map(|(count, cos)| count * (cos - mean).abs()).sum();
        if pull > 0.0 { pull / known.sqrt() } else { 0.0 }
    }
}

fn is_stray(bins: &[usize]) -> impl Fn(usize) -> bool {
    let fullest = bins.iter().copied().max().unwrap_or(0);
    move |points_count| points_count as f64 <= STRAY * fullest as f64
}

/// The bin after the widest gap on the full circle.
fn after_widest_gap(bins: &[usize; BINS]) -> usize {
    let is_stray = is_stray(bins);
    let (mut gap, mut widest, mut after) = (0, 0, 0);
    for (index, points_count) in bins.iter().chain(bins).enumerate() {
        if is_stray(*points_count) {
            gap += 1;
            continue;
        }
        if gap > widest {
            (widest, after) = (gap, index % BINS);
        }
        gap = 0;
    }
    after
}

/// Consecutive bins without a gap between them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    start: usize,
    end: usize,
    points_count: usize,
}

fn pieces(bins: &[usize]) -> Vec<Piece> {
    let is_stray = is_stray(bins);
    let mut pieces: Vec<Piece> = Vec::new();
    for (bin, &points_count) in bins.iter().enumerate() {
        if is_stray(points_count) {
            continue;
        }
        match pieces.last_mut().filter(|piece| bin < piece.end + GAP) {
            Some(piece) => {
                piece.points_count += points_count;
                piece.end = bin + 1;
            }
            None => pieces.push(Piece { start: bin, end: bin + 1, points_count }),
        }
    }
    pieces
}

/// Profiles that are processed at a time, so that their points are not in memory twice.
const CHUNK: usize = 128;

/// A scan without some of its points.
pub(super) struct Subset {
    pub(super) scan: Scan,
    /// All of its profiles are used.
    pub(super) used: Vec<bool>,
    /// The indices of its profiles in the complete scan.
    kept: Vec<usize>,
    whole_count: usize,
}

impl Subset {
    /// The points of the used profiles for which the test, one for each profile, is true; `None` if there are none.
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

    /// Maps a solution of this scan back to the profiles of the complete scan.
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
        // The values were of single precision before.
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

    /// An arc of forty degrees from the bin `start`, and some points this many degrees after its end.
    fn circle(start: usize, degrees: usize, points_count: usize) -> Circle {
        let mut bins = [0; BINS];
        for bin in start..start + 40 {
            bins[bin % BINS] = 50;
        }
        bins[(start + 39 + degrees) % BINS] = points_count;
        Circle::of_bins(bins).expect("a piece")
    }

    #[test]
    fn a_gap_of_twenty_degrees_separates_pieces_and_a_narrower_one_does_not() {
        // The second arc extends across the direction at which angles begin.
        for start in [100, 340] {
            let arc = |degrees, points_count| {
                let circle = circle(start, degrees, points_count);
                assert_eq!(circle.turn, start);
                (circle.length, circle.pull() > 0.0)
            };
            assert_eq!(arc(20, 5), (60, false));
            assert_eq!(arc(20, 1), (40, false));
            assert_eq!(arc(21, 5), (40, true));
            assert_eq!(arc(21, 1), (40, true));
            assert_eq!(arc(40, 400), (80, false));
        }
    }

    /// Over ± θ the cosine has the variance (1 + sin 2θ/2θ)/2 − (sin θ/θ)², 3.2e-4 for ± 20°, which is 0.65 for 2000 points; a
    /// point on the opposite side is 1 + sin θ/θ = 1.98 away.
    #[test]
    fn a_point_opposite_a_short_arc_shifts_the_fit_by_its_lever() {
        let pull = circle(100, 161, 1).pull();
        assert!((pull - 1.98 / 0.65_f64.sqrt()).abs() < 0.03, "{pull}");
    }
}

#[cfg(test)]
mod rest_tests {
    use super::*;

    #[test]
    fn the_remaining_points_keep_their_bits_and_their_order() {
        let columns = Columns::F32 { y: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6], z: vec![1.1, 1.2, 1.3, 1.4, 1.5, 1.6] };
        let station = |x: f64, start: usize| Station { x, start, end: start + 2 };
        let stations = vec![station(0.0, 0), station(1.0, 2), station(2.0, 4)];
        let scan = Scan::new(stations, columns, "by hand".to_owned()).expect("a scan");
        let rest =
            Subset::of(&scan, &[true, true, false], |index, _| move |[_, y, _]: [f64; 3]| index == 1 && y > 0.35);
        let rest = rest.expect("a point");
        assert_eq!(*rest.scan.columns(), Columns::F32 { y: vec![0.4], z: vec![1.4] });
        assert_eq!((rest.kept, rest.whole_count), (vec![1], 3));
        assert!(Subset::of(&scan, &[true; 3], |_, _| |_: [f64; 3]| false).is_none());
    }
}
