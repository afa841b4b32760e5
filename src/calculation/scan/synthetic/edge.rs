//! The ends of a synthetic part: an end plane square to the axis, a chamfer, columns that end early, and what lies beyond.
//! Says of a line of sight whether, and how far from the cylinder's surface, it meets something.

use super::laser_plane::Sight;
use super::{Part, Stream};
use crate::geometry::AxisLine;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Where a part ends. A side without an edge goes on beyond the scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Edges {
    /// Towards smaller x.
    pub near: Option<Edge>,
    /// Towards larger x.
    pub far: Option<Edge>,
}

/// One end of a part. Lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Edge {
    /// Where the axis meets the end plane.
    pub x_mm: f64,
    /// Size of a chamfer of 45°; 0 for a sharp edge.
    pub chamfer_mm: f64,
    /// Share of the columns that end early, in runs of about a thirtieth of the arc.
    pub ragged_ratio: f64,
    /// How early those columns end, on average.
    pub ragged_mm: f64,
    /// What lies beyond; `None` for nothing.
    pub beyond: Option<Neighbour>,
}

/// Another cylinder about the same axis, beyond a gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Between the end plane and where it begins, mm.
    pub gap_mm: f64,
    /// Above the part's surface, mm: 0 for another part, below 0 for a support, above 0 for a clamp.
    pub height_mm: f64,
}

/// Columns of a ragged edge that end alike, on average, as a share of all.
const RUN_SHARE: f64 = 1.0 / 30.0;

impl Edge {
    /// Where the axis meets the end plane, mm.
    #[must_use]
    pub fn centre(&self, axis: &AxisLine) -> [f64; 3] {
        let [y, z] = axis.at(self.x_mm);
        [self.x_mm, y, z]
    }

    /// How early each column ends, mm: alternating runs of whole and ragged columns of exponential lengths.
    fn early(&self, columns_count: usize, chance: &mut ChaCha8Rng) -> Vec<f64> {
        let ratio = self.ragged_ratio.clamp(0.0, 0.95);
        if ratio == 0.0 {
            return vec![0.0; columns_count];
        }
        let mut exponential = |mean: f64| -mean * (1.0 - chance.random_range(0.0..1.0_f64)).ln();
        let run = RUN_SHARE * columns_count as f64;
        let mut early = Vec::with_capacity(columns_count);
        while early.len() < columns_count {
            let whole_count = exponential(run * (1.0 - ratio) / ratio).round() as usize;
            early.resize(early.len() + whole_count, 0.0);
            let depth = exponential(self.ragged_mm);
            early.resize(early.len() + exponential(run).round() as usize, depth);
        }
        // Begin anywhere in the pattern, so that its first run is as likely ragged as any.
        early.truncate(columns_count);
        early.rotate_left((exponential(1.0) * columns_count as f64) as usize % columns_count.max(1));
        early
    }
}

impl Edges {
    /// The edges of one scan, their chances drawn.
    pub(super) fn prepare(&self, part: &Part) -> Prepared {
        // A stream of its own, so that the points of a part do not depend on whether it ends.
        let mut chance = Stream::Edges.of(part.seed);
        let mut prepare =
            |edge: Option<Edge>, side: f64| edge.map(|edge| (edge, side, edge.early(part.points_count, &mut chance)));
        let sides = [prepare(self.near, -1.0), prepare(self.far, 1.0)].into_iter().flatten().collect();
        Prepared { axis: part.axis, radius_mm: part.radius_mm, outward: part.side.sign(), sides }
    }
}

/// The edges of one scan.
pub(super) struct Prepared {
    axis: AxisLine,
    radius_mm: f64,
    /// 1 where a chamfer takes material towards the axis, −1 inside a pipe.
    outward: f64,
    /// Each with its side, −1 or 1, and how early its columns end.
    sides: Vec<(Edge, f64, Vec<f64>)>,
}

impl Prepared {
    /// How far beyond the surface the line of sight of a column meets something, where `offset` is what it would without
    /// an edge; `None` where it meets nothing.
    pub(super) fn offset(&self, sight: &Sight, column: usize, offset: f64) -> Option<f64> {
        self.sides.iter().try_fold(offset, |offset, (edge, side, early)| {
            let early = early.get(column).copied().unwrap_or(0.0);
            self.past(edge, *side, early, sight, offset)
        })
    }

    /// The plane is T·(P − C) = 0. A point at `reach` along the line of sight lies `side`·(n·(x − x_C) + reach·k/n) beyond
    /// it, k = T·D of the direction D, and m·reach from the axis, m² = 1 − k²/n².
    fn past(&self, edge: &Edge, side: f64, early: f64, sight: &Sight, offset: f64) -> Option<f64> {
        let AxisLine { p, q, .. } = self.axis;
        let [unit_x, unit_y, unit_z] = sight.direction;
        let n = (1.0 + p * p + q * q).sqrt();
        let along = (p * unit_y + q * unit_z + unit_x) / n;
        let square = (1.0 - along * along).sqrt();
        let surface = self.radius_mm / square;
        let start = side * n * (sight.x - edge.x_mm);
        let beyond = |reach: f64| start + side * reach * along;
        let over = beyond(surface + offset);
        if over > -early && over <= edge.beyond.map_or(f64::INFINITY, |neighbour| neighbour.gap_mm) && early > 0.0 {
            return None;
        }
        if over <= -edge.chamfer_mm {
            return Some(offset);
        }
        // On the chamfer m·reach = R − (beyond + chamfer), inside a pipe R + (beyond + chamfer).
        let out = self.outward;
        let reach = (self.radius_mm - out * edge.chamfer_mm - out * start) / (square + out * side * along);
        if beyond(reach) <= 0.0 {
            return Some(out * (out * (reach - surface)).min(out * offset));
        }
        let Neighbour { gap_mm, height_mm } = edge.beyond?;
        let there = surface + out * height_mm;
        (beyond(there) >= gap_mm).then_some(out * height_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::synthetic::{LaserPlane, Side};
    use rand::SeedableRng;

    const STRAIGHT: AxisLine = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };

    /// What is seen at `x` of a part along X: beyond the plane is x − x_C, whatever the direction.
    fn seen(edge: Edge, side: Side, x: f64) -> Option<f64> {
        let edges = Edges { near: None, far: Some(edge) };
        let part = Part { axis: STRAIGHT, radius_mm: 50.0, side, edges, ..Part::smooth(1) };
        part.edges.prepare(&part).offset(&LaserPlane::default().sight(&STRAIGHT, x, 0.0), 0, 0.0)
    }

    #[test]
    fn a_chamfer_falls_by_as_much_as_it_goes_on_and_ends_in_the_plane() {
        let edge = Edge { x_mm: 100.0, chamfer_mm: 2.0, ..Edge::default() };
        let seen = |x: f64| seen(edge, Side::Outside, x);
        assert_eq!(
            [seen(90.0), seen(98.0), seen(99.0), seen(100.0), seen(100.1)],
            [Some(0.0), Some(0.0), Some(-1.0), Some(-2.0), None]
        );
    }

    #[test]
    fn inside_a_pipe_a_chamfer_and_the_neighbour_lie_on_the_other_side_of_the_surface() {
        let beyond = Some(Neighbour { gap_mm: 5.0, height_mm: -7.0 });
        let edge = Edge { x_mm: 100.0, chamfer_mm: 2.0, beyond, ..Edge::default() };
        let seen = |x: f64| seen(edge, Side::Inside, x);
        assert_eq!(
            [seen(90.0), seen(98.0), seen(99.0), seen(100.0), seen(100.1), seen(105.0)],
            [Some(0.0), Some(0.0), Some(1.0), Some(2.0), None, Some(7.0)]
        );
    }

    #[test]
    fn the_neighbour_begins_beyond_the_gap() {
        let beyond = Some(Neighbour { gap_mm: 5.0, height_mm: -7.0 });
        let edge = Edge { x_mm: 100.0, beyond, ..Edge::default() };
        let seen = |x: f64| seen(edge, Side::Outside, x);
        assert_eq!([seen(100.0), seen(100.5), seen(104.9), seen(105.0)], [Some(0.0), None, None, Some(-7.0)]);
    }

    #[test]
    fn the_asked_share_of_the_columns_ends_early() {
        let edge = Edge { ragged_ratio: 0.3, ragged_mm: 2.0, ..Edge::default() };
        let mut chance = ChaCha8Rng::seed_from_u64(7);
        let early = edge.early(1_000_000, &mut chance);
        // Thirty runs only: the share of one edge scatters by a third of itself.
        let share = early.iter().filter(|early| **early > 0.0).count() as f64 / 1e6;
        assert!((0.1..0.5).contains(&share), "{share}");
    }
}
