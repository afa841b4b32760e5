//! The sensor's linearity error: its distance scale deviates by a smooth function δ(y) of the place along the laser line, alike in
//! every profile, so that more profiles do not average it out.
//!
//! δ is taken as a random function with the standard deviation u and the correlation ρ = exp(−(y − y′)²/2L²), and the pose
//! answers with E(y) to a shift of the points about y in z. The covariance of the pose is then Σ ρ(y_a − y_b) u² E_a E_bᵀ over
//! patches of the line. Along a tilted part the points of one patch lie at different z, where δ differs as it does between
//! places of the line: its slope along z has the standard deviation u/L, to which the pose answers with F(y), and Σ ρ (u/L)²
//! F_a F_bᵀ is added.

use nalgebra::{Matrix5, Vector5};

/// Patches along the line; a shorter correlation than a patch is taken as one patch, which overstates its effect.
const PATCHES: usize = 64;
/// Correlation length where none is declared, as a share of the width that is seen: shorter errors average out along the
/// line, longer ones shift the part as a whole. Between 0.15 and 0.25 the effect on the position is within 10 % of its maximum,
/// for arcs of 60° to 150°.
const LENGTH_SHARE: f64 = 0.2;

/// How (p, q, y_ref, z_ref, radius) answer to a shift of the points of one patch by 1 mm in z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PatchInfluence {
    /// Middle of the patch, mm.
    pub(super) y: f64,
    pub(super) effect: Vector5<f64>,
    /// The same to a shift by 1 mm for each mm that a point lies higher than the others of the patch.
    pub(super) slope: Vector5<f64>,
}

/// The laser line cut into patches of equal width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Patches {
    low: f64,
    width: f64,
}

impl Patches {
    /// Patches over all of these places; `None` where there is none.
    pub(super) fn over(places: impl Iterator<Item = f64>) -> Option<Self> {
        let wider = |[low, high]: [f64; 2], y: f64| [low.min(y), high.max(y)];
        let [low, high] = places.fold([f64::INFINITY, f64::NEG_INFINITY], wider);
        (low <= high).then(|| Self { low, width: (high - low) / PATCHES as f64 })
    }

    pub(super) const fn count() -> usize {
        PATCHES
    }

    /// The patch that holds this place.
    pub(super) fn index(&self, y: f64) -> usize {
        let place = (y - self.low) / self.width.max(f64::MIN_POSITIVE);
        // The cast saturates, and NaN becomes 0.
        (place as usize).min(PATCHES - 1)
    }

    /// The influences of these patches, given in order.
    pub(super) fn influences(&self, effects: Vec<[Vector5<f64>; 2]>) -> Vec<PatchInfluence> {
        let influence = |(index, [effect, slope]): (usize, [Vector5<f64>; 2])| PatchInfluence {
            y: self.low + (index as f64 + 0.5) * self.width,
            effect,
            slope,
        };
        effects.into_iter().enumerate().map(influence).collect()
    }
}

/// Covariance of (p, q, y_ref, z_ref, radius) under a linearity error of `standard` mm with this correlation length, mm.
pub(super) fn covariance(influences: &[PatchInfluence], standard: f64, length: Option<f64>) -> Matrix5<f64> {
    let seen = || influences.iter().filter(|influence| influence.effect.amax() > 0.0);
    let ends = seen().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at.y), high.max(at.y)]);
    let [low, high] = ends;
    let length = length.unwrap_or(LENGTH_SHARE * (high - low)).max(f64::MIN_POSITIVE);
    let mut sum = Matrix5::zeros();
    for a in seen() {
        for b in seen() {
            let correlation = (-0.5 * ((a.y - b.y) / length).powi(2)).exp();
            sum += a.effect * b.effect.transpose() * correlation;
            // Divided one by one: the square of the least length is none.
            sum += (a.slope / length) * (b.slope / length).transpose() * correlation;
        }
    }
    sum * standard.powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The position z is the mean over the line.
    fn mean_of(places: &[f64]) -> Vec<PatchInfluence> {
        let effect = Vector5::new(0.0, 0.0, 0.0, 1.0 / places.len() as f64, 0.0);
        places.iter().map(|&y| PatchInfluence { y, effect, slope: Vector5::zeros() }).collect()
    }

    #[test]
    fn an_error_alike_everywhere_shifts_and_independent_ones_average_out() {
        let line = mean_of(&[-30.0, -10.0, 10.0, 30.0]);
        let z = |length: f64| covariance(&line, 0.02, Some(length))[(3, 3)].sqrt();
        assert!((z(1e5) - 0.02).abs() < 1e-8);
        assert!((z(1.0) - 0.01).abs() < 1e-8);
        // Two places 20 mm apart with L = 20 mm: u²·(1 + exp(−1/2))/2.
        let two = covariance(&mean_of(&[0.0, 20.0]), 0.02, Some(20.0))[(3, 3)];
        assert!((two - 4e-4 * 0.5 * (1.0 + (-0.5f64).exp())).abs() < 1e-15);
    }

    #[test]
    fn along_a_tilted_part_the_slope_of_the_error_counts() {
        let slope = Vector5::new(0.0, 0.5, 0.0, 0.0, 0.0);
        let place = PatchInfluence { y: 0.0, effect: Vector5::new(0.0, 0.0, 0.0, 1.0, 0.0), slope };
        let found = covariance(&[place], 0.02, Some(10.0));
        assert!(
            (found[(3, 3)] - 4e-4).abs() < 1e-18 && (found[(1, 1)] - (0.5 * 0.02 / 10.0_f64).powi(2)).abs() < 1e-18
        );
    }

    #[test]
    fn without_a_declared_length_it_is_a_share_of_the_width_and_one_place_needs_none() {
        let line = mean_of(&[-50.0, 0.0, 50.0]);
        assert_eq!(covariance(&line, 0.01, None), covariance(&line, 0.01, Some(20.0)));
        assert!((covariance(&mean_of(&[3.0]), 0.01, None)[(3, 3)] - 1e-4).abs() < 1e-18);
        assert_eq!(covariance(&[], 0.01, None), Matrix5::zeros());
    }

    #[test]
    fn patches_hold_the_whole_line_and_nothing_breaks_outside() {
        let patches = Patches::over([-10.0, 54.0].into_iter()).expect("places");
        assert_eq!([-10.0, -9.5, 53.5, 54.0].map(|y| patches.index(y)), [0, 0, 63, 63]);
        assert_eq!([-1e9, 1e9, f64::NAN].map(|y| patches.index(y)), [0, 63, 0]);
        assert_eq!(Patches::over([2.0].into_iter()).expect("a place").index(2.0), 0);
        assert_eq!(Patches::over(std::iter::empty()), None);
    }
}
