//! The likelihood of an end plane at a position along the axis.
//!
//! Before the plane a cell shows the part except for drop-outs, beyond it nothing except for stray points. Both come in runs, so a
//! cell is weighted by the number of consecutive cells beside it that lack the part: a Markov chain along the profile. Its
//! probabilities are estimated from counts before the plane. In order of t the log-likelihood of a plane is the running sum of the
//! gains.

use super::occupancy::{Observation, RUN_MAX};

/// Probability that a cell beyond the part shows something. Half and double of it change no scene of the tests.
const STRAY: f64 = 1e-3;
/// Prior probabilities that a cell before the plane lacks the part: after none, one, two, and three or more cells that lack it.
const MISSING: [f64; 1 + RUN_MAX] = [0.01, 0.9, 0.9, 0.9];
/// Weight of the prior in cells, next to the plane and farther before it.
const PRIOR_CELLS: f64 = 10.0;
const PRIOR_CELLS_BEFORE: f64 = 1.0;
/// Largest probabilities: a cell that shows the part must remain likelier before the plane than beyond it.
const MISSING_MAX: [f64; 1 + RUN_MAX] = [0.5, 0.99, 0.99, 0.99];
/// Cells are counted over this many spacings before the plane: one spacing contains each column once. An edge is more ragged the
/// nearer to its end.
const COUNTED_SPACINGS: f64 = 1.0;
/// The likelihood of an end must fall by e⁸ (1 in 3000) on both sides.
const LOG_RATIO_MIN: f64 = 8.0;
/// Share of the columns that must end before the last plane.
const ENDED_MIN: f64 = 0.1;

/// A position at which the likelihood of a plane changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    pub(super) t: f64,
    /// The change of its logarithm when the plane passes.
    pub(super) gain: f64,
    pub(super) column: usize,
    /// Variance of `t`, independent of that of the other steps, mm².
    pub(super) variance: f64,
}

/// The likelihood of a plane as a function of its position.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Likelihood {
    /// In order of t.
    pub(super) steps: Vec<Step>,
    /// The last position before the likeliest plane, mm.
    pub(super) last: f64,
}

impl Likelihood {
    /// `None` if the observations do not show an end.
    pub(super) fn of(observations: &[Observation], spacing: f64, columns_count: usize) -> Option<Self> {
        let mut missing = Missing(MISSING);
        // The probabilities depend on the position of the plane, but only slightly.
        for _ in 0..2 {
            let last = likeliest(&missing.steps(observations))?.t;
            missing = Missing::before(last, COUNTED_SPACINGS * spacing, observations);
        }
        let steps = missing.steps(observations);
        let Step { t: last, gain: most, .. } = likeliest(&steps)?;
        let falls = most >= LOG_RATIO_MIN && most - sums(&steps).last()?.gain >= LOG_RATIO_MIN;
        let mut ended: Vec<usize> =
            observations.iter().filter(|o| o.t > last && !o.present).map(|o| o.column).collect();
        ended.sort_unstable();
        ended.dedup();
        (falls && ended.len() as f64 >= ENDED_MIN * columns_count as f64).then_some(Self { steps, last })
    }
}

/// The log-likelihood just beyond each step, in their order, up to a constant.
pub(super) fn sums(steps: &[Step]) -> impl Iterator<Item = Step> {
    steps.iter().scan(0.0, |sum, step| {
        *sum += step.gain;
        Some(Step { gain: *sum, ..*step })
    })
}

fn likeliest(steps: &[Step]) -> Option<Step> {
    sums(steps).max_by(|a, b| a.gain.total_cmp(&b.gain))
}

/// Probabilities that a cell before the plane lacks the part, by the number of cells beside it that lack it.
#[derive(Debug, Clone, Copy)]
struct Missing([f64; 1 + RUN_MAX]);

impl Missing {
    /// Estimated from the cells before a plane at `last`.
    fn before(last: f64, counted: f64, observations: &[Observation]) -> Self {
        let within = |from: f64, to: f64| observations.iter().filter(move |o| o.t > from && o.t <= to);
        // Farther before the plane there is no ragged edge: there the counts distinguish single cells that noise and raster leave
        // empty from runs.
        let far = Self(MISSING).counted(within(f64::NEG_INFINITY, last - counted), PRIOR_CELLS_BEFORE);
        let ([_, second, ..], [first, _, third, more]) = (far.0, MISSING);
        Self([first, second, third, more]).counted(within(last - counted, last), PRIOR_CELLS)
    }

    fn counted<'a>(self, observations: impl Iterator<Item = &'a Observation>, prior_cells: f64) -> Self {
        let mut counts = self.0.map(|prior| (prior * prior_cells, prior_cells));
        for observation in observations {
            let of_kind = observation.missing_beside.and_then(|beside| counts.get_mut(beside));
            let Some((missing, all)) = of_kind else { continue };
            *missing += f64::from(u8::from(!observation.present));
            *all += 1.0;
        }
        let mut most = MISSING_MAX.into_iter();
        Self(counts.map(|(missing, all)| (missing / all).min(most.next().unwrap_or_default())))
    }

    fn steps(&self, observations: &[Observation]) -> Vec<Step> {
        let step = |o: &Observation| Step { t: o.t, gain: self.gain(o), column: o.column, variance: o.variance };
        let mut steps: Vec<Step> = observations.iter().map(step).collect();
        steps.sort_by(|a, b| a.t.total_cmp(&b.t));
        steps
    }

    /// The change of the log-likelihood when the plane passes a cell.
    fn gain(&self, observation: &Observation) -> f64 {
        let after = |beside: usize| self.0.get(beside).copied().unwrap_or_default();
        // If the cell beside it cannot be judged, the stationary probability of the chain applies.
        let missing = observation.missing_beside.map_or_else(|| after(0) / (1.0 + after(0) - after(1)), after);
        let of = |present: f64| if observation.present { present.ln() } else { (1.0 - present).ln() };
        of(1.0 - missing) - of(STRAY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLUMNS: usize = 200;

    /// Ten profiles 1 mm apart, each column `step` farther than the previous one, of a part that ends at `end`.
    fn likelihood(step: f64, end: f64) -> Option<Likelihood> {
        let cell = |plane: u32, column: usize| {
            let t = f64::from(plane) + step * column as f64;
            let missing_beside = column.checked_sub(1).map(|_| usize::from(t - step > end));
            Observation { t, present: t <= end, missing_beside, variance: 0.0, column }
        };
        let cells: Vec<_> = (0..10).flat_map(|plane| (0..COLUMNS).map(move |column| cell(plane, column))).collect();
        Likelihood::of(&cells, 1.0, COLUMNS)
    }

    #[test]
    fn the_likeliest_plane_lies_beyond_the_last_cell_that_shows_the_part() {
        assert!((likelihood(0.0, 5.7).expect("an end").last - 5.0).abs() < 1e-9);
        assert!((likelihood(0.005, 5.333).expect("an end").last - 5.333).abs() < 0.03);
    }

    #[test]
    fn a_part_that_continues_or_is_not_scanned_has_no_end() {
        assert_eq!(likelihood(0.005, 99.0), None);
        assert_eq!(likelihood(0.0, -1.0), None);
    }
}
