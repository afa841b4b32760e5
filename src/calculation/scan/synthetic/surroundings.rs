//! What a sensor sees beside a synthetic part: the floor below it and a support next to it. In: the part and a plane. Out: points,
//! left and right of the part's own.

use super::Part;

/// Points beside the part, as shares of the points on it. All none by default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surroundings {
    /// Points on a level floor, half of them on either side.
    pub floor: f64,
    /// How far below the axis, in its middle, the floor lies.
    pub floor_depth_mm: f64,
    /// Points of a support on the +Y side.
    pub support: f64,
    /// Share of the profiles that show the support.
    pub supports: f64,
    /// A round support's radius, its axis parallel to the part's and at its height; 0 for a level one.
    pub support_radius_mm: f64,
}

/// Gap between the part and what stands beside it, in radii.
const GAP: f64 = 0.05;
/// Width of the floor on either side, in radii.
const FLOOR_WIDTH: f64 = 0.75;
/// Width of a level support, in radii,
const SUPPORT_WIDTH: f64 = 0.4;
/// and how far below the axis its face lies.
const SUPPORT_DEPTH: f64 = 0.3;
/// Half of the angle over which a round support is seen.
const SUPPORT_HALF_RAD: f64 = 1.0;

impl Surroundings {
    /// The points left of the part (towards −Y) in the plane of the profile `index` at `x`, in order of y.
    pub(super) fn left(&self, part: &Part, x: f64) -> Vec<[f64; 2]> {
        let start = part.axis.at(x)[0] - part.radius_mm * (1.0 + GAP + FLOOR_WIDTH);
        self.floor(part, start)
    }

    /// The points right of the part, in order of y but for the end of a support that hangs over the floor.
    pub(super) fn right(&self, part: &Part, x: f64, index: usize) -> Vec<[f64; 2]> {
        let [axis_y, axis_z] = part.axis.at(x);
        let edge = axis_y + part.radius_mm * (1.0 + GAP);
        let shown = (index as f64 + 0.5) / part.profiles_count as f64 % 0.25 < 0.25 * self.supports;
        let count = if shown { (self.support * part.points_count as f64).round() as usize } else { 0 };
        let support = (0..count).map(|i| (i as f64 + 0.5) / count as f64).map(|share| {
            let own = self.support_radius_mm;
            if own > 0.0 {
                let (sin, cos) = ((2.0 * share - 1.0) * SUPPORT_HALF_RAD).sin_cos();
                [edge + own * (1.0 + sin), axis_z + own * cos]
            } else {
                [edge + share * part.radius_mm * SUPPORT_WIDTH, axis_z - part.radius_mm * SUPPORT_DEPTH]
            }
        });
        support.chain(self.floor(part, edge)).collect()
    }

    fn floor(&self, part: &Part, start: f64) -> Vec<[f64; 2]> {
        let [_, middle_z] = part.axis.at(part.x_start_mm + part.length_mm / 2.0);
        let count = (0.5 * self.floor * part.points_count as f64).round() as usize;
        let step = part.radius_mm * FLOOR_WIDTH / count.max(1) as f64;
        (0..count).map(|i| [start + (i as f64 + 0.5) * step, middle_z - self.floor_depth_mm]).collect()
    }
}
