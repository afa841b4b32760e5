//! What is known of a place as a distribution in pieces, each of which is even, and how wide the interval about its mean is
//! that holds it. Must not know cells or planes.

use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

/// What two standard uncertainties hold of a normal distribution: erf √2.
const HELD: f64 = 0.954_499_736_103_642;
/// Pieces below this share of the whole are left out: together, some thousands, they hold less than a millionth.
const SHARE_MIN: f64 = 1e-10;
/// Beyond so many standard deviations a normal distribution has ended, to double precision.
const NORMAL_ENDS: f64 = 8.0;
/// What is normal about the place is at least this, mm; it keeps the quotients finite.
const NORMAL_MIN_MM: f64 = 1e-9;
/// Steps in which the half-width is looked for at most, and how far off the share may be that it holds.
const STEPS_MAX: usize = 60;
const HELD_OFF_MAX: f64 = 1e-9;
/// No distribution has more than 1/k² beyond k standard deviations (Chebyshev); a 22nd is outside of the interval.
const DEVIATIONS_MAX: f64 = 5.0;

/// Even from here to there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) weight: f64,
}

/// Where something is, mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Posterior {
    /// Their weights add up to one.
    pieces: Vec<Piece>,
    mean: f64,
    deviation: f64,
}

impl Posterior {
    /// `None` without weight.
    pub(super) fn of(mut pieces: Vec<Piece>) -> Option<Self> {
        let total = |pieces: &[Piece]| pieces.iter().map(|piece| piece.weight).sum::<f64>();
        let least = SHARE_MIN * total(&pieces);
        pieces.retain(|piece| piece.weight > least);
        let total = total(&pieces);
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        for piece in &mut pieces {
            piece.weight /= total;
        }
        let middle = |piece: &Piece| 0.5 * (piece.from + piece.to);
        let mean: f64 = pieces.iter().map(|piece| piece.weight * middle(piece)).sum();
        let square = |piece: &Piece| (middle(piece) - mean).powi(2) + (piece.to - piece.from).powi(2) / 12.0;
        let variance: f64 = pieces.iter().map(|piece| piece.weight * square(piece)).sum();
        Some(Self { pieces, mean, deviation: variance.sqrt() })
    }

    /// Its mean, mm.
    pub(super) const fn mean(&self) -> f64 {
        self.mean
    }

    /// Half of the half-width of the interval about the mean that holds 95.45 % when an independent normal error of this
    /// standard deviation is added, mm.
    pub(super) fn half_of_expanded(&self, normal: f64) -> f64 {
        let normal = normal.max(NORMAL_MIN_MM);
        let deviation = self.deviation.hypot(normal);
        let [mut low, mut high] = [0.0, DEVIATIONS_MAX * deviation];
        let mut half_width = 2.0 * deviation;
        // Newton's method, kept between what holds too little and what holds too much.
        for _ in 0..STEPS_MAX {
            let [held, growth] = self.held(half_width, normal);
            if (HELD - held).abs() < HELD_OFF_MAX {
                break;
            }
            *(if held < HELD { &mut low } else { &mut high }) = half_width;
            let next = half_width + (HELD - held) / growth;
            half_width = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        0.5 * half_width
    }

    /// The share within a half-width of the mean, and by how much it grows with that.
    fn held(&self, half_width: f64, normal: f64) -> [f64; 2] {
        let [low, high] = [self.mean - half_width, self.mean + half_width];
        let share = |piece: &Piece| {
            let below = |x: f64| {
                let [from, to] = [piece.from, piece.to].map(|end| Excess::at((x - end) / normal));
                [(from.mean - to.mean) * normal, from.chance - to.chance]
            };
            let ([below_high, at_high], [below_low, at_low]) = (below(high), below(low));
            let density = piece.weight / (piece.to - piece.from);
            [density * (below_high - below_low), density * (at_high + at_low)]
        };
        self.pieces.iter().map(share).fold([0.0; 2], |[held, growth], [share, by]| [held + share, growth + by])
    }
}

/// By how much a number exceeds one of the unit normal distribution.
struct Excess {
    /// ∫ Φ up to z = z·Φ(z) + φ(z).
    mean: f64,
    /// Φ(z), that it does.
    chance: f64,
}

impl Excess {
    fn at(z: f64) -> Self {
        if z.abs() > NORMAL_ENDS {
            return Self { mean: z.max(0.0), chance: if z > 0.0 { 1.0 } else { 0.0 } };
        }
        let density = (-0.5 * z * z).exp() * FRAC_1_SQRT_2 / PI.sqrt();
        let chance = 0.5 * libm::erfc(-z / SQRT_2);
        Self { mean: z * chance + density, chance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn even(from: f64, to: f64) -> Posterior {
        Posterior::of(vec![Piece { from, to, weight: 7.0 }]).expect("a posterior")
    }

    #[test]
    fn of_an_even_distribution_the_interval_is_its_share() {
        let half = even(2.0, 4.0).half_of_expanded(0.0);
        assert!((half - HELD / 2.0).abs() < 1e-7, "{half}");
    }

    #[test]
    fn of_a_normal_distribution_it_is_two_standard_deviations() {
        let half = even(2.0, 2.0 + 1e-6).half_of_expanded(0.3);
        assert!((half - 0.3).abs() < 1e-7, "{half}");
    }

    /// The half-width of 95.45 % of an even distribution over ±1 and a normal one of 0.3: where 0.3·L((c − 1)/0.3) = 0.0455,
    /// L(z) = φ(z) − z·(1 − Φ(z)), that is at L = 0.1517, z = 0.665 by the table of the unit normal loss.
    #[test]
    fn of_both_it_is_what_the_table_of_the_loss_function_says() {
        let half = even(-1.0, 1.0).half_of_expanded(0.3);
        assert!((2.0 * half - 1.1995).abs() < 2e-3, "{half}");
    }

    #[test]
    fn a_far_piece_of_little_weight_is_left_outside() {
        let pieces = vec![Piece { from: 0.0, to: 1.0, weight: 0.98 }, Piece { from: 9.0, to: 10.0, weight: 0.02 }];
        let posterior = Posterior::of(pieces).expect("a posterior");
        assert!(posterior.half_of_expanded(0.0) < 0.4, "{posterior:?}");
        assert!(posterior.deviation > 1.0, "{posterior:?}");
    }

    /// Far from the origin a mean over shares that do not add up to one would be off by micrometres.
    #[test]
    fn what_is_left_out_moves_nothing() {
        let small = (0..1000).map(|index| Piece { from: 900.0, to: 901.0 + f64::from(index), weight: 0.9e-10 });
        let pieces = std::iter::once(Piece { from: 900.0, to: 901.0, weight: 1.0 }).chain(small).collect();
        let posterior = Posterior::of(pieces).expect("a posterior");
        assert!((posterior.mean() - 900.5).abs() < 1e-12, "{posterior:?}");
    }

    #[test]
    fn without_weight_there_is_none() {
        assert_eq!(Posterior::of(Vec::new()), None);
        assert_eq!(Posterior::of(vec![Piece { from: 1.0, to: 1.0, weight: 0.0 }]), None);
    }
}
