//! Columns about the axis, as the points of the part fill them, each with how far ahead of its plane the surface lies in it.
//! Must not know what a column shows.

use super::view::View;

/// Columns about the axis that all hold equally many points of the part.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lattice {
    /// Where each column but the first begins, radians.
    bounds: Vec<f64>,
    columns: Vec<Column>,
    radius: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    /// Median direction of its points.
    angle: f64,
    /// How far ahead of its plane it lies, mm.
    pub(super) lead: f64,
    /// By how much that grows per millimetre about the axis, and away from it.
    pub(super) slope: [f64; 2],
    /// The column beside it that a growing part reaches first.
    pub(super) before: Option<usize>,
    /// Whether columns lie farther ahead as the angle grows: where that turns, the part has two flanks.
    pub(super) rising: bool,
}

impl Lattice {
    /// `None` where there are fewer points than columns.
    pub(super) fn of(mut angles: Vec<f64>, columns_count: usize, view: &View) -> Option<Self> {
        if columns_count == 0 || angles.len() < columns_count {
            return None;
        }
        angles.sort_by(f64::total_cmp);
        let at = |share: f64| angles.get((share * angles.len() as f64 / columns_count as f64) as usize).copied();
        let between = |index: usize| {
            let upper = index * angles.len() / columns_count;
            Some(0.5 * (angles.get(upper.checked_sub(1)?)? + angles.get(upper)?))
        };
        let bounds = (1..columns_count).filter_map(between).collect();
        let column = |index: usize| {
            let angle = at(index as f64 + 0.5)?;
            let lead = view.lead(angle);
            Some(Column { angle, lead, slope: [view.slope(angle), lead / view.radius()], before: None, rising: true })
        };
        let mut columns: Vec<Column> = (0..columns_count).filter_map(column).collect();
        let leads: Vec<f64> = columns.iter().map(|column| column.lead).collect();
        for (index, column) in columns.iter_mut().enumerate() {
            let beside = [index.checked_sub(1), Some(index + 1)].into_iter().flatten();
            let earlier = |other: &usize| leads.get(*other).is_some_and(|lead| (*lead, *other) < (column.lead, index));
            column.before = beside.into_iter().find(earlier);
            column.rising = column.before.map_or(index + 1 < leads.len(), |before| before < index);
        }
        Some(Self { bounds, columns, radius: view.radius() })
    }

    /// Its columns, in order of their angle.
    pub(super) fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The position of the column that a direction lies in.
    pub(super) fn column_at(&self, angle: f64) -> usize {
        self.bounds.partition_point(|bound| *bound <= angle)
    }

    /// The radius of the cylinder, mm.
    pub(super) const fn radius(&self) -> f64 {
        self.radius
    }

    /// The number of its columns.
    pub(super) fn len(&self) -> usize {
        self.columns.len()
    }

    /// Least and most that the columns lie ahead of their plane, mm.
    pub(super) fn span(&self) -> [f64; 2] {
        let leads = self.columns.iter().map(|column| column.lead);
        leads.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], lead| [least.min(lead), most.max(lead)])
    }

    /// The direction of each of its columns.
    pub(super) fn angles(&self) -> impl Iterator<Item = f64> {
        self.columns.iter().map(|column| column.angle)
    }

    /// Mean step from a column to the next along the axis, mm.
    pub(super) fn mean_step(&self) -> f64 {
        let pairs = self.columns.windows(2).filter_map(|pair| Some((pair.last()?.lead - pair.first()?.lead).abs()));
        pairs.sum::<f64>() / self.len() as f64
    }
}
