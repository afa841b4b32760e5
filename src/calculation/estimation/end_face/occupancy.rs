//! Where the surface is present and where it is missing. A cell is one column in one plane: it shows the surface, an object below
//! it, an object above that hides it, or nothing. Each cell that can be judged is an observation that the part is present, or is
//! not, at a position along the axis.

use super::unroll::{Column, Columns, Plane, Unrolled};

/// Points deeper below the surface than this share of the radius do not belong to the part: a slant that deep is a cone, not a
/// chamfer. The deepest chamfer of the tests has a quarter.
pub(super) const DEPTH_MAX: f64 = 0.5;
/// Runs of missing cells are distinguished up to this length.
pub(super) const RUN_MAX: usize = 3;
/// The part continues while this share of the cells shows it, judged by at least this many cells.
pub(super) const SHARE_MIN: f64 = 0.1;
pub(super) const CELLS_MIN: usize = 4;
/// Up to this many spacings without the part are lost profiles; more than `UNDECIDED_MAX` are a gap.
pub(super) const LOST_MAX: usize = 1;
const UNDECIDED_MAX: usize = 3;

/// The content of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Seen {
    Nothing,
    Below { t: f64, depth: f64 },
    Hidden,
    Surface { first: f64, last: f64 },
}

impl Seen {
    /// The cell with one more point: the surface takes precedence over an object that hides it, and that over an object below, of
    /// which the farthest outward position is kept.
    fn with(self, point: &Unrolled, tolerance: f64, depth_max: f64) -> Self {
        let (t, depth, on_surface) = (point.t, -point.height, point.t_on_surface);
        match self {
            Self::Surface { first, last } if depth.abs() <= tolerance => {
                Self::Surface { first: first.min(on_surface), last: last.max(on_surface) }
            }
            Self::Surface { .. } => self,
            _ if depth.abs() <= tolerance => Self::Surface { first: on_surface, last: on_surface },
            _ if depth < 0.0 => Self::Hidden,
            Self::Below { t: last, .. } if t <= last => self,
            Self::Nothing | Self::Below { .. } if depth <= depth_max => Self::Below { t, depth },
            _ => self,
        }
    }

    const fn surface(self) -> Option<[f64; 2]> {
        match self {
            Self::Surface { first, last } => Some([first, last]),
            _ => None,
        }
    }
}

/// The cells about an end.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cells {
    pub(super) columns: Columns,
    /// Intersections of the axis with the planes, mm.
    planes: Vec<f64>,
    /// Plane by plane, in each the columns in their order.
    seen: Vec<Seen>,
}

/// A slant below the end of the surface, as a straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slant {
    pub(super) from: f64,
    pub(super) to: f64,
    /// Deeper points do not belong to it.
    pub(super) depth_max: f64,
    /// A position on it, and its depth there, mm.
    pub(super) at: f64,
    pub(super) depth: f64,
    /// Its increase of depth per millimetre outward.
    pub(super) slope: f64,
}

impl Slant {
    fn contains(&self, t: f64, depth: f64) -> bool {
        t > self.from && t <= self.to && depth <= self.depth_max
    }

    /// Position of the slant along the axis in a direction in which the surface leads its plane: leads grow with the distance from
    /// the axis, so that t = plane + lead·(1 − d/R) with the depth d = depth + slope·(t − at).
    fn place(&self, plane: f64, lead: f64, radius: f64) -> f64 {
        let share = lead / radius;
        (plane + lead - share * (self.depth - self.slope * self.at)) / (1.0 + share * self.slope)
    }
}

/// An observation that the part is present, or is not, at a position along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Observation {
    pub(super) t: f64,
    pub(super) present: bool,
    /// Number of consecutive cells beside it that lack the part, on the side with the smaller leads, up to [`RUN_MAX`]; `None` if
    /// the first of them cannot be judged.
    pub(super) missing_beside: Option<usize>,
    /// Variance of `t`, mm².
    pub(super) variance: f64,
    pub(super) column: usize,
}

impl Cells {
    pub(super) fn of(points: &[Unrolled], planes: &[Plane], columns: Columns, tolerance: f64) -> Self {
        let mut seen = vec![Seen::Nothing; planes.len() * columns.len()];
        let depth_max = DEPTH_MAX * columns.radius;
        for point in points {
            let cell = seen.get_mut(point.plane * columns.len() + columns.index_of(point.angle));
            if let Some(cell) = cell {
                *cell = cell.with(point, tolerance, depth_max);
            }
        }
        Self { columns, planes: planes.iter().map(|plane| plane.t).collect(), seen }
    }

    fn by_plane(&self) -> impl Iterator<Item = (f64, &[Seen])> {
        self.planes.iter().copied().zip(self.seen.chunks(self.columns.len().max(1)))
    }

    /// The position of each cell that can be judged and the depth of an object below the surface.
    pub(super) fn depths(&self) -> impl Iterator<Item = (f64, Option<f64>)> {
        self.by_plane().flat_map(|(plane, seen)| {
            self.columns.all.iter().zip(seen).filter_map(move |(column, seen)| match *seen {
                Seen::Nothing => Some((plane + column.lead, None)),
                Seen::Surface { last, .. } => Some((last, None)),
                Seen::Below { t, depth } => Some((t, Some(depth))),
                Seen::Hidden => None,
            })
        })
    }

    /// One observation of each cell that is not hidden. A slant counts as the part. `sigma` is the noise of a point, mm.
    pub(super) fn observations(&self, slant: Option<&Slant>, sigma: f64) -> Vec<Observation> {
        let place = |plane: f64, lead: f64| slant.map_or(plane + lead, |s| s.place(plane, lead, self.columns.radius));
        // Position at which a cell shows the part.
        let shown = |seen: &Seen| match *seen {
            Seen::Surface { last, .. } => Some(last),
            Seen::Below { t, depth } => slant.is_some_and(|slant| slant.contains(t, depth)).then_some(t),
            Seen::Hidden | Seen::Nothing => None,
        };
        let firsts = self.firsts();
        let mut observations = Vec::with_capacity(self.seen.len());
        for (plane, seen) in self.by_plane() {
            for (index, ((cell, column), first)) in seen.iter().zip(&self.columns.all).zip(&firsts).enumerate() {
                if *cell == Seen::Hidden {
                    continue;
                }
                // The part is missing from the first point of the column onwards: one step after the last point before it.
                let behind = column.before.and_then(|before| shown(seen.get(before)?)).zip(first.behind);
                let (from, lead) = behind.unwrap_or((plane, first.lead));
                let missing = || (place(from, lead.mean), lead.variance);
                let (t, variance) =
                    shown(cell).map_or_else(missing, |t| (t, sigma * sigma * column.place_by_noise(*cell)));
                let beside = std::iter::successors(column.before, |index| self.columns.all.get(*index)?.before);
                let mut beside = beside.filter_map(|index| seen.get(index)).peekable();
                let judged = beside.peek().is_some_and(|seen| **seen != Seen::Hidden);
                let lacks = |seen: &&Seen| **seen != Seen::Hidden && shown(seen).is_none();
                let missing_beside = judged.then(|| beside.take_while(lacks).take(RUN_MAX).count());
                let present = shown(cell).is_some();
                observations.push(Observation { t, present, missing_beside, variance, column: index });
            }
        }
        observations
    }

    /// Position of the first point of each column, over the planes that show the surface in it.
    fn firsts(&self) -> Vec<First> {
        let of_column = |index: usize| self.by_plane().map(move |(plane, seen)| (plane, seen.get(index)));
        let surface = |seen: Option<&Seen>| seen.and_then(|seen| seen.surface());
        let first = |(index, column): (usize, &Column)| {
            let leads = of_column(index).filter_map(|(plane, seen)| Some(surface(seen)?[0] - plane));
            let behind = |before: usize| {
                let pairs = of_column(index).zip(of_column(before));
                Spread::of(pairs.filter_map(|((_, seen), (_, before))| Some(surface(seen)?[0] - surface(before)?[1])))
            };
            First {
                lead: Spread::of(leads).unwrap_or(Spread { mean: column.lead, variance: 0.0 }),
                behind: column.before.and_then(behind),
            }
        };
        self.columns.all.iter().enumerate().map(first).collect()
    }
}

impl Column {
    /// Variance along the axis from the variance of a point's noise. On the surface only noise about the axis contributes.
    fn place_by_noise(&self, seen: Seen) -> f64 {
        let [about, away] = self.slope;
        about * about + if matches!(seen, Seen::Below { .. }) { away * away } else { 0.0 }
    }
}

/// Mean and variance over the planes.
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

/// Position of the first point of a column.
#[derive(Debug, Clone, Copy)]
struct First {
    /// Lead over its plane.
    lead: Spread,
    /// Distance from the last point of the previous column.
    behind: Option<Spread>,
}

/// How far the part continues without a gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extent {
    /// End of the last spacing that shows the part, mm.
    pub(super) last: f64,
    /// Position at which an object begins beyond a gap; infinite if there is none.
    pub(super) next: f64,
}

/// `None` if nothing shows the part, or if lost profiles cannot be distinguished from a gap.
pub(super) fn extent(observations: &[Observation], from: f64, spacing: f64) -> Option<Extent> {
    let bin = |o: &Observation| (((o.t - from) / spacing).floor(), o.present);
    let mut bins: Vec<(f64, bool)> = observations.iter().filter(|o| o.t >= from).map(bin).collect();
    bins.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let (mut last, mut void_count) = (None, 0);
    for of_bin in bins.chunk_by(|(a, _), (b, _)| a == b).filter(|of_bin| of_bin.len() >= CELLS_MIN) {
        let start = from + spacing * of_bin.first()?.0;
        let present_count = of_bin.iter().filter(|(_, present)| *present).count();
        if (present_count as f64) < SHARE_MIN * of_bin.len() as f64 {
            void_count += 1;
            continue;
        }
        if let Some(last) = last.filter(|_| void_count > LOST_MAX) {
            return (void_count > UNDECIDED_MAX).then_some(Extent { last, next: start });
        }
        (last, void_count) = (Some(start + spacing), 0);
    }
    last.map(|last| Extent { last, next: f64::INFINITY })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Planes a millimetre apart with five cells each, which show the part at each '#'.
    fn planes(shown: &str) -> Vec<Observation> {
        let plane = |(index, shown): (usize, char)| {
            let (t, present) = (index as f64 + 0.5, shown == '#');
            std::iter::repeat_n(Observation { t, present, missing_beside: None, variance: 0.0, column: 0 }, 5)
        };
        shown.chars().enumerate().flat_map(plane).collect()
    }

    #[test]
    fn one_lost_profile_is_not_a_gap_four_are_and_two_or_three_are_undecided() {
        let extent = |shown| extent(&planes(shown), 0.0, 1.0);
        assert_eq!(extent("####.###....##"), Some(Extent { last: 8.0, next: 12.0 }));
        assert_eq!(extent("####.###..."), Some(Extent { last: 8.0, next: f64::INFINITY }));
        assert_eq!(extent("####.###..##"), None);
        assert_eq!(extent("####.###...##"), None);
        assert_eq!(extent("....."), None);
    }

    /// 45°, from the surface at 10 to a depth of 1.5 at 11.5.
    #[test]
    fn a_slant_leads_its_plane_by_less_than_the_surface() {
        let slant = Slant { from: 9.0, to: 12.0, depth_max: 2.0, at: 11.5, depth: 1.5, slope: 1.0 };
        let (radius, lead) = (8.0, 0.8);
        let t = slant.place(11.5, lead, radius);
        assert!((t - (11.5 + lead * (1.0 - (t - 10.0) / radius))).abs() < 1e-9, "{t}");
    }
}
