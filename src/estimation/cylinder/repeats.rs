//! Whether profiles repeat what those before them show beside the fit: a layer lies on many in the same place, while noise,
//! also what neighbouring points share of it, begins anew in each. In: the points near a fit. Out: by how many standard
//! deviations they do. Must not know what it is that they repeat.
//!
//! With e_i the deviations of profile i over sectors of the arc, without the shift in y and in z that vibration gives it, and
//! m_i a running mean of those before it, s_i = e_i · m_i is zero on average where profiles are independent, whatever is
//! correlated within them, and uncorrelated from one i to the next. So Σ s_i / √Σ s_i² is a standard normal number.

use super::patches::{self, Near, Surface};
use nalgebra::{Matrix2, Vector2};

/// Points of a profile a sector, and sectors.
const POINTS: usize = 3;
const SECTORS: [usize; 2] = [6, 24];
/// What of the running mean stays from one profile to the next.
const STAYS: f64 = 0.6;

/// By how many standard deviations profiles go together with those before them.
pub(super) fn repeats(surface: &Surface) -> f64 {
    let profiles = || surface.near.chunk_by(|one, next| one.index == next.index);
    let [least, most] = SECTORS;
    let sectors = (surface.near.len() / profiles().count().max(1) / POINTS).clamp(least, most);
    let ends = surface.ends();
    let (mut running, mut sum, mut squares) = (vec![0.0; sectors], 0.0, 0.0);
    for profile in profiles() {
        let own = deviations(profile, ends, sectors);
        let together: f64 = own.iter().zip(&running).map(|(own, running)| own * running).sum();
        sum += together;
        squares += together * together;
        running.iter_mut().zip(own).for_each(|(running, own)| *running = STAYS * *running + own);
    }
    if squares > 0.0 { sum / squares.sqrt() } else { 0.0 }
}

/// Sums over sectors of what the points of a profile deviate by, beside its shift.
fn deviations(profile: &[Near], ends: [f64; 2], sectors: usize) -> Vec<f64> {
    let direction = |point: &Near| Vector2::new(point.angle.cos(), point.angle.sin());
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for point in profile {
        let row = direction(point);
        normal += row * row.transpose();
        right += row * point.d;
    }
    let shift = normal.cholesky().map_or_else(Vector2::zeros, |normal| normal.solve(&right));
    let mut sums = vec![0.0; sectors];
    for point in profile {
        if let Some(sum) = sums.get_mut(patches::sector(point.angle, ends, sectors)) {
            *sum += point.d - direction(point).dot(&shift);
        }
    }
    sums
}
