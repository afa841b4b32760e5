//! The cylinder about its end as cells: columns about the axis times planes. A cell shows the surface, something below it,
//! something above that hides it, or nothing. Must not know where the part ends.

use super::chamfer::Chamfer;
use super::lattice::{Column, Lattice};
use super::view::{Glimpse, Plane};

/// Deepest chamfer that is told from a hole or a support, and deepest place that is looked at, mm.
const DEPTH_MAX_MM: f64 = 3.2;
const DEEP_MAX_MM: f64 = 12.0;
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
    /// Something farther below than a chamfer may be.
    Deep {
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
    pub(super) ahead: f64,
    pub(super) seen: Seen,
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
            Seen::Nothing | Seen::Deep { .. } if depth < 0.0 => Seen::Hidden,
            Seen::Nothing if depth <= DEEP_MAX_MM => Seen::Deep { depth },
            other => other,
        };
    }
    cells
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
        let reach = |index: usize| plane.get(index)?.seen.t().filter(|_| shows(index) == Some(true));
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
    /// How far the surface or what is a little below it is seen.
    pub(super) const fn t(self) -> Option<f64> {
        match self {
            Self::Surface { t, .. } | Self::Below { t, .. } => Some(t),
            _ => None,
        }
    }

    /// How far something below the surface is below it.
    pub(super) const fn depth(self) -> Option<f64> {
        match self {
            Self::Below { depth, .. } | Self::Deep { depth } => Some(depth),
            _ => None,
        }
    }

    /// Whether this is the part; `None` where nobody can say.
    pub(super) fn is_part(self, chamfer: Option<Chamfer>) -> Option<bool> {
        match self {
            Self::Surface { .. } => Some(true),
            Self::Below { t, .. } => Some(chamfer.is_some_and(|chamfer| chamfer.holds(t))),
            Self::Deep { .. } | Self::Nothing => Some(false),
            Self::Hidden => None,
        }
    }
}
