//! Distinguishes the continuations below the end of the surface: a chamfer, which belongs to the part; a shaft or support, which
//! does not; or a slant whose end the scan does not show.
//!
//! One spacing at a time outward from the end of the surface, the positions below it are followed as long as they get deeper no
//! faster than a chamfer does. A support farther below is not reached.

use super::occupancy::{CELLS_MIN, Cells, DEPTH_MAX, LOST_MAX, SHARE_MIN, Slant};
use crate::estimation::statistics::median;

/// Steepest slope that is followed: chamfers of 30°, 45° and 60° are usual (tan 60° = 1.7).
const SLOPE_MAX: f64 = 2.0;
/// Flattest slope of a chamfer: 6°. Lead-in chamfers have 15° (0.27); a shaft along the axis has 0.
const SLOPE_MIN: f64 = 0.1;
/// Share of the points, the deepest ones, whose mean fixes the line: the end plane lies there.
const DEEPEST_SHARE: f64 = 0.1;

/// The continuation below the end of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Beneath {
    /// Nothing, or an object too far below to belong to the part.
    Nothing,
    /// A slant that ends.
    Chamfer(Slant),
    /// A shaft or a support parallel to the axis.
    Ledge(Slant),
    /// A slant that does not end in the scan, or that ends deeper than any chamfer.
    Endless(Slant),
}

impl Beneath {
    /// How far it has to be examined: a ledge no farther than `ledge_max`, since a longer stretch of it adds no information.
    pub(super) fn to(&self, surface_end: f64, ledge_max: f64) -> f64 {
        match self {
            Self::Nothing => surface_end,
            Self::Ledge(slant) => slant.to.min(ledge_max),
            Self::Chamfer(slant) | Self::Endless(slant) => slant.to,
        }
    }
}

/// The continuation below a surface that ends at `surface_end` ± half a spacing.
pub(super) fn beneath(cells: &Cells, surface_end: f64, spacing: f64, tolerance: f64) -> Beneath {
    let start = surface_end - 0.5 * spacing;
    let mut bins: Vec<(f64, Option<f64>)> =
        cells.depths().filter(|(t, _)| *t > start).map(|(t, depth)| (((t - start) / spacing).floor(), depth)).collect();
    bins.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (mut to, mut depth_to, mut followed_count, mut void_count) = (start, 0.0, 0, 0);
    for of_bin in bins.chunk_by(|(a, _), (b, _)| a == b).filter(|of_bin| of_bin.len() >= CELLS_MIN) {
        let end = start + spacing * (1.0 + of_bin.first().map_or(0.0, |(bin, _)| *bin));
        let depth_max = depth_to + SLOPE_MAX * (end - to) + tolerance;
        let reached: Vec<f64> = of_bin.iter().filter_map(|(_, depth)| *depth).filter(|d| *d <= depth_max).collect();
        if (reached.len() as f64) >= SHARE_MIN * of_bin.len() as f64 {
            (to, depth_to) = (end, median(reached.into_iter()).unwrap_or(depth_to));
            (followed_count, void_count) = (followed_count + 1, 0);
            continue;
        }
        void_count += 1;
        if void_count > LOST_MAX {
            break;
        }
    }
    // A few points may lie up to a spacing to either side of the positions that were followed.
    let depth_max = depth_to + SLOPE_MAX * spacing + tolerance;
    let Some(slant) = line(cells, [start - spacing, to + spacing], depth_max).filter(|_| followed_count > 0) else {
        return Beneath::Nothing;
    };
    let flat = followed_count > 1 && slant.slope < SLOPE_MIN;
    let ends = void_count > 0 && depth_to + slant.slope * spacing < DEPTH_MAX * cells.columns.radius;
    match (flat, ends) {
        (true, _) => Beneath::Ledge(slant),
        (false, true) => Beneath::Chamfer(slant),
        (false, false) => Beneath::Endless(slant),
    }
}

/// The line with the least-squares slope through the mean of the deepest points; `None` for few points.
fn line(cells: &Cells, [from, to]: [f64; 2], depth_max: f64) -> Option<Slant> {
    let below = cells.depths().filter_map(|(t, depth)| Some([t, depth?]));
    let mut points: Vec<[f64; 2]> = below.filter(|[t, d]| *t > from && *t <= to && *d <= depth_max).collect();
    points.sort_by(|[_, a], [_, b]| b.total_cmp(a));
    let [at, depth] = mean(points.get(..(DEEPEST_SHARE * points.len() as f64).ceil() as usize)?);
    let [mean_t, mean_depth] = mean(&points);
    let moments = points.iter().map(|[t, depth]| [(t - mean_t) * (depth - mean_depth), (t - mean_t).powi(2)]);
    let [product, square] = moments.fold([0.0; 2], |[product, square], [p, s]| [product + p, square + s]);
    // If all points lie at one position, the slope has no effect.
    let slope = if square > 0.0 { (product / square).clamp(0.0, SLOPE_MAX) } else { 0.0 };
    (points.len() > CELLS_MIN).then_some(Slant { from, to, depth_max, at, depth, slope })
}

fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let sum = points.iter().fold([0.0; 2], |[ts, depths], [t, depth]| [ts + t, depths + depth]);
    sum.map(|sum| sum / points.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::end_face::unroll::{Column, Columns, Plane, Unrolled};

    /// Ten columns of a part of radius 20 along X that ends at 3, and the depth that they show in each plane beyond.
    fn beyond(depths: &[Option<f64>]) -> Beneath {
        let column = Column { angle: 0.0, lead: 0.0, slope: [0.0; 2], before: None, rising: true };
        let columns = Columns { bounds: (1..10).map(f64::from).collect(), all: vec![column; 10], radius: 20.0 };
        let shown: Vec<Option<f64>> = [Some(0.0); 4].iter().chain(depths).copied().collect();
        let planes: Vec<Plane> =
            (0..shown.len()).map(|index| Plane { x: 0.0, t: index as f64, points: 0..0 }).collect();
        let point = |(plane, depth): (usize, &Option<f64>)| {
            let (t, depth) = (plane as f64, *depth);
            (0..10).filter_map(move |column| {
                Some(Unrolled { plane, t, t_on_surface: t, angle: f64::from(column) + 0.5, height: -depth? })
            })
        };
        let points: Vec<Unrolled> = shown.iter().enumerate().flat_map(point).collect();
        beneath(&Cells::of(&points, &planes, columns, 0.1), 3.0, 1.0, 0.1)
    }

    #[test]
    fn a_slant_that_ends_is_a_chamfer() {
        let Beneath::Chamfer(slant) = beyond(&[Some(0.5), Some(1.5), None, None]) else { panic!("no chamfer") };
        assert!((slant.slope - 1.0).abs() < 1e-9 && (slant.at, slant.depth) == (5.0, 1.5), "{slant:?}");
        assert!(matches!(beyond(&[Some(0.5), None, None]), Beneath::Chamfer(_)));
        // A background farther below is not a continuation.
        assert!(matches!(beyond(&[Some(0.5), Some(7.0), Some(7.0)]), Beneath::Chamfer(_)));
    }

    #[test]
    fn an_endless_slant_a_shaft_and_a_support_are_not_chamfers() {
        assert!(matches!(beyond(&[Some(0.5), Some(1.5), Some(2.5)]), Beneath::Endless(_)));
        let cone: Vec<Option<f64>> = (1..15).map(|depth| Some(f64::from(depth))).collect();
        assert!(matches!(beyond(&cone), Beneath::Endless(_)));
        assert!(matches!(beyond(&[Some(1.0); 4]), Beneath::Ledge(_)));
        assert!(matches!(beyond(&[Some(1.0), Some(1.0), None, None]), Beneath::Ledge(_)));
        assert_eq!(beyond(&[Some(5.0); 4]), Beneath::Nothing);
        assert_eq!(beyond(&[None; 4]), Beneath::Nothing);
    }
}
