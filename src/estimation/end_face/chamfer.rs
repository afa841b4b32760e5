//! What lies below the surface at its end: a chamfer, which is part of the part, or a slant whose end is not told. Must not
//! know what a plane of the end is.

use super::cells::{Cell, Seen};

/// Points below the surface that make a chamfer, or a slant that goes on; the share of them that tells its depth, and how steep
/// it may be: 60° are usual.
const POINTS_MIN: usize = 5;
const DEEPEST_SHARE: f64 = 0.1;
const SLOPE_MAX: f64 = 2.0;

/// What goes on below is seen in this share of the columns; and below this slope it is flat.
const SLANT_SHARE_MIN: f64 = 0.1;
const FLAT_MAX: f64 = 0.1;

/// Where points below the surface are part of it: a slant, through the deepest of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Chamfer {
    from: f64,
    to: f64,
    /// A place on it, mm.
    at: f64,
    /// How deep it is there, mm.
    depth: f64,
    /// By how much it is deeper per millimetre outward.
    slope: f64,
}

impl Chamfer {
    /// From the points below the surface between two places; `None` where there is no chamfer.
    pub(super) fn seen(cells: &[Cell], from: f64, to: f64) -> Option<Self> {
        let below = |cell: &Cell| match cell.seen {
            Seen::Below { t, depth } if t > from && t <= to => Some([t, depth]),
            _ => None,
        };
        let mut points: Vec<[f64; 2]> = cells.iter().filter_map(below).collect();
        points.sort_by(|[_, a], [_, b]| b.total_cmp(a));
        let deepest = points.get(..(DEEPEST_SHARE * points.len() as f64).ceil() as usize)?;
        let [at, depth] = mean(deepest);
        let slope = slope(&points).clamp(0.0, SLOPE_MAX);
        (points.len() >= POINTS_MIN).then_some(Self { from, to, at, depth, slope })
    }

    /// Whether it reaches to a place along the axis.
    fn holds(&self, t: f64) -> bool {
        t > self.from && t <= self.to
    }

    /// How far a point on it lies along the axis that on the surface would lie `lead` beyond `from`: leads grow with the
    /// distance from the axis, so that t = from + lead·(1 − d/R), and the depth d = depth + slope·(t − at).
    pub(super) fn place(&self, from: f64, lead: f64, radius: f64) -> f64 {
        let share = lead / radius;
        (from + lead - share * (self.depth - self.slope * self.at)) / (1.0 + share * self.slope)
    }
}

/// Whether a cell shows the part; `None` where nobody can say.
pub(super) fn is_part(seen: Seen, chamfer: Option<Chamfer>) -> Option<bool> {
    match seen {
        Seen::Surface { .. } => Some(true),
        Seen::Below { t, .. } => Some(chamfer.is_some_and(|chamfer| chamfer.holds(t))),
        Seen::Deep { .. } | Seen::Nothing => Some(false),
        Seen::Hidden => None,
    }
}

/// Of places with their depths.
fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let sum = points.iter().fold([0.0; 2], |[ts, depths], [t, depth]| [ts + t, depths + depth]);
    sum.map(|sum| sum / points.len() as f64)
}

/// By how much the depth grows with the place, by least squares; none where all are at one place.
fn slope(points: &[[f64; 2]]) -> f64 {
    let [mean_t, mean_depth] = mean(points);
    let products = points.iter().map(|[t, depth]| [(t - mean_t) * (depth - mean_depth), (t - mean_t).powi(2)]);
    let [both, square] = products.fold([0.0; 2], |[both, square], [b, s]| [both + b, square + s]);
    if square > 0.0 { both / square } else { 0.0 }
}

/// Whether beyond the last place that shows the part it goes on below as a slant would, deeper or longer than what is told:
/// nobody can say where that ends. A support or a shaft lies farther below, or goes on at one depth.
pub(super) fn goes_on(
    cells: &[Cell],
    columns_count: usize,
    chamfer: Option<Chamfer>,
    last: f64,
    tolerance: f64,
) -> bool {
    let next = (0..columns_count).filter_map(|column| {
        let of_column: Vec<&Cell> = cells.iter().skip(column).step_by(columns_count.max(1)).collect();
        Next::beyond(&of_column, chamfer, last)
    });
    let slants: Vec<Next> = next.filter(|next| next.deeper <= SLOPE_MAX * next.step + tolerance).collect();
    let grown = slants.iter().filter_map(|next| next.grows);
    let [grown, steps, count] = grown.fold([0.0; 3], |[sum, steps, n], [by, step]| [sum + by, steps + step, n + 1.0]);
    let ends = 2.0 * count < slants.len() as f64;
    slants.len() >= POINTS_MIN.max((SLANT_SHARE_MIN * columns_count as f64) as usize)
        && (ends || grown > FLAT_MAX * steps)
}

/// What a column shows in the plane beyond the last one that shows the part.
struct Next {
    /// How far that is, mm, and by how much what it shows is deeper.
    step: f64,
    deeper: f64,
    /// By how much the plane after it is deeper still, and how far it is.
    grows: Option<[f64; 2]>,
}

impl Next {
    /// `None` where the column shows nothing below there.
    fn beyond(of_column: &[&Cell], chamfer: Option<Chamfer>, last: f64) -> Option<Self> {
        let is_last =
            |cell: &&Cell| is_part(cell.seen, chamfer) == Some(true) && cell.seen.t().is_some_and(|t| t <= last);
        let at = of_column.iter().rposition(is_last)?;
        let [part, next] = [at, at + 1].map(|index| of_column.get(index));
        let (part, next) = part.zip(next)?;
        let depth = next.seen.depth()?;
        let grows = of_column.get(at + 2).and_then(|cell| Some([cell.seen.depth()? - depth, cell.ahead - next.ahead]));
        Some(Self { step: next.ahead - part.ahead, deeper: depth - part.seen.depth().unwrap_or(0.0), grows })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn below(t: f64, depth: f64) -> Cell {
        Cell { ahead: 0.0, seen: Seen::Below { t, depth } }
    }

    /// 45°, from the surface at 10.
    #[test]
    fn a_chamfer_is_a_slant_and_what_it_lacks_lies_on_it() {
        let cells: Vec<Cell> = (1..=20).map(|index| 0.1 * f64::from(index)).map(|d| below(10.0 + d, d)).collect();
        let chamfer = Chamfer::seen(&cells, 9.0, 17.0).expect("a chamfer");
        let (radius, lead) = (8.0, 0.8);
        let t = chamfer.place(11.5, lead, radius);
        let depth = t - 10.0;
        assert!((t - (11.5 + lead * (1.0 - depth / radius))).abs() < 1e-9, "{t}");
    }

    #[test]
    fn few_points_are_no_chamfer() {
        assert_eq!(Chamfer::seen(&[below(10.0, 0.5); 4], 9.0, 17.0), None);
    }

    /// Ten columns that end at 10, and what three planes a millimetre apart show beyond.
    fn beyond(depths: [Option<f64>; 3]) -> Vec<Cell> {
        let surface = Seen::Surface { first: 10.0, t: 10.0 };
        let seen = depths.map(|depth| depth.map_or(Seen::Nothing, |depth| Seen::Deep { depth }));
        let planes = std::iter::once(surface).chain(seen).enumerate();
        planes.flat_map(|(index, seen)| [Cell { ahead: 10.0 + index as f64, seen }; 10]).collect()
    }

    #[test]
    fn a_slant_goes_on_and_a_support_a_shaft_and_nothing_do_not() {
        let goes_on = |depths| goes_on(&beyond(depths), 10, None, 10.0, 0.15);
        assert!(goes_on([Some(0.3), Some(0.6), Some(0.9)]));
        assert!(goes_on([Some(1.5), None, None]));
        assert!(!goes_on([Some(5.0), Some(5.0), Some(5.0)]));
        assert!(!goes_on([Some(1.0), Some(1.0), Some(1.0)]));
        assert!(!goes_on([None, Some(1.0), Some(2.0)]));
    }
}
