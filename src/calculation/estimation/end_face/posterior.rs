//! The position of the end plane with its uncertainty, from the pieces that every pose contributes.

use super::marginalise::{Motions, Piece, largest};
use super::occupancy::Observation;
use super::unroll::Columns;
use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

/// Share of a normal distribution within two standard deviations: erf √2.
const CONTAINED: f64 = 0.954_499_736_103_642;
/// Pieces below this share are left out: some thousands of them contain less than a millionth.
const SHARE_MIN: f64 = 1e-10;
/// Beyond this many standard deviations a normal density is zero in double precision.
const NORMAL_ENDS: f64 = 8.0;
/// Least normal error as a share of the standard deviation; it keeps the quotients finite.
const NORMAL_MIN: f64 = 1e-9;
/// Iterations for the half-width, and the error of the share that it contains.
const ITERATIONS_MAX: usize = 60;
const SHARE_ERROR: f64 = 1e-7;
/// No distribution has more than 1/k² beyond k standard deviations (Chebyshev); 1/25 is less than 4.55 %.
const DEVIATIONS_MAX: f64 = 5.0;
/// Cells within this many steps of a column, or this many times half of the interval's half-width, are near the plane.
const ABOUT_STEPS: f64 = 2.0;
const ABOUT_HALVES: f64 = 4.0;
/// Share of the motion between flanks that is added to the uncertainty, calibrated by the coverage of regular rasters under pure
/// pitch.
const FLANK_SHARE: f64 = 0.2;

/// A distribution of pieces with uniform density.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Posterior {
    /// From, to and weight; the weights add up to one.
    pieces: Vec<[f64; 3]>,
    pub(super) mean: f64,
    deviation: f64,
}

impl Posterior {
    /// `None` without weight.
    pub(super) fn of(pieces: &[Piece]) -> Option<Self> {
        let most = largest(pieces);
        let mut pieces: Vec<[f64; 3]> = pieces.iter().map(|p| [p.from, p.to, p.weight(most)]).collect();
        let total = |pieces: &[[f64; 3]]| pieces.iter().map(|[.., weight]| weight).sum::<f64>();
        let least = SHARE_MIN * total(&pieces);
        pieces.retain(|[.., weight]| *weight > least);
        let total = total(&pieces);
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        for [.., weight] in &mut pieces {
            *weight /= total;
        }
        let mean: f64 = pieces.iter().map(|[from, to, weight]| weight * 0.5 * (from + to)).sum();
        let square =
            |[from, to, weight]: &[f64; 3]| weight * ((0.5 * (from + to) - mean).powi(2) + (to - from).powi(2) / 12.0);
        let deviation = pieces.iter().map(square).sum::<f64>().sqrt();
        Some(Self { pieces, mean, deviation })
    }

    /// Half of the half-width of the interval about the mean that contains 95.45 %, including an independent normal error of this
    /// standard deviation.
    pub(super) fn half_of_expanded(&self, normal: f64) -> f64 {
        let normal = normal.max(NORMAL_MIN * self.deviation);
        let deviation = self.deviation.hypot(normal);
        let [mut low, mut high] = [0.0, DEVIATIONS_MAX * deviation];
        let mut half_width = 2.0 * deviation;
        // Newton's method between bounds.
        for _ in 0..ITERATIONS_MAX {
            let [share, growth] = self.contained(half_width, normal);
            if (CONTAINED - share).abs() < SHARE_ERROR {
                break;
            }
            *(if share < CONTAINED { &mut low } else { &mut high }) = half_width;
            let next = half_width + (CONTAINED - share) / growth;
            half_width = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        0.5 * half_width
    }

    /// The share within a half-width of the mean, and its derivative by the half-width.
    fn contained(&self, half_width: f64, normal: f64) -> [f64; 2] {
        let [low, high] = [self.mean - half_width, self.mean + half_width];
        let share = |[from, to, weight]: &[f64; 3]| {
            let below = |x: f64| {
                let [from, to] = [from, to].map(|end| excess((x - end) / normal));
                [(from[0] - to[0]) * normal, from[1] - to[1]]
            };
            let ([below_high, at_high], [below_low, at_low]) = (below(high), below(low));
            let density = weight / (to - from);
            [density * (below_high - below_low), density * (at_high + at_low)]
        };
        self.pieces.iter().map(share).fold([0.0; 2], |[all, growth], [share, by]| [all + share, growth + by])
    }

    /// The amount to add to half of the half-width. Two flanks of the part that meet the plane at different phases of the raster
    /// show how far the pose has moved them relative to each other. If both meet it at the same phase, they give one interval,
    /// which the posterior takes for the intersection of two: each of its ends is short by about that motion, and by at most the
    /// width of the interval.
    pub(super) fn flank_shortfall(&self, observations: &[Observation], columns: &Columns, motions: &Motions) -> f64 {
        let half = self.half_of_expanded(0.0);
        let about = f64::max(ABOUT_STEPS * columns.mean_step(), ABOUT_HALVES * half);
        let flank = |rising: bool| {
            let on_flank = |o: &&Observation| columns.all.get(o.column).is_some_and(|c| c.rising == rising);
            let near = observations.iter().filter(|o| (o.t - self.mean).abs() <= about).filter(on_flank);
            motions.mean(near.map(|o| o.column))
        };
        let against = flank(true).zip(flank(false)).map_or(0.0, |(a, b)| 0.5 * (a - b).norm());
        if against > 0.0 { FLANK_SHARE * against * half / (against + half) } else { 0.0 }
    }
}

/// The mean excess of z over a unit normal variable and its probability: z·Φ(z) + φ(z), and Φ(z).
fn excess(z: f64) -> [f64; 2] {
    if z.abs() > NORMAL_ENDS {
        return if z > 0.0 { [z, 1.0] } else { [0.0; 2] };
    }
    let density = (-0.5 * z * z).exp() * FRAC_1_SQRT_2 / PI.sqrt();
    let probability = 0.5 * libm::erfc(-z / SQRT_2);
    [z * probability + density, probability]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn posterior(pieces: &[(f64, f64, f64)]) -> Option<Posterior> {
        let piece = |&(from, to, weight): &(f64, f64, f64)| Piece { from, to, log: f64::ln(weight / (to - from)) };
        Posterior::of(&pieces.iter().map(piece).collect::<Vec<_>>())
    }

    fn uniform(from: f64, to: f64) -> Posterior {
        posterior(&[(from, to, 7.0)]).expect("a posterior")
    }

    #[test]
    fn for_a_uniform_distribution_the_interval_is_its_share() {
        let half = uniform(2.0, 4.0).half_of_expanded(0.0);
        assert!((half - CONTAINED / 2.0).abs() < 1e-6, "{half}");
    }

    #[test]
    fn for_a_normal_distribution_it_is_two_standard_deviations() {
        let half = uniform(2.0, 2.0 + 1e-6).half_of_expanded(0.3);
        assert!((half - 0.3).abs() < 1e-6, "{half}");
    }

    /// The half-width of 95.45 % of a uniform distribution over ±1 and a normal one of 0.3: where 0.3·L((c − 1)/0.3) =
    /// 0.0455 with L(z) = φ(z) − z·(1 − Φ(z)), that is L = 0.1517, z = 0.665 by the table of the unit normal loss.
    #[test]
    fn for_both_it_agrees_with_the_table_of_the_loss_function() {
        let half = uniform(-1.0, 1.0).half_of_expanded(0.3);
        assert!((2.0 * half - 1.1995).abs() < 2e-3, "{half}");
    }

    #[test]
    fn a_far_piece_of_little_weight_is_outside_the_interval() {
        let posterior = posterior(&[(0.0, 1.0, 0.98), (9.0, 10.0, 0.02)]).expect("a posterior");
        assert!(posterior.half_of_expanded(0.0) < 0.4, "{posterior:?}");
        assert!(posterior.deviation > 1.0, "{posterior:?}");
    }

    /// Far from the origin a mean over shares that do not add up to one would be off by micrometres.
    #[test]
    fn pieces_that_are_left_out_do_not_move_the_mean() {
        let small = (0..1000).map(|index| (900.0, 901.0 + f64::from(index), 0.9e-10));
        let pieces: Vec<_> = std::iter::once((900.0, 901.0, 1.0)).chain(small).collect();
        let posterior = posterior(&pieces).expect("a posterior");
        assert!((posterior.mean - 900.5).abs() < 1e-12, "{posterior:?}");
    }

    #[test]
    fn without_weight_there_is_no_posterior() {
        assert_eq!(Posterior::of(&[]), None);
        assert_eq!(Posterior::of(&[Piece { from: 1.0, to: 1.0, log: 0.0 }]), None);
    }
}
