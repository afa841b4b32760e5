//! What the cells say about where the part is: at which place along the axis each of them shows it or lacks it. Must not know
//! where the part ends.

use super::cells::{Cell, Seen};
use super::chamfer::{self, Chamfer};
use super::lattice::{Column, Lattice};

/// Cells in a row that are told apart.
pub(super) const LACKING_MAX: usize = 3;

/// That the part is there, or is not, at a place along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Evidence {
    pub(super) t: f64,
    pub(super) present: bool,
    /// How many cells in a row lack the part, of those beside it that a growing part reaches first, up to [`LACKING_MAX`];
    /// `None` where nobody can say.
    pub(super) lacking: Option<usize>,
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
        let shows = |index: usize| chamfer::is_part(plane.get(index)?.seen, chamfer);
        let reach = |index: usize| plane.get(index)?.seen.t().filter(|_| shows(index) == Some(true));
        let before = |index: usize| lattice.columns().get(index)?.before;
        for (index, ((cell, column), first)) in plane.iter().zip(lattice.columns()).zip(&firsts).enumerate() {
            let Some(present) = chamfer::is_part(cell.seen, chamfer) else { continue };
            // What is missing is missing from the first of its points on: just behind the last one of the column before it.
            let behind = column.before.and_then(reach).zip(first.behind);
            let (from, lead) = behind.unwrap_or((cell.ahead, first.ahead));
            let missing = (place(from, lead.mean), lead.variance);
            let noise = sigma * sigma * column.of_noise(cell.seen);
            let (t, variance) = reach(index).map_or(missing, |t| (t, noise));
            let known = column.before.and_then(shows).is_some();
            let run = std::iter::successors(column.before, |index| before(*index));
            let lacking = known.then(|| run.take_while(|index| shows(*index) == Some(false)).take(LACKING_MAX).count());
            evidence.push(Evidence { t, present, lacking, variance, column: index, rising: column.rising });
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
