//! The offset of the end plane from what every cell says: a change point, found by its likelihood. Must not know cells,
//! profiles or poses.
//!
//! Up to the plane a cell shows the part but for drop-outs, beyond it nothing but for strays. Drop-outs and strays come in
//! runs, so each cell is weighed given those beside it: a Markov chain along the profile, whose rates are those of the
//! cells just before the plane. In order of t the logarithm of the likelihood of a plane is a running sum; with nothing
//! known before about the offset it is the posterior, constant between one cell and the next. Where all cells of a profile
//! share one t it is even over the spacing, however many the columns.

use super::cells::{Evidence, LACKING_MAX};
use super::posterior::{Piece, Posterior};

/// Where the plane is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Offset {
    /// Outward from the reference point along the axis, mm.
    pub(super) at: Posterior,
    /// The last place before the likeliest plane, mm.
    pub(super) last: f64,
    /// The columns that decided it.
    pub(super) columns: Vec<usize>,
    /// Variance by what is not known of the places of the points that decided it, mm².
    pub(super) of_places: f64,
}

/// How the evidence is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    /// From profile to profile along the axis, mm.
    pub(super) spacing: f64,
    /// From column to column along the axis, mm.
    pub(super) step: f64,
    pub(super) columns_count: usize,
}

/// Beyond the part: a cell shows something after one that does not, and after one that does.
const STRAY: [f64; 2] = [1e-3, 0.3];
/// Before the end: how often a cell is taken to lack its point until that is counted, after none, one, two, and three cells
/// or more that lack theirs; and how many cells that is worth.
const LACK: [f64; 1 + LACKING_MAX] = [0.01, 0.9, 0.9, 0.9];
const LACK_WORTH: f64 = 10.0;
/// At most: a point must stay likelier on the part than beyond it, also where a chamfer has taken most of the surface.
const LACK_MOST: [f64; 1 + LACKING_MAX] = [0.5, 0.99, 0.99, 0.99];
/// Cells are counted this far before the plane, [mm, spacings]: an edge is the more ragged the nearer to its end.
const COUNTED: [f64; 2] = [0.5, 0.5];
/// The end is seen where the likelihood falls by a factor of e⁸ on both sides, and this share of the columns ends.
const LOG_LIKELIHOOD_MIN: f64 = 8.0;
const COLUMNS_SHARE_MIN: f64 = 0.1;

/// Cells this near to the plane decided it: half of what is open, √3 standard deviations where it is even, or steps from a
/// column to the next.
const NEAR_STANDARDS: f64 = 1.8;
const NEAR_STEPS: f64 = 2.0;

/// Chances that a cell before the plane lacks its point, after so many beside it that lack theirs.
#[derive(Debug, Clone, Copy)]
struct Lack([f64; 1 + LACKING_MAX]);

impl Lack {
    /// Counted in cells, what was assumed being worth a few.
    fn counted<'a>(cells: impl Iterator<Item = &'a Evidence>) -> Self {
        let mut counts = LACK.map(|assumed| (assumed * LACK_WORTH, LACK_WORTH));
        for cell in cells {
            let of_kind = cell.lacking.and_then(|lacking| counts.get_mut(lacking));
            let Some((lacking, all)) = of_kind else { continue };
            *lacking += f64::from(u8::from(!cell.present));
            *all += 1.0;
        }
        let mut most = LACK_MOST.into_iter();
        Self(counts.map(|(lacking, all)| (lacking / all).min(most.next().unwrap_or_default())))
    }

    /// By how much the logarithm of the likelihood grows as the plane passes the cell beside this one, and this one.
    fn gains(&self, cell: &Evidence) -> [f64; 2] {
        let [stray, stray_again] = STRAY;
        let after = |lacking: usize| self.0.get(lacking).copied().unwrap_or_default();
        let lack = match cell.lacking {
            Some(lacking) => after(lacking),
            // With nothing beside it, as often as in the long run.
            None => after(0) / (1.0 + after(0) - after(1)),
        };
        let of = |present: f64| if cell.present { present.ln() } else { (1.0 - present).ln() };
        let passed = if cell.beside.is_some() { of(stray) - of(stray_again) } else { 0.0 };
        [passed, of(1.0 - lack) - of(stray)]
    }
}

/// Where the likelihood of a plane changes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Step {
    t: f64,
    gain: f64,
}

/// The plane, from evidence up to `to`; `None` where no end is seen.
pub(super) fn find(evidence: &[Evidence], to: f64, grid: Grid) -> Option<Offset> {
    let [mm, spacings] = COUNTED;
    let counted = f64::max(mm, spacings * grid.spacing);
    let mut lack = Lack(LACK);
    for _ in 0..2 {
        let last = best(&likelihood(evidence, lack))?.t;
        lack = Lack::counted(evidence.iter().filter(|cell| cell.t <= last && cell.t > last - counted));
    }
    let sums = likelihood(evidence, lack);
    let Step { t: last, gain: most } = best(&sums)?;
    let falls = most >= LOG_LIKELIHOOD_MIN && most - sums.last()?.gain >= LOG_LIKELIHOOD_MIN;
    let mut ended: Vec<usize> = evidence.iter().filter(|c| c.t > last && !c.present).map(|c| c.column).collect();
    ended.sort_unstable();
    ended.dedup();
    if !falls || (ended.len() as f64) < COLUMNS_SHARE_MIN * grid.columns_count as f64 {
        return None;
    }
    let at = posterior(&sums, most, to)?;
    // The cells at either side of what is left open, and those of every other profile that meets the edge.
    let steps = NEAR_STEPS * grid.step;
    let near = |cell: &&Evidence| (cell.t - at.mean()).abs() <= steps.max(NEAR_STANDARDS * at.deviation());
    let columns: Vec<usize> = evidence.iter().filter(near).map(|cell| cell.column).collect();
    let count = columns.len().max(1) as f64;
    let crossings = (count / (2.0 * NEAR_STEPS)).max(1.0);
    let of_places = evidence.iter().filter(near).map(|cell| cell.variance).sum::<f64>() / count / crossings;
    Some(Offset { at, last, columns, of_places })
}

/// The logarithm of the likelihood of a plane just beyond each place where it changes, but for a constant.
///
/// A cell beyond the plane that shows something after one that does is no surprise, unless that one lies before the plane.
fn likelihood(evidence: &[Evidence], lack: Lack) -> Vec<Step> {
    let steps = |cell: &Evidence| {
        let [passed, gain] = lack.gains(cell);
        let beside = cell.beside.map(|t| Step { t: t.min(cell.t), gain: passed });
        [beside, Some(Step { t: cell.t, gain })].into_iter().flatten()
    };
    let mut steps: Vec<Step> = evidence.iter().flat_map(steps).collect();
    steps.sort_by(|a, b| a.t.total_cmp(&b.t));
    let mut sum = 0.0;
    for step in &mut steps {
        sum += step.gain;
        step.gain = sum;
    }
    steps
}

/// Where the likelihood is largest.
fn best(sums: &[Step]) -> Option<Step> {
    sums.iter().copied().max_by(|a, b| a.gain.total_cmp(&b.gain))
}

/// Constant from each step to the next and from the last one up to `to`.
fn posterior(sums: &[Step], most: f64, to: f64) -> Option<Posterior> {
    let ends = sums.iter().skip(1).map(|step| step.t).chain([to]);
    let pieces = sums.iter().zip(ends).map(|(step, end)| {
        let end = end.max(step.t);
        Piece { from: step.t, to: end, weight: (step.gain - most).exp() * (end - step.t) }
    });
    Posterior::of(pieces.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: usize = 200;

    /// Ten profiles 1 mm apart, each column `step` further than the one before it, of a part that ends at `end`.
    fn cells(step: f64, end: f64) -> Vec<Evidence> {
        let cell = |plane: u32, column: usize| {
            let t = f64::from(plane) + step * column as f64;
            let lacking = column.checked_sub(1).map(|_| usize::from(t - step > end));
            Evidence {
                t,
                present: t <= end,
                lacking,
                beside: lacking.filter(|l| *l == 0).map(|_| t - step),
                variance: 0.0,
                column,
            }
        };
        (0..10).flat_map(|plane| (0..COLUMNS).map(move |column| cell(plane, column))).collect()
    }

    fn found(step: f64, end: f64) -> Option<Offset> {
        find(&cells(step, end), 12.0, Grid { spacing: 1.0, step, columns_count: COLUMNS })
    }

    #[test]
    fn where_all_columns_end_alike_the_plane_is_anywhere_in_the_spacing() {
        let offset = found(0.0, 5.7).expect("an end");
        assert!((offset.at.mean() - 5.5).abs() < 1e-3, "{offset:?}");
        assert!((offset.at.deviation() - 1.0 / 12f64.sqrt()).abs() < 1e-3, "{offset:?}");
    }

    #[test]
    fn where_columns_end_in_turn_the_plane_is_known_to_a_step() {
        let offset = found(0.005, 5.333).expect("an end");
        assert!((offset.at.mean() - 5.333).abs() < 0.03 && offset.at.deviation() < 0.05, "{offset:?}");
    }

    #[test]
    fn a_part_that_goes_on_has_no_end() {
        assert_eq!(found(0.005, 99.0), None);
        assert_eq!(found(0.0, -1.0), None);
    }
}
