//! What is known of a place as a distribution in pieces, each of which is even, and how wide the interval about its mean is
//! that holds it. Must not know cells or planes.

use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

/// What two standard uncertainties hold of a normal distribution: erf √2.
const HELD: f64 = 0.954_499_736_103_642;
/// Pieces below this share of the whole are left out: together they hold less than a millionth.
const SHARE_MIN: f64 = 1e-8;
/// Beyond so many standard deviations a normal distribution has ended, to double precision.
const NORMAL_ENDS: f64 = 8.0;
/// What is normal about the place is at least this, mm; it keeps the quotients finite.
const NORMAL_MIN_MM: f64 = 1e-9;
/// Halvings of the interval in which the half-width is looked for.
const HALVINGS: usize = 30;
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
        let total: f64 = pieces.iter().map(|piece| piece.weight).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        pieces.retain_mut(|piece| {
            piece.weight /= total;
            piece.weight > SHARE_MIN
        });
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
        let mut bounds = [0.0, DEVIATIONS_MAX * self.deviation.hypot(normal)];
        for _ in 0..HALVINGS {
            let [low, high] = bounds;
            let middle = 0.5 * (low + high);
            bounds = if self.held(middle, normal) < HELD { [middle, high] } else { [low, middle] };
        }
        0.5 * bounds.iter().sum::<f64>() / 2.0
    }

    /// The share within a half-width of the mean.
    fn held(&self, half_width: f64, normal: f64) -> f64 {
        let below = |x: f64, piece: &Piece| {
            let [from, to] = [piece.from, piece.to].map(|end| mean_excess((x - end) / normal));
            (from - to) * normal / (piece.to - piece.from)
        };
        let [low, high] = [self.mean - half_width, self.mean + half_width];
        self.pieces.iter().map(|piece| piece.weight * (below(high, piece) - below(low, piece))).sum()
    }
}

/// ∫ Φ up to z = z·Φ(z) + φ(z).
fn mean_excess(z: f64) -> f64 {
    if z.abs() > NORMAL_ENDS {
        return z.max(0.0);
    }
    let density = (-0.5 * z * z).exp() * FRAC_1_SQRT_2 / PI.sqrt();
    z * 0.5 * libm::erfc(-z / SQRT_2) + density
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

    #[test]
    fn without_weight_there_is_none() {
        assert_eq!(Posterior::of(Vec::new()), None);
        assert_eq!(Posterior::of(vec![Piece { from: 1.0, to: 1.0, weight: 0.0 }]), None);
    }
}
