//! The cylinder about its end as cells: columns about the axis times planes. A cell shows the surface, something below it,
//! something above that hides it, or nothing. Must not know where the part ends.

use super::lattice::Lattice;
use super::view::{Glimpse, Plane};

/// Deepest chamfer that is told from a hole or a support, and deepest place that is looked at, mm.
const DEPTH_MAX_MM: f64 = 3.2;
const DEEP_MAX_MM: f64 = 12.0;

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

impl Cell {
    /// The first and the last point on the surface.
    pub(super) const fn surface(&self) -> Option<[f64; 2]> {
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
}
