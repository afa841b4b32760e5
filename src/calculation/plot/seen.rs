//! Which directions around a centre hold points: where the circle is cut to be unrolled, and which arcs were seen.

use super::ticks::Range;

/// Half degrees: fine enough for a picture, coarse enough to be counted in one pass over millions of points.
const BINS: usize = 720;
const DEGREES: f64 = 360.0 / BINS as f64;

/// The directions that hold points, in half degrees.
pub(super) struct Seen {
    bins: Vec<bool>,
    points_count: usize,
}

/// A run of directions: first bin and number of bins.
#[derive(Clone, Copy)]
struct Run {
    first: usize,
    length: usize,
}

impl Seen {
    /// From directions in degrees.
    pub(super) fn new(directions: impl Iterator<Item = f64>) -> Self {
        let mut seen = Self { bins: vec![false; BINS], points_count: 0 };
        for degrees in directions {
            let bin = (degrees.rem_euclid(360.0) / DEGREES) as usize % BINS;
            if let Some(bin) = seen.bins.get_mut(bin) {
                *bin = true;
                seen.points_count += 1;
            }
        }
        seen
    }

    /// How many half degrees hold points.
    pub(super) fn bins_count(&self) -> usize {
        self.bins.iter().filter(|bin| **bin).count()
    }

    /// The smallest window of degrees that holds all of them, its middle in (−180°, 180°].
    pub(super) fn window(&self) -> Range {
        let Some(gap) = self.gaps().into_iter().max_by_key(|gap| gap.length) else {
            return Range::new(-180.0, 180.0);
        };
        let lo = (gap.first + gap.length) as f64 * DEGREES;
        let width = (BINS - gap.length) as f64 * DEGREES;
        let turns = ((lo + width / 2.0) / 360.0 - 0.5).ceil() * 360.0;
        Range::new(lo - turns, lo - turns + width)
    }

    /// The arcs that hold points, each as degrees from and to (from < to). Gaps that are no larger than the spacing of
    /// the points makes likely do not divide an arc.
    pub(super) fn arcs(&self) -> Vec<[f64; 2]> {
        let gaps = self.gaps();
        let widest = gaps.iter().map(|gap| gap.length).max().unwrap_or(0);
        let spacing = (BINS - widest) as f64 / self.points_count.max(1) as f64;
        let least = (4.0 / DEGREES).max(4.0 * spacing);
        let wide: Vec<Run> = gaps.into_iter().filter(|gap| gap.length as f64 >= least).collect();
        let Some(&first) = wide.first() else {
            return if self.points_count == 0 { Vec::new() } else { vec![[0.0, 360.0]] };
        };
        let next = wide.iter().skip(1).chain([&first]);
        let arcs = wide.iter().zip(next).map(|(gap, next)| {
            let from = gap.first + gap.length;
            let to = if next.first >= from { next.first } else { next.first + BINS };
            [from as f64 * DEGREES, to as f64 * DEGREES]
        });
        arcs.filter(|[from, to]| to > from && self.points_count > 0).collect()
    }

    /// The empty runs around the circle, in order; one of them may go past the last bin.
    fn gaps(&self) -> Vec<Run> {
        let Some(start) = self.bins.iter().position(|&bin| bin) else {
            return vec![Run { first: 0, length: BINS }];
        };
        let mut gaps: Vec<Run> = Vec::new();
        let mut length = 0;
        for (index, &bin) in self.bins.iter().enumerate().cycle().skip(start).take(BINS + 1) {
            match (bin, length) {
                (false, _) => length += 1,
                (true, 0) => {}
                (true, _) => {
                    gaps.push(Run { first: (index + BINS - length) % BINS, length });
                    length = 0;
                }
            }
        }
        gaps
    }
}

/// A direction in degrees, turned into the full circle that begins at `from`.
pub(super) fn turned_into(degrees: f64, from: f64) -> f64 {
    from + (degrees - from).rem_euclid(360.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_degree(from: i32, to: i32) -> impl Iterator<Item = f64> {
        (from..to).map(|d| f64::from(d) + 0.1)
    }

    #[test]
    fn the_window_holds_the_seen_side_only() {
        let window = Seen::new(every_degree(30, 150)).window();
        assert!((window.lo - 30.0).abs() < 1.0 && (window.hi - 150.0).abs() < 1.0, "{window:?}");
        // Across the direction of 180°.
        let window = Seen::new(every_degree(150, 230)).window();
        assert!((window.width() - 79.5).abs() < 1.0 && (window.middle() + 170.0).abs() < 1.0, "{window:?}");
    }

    #[test]
    fn holes_divide_the_seen_arc_and_missing_points_do_not() {
        let arcs = Seen::new(every_degree(30, 80).chain(every_degree(95, 150))).arcs();
        assert_eq!(arcs.len(), 2, "{arcs:?}");
        // Twenty points, six degrees apart.
        assert_eq!(Seen::new((0..20).map(|i| f64::from(i) * 6.0 - 60.0)).arcs().len(), 1);
        assert_eq!(Seen::new(std::iter::empty()).arcs().len(), 0);
        assert_eq!(Seen::new(every_degree(0, 360)).arcs(), [[0.0, 360.0]]);
        assert_eq!(Seen::new([77.0].into_iter()).arcs().len(), 1);
    }
}
