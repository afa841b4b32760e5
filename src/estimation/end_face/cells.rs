//! The cylinder about its end as cells: columns about the axis times planes. A cell shows the surface, something below it,
//! something above that hides it, or nothing. Must not know where the part ends.

use super::lattice::{Column, Lattice};
use super::view::{Glimpse, Plane};

/// Deepest chamfer that is told from a hole or a support, mm.
const DEPTH_MAX_MM: f64 = 3.2;
/// Points below the surface that make a chamfer, and which of their depths tells that at its end.
const CHAMFER_POINTS_MIN: usize = 5;
const DEPTH_QUANTILE: f64 = 0.95;

/// Cells in a row that are told apart.
pub(super) const LACKING_MAX: usize = 3;

/// What a column shows in one plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Seen {
    Nothing,
    /// Something above the surface, which hides it.
    Hidden,
    /// Something a little below, at t.
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
                Seen::Surface { first: first.min(t), t: last.max(t) }
            }
            surface @ Seen::Surface { .. } => surface,
            _ if depth.abs() <= tolerance => Seen::Surface { first: t, t },
            Seen::Nothing | Seen::Hidden if depth > 0.0 && depth <= DEPTH_MAX_MM + tolerance => {
                Seen::Below { t, depth }
            }
            Seen::Nothing if depth < 0.0 => Seen::Hidden,
            other => other,
        };
    }
    cells
}

/// Where points below the surface are part of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Chamfer {
    pub(super) from: f64,
    pub(super) to: f64,
    /// How deep it is at its end, mm: what is missing there is missing from a smaller radius.
    pub(super) depth: f64,
}

impl Chamfer {
    /// How deep the cells say it is; `None` where there is no chamfer.
    pub(super) fn depth_of(&self, cells: &[Cell]) -> Option<f64> {
        let depth = |cell: &Cell| match cell.seen {
            Seen::Below { t, depth } if t > self.from && t <= self.to => Some(depth),
            _ => None,
        };
        let mut depths: Vec<f64> = cells.iter().filter_map(depth).collect();
        depths.sort_by(f64::total_cmp);
        let at = (DEPTH_QUANTILE * depths.len() as f64) as usize;
        let (least, depth) = (depths.first()?, depths.get(at)?);
        // Up to its end the depths are spread evenly.
        (depths.len() >= CHAMFER_POINTS_MIN).then(|| least + (depth - least) / DEPTH_QUANTILE)
    }
}

/// That the part is there, or is not, at a place along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    pub(super) t: f64,
    pub(super) present: bool,
    /// How many cells in a row lack the part, of those beside it that a growing part reaches first, up to [`LACKING_MAX`];
    /// `None` where nobody can say.
    pub(super) lacking: Option<usize>,
    /// Where the nearest of those lies, if it shows the part.
    pub(super) beside: Option<f64>,
    /// Variance of `t`, mm².
    pub(super) variance: f64,
    pub(super) column: usize,
}

/// What the cells say; hidden ones say nothing.
pub(super) fn evidence(cells: &[Cell], lattice: &Lattice, chamfer: Option<Chamfer>) -> Vec<Evidence> {
    // The lead grows with the radius.
    let share = 1.0 - chamfer.map_or(0.0, |chamfer| chamfer.depth / lattice.radius());
    let firsts = firsts(cells, lattice);
    let mut evidence = Vec::with_capacity(cells.len());
    for plane in cells.chunks(lattice.len().max(1)) {
        let shows = |index: usize| plane.get(index)?.seen.is_part(chamfer);
        let reach = |index: usize| match plane.get(index)?.seen {
            Seen::Surface { t, .. } | Seen::Below { t, .. } if shows(index)? => Some(t),
            _ => None,
        };
        for (index, ((cell, column), first)) in plane.iter().zip(lattice.columns()).zip(&firsts).enumerate() {
            let Some(present) = cell.seen.is_part(chamfer) else { continue };
            // What is missing is missing from the first of its points on.
            let t = reach(index).unwrap_or(cell.ahead + share * first.mean);
            let before = |index: usize| lattice.columns().get(index)?.before;
            let known = column.before.and_then(shows).is_some();
            let run = std::iter::successors(column.before, |index| before(*index));
            let lacking = known.then(|| run.take_while(|index| shows(*index) == Some(false)).take(LACKING_MAX).count());
            let beside = column.before.and_then(reach);
            evidence.push(Evidence { t, present, lacking, beside, variance: first.variance, column: index });
        }
    }
    evidence
}

/// How far ahead of its plane the first point of a column lies.
#[derive(Debug, Clone, Copy)]
struct First {
    mean: f64,
    variance: f64,
}

/// Of each column, over the planes that show the surface in it.
fn firsts(cells: &[Cell], lattice: &Lattice) -> Vec<First> {
    let mut sums = vec![[0.0; 3]; lattice.len()];
    for plane in cells.chunks(lattice.len().max(1)) {
        for ([count, sum, squares], cell) in sums.iter_mut().zip(plane) {
            if let Seen::Surface { first, .. } = cell.seen {
                let lead = first - cell.ahead;
                (*count, *sum, *squares) = (*count + 1.0, *sum + lead, *squares + lead * lead);
            }
        }
    }
    let first = |([count, sum, squares], column): ([f64; 3], &Column)| {
        let mean = if count > 0.0 { sum / count } else { column.lead };
        First { mean, variance: (squares / f64::max(count, 1.0) - mean * mean).max(0.0) }
    };
    sums.into_iter().zip(lattice.columns()).map(first).collect()
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
