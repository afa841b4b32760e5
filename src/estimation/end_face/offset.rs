//! The offset of the end plane from what every cell says: a change point, found by its likelihood. Must not know cells,
//! profiles or poses.
//!
//! Up to the plane a cell shows the part but for drop-outs, beyond it nothing but for strays. Drop-outs and strays come in
//! runs, so each cell is weighed given those beside it: a Markov chain along the profile, whose rates are those of the
//! cells just before the plane. In order of t the logarithm of the likelihood of a plane is a running sum; with nothing
//! known before about the offset it is the posterior, constant between one cell and the next, and its mean and standard
//! deviation are the answer. Where all cells of a profile share one t it is even over the spacing: its standard deviation
//! is spacing/√12, however many the columns.

use super::cells::{Evidence, LACKING_MAX};

/// Where the plane is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Offset {
    /// Outward from the reference point along the axis, mm.
    pub(super) t: f64,
    /// Standard uncertainty, mm.
    pub(super) standard: f64,
    /// The last place before the likeliest plane, mm.
    pub(super) last: f64,
    /// The columns that decided it.
    pub(super) columns: Vec<usize>,
    /// How many profiles meet the edge, about; at least 1.
    pub(super) crossings: f64,
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
const LACK: [f64; 1 + LACKING_MAX] = [0.05, 0.9, 0.9, 0.9];
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

    /// Logarithm of how much likelier a cell is before the plane than beyond it.
    fn gain(&self, cell: &Evidence) -> f64 {
        let [stray, stray_again] = STRAY;
        let after = |lacking: usize| self.0.get(lacking).copied().unwrap_or_default();
        let (lack, stray) = match cell.lacking {
            Some(0) => (after(0), stray_again),
            Some(lacking) => (after(lacking), stray),
            // With nothing beside it, as often as in the long run.
            None => (after(0) / (1.0 + after(0) - after(1)), stray),
        };
        if cell.present { ((1.0 - lack) / stray).ln() } else { (lack / (1.0 - stray)).ln() }
    }
}

/// The plane, from evidence up to `to`; `None` where no end is seen.
pub(super) fn find(mut evidence: Vec<Evidence>, to: f64, grid: Grid) -> Option<Offset> {
    evidence.sort_by(|a, b| a.t.total_cmp(&b.t));
    let [mm, spacings] = COUNTED;
    let counted = f64::max(mm, spacings * grid.spacing);
    let mut lack = Lack(LACK);
    for _ in 0..2 {
        let sums = sums(&evidence, lack);
        let (_, last) = best(&evidence, &sums)?;
        lack = Lack::counted(evidence.iter().filter(|cell| cell.t <= last && cell.t > last - counted));
    }
    let sums = sums(&evidence, lack);
    let (most, last) = best(&evidence, &sums)?;
    let falls = most >= LOG_LIKELIHOOD_MIN && most - sums.last()? >= LOG_LIKELIHOOD_MIN;
    let mut ended: Vec<usize> = evidence.iter().filter(|c| c.t > last && !c.present).map(|c| c.column).collect();
    ended.sort_unstable();
    ended.dedup();
    if !falls || (ended.len() as f64) < COLUMNS_SHARE_MIN * grid.columns_count as f64 {
        return None;
    }
    let [t, standard] = moments(&evidence, &sums, most, to)?;
    // The cells at either side of what is left open, and those of every other profile that meets the edge.
    let steps = NEAR_STEPS * grid.step;
    let near = |cell: &&Evidence| (cell.t - t).abs() <= steps.max(NEAR_STANDARDS * standard);
    let columns: Vec<usize> = evidence.iter().filter(near).map(|cell| cell.column).collect();
    let crossings = (columns.len() as f64 / (2.0 * NEAR_STEPS)).max(1.0);
    Some(Offset { t, standard, last, columns, crossings })
}

/// The logarithm of the likelihood of a plane just beyond each cell, but for a constant.
fn sums(evidence: &[Evidence], lack: Lack) -> Vec<f64> {
    let mut sum = 0.0;
    evidence
        .iter()
        .map(|cell| {
            sum += lack.gain(cell);
            sum
        })
        .collect()
}

/// The largest of the sums, and the t of its cell.
fn best(evidence: &[Evidence], sums: &[f64]) -> Option<(f64, f64)> {
    sums.iter().zip(evidence).map(|(sum, cell)| (*sum, cell.t)).max_by(|(a, _), (b, _)| a.total_cmp(b))
}

/// Mean and standard deviation of the posterior, constant from each cell to the next and from the last one up to `to`.
fn moments(evidence: &[Evidence], sums: &[f64], most: f64, to: f64) -> Option<[f64; 2]> {
    let ends = evidence.iter().skip(1).map(|cell| cell.t).chain([to]);
    let pieces = evidence.iter().zip(sums).zip(ends).map(|((cell, sum), end)| {
        let width = (end - cell.t).max(0.0);
        ((sum - most).exp() * width, 0.5 * (cell.t + end), width)
    });
    let pieces: Vec<(f64, f64, f64)> = pieces.collect();
    let total: f64 = pieces.iter().map(|(weight, ..)| weight).sum();
    if !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let mean = pieces.iter().map(|(weight, middle, _)| weight * middle).sum::<f64>() / total;
    let square = |(weight, middle, width): &(f64, f64, f64)| weight * ((middle - mean).powi(2) + width * width / 12.0);
    let variance = pieces.iter().map(square).sum::<f64>() / total;
    Some([mean, variance.sqrt()])
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
            Evidence { t, present: t <= end, lacking, column }
        };
        (0..10).flat_map(|plane| (0..COLUMNS).map(move |column| cell(plane, column))).collect()
    }

    fn found(step: f64, end: f64) -> Option<Offset> {
        find(cells(step, end), 12.0, Grid { spacing: 1.0, step, columns_count: COLUMNS })
    }

    #[test]
    fn where_all_columns_end_alike_the_plane_is_anywhere_in_the_spacing() {
        let offset = found(0.0, 5.7).expect("an end");
        assert!((offset.t - 5.5).abs() < 1e-3 && (offset.standard - 1.0 / 12f64.sqrt()).abs() < 1e-3, "{offset:?}");
    }

    #[test]
    fn where_columns_end_in_turn_the_plane_is_known_to_a_step() {
        let offset = found(0.005, 5.333).expect("an end");
        assert!((offset.t - 5.333).abs() < 0.03 && offset.standard < 0.05, "{offset:?}");
    }

    #[test]
    fn a_part_that_goes_on_has_no_end() {
        assert_eq!(found(0.005, 99.0), None);
        assert_eq!(found(0.0, -1.0), None);
    }
}
