//! Whether profiles repeat what those before them show beside the fit: a layer lies on many in the same place, while noise,
//! also what neighbouring points share of it, begins anew in each. In: the points near a fit. Out: how high it is, and by how
//! many standard deviations it shows. Must not know what it is that they repeat.
//!
//! With e_i the deviations of profile i over sectors of the arc, without the shift in y and in z that vibration gives it, and
//! m_i a running mean of those before it, s_i = e_i · m_i is zero on average where profiles are independent, whatever is
//! correlated within them, and uncorrelated from one i to the next. So Σ s_i / √Σ s_i² is nearly a standard normal number
//! where there are many of them. Of n profiles it is √(n − 1) at most: of ten and fewer nothing is said.

use super::patches::{self, Near, Surface};
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// Points of a profile a sector, and sectors.
const POINTS: usize = 3;
const SECTORS: [usize; 2] = [6, 24];
/// What of the running mean stays from one profile to the next.
const STAYS: f64 = 0.95;

/// A normal number is more standard deviations than this once in 740,
const CERTAIN: f64 = 3.0;
/// and than this once in 120; that counts where the fit is rougher than its points, by this share of its scatter.
const LIKELY: f64 = 2.4;
pub(super) const ROUGHER: f64 = 0.33;

/// Profiles in one piece of work.
const CHUNK: usize = 32;

/// What profiles have in common with those before them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Repeated {
    /// By how many standard deviations.
    pub(super) certain: f64,
    /// Root mean square of it, mm.
    pub(super) shared: f64,
}

impl Repeated {
    /// Whether it is more than chance, where the fit is rougher by a share of its scatter than neighbouring points are.
    pub(super) fn tells(&self, excess: f64) -> bool {
        self.certain > CERTAIN || (self.certain > LIKELY && excess > ROUGHER)
    }
}

/// What profiles repeat of those before them, of the points that are nearer to the fit than `reach`: others have no part in it.
pub(super) fn repeated(surface: &Surface, reach: f64) -> Repeated {
    let is_near = |point: &&Near| point.d.abs() < reach;
    let profiles = surface.near.chunk_by(|one, next| one.index == next.index);
    let profiles: Vec<&[Near]> = profiles.filter(|profile| profile.iter().any(|point| is_near(&point))).collect();
    let [least, most] = SECTORS;
    let near_count = surface.near.iter().filter(is_near).count();
    let sectors = (near_count / profiles.len().max(1) / POINTS).clamp(least, most);
    let ends = surface.ends();
    let chunk = |profiles: &[&[Near]]| -> Vec<Vec<Sector>> {
        profiles.iter().map(|profile| deviations(profile, reach, ends, sectors)).collect()
    };
    let (mut running, mut sum, mut squares, mut pairs) = (vec![Sector::default(); sectors], 0.0, 0.0, 0.0);
    for own in profiles.par_chunks(CHUNK).flat_map_iter(chunk).collect::<Vec<_>>() {
        let both = || own.iter().zip(&running);
        let together: f64 = both().map(|(own, running)| own.sum * running.sum).sum();
        sum += together;
        squares += together * together;
        pairs += both().map(|(own, running)| own.count * running.count).sum::<f64>();
        for (running, own) in running.iter_mut().zip(own) {
            running.sum = STAYS * running.sum + own.sum;
            running.count = STAYS * running.count + own.count;
        }
    }
    let quotient = |of: f64, by: f64| if by > 0.0 { of / by } else { 0.0 };
    Repeated { certain: quotient(sum, squares.sqrt()), shared: quotient(sum, pairs).max(0.0).sqrt() }
}

/// What lies in a sector of the arc.
#[derive(Debug, Clone, Copy, Default)]
struct Sector {
    count: f64,
    /// Of deviations, mm.
    sum: f64,
}

/// Sums over sectors of what the near points of a profile deviate by, beside its shift.
fn deviations(profile: &[Near], reach: f64, ends: [f64; 2], sectors: usize) -> Vec<Sector> {
    let near = || profile.iter().filter(|point| point.d.abs() < reach);
    let direction = |point: &Near| Vector2::from(point.direction);
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for point in near() {
        let row = direction(point);
        normal += row * row.transpose();
        right += row * point.d;
    }
    let shift = normal.cholesky().map_or_else(Vector2::zeros, |normal| normal.solve(&right));
    let mut sums = vec![Sector::default(); sectors];
    for point in near() {
        if let Some(sector) = sums.get_mut(patches::sector(point.angle, ends, sectors)) {
            sector.count += 1.0;
            sector.sum += point.d - direction(point).dot(&shift);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::super::model::Cylinder;
    use super::*;
    use crate::scan::synthetic::{ClampShape, Interference, Part, make};

    fn of(part: &Part) -> Repeated {
        let (scan, _) = make(part).expect("a part");
        let axis = part.axis;
        let cylinder =
            Cylinder { x_ref: 0.0, p: axis.p, q: axis.q, y_ref: axis.y0, z_ref: axis.z0, radius: part.radius_mm };
        let used = vec![true; scan.stations().len()];
        repeated(&patches::look(&scan, &used, &cylinder, 1.0).expect("points"), 1.0)
    }

    #[test]
    fn a_layer_repeats_and_noise_does_not_whatever_points_share() {
        let jaw = Interference {
            clamps: 0.5,
            clamp_arc: 0.6,
            clamp_height_mm: 0.1,
            clamp_shape: ClampShape::Concentric,
            ..Interference::NONE
        };
        for seed in 0..8 {
            let plain = Part {
                noise_sigma_mm: 0.05,
                jitter_sigma_mm: 0.05,
                interference: Interference::NONE,
                ..Part::smooth(seed)
            };
            for noise_correlation in [0.0, 0.9] {
                let Repeated { certain, .. } = of(&Part { noise_correlation, ..plain });
                // Beyond 4 lies one normal number in 16 000.
                assert!(certain.abs() < 4.0, "{certain}");
            }
            let Repeated { certain, shared } = of(&Part { interference: jaw, ..plain });
            // Of 0.1 mm over 60 % of the arc, half is left beside a shift, on half of the profiles.
            assert!(certain > 5.0 && shared > 0.01 && shared < 0.05, "{certain} {shared}");
        }
    }
}
