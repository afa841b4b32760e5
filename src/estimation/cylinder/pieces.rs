//! Whether what lies on a surface hangs together about the axis. A floor or a support that crosses the circle far from the
//! arc holds the radius with a handful of points, and the scatter does not tell: what the arc alone would say is not asked.
//! In: the points near a fit. Out: the directions that count. Must not fit anything.

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

/// From the first piece that counts to the last one; `None` where nothing lies beyond them.
pub(super) fn held(surface: &Surface, sigma: f64) -> Option<Directions> {
    let reach = robust::TUKEY_C * sigma;
    let mut bins = [0_usize; BINS];
    for point in surface.near.iter().filter(|point| point.d.abs() < reach) {
        let place = ((point.angle + PI) / TAU * BINS as f64) as usize;
        if let Some(bin) = bins.get_mut(place.min(BINS - 1)) {
            *bin += 1;
        }
    }
    let [start, end] = counting(&bins)?;
    let edge = |bin: usize| bin as f64 / BINS as f64 * TAU - PI;
    Some(surface.directions([edge(start.saturating_sub(MARGIN)), edge((end + MARGIN).min(BINS))]))
}

/// The bins from the first piece that counts to the last one; `None` where nothing lies beyond them.
fn counting(bins: &[usize]) -> Option<[usize; 2]> {
    let all: usize = bins.iter().sum();
    let pieces = pieces(bins);
    let mut counting = pieces.iter().filter(|piece| piece.points_count as f64 >= PIECE_MIN * all as f64);
    let first = counting.next()?;
    let last = counting.next_back().unwrap_or(first);
    let before = bins.iter().take(first.start.saturating_sub(GAP));
    let beyond: usize = before.chain(bins.iter().skip(last.end + GAP)).sum();
    (beyond > 0).then_some([first.start, last.end])
}

/// Bins without a gap between them.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    start: usize,
    end: usize,
    points_count: usize,
}

fn pieces(bins: &[usize]) -> Vec<Piece> {
    let fullest = bins.iter().copied().max().unwrap_or(0);
    let mut pieces: Vec<Piece> = Vec::new();
    for (bin, &points_count) in bins.iter().enumerate() {
        if points_count as f64 <= STRAY * fullest as f64 {
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

    #[test]
    fn a_gap_of_twenty_degrees_parts_and_a_narrower_one_does_not() {
        let mut bins = [0; BINS];
        bins[100..140].fill(50);
        bins[159] = 5;
        assert_eq!(pieces(&bins), [Piece { start: 100, end: 160, points_count: 2005 }]);
        assert_eq!(counting(&bins), None);
        bins[159] = 1;
        assert_eq!(counting(&bins), None);
        bins[160] = 5;
        assert_eq!(counting(&bins), Some([100, 140]));
        bins[150] = 5;
        assert_eq!(counting(&bins), None);
    }
}
