//! Features of a synthetic part: holes, clamps and a weld bead, and its ends: an end plane perpendicular to the axis, a chamfer,
//! columns that end early, and an adjacent object. They determine the displacement of a line of sight from the surface, and whether
//! it meets anything. Holes and clamps cover complete profiles: if the laser plane is tilted, so are their ends.

use super::noise::Stream;
use super::sensor::Sight;
use crate::geometry::AxisLine;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Shares of the profiles with each kind of feature; the others are smooth. Features come in blocks along x.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Interference {
    /// Profiles with two screw holes: two groups of 2 % of the points, 10 and 20 mm deep.
    pub screw_holes: f64,
    /// Profiles through a straight hole: 15 % of the points, 30 mm deep.
    pub straight_holes: f64,
    /// Profiles under a clamp.
    pub clamps: f64,
    /// Share of the arc that a clamp covers.
    pub clamp_arc: f64,
    /// Height of a clamp above the surface, at its middle.
    pub clamp_height_mm: f64,
    /// The face of a clamp.
    pub clamp_shape: ClampShape,
    /// Displacement of holes and clamps from the middle of the arc, as a share of it.
    pub shift: f64,
    /// A weld bead along the complete part.
    pub bead: Bead,
}

/// The face of a clamp.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum ClampShape {
    /// Follows the part: a band of uniform thickness.
    #[default]
    Concentric,
    /// A flat clamp, perpendicular to the direction of its middle.
    Flat,
    /// A round clamp of this radius, whose axis differs from the part's.
    Round {
        /// Radius of the face, mm.
        radius_mm: f64,
    },
}

/// A bead along the part, highest in its middle, with a smooth transition to the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bead {
    /// Height; 0 for none.
    pub height_mm: f64,
    /// Share of the arc that it covers.
    pub arc: f64,
    /// Position of its middle along the arc, 0 to 1.
    pub place: f64,
}

impl Bead {
    /// h·cos²(π t/2), with t from −1 to 1 across the bead.
    fn offset_mm(self, place: f64) -> f64 {
        let t = (place - self.place) / (0.5 * self.arc);
        if t.abs() < 1.0 { self.height_mm * (t * std::f64::consts::FRAC_PI_2).cos().powi(2) } else { 0.0 }
    }
}

/// The feature of one profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feature {
    /// Nothing.
    Smooth,
    /// Two groups of 2 % of the points, 10 and 20 mm deep.
    ScrewHoles,
    /// 15 % of the points, 30 mm deep.
    StraightHole,
    /// A face above the surface hides a part of the arc.
    Clamp {
        /// Share of the arc.
        arc: f64,
        /// Height above the surface, at its middle.
        height_mm: f64,
        /// Its face.
        shape: ClampShape,
    },
}

impl Interference {
    /// A smooth part.
    pub const NONE: Self = Self {
        screw_holes: 0.0,
        straight_holes: 0.0,
        clamps: 0.0,
        clamp_arc: 0.0,
        clamp_height_mm: 0.0,
        clamp_shape: ClampShape::Concentric,
        shift: 0.0,
        bead: Bead { height_mm: 0.0, arc: 0.0, place: 0.0 },
    };

    /// The feature of the profile at `phase` (0 to 1 along a block).
    pub(super) fn feature(&self, phase: f64) -> Feature {
        let smooth = 1.0 - self.screw_holes - self.straight_holes - self.clamps;
        match phase {
            phase if phase < smooth => Feature::Smooth,
            phase if phase < smooth + self.screw_holes => Feature::ScrewHoles,
            phase if phase < smooth + self.screw_holes + self.straight_holes => Feature::StraightHole,
            _ => Feature::Clamp { arc: self.clamp_arc, height_mm: self.clamp_height_mm, shape: self.clamp_shape },
        }
    }

    /// Displacement of the point at `place` (0 to 1 along the arc) away from the axis by `feature` and the bead, mm. `angle` is its
    /// distance from the middle of a clamp, radians about the axis.
    pub(super) fn offset_mm(&self, feature: Feature, place: f64, angle: f64, radius_mm: f64) -> f64 {
        let raised = feature.offset_mm(place - self.shift, angle, radius_mm);
        // A clamp hides the bead.
        if raised == 0.0 { self.bead.offset_mm(place) } else { raised }
    }
}

impl Feature {
    fn offset_mm(self, place: f64, angle: f64, radius_mm: f64) -> f64 {
        let within = |start: f64, width: f64| place >= start && place < start + width;
        match self {
            Self::ScrewHoles if within(0.41, 0.02) => -10.0,
            Self::ScrewHoles if within(0.61, 0.02) => -20.0,
            Self::StraightHole if within(0.55, 0.15) => -30.0,
            Self::Clamp { arc, height_mm, shape } if within(0.5 - arc / 2.0, arc) => {
                shape.offset_mm(angle, height_mm, radius_mm)
            }
            _ => 0.0,
        }
    }
}

impl ClampShape {
    /// Height above the surface in the direction `angle` from the middle of the clamp, about the axis.
    fn offset_mm(self, angle: f64, height_mm: f64, radius_mm: f64) -> f64 {
        let (sin, cos) = angle.sin_cos();
        let top = radius_mm + height_mm;
        let face = match self {
            Self::Concentric => return height_mm,
            // Beyond 80° a flat face is no longer visible.
            Self::Flat => top / cos.max(0.17) - radius_mm,
            Self::Round { radius_mm: own } => {
                let centre = top - own;
                centre * cos + (own * own - (centre * sin).powi(2)).max(0.0).sqrt() - radius_mm
            }
        };
        // A clamp that would intersect the part is hidden by it.
        face.max(0.0)
    }
}

/// The ends of a part. A side without an edge extends beyond the scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Edges {
    /// The end at the smaller x.
    pub near: Option<Edge>,
    /// The end at the larger x.
    pub far: Option<Edge>,
}

/// One end of a part. Lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Edge {
    /// Intersection of the axis with the end plane.
    pub x_mm: f64,
    /// Size of a chamfer of 45°; 0 for a sharp edge.
    pub chamfer_mm: f64,
    /// Share of the columns that end early, in runs of about a thirtieth of the arc.
    pub ragged_ratio: f64,
    /// Mean distance by which those columns end early.
    pub ragged_mm: f64,
    /// The object beyond; `None` for nothing.
    pub beyond: Option<Neighbour>,
}

/// Another cylinder about the same axis, beyond a gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Distance from the end plane to its beginning, mm.
    pub gap_mm: f64,
    /// Height above the part's surface, mm: 0 for another part, below 0 for a support, above 0 for a clamp.
    pub height_mm: f64,
}

/// Mean length of a run of columns of a ragged edge that end together, as a share of all.
const RUN_SHARE: f64 = 1.0 / 30.0;

impl Edge {
    /// Intersection of the axis with the end plane, mm.
    #[must_use]
    pub fn centre(&self, axis: &AxisLine) -> [f64; 3] {
        let [y, z] = axis.at(self.x_mm);
        [self.x_mm, y, z]
    }

    /// Distance by which each column ends early, mm: alternating runs of complete and ragged columns of exponential lengths.
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
        // The pattern starts at a random position, so that its first run is as likely ragged as any other.
        early.truncate(columns_count);
        early.rotate_left((exponential(1.0) * columns_count as f64) as usize % columns_count.max(1));
        early
    }
}

impl Edges {
    /// The edges of one scan with their random numbers drawn.
    pub(super) fn prepare(
        &self,
        axis: AxisLine,
        radius_mm: f64,
        outward: f64,
        columns_count: usize,
        seed: u64,
    ) -> Prepared {
        // A separate random stream, so that the points of a part do not depend on whether it ends.
        let mut chance = Stream::Edges.of(seed);
        let mut prepare =
            |edge: Option<Edge>, side: f64| edge.map(|edge| (edge, side, edge.early(columns_count, &mut chance)));
        let sides = [prepare(self.near, -1.0), prepare(self.far, 1.0)].into_iter().flatten().collect();
        Prepared { axis, radius_mm, outward, sides }
    }
}

/// The edges of one scan.
pub(super) struct Prepared {
    axis: AxisLine,
    radius_mm: f64,
    /// 1 if a chamfer removes material towards the axis, −1 inside a pipe.
    outward: f64,
    /// Each edge with its side, −1 or 1, and the distances by which its columns end early.
    sides: Vec<(Edge, f64, Vec<f64>)>,
}

impl Prepared {
    /// Distance beyond the surface at which the line of sight of a column meets an object, where `offset` is the distance without
    /// an edge; `None` if it meets nothing.
    pub(super) fn offset(&self, sight: &Sight, column: usize, offset: f64) -> Option<f64> {
        self.sides.iter().try_fold(offset, |offset, (edge, side, early)| {
            let early = early.get(column).copied().unwrap_or(0.0);
            self.past(edge, *side, early, sight, offset)
        })
    }

    /// The plane is T·(P − C) = 0. A point at the distance `reach` along the line of sight lies `side`·(n·(x − x_C) + reach·k/n)
    /// beyond it, k = T·D of the direction D, and m·reach from the axis, m² = 1 − k²/n².
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
mod interference_tests {
    use super::*;

    /// The point in the direction `angle`, about the part's axis.
    fn face(shape: ClampShape, angle: f64) -> [f64; 2] {
        let reach = 200.0 + shape.offset_mm(angle, 25.0, 200.0);
        [reach * angle.sin(), reach * angle.cos()]
    }

    #[test]
    fn a_flat_clamp_is_flat_and_a_round_one_round() {
        for angle in [-0.6, -0.1, 0.0, 0.3, 0.5] {
            assert!((face(ClampShape::Flat, angle)[1] - 225.0).abs() < 1e-9);
            for own in [60.0, 150.0, 400.0] {
                let [y, z] = face(ClampShape::Round { radius_mm: own }, 0.3 * angle);
                assert!((y.hypot(z - (225.0 - own)) - own).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_bead_has_no_height_at_its_edges() {
        let bead = Bead { height_mm: 0.3, arc: 0.1, place: 0.4 };
        assert!((bead.offset_mm(0.4) - 0.3).abs() < 1e-12 && (bead.offset_mm(0.425) - 0.15).abs() < 1e-12);
        assert!(bead.offset_mm(0.3501) < 1e-5 && bead.offset_mm(0.46) == 0.0);
        assert_eq!(Bead::default().offset_mm(0.0), 0.0);
    }
}

#[cfg(test)]
mod edge_tests {
    use super::*;
    use crate::scan::synthetic::{LaserPlane, Part, Side};
    use rand::SeedableRng;

    const STRAIGHT: AxisLine = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };

    /// The observed distance at `x` of a part along X: the position beyond the plane is x − x_C for every direction.
    fn seen(edge: Edge, side: Side, x: f64) -> Option<f64> {
        let edges = Edges { near: None, far: Some(edge) };
        let part = Part { axis: STRAIGHT, radius_mm: 50.0, side, edges, ..Part::smooth(1) };
        part.prepared_edges().offset(&LaserPlane::default().sight(&STRAIGHT, x, 0.0), 0, 0.0)
    }

    #[test]
    fn a_chamfer_has_45_degrees_and_ends_in_the_plane() {
        let edge = Edge { x_mm: 100.0, chamfer_mm: 2.0, ..Edge::default() };
        let seen = |x: f64| seen(edge, Side::Outside, x);
        assert_eq!(
            [seen(90.0), seen(98.0), seen(99.0), seen(100.0), seen(100.1)],
            [Some(0.0), Some(0.0), Some(-1.0), Some(-2.0), None]
        );
    }

    #[test]
    fn inside_a_pipe_chamfer_and_neighbour_lie_on_the_other_side_of_the_surface() {
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
    fn the_requested_share_of_the_columns_ends_early() {
        let edge = Edge { ragged_ratio: 0.3, ragged_mm: 2.0, ..Edge::default() };
        let mut chance = ChaCha8Rng::seed_from_u64(7);
        let early = edge.early(1_000_000, &mut chance);
        // Only thirty runs: the share of one edge scatters by a third of itself.
        let share = early.iter().filter(|early| **early > 0.0).count() as f64 / 1e6;
        assert!((0.1..0.5).contains(&share), "{share}");
    }
}
