//! The offset of the end plane from what every cell says: a change point, found by its likelihood. Must not know cells,
//! profiles or poses.
//!
//! Up to the plane a cell shows the part but for drop-outs, beyond it nothing but for strays. Drop-outs and strays come in
//! runs, so each cell is weighed given those beside it: a Markov chain along the profile, whose rates are those of the
//! cells just before the plane, but for how often a second cell lacks its point, which those farther before tell. In order
//! of t the logarithm of the likelihood of a plane is a running sum, constant between one cell and the next; where all cells
//! of a profile share one t it is even over the spacing, however many the columns. With nothing known before about the
//! offset, and all poses that the uncertainty leaves open, it becomes the posterior.

use super::evidence::{Evidence, LACKING_MAX};
use super::marginal::{self, Step, sums};
use super::posterior::Posterior;
use super::sway::Sway;

/// Where the plane is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Offset {
    /// Outward from the reference point along the axis, mm.
    pub(super) at: Posterior,
    /// The last place before the likeliest plane, mm.
    pub(super) last: f64,
    /// Variance of a normal error beside it, mm².
    pub(super) normal: f64,
    /// What is added to half of the half-width of its interval, mm.
    pub(super) untold: f64,
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

/// Chance that a cell beyond the part shows something.
const STRAY: f64 = 1e-3;
/// Before the end: how often a cell is taken to lack its point until that is counted, after none, one, two, and three cells
/// or more that lack theirs; and how many cells that is worth, near the end and farther before it.
const LACK: [f64; 1 + LACKING_MAX] = [0.01, 0.9, 0.9, 0.9];
const LACK_WORTH: f64 = 10.0;
const FAR_WORTH: f64 = 1.0;
/// At most: a point must stay likelier on the part than beyond it, also where a chamfer has taken most of the surface.
const LACK_MOST: [f64; 1 + LACKING_MAX] = [0.5, 0.99, 0.99, 0.99];
/// Cells are counted this far before the plane, [mm, spacings]: an edge is the more ragged the nearer to its end.
const COUNTED: [f64; 2] = [0.5, 0.5];
/// The end is seen where the likelihood falls by a factor of e⁸ on both sides, and this share of the columns ends.
const LOG_LIKELIHOOD_MIN: f64 = 8.0;
const COLUMNS_SHARE_MIN: f64 = 0.1;

/// Cells within so many steps from column to column, or so often half of the half-width that holds the plane, are about it;
/// and the share of the sway between flanks that is added for the chance that they tell nothing of it.
const NEAR_STEPS: f64 = 2.0;
const NEAR_HALVES: f64 = 4.0;
const SWAY_UNTOLD: f64 = 0.2;

/// Chances that a cell before the plane lacks its point, after so many beside it that lack theirs.
#[derive(Debug, Clone, Copy)]
struct Lack([f64; 1 + LACKING_MAX]);

impl Lack {
    /// Of the cells before a plane at `last`.
    fn before(last: f64, counted: f64, evidence: &[Evidence]) -> Self {
        let within = |from: f64, to: f64| evidence.iter().filter(move |cell| cell.t > from && cell.t <= to);
        let near = last - counted;
        // How often a second cell lacks its point is seen where there is no edge: noise and the raster empty single ones.
        let [_, second, ..] = Self(LACK).counted(within(f64::NEG_INFINITY, near), FAR_WORTH).0;
        let [first, _, third, more] = LACK;
        Self([first, second, third, more]).counted(within(near, last), LACK_WORTH)
    }

    /// Counted in cells, what is assumed being worth so many.
    fn counted<'a>(self, cells: impl Iterator<Item = &'a Evidence>, worth: f64) -> Self {
        let mut counts = self.0.map(|assumed| (assumed * worth, worth));
        for cell in cells {
            let of_kind = cell.lacking.and_then(|lacking| counts.get_mut(lacking));
            let Some((lacking, all)) = of_kind else { continue };
            *lacking += f64::from(u8::from(!cell.present));
            *all += 1.0;
        }
        let mut most = LACK_MOST.into_iter();
        Self(counts.map(|(lacking, all)| (lacking / all).min(most.next().unwrap_or_default())))
    }

    /// By how much the logarithm of the likelihood grows as the plane passes a cell.
    fn gain(&self, cell: &Evidence) -> f64 {
        let after = |lacking: usize| self.0.get(lacking).copied().unwrap_or_default();
        let lack = match cell.lacking {
            Some(lacking) => after(lacking),
            // With nothing beside it, as often as in the long run.
            None => after(0) / (1.0 + after(0) - after(1)),
        };
        let of = |present: f64| if cell.present { present.ln() } else { (1.0 - present).ln() };
        of(1.0 - lack) - of(STRAY)
    }
}

/// The plane, from evidence up to `to`; `None` where no end is seen.
pub(super) fn find(evidence: &[Evidence], to: f64, grid: Grid, sway: &Sway) -> Option<Offset> {
    let [mm, spacings] = COUNTED;
    let counted = f64::max(mm, spacings * grid.spacing);
    let mut lack = Lack(LACK);
    for _ in 0..2 {
        let last = best(&steps(evidence, lack))?.t;
        lack = Lack::before(last, counted, evidence);
    }
    let steps = steps(evidence, lack);
    let Step { t: last, gain: most, .. } = best(&steps)?;
    let falls = most >= LOG_LIKELIHOOD_MIN && most - sums(&steps).last()?.gain >= LOG_LIKELIHOOD_MIN;
    let mut ended: Vec<usize> = evidence.iter().filter(|c| c.t > last && !c.present).map(|c| c.column).collect();
    ended.sort_unstable();
    ended.dedup();
    if !falls || (ended.len() as f64) < COLUMNS_SHARE_MIN * grid.columns_count as f64 {
        return None;
    }
    let at = marginal::posterior(&steps, sway, to)?;
    let untold = untold(evidence, &at, grid, sway);
    Some(Offset { at, last, normal: sway.alike(), untold })
}

/// What to add to half of the half-width, mm. Two flanks of the part that meet the plane in phases of their own tell how far
/// the pose has moved them against each other. Where the raster meets it alike on both, they show one interval, which the
/// posterior takes for the intersection of two: each of its ends then falls short by about that sway, and by no more than the
/// interval is wide.
fn untold(evidence: &[Evidence], at: &Posterior, grid: Grid, sway: &Sway) -> f64 {
    let half = at.half_of_expanded(0.0);
    let open = f64::max(NEAR_STEPS * grid.step, NEAR_HALVES * half);
    let near = |cell: &&Evidence| (cell.t - at.mean()).abs() <= open;
    let flank = |rising: bool| {
        let cells = evidence.iter().filter(near).filter(|cell| cell.rising == rising);
        sway.mean(cells.map(|cell| cell.column))
    };
    let against = flank(true).zip(flank(false)).map_or(0.0, |(a, b)| 0.5 * (a - b).norm());
    if against > 0.0 { SWAY_UNTOLD * against * half / (against + half) } else { 0.0 }
}

/// Where the likelihood of a plane changes, in order of t.
fn steps(evidence: &[Evidence], lack: Lack) -> Vec<Step> {
    let step =
        |cell: &Evidence| Step { t: cell.t, gain: lack.gain(cell), column: cell.column, variance: cell.variance };
    let mut steps: Vec<Step> = evidence.iter().map(step).collect();
    steps.sort_by(|a, b| a.t.total_cmp(&b.t));
    steps
}

/// Where the likelihood is largest.
fn best(steps: &[Step]) -> Option<Step> {
    sums(steps).max_by(|a, b| a.gain.total_cmp(&b.gain))
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
            Evidence { t, present: t <= end, lacking, variance: 0.0, column, rising: true }
        };
        (0..10).flat_map(|plane| (0..COLUMNS).map(move |column| cell(plane, column))).collect()
    }

    fn found(step: f64, end: f64) -> Option<Offset> {
        let sway = Sway::of(&vec![nalgebra::Vector4::zeros(); COLUMNS], nalgebra::Matrix4::zeros()).expect("a sway");
        find(&cells(step, end), 12.0, Grid { spacing: 1.0, step, columns_count: COLUMNS }, &sway)
    }

    #[test]
    fn where_all_columns_end_alike_the_plane_is_anywhere_in_the_spacing() {
        let offset = found(0.0, 5.7).expect("an end");
        assert!((offset.at.mean() - 5.5).abs() < 1e-3, "{offset:?}");
        // 95.45 % of it.
        assert!((offset.at.half_of_expanded(0.0) - 0.9545 / 4.0).abs() < 1e-3, "{offset:?}");
    }

    #[test]
    fn where_columns_end_in_turn_the_plane_is_known_to_a_step() {
        let offset = found(0.005, 5.333).expect("an end");
        assert!((offset.at.mean() - 5.333).abs() < 0.03 && offset.at.half_of_expanded(0.0) < 0.05, "{offset:?}");
    }

    #[test]
    fn a_part_that_goes_on_has_no_end() {
        assert_eq!(found(0.005, 99.0), None);
        assert_eq!(found(0.0, -1.0), None);
    }
}
