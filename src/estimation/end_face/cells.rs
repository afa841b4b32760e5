//! The cylinder about its end as cells: columns about the axis times planes. A cell shows the surface, something below it,
//! something above that hides it, or nothing. Must not know where the part ends.

use super::lattice::{Column, Lattice};
use super::view::{Glimpse, Plane};

/// Deepest chamfer that is told from a hole or a support, mm.
const DEPTH_MAX_MM: f64 = 3.2;
/// Points below the surface that make a chamfer, the share of them that tells its depth, and how steep it may be: 60° are
/// usual.
const CHAMFER_POINTS_MIN: usize = 5;
const DEEPEST_SHARE: f64 = 0.1;
const SLOPE_MAX: f64 = 2.0;

/// Cells in a row that are told apart.
pub(super) const LACKING_MAX: usize = 3;

/// What a column shows in one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Seen {
    Nothing,
    /// Something above the surface, which hides it.
    Hidden,
    /// Something a little below, up to t.
    Below {
        t: f64,
        depth: f64,
    },
    /// The surface, from `first` up to t.
    Surface {
        first: f64,
        t: f64,
    },
}

/// One column in one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    /// Where the axis is in its plane, mm.
    ahead: f64,
    seen: Seen,
}

/// The cells, plane after plane, in each the columns in their order.
pub(super) fn cells(glimpses: &[Glimpse], planes: &[Plane], lattice: &Lattice, tolerance: f64) -> Vec<Cell> {
    let nothing = |plane: &Plane| std::iter::repeat_n(Cell { ahead: plane.ahead, seen: Seen::Nothing }, lattice.len());
    let mut cells: Vec<Cell> = planes.iter().flat_map(nothing).collect();
    for glimpse in glimpses {
        let column = lattice.column_at(glimpse.angle);
        let Some(cell) = cells.get_mut(glimpse.plane * lattice.len() + column) else { continue };
        let (t, depth) = (glimpse.t, -glimpse.height);
        cell.seen = match cell.seen {
            Seen::Surface { first, t: last } if depth.abs() <= tolerance => {
                Seen::Surface { first: first.min(glimpse.of_surface), t: last.max(glimpse.of_surface) }
            }
            surface @ Seen::Surface { .. } => surface,
            _ if depth.abs() <= tolerance => Seen::Surface { first: glimpse.of_surface, t: glimpse.of_surface },
            Seen::Below { t: last, .. } if t <= last => cell.seen,
            _ if depth > 0.0 && depth <= DEPTH_MAX_MM + tolerance => Seen::Below { t, depth },
            Seen::Nothing if depth < 0.0 => Seen::Hidden,
            other => other,
        };
    }
    cells
}

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
        (points.len() >= CHAMFER_POINTS_MIN).then_some(Self { from, to, at, depth, slope })
    }

    /// Whether it is as deep as anything is told from a support, and may go on: evenly spread depths have the mean of their
    /// deepest share half of that before its end.
    pub(super) fn is_deep(&self) -> bool {
        self.depth > (1.0 - 0.5 * DEEPEST_SHARE) * DEPTH_MAX_MM
    }

    /// How far a point on it lies along the axis that on the surface would lie `lead` beyond `from`: leads grow with the
    /// distance from the axis, so that t = from + lead·(1 − d/R), and the depth d = depth + slope·(t − at).
    fn place(&self, from: f64, lead: f64, radius: f64) -> f64 {
        let share = lead / radius;
        (from + lead - share * (self.depth - self.slope * self.at)) / (1.0 + share * self.slope)
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

/// That the part is there, or is not, at a place along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    pub(super) t: f64,
    pub(super) present: bool,
    /// How many cells in a row lack the part, of those beside it that a growing part reaches first, up to [`LACKING_MAX`];
    /// `None` where nobody can say.
    pub(super) lacking: Option<usize>,
    /// How many cells that show the part lie just beside it, behind it as a part grows.
    pub(super) followers: usize,
    /// Variance of `t`, mm².
    pub(super) variance: f64,
    pub(super) column: usize,
    /// Which flank of the part its column is on.
    pub(super) rising: bool,
}

/// What the cells say; hidden ones say nothing. `sigma` is the noise of a point, mm.
pub(super) fn evidence(cells: &[Cell], lattice: &Lattice, chamfer: Option<Chamfer>, sigma: f64) -> Vec<Evidence> {
    let place =
        |from: f64, lead: f64| chamfer.map_or(from + lead, |chamfer| chamfer.place(from, lead, lattice.radius()));
    let firsts = firsts(cells, lattice);
    let mut evidence = Vec::with_capacity(cells.len());
    for plane in cells.chunks(lattice.len().max(1)) {
        let shows = |index: usize| plane.get(index)?.seen.is_part(chamfer);
        let reach = |index: usize| match plane.get(index)?.seen {
            Seen::Surface { t, .. } | Seen::Below { t, .. } if shows(index)? => Some(t),
            _ => None,
        };
        let before = |index: usize| lattice.columns().get(index)?.before;
        for (index, ((cell, column), first)) in plane.iter().zip(lattice.columns()).zip(&firsts).enumerate() {
            let Some(present) = cell.seen.is_part(chamfer) else { continue };
            // What is missing is missing from the first of its points on: just behind the last one of the column before it.
            let behind = column.before.and_then(reach).zip(first.behind);
            let (from, lead) = behind.unwrap_or((cell.ahead, first.ahead));
            let missing = (place(from, lead.mean), lead.variance);
            let noise = sigma * sigma * column.of_noise(cell.seen);
            let (t, variance) = reach(index).map_or(missing, |t| (t, noise));
            let known = column.before.and_then(shows).is_some();
            let run = std::iter::successors(column.before, |index| before(*index));
            let lacking = known.then(|| run.take_while(|index| shows(*index) == Some(false)).take(LACKING_MAX).count());
            let beside = [index.checked_sub(1), Some(index + 1)].into_iter().flatten();
            let follows = |other: &usize| before(*other) == Some(index) && shows(*other) == Some(true);
            let followers = if present { beside.filter(follows).count() } else { 0 };
            evidence.push(Evidence { t, present, lacking, followers, variance, column: index, rising: column.rising });
        }
    }
    evidence
}

impl Column {
    /// The variance along the axis of a point's place by the variance of its noise, which does not move the surface in its
    /// direction across, but what lies below.
    fn of_noise(&self, seen: Seen) -> f64 {
        let [about, away] = self.slope;
        let across = if matches!(seen, Seen::Below { .. }) { away } else { 0.0 };
        about * about + across * across
    }
}

/// Mean and variance of what differs from plane to plane.
#[derive(Debug, Clone, Copy)]
struct Spread {
    mean: f64,
    variance: f64,
}

impl Spread {
    /// `None` without values.
    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let add = |[count, sum, squares]: [f64; 3], value: f64| [count + 1.0, sum + value, squares + value * value];
        let [count, sum, squares] = values.fold([0.0; 3], add);
        let mean = sum / count;
        (count > 0.0).then(|| Self { mean, variance: (squares / count - mean * mean).max(0.0) })
    }
}

/// Where the first point of a column lies.
#[derive(Debug, Clone, Copy)]
struct First {
    /// Ahead of its plane.
    ahead: Spread,
    /// Behind the last point of the column before it.
    behind: Option<Spread>,
}

/// Of each column, over the planes that show the surface in it.
fn firsts(cells: &[Cell], lattice: &Lattice) -> Vec<First> {
    let of_column = |index: usize| cells.iter().skip(index).step_by(lattice.len().max(1));
    let first = |(index, column): (usize, &Column)| {
        let leads = of_column(index).filter_map(|cell| Some(cell.surface()?[0] - cell.ahead));
        let ahead = Spread::of(leads).unwrap_or(Spread { mean: column.lead, variance: 0.0 });
        let step = |(cell, before): (&Cell, &Cell)| Some(cell.surface()?[0] - before.surface()?[1]);
        let steps = |before: usize| Spread::of(of_column(index).zip(of_column(before)).filter_map(step));
        First { ahead, behind: column.before.and_then(steps) }
    };
    lattice.columns().iter().enumerate().map(first).collect()
}

impl Cell {
    /// The first and the last point on the surface.
    const fn surface(&self) -> Option<[f64; 2]> {
        match self.seen {
            Seen::Surface { first, t } => Some([first, t]),
            _ => None,
        }
    }
}

impl Seen {
    /// Whether this is the part; `None` where nobody can say.
    fn is_part(self, chamfer: Option<Chamfer>) -> Option<bool> {
        match self {
            Self::Surface { .. } => Some(true),
            Self::Below { t, .. } => Some(chamfer.is_some_and(|chamfer| t > chamfer.from && t <= chamfer.to)),
            Self::Nothing => Some(false),
            Self::Hidden => None,
        }
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
        assert!(!chamfer.is_deep());
    }

    #[test]
    fn few_points_are_no_chamfer_and_one_that_reaches_3_2_mm_may_go_on() {
        assert_eq!(Chamfer::seen(&[below(10.0, 0.5); 4], 9.0, 17.0), None);
        let to_the_most: Vec<Cell> = (1..=100).map(|i| below(10.0, 0.033 * f64::from(i))).collect();
        assert!(Chamfer::seen(&to_the_most, 9.0, 17.0).is_some_and(|chamfer| chamfer.is_deep()));
    }
}
