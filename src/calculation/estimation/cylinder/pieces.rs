//! Whether what lies on a surface hangs together about the axis. A floor or a support that crosses the circle far from the arc
//! holds the radius with a handful of points, and the scatter does not tell: what the arc alone would say is not asked. In:
//! directions about the axis. Out: those that count.

use super::patches::{Directions, Surface};
use crate::estimation::robust;
use std::f64::consts::{PI, TAU};

/// Bins about the axis, of a degree.
const BINS: usize = 360;
/// A gap is at least this wide, in bins,
const GAP: usize = 20;
/// and in it no bin has more than this share of what the fullest has. So far from a piece, points are beyond it.
const STRAY: f64 = 0.02;
/// A piece beyond a gap with less than this share of the points is something else.
const PIECE_MIN: f64 = 0.1;
/// What is left of the surface beside a piece, in bins.
const MARGIN: usize = 5;
/// What lies beyond is left out where points that are off by a standard deviation each, all to the same side, would move the
/// fit by this share of its own: on a long arc a stray point does nothing, on a short one it holds the radius.
const PULL_MIN: f64 = 0.1;

/// Points about an axis by their direction, counted from the first of those that hang together.
struct Circle {
    bins: [usize; BINS],
    /// Bin of the direction −π where the first bin is.
    turn: usize,
    /// Bins up to the end of the last piece that counts.
    length: usize,
}

/// The directions from the first piece that counts to the last one; `None` where nothing beyond them matters.
pub(super) fn held(surface: &Surface, sigma: f64) -> Option<Directions> {
    let reach = robust::TUKEY_C * sigma;
    let circle = Circle::of(surface.near.iter().filter(|point| point.d.abs() < reach).map(|point| point.angle))?;
    if circle.pull() * (surface.thinned() as f64).sqrt() < PULL_MIN {
        return None;
    }
    let bin = TAU / BINS as f64;
    let first = (circle.turn as f64 - MARGIN as f64) * bin - PI;
    Some(surface.directions(first, (circle.length + 2 * MARGIN) as f64 * bin))
}

impl Circle {
    /// `None` where no piece counts.
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
        // So that no piece goes on beyond the last bin.
        let seam = after_widest_gap(&bins);
        bins.rotate_left(seam);
        let pieces = pieces(&bins);
        let mut counting = pieces.iter().filter(|piece| piece.points_count as f64 >= PIECE_MIN * all as f64);
        let first = counting.next()?;
        let last = counting.next_back().unwrap_or(first);
        bins.rotate_left(first.start);
        Some(Self { bins, turn: (seam + first.start) % BINS, length: last.end - first.start })
    }

    /// By how many of its own standard deviations points beyond move the fit towards them, if they are off by one of theirs.
    fn pull(&self) -> f64 {
        let lever = |(bin, count): (usize, &usize)| {
            let angle = (bin as f64 + 0.5 - 0.5 * self.length as f64) / BINS as f64 * TAU;
            (*count as f64, angle.cos())
        };
        let held = || self.bins.iter().enumerate().take(self.length).map(lever);
        let beyond = self.bins.iter().enumerate().take(BINS.saturating_sub(GAP)).skip(self.length + GAP).map(lever);
        let (count, sum) = held().fold((0.0, 0.0), |(all, sum), (count, cos)| (all + count, sum + count * cos));
        let mean = sum / f64::max(count, 1.0);
        let known: f64 = held().map(|(count, cos)| count * (cos - mean).powi(2)).sum();
        let pull: f64 = beyond.map(|(count, cos)| count * (cos - mean).abs()).sum();
        if pull > 0.0 { pull / known.sqrt() } else { 0.0 }
    }
}

fn is_stray(bins: &[usize]) -> impl Fn(usize) -> bool {
    let fullest = bins.iter().copied().max().unwrap_or(0);
    move |points_count| points_count as f64 <= STRAY * fullest as f64
}

/// The bin behind the widest gap, all around.
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

/// Bins without a gap between them.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// An arc of forty degrees from the bin `start`, and some points so many degrees behind its end.
    fn circle(start: usize, degrees: usize, points_count: usize) -> Circle {
        let mut bins = [0; BINS];
        for bin in start..start + 40 {
            bins[bin % BINS] = 50;
        }
        bins[(start + 39 + degrees) % BINS] = points_count;
        Circle::of_bins(bins).expect("a piece")
    }

    #[test]
    fn a_gap_of_twenty_degrees_parts_and_a_narrower_one_does_not_wherever_the_arc_is() {
        // One of them across the direction where angles begin.
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

    /// Over ± θ the cosine has the variance (1 + sin 2θ/2θ)/2 − (sin θ/θ)², 3.2e-4 for ± 20°, for 2000 points 0.65; one
    /// opposite is 1 + sin θ/θ = 1.98 away.
    #[test]
    fn what_lies_opposite_a_short_arc_pulls_by_its_lever() {
        let pull = circle(100, 161, 1).pull();
        assert!((pull - 1.98 / 0.65_f64.sqrt()).abs() < 0.03, "{pull}");
    }
}
