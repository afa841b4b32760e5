//! The covariance of the joint fit, with the profile as the cluster.
//!
//! Points of one profile share errors (speckle, vibration), so a covariance that takes them as independent is wrong. The
//! clustered jackknife (n − 1)/n Σ_i δ_i δ_iᵀ, with δ_i = (N − N_i)⁻¹ G_i what the fit moves by without profile i, assumes
//! nothing about points of the same profile. N_i is the sum of ψ′ J Jᵀ and G_i that of w·d·J over profile i, N the sum of all
//! N_i. It is the sandwich whose residuals are corrected for the pull of their own profile (Bell and McCaffrey's CR3). Few
//! profiles widen the interval as Student's t does, with Satterthwaite's degrees of freedom for each parameter: the two ends
//! of a scan decide a slope, however many profiles lie between.

use super::components;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::student::{TWO_SIGMA, coverage_ratio};
use nalgebra::{Matrix5, Vector5};

/// Above this share of the whole, a profile is taken out exactly, below by the first terms of the series.
const LEVERAGE_SMALL: f64 = 0.1;
/// Of fewer profiles what they say together is asked as well.
const FEW: f64 = 20.0;
/// And where a parameter hangs on fewer of them than this.
const FEW_EFFECTIVE: f64 = 10.0;
/// Parameters of an axis in one projection: what the degrees of freedom cannot get back.
const LINE: f64 = 2.0;

/// The covariance of (p, q, y_ref, z_ref, R) and the degrees of freedom of its variances, for which it is widened already.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scatter {
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: Vector5<f64>,
}

/// From the joint normal matrix and each profile's sums; `None` where it is singular.
pub(super) fn sandwich(normal: &Matrix5<f64>, profiles: &[Sums], hold: Hold) -> Option<Scatter> {
    let bread = step::invert(normal)?;
    // A fixed radius has no say and learns nothing.
    let free = if matches!(hold, Hold::Fixed { .. }) { step::OTHERS } else { Vector5::repeat(1.0) };
    let mask = Matrix5::from_diagonal(&free);
    let clusters = || profiles.iter().filter(|profile| profile.weight > 0.0);
    let clusters_count = clusters().count() as f64;
    // Two profiles make a line whatever they are off by: what is left of their sums is all that can be told.
    let repeated = clusters_count > LINE;
    let mut scatter = Matrix5::zeros();
    let (mut shares, mut squared_shares) = (Vector5::zeros(), Vector5::zeros());
    for profile in clusters() {
        let (gradient, own) = (profile.gradient.component_mul(&free), mask * profile.normal * mask);
        let pull = bread * own;
        let shift = if repeated { without(normal, &bread, &own, &pull, &gradient) } else { bread * gradient };
        scatter += shift * shift.transpose();
        let share = (pull * bread).diagonal().map(|v| v.max(0.0));
        shares += share;
        squared_shares += share.component_mul(&share);
    }
    if !repeated {
        return Some(Scatter { covariance: scatter * clusters_count, freedom: Vector5::repeat(1.0) });
    }
    let mut freedom = shares.zip_map(&squared_shares, |sum, squares| {
        let effective = if squares > 0.0 { sum * sum / squares } else { clusters_count };
        effective.min(clusters_count - LINE).max(1.0)
    });
    let widen = Matrix5::from_diagonal(&freedom.map(|freedom| coverage_ratio(freedom, TWO_SIGMA)));
    let mut covariance = widen * scatter * widen * ((clusters_count - 1.0) / clusters_count.max(1.0));
    let few = freedom.map(|freedom| clusters_count < FEW || freedom < FEW_EFFECTIVE);
    if few.iter().any(|few| *few) {
        let (floor, floor_freedom) =
            components::variances(&bread, profiles, &free).unwrap_or((Vector5::zeros(), freedom));
        let wider = |own: f64, floor: f64| if own > 0.0 { (floor / own).max(1.0).sqrt() } else { 1.0 };
        let wider =
            covariance.diagonal().zip_map(&floor, wider).zip_map(&few, |wider, few| if few { wider } else { 1.0 });
        let widen = Matrix5::from_diagonal(&wider);
        covariance = widen * covariance * widen;
        freedom =
            wider.zip_zip_map(&freedom, &floor_freedom, |wider, own, floor| if wider > 1.0 { floor } else { own });
    }
    covariance.iter().all(|v| v.is_finite()).then_some(Scatter { covariance, freedom })
}

/// The same where the profiles are sections or slabs that were cut from a cloud. What the sensor took together is not known then: its
/// profiles, whose points share errors, pass through several sections. So runs of 1, 2, 4, … neighbouring sections are the
/// clusters in turn, as long as enough of them are left, and for each parameter the largest variance counts.
pub(super) fn over_runs(normal: &Matrix5<f64>, sections: &[Sums], hold: Hold) -> Option<Scatter> {
    let mut widest = sandwich(normal, sections, hold)?;
    let sections: Vec<&Sums> = sections.iter().filter(|section| section.weight > 0.0).collect();
    let mut length = 2;
    while sections.len() as f64 >= FEW * length as f64 {
        let run = |run: &[&Sums]| {
            let mut sum = Sums::zero();
            run.iter().for_each(|section| sum.add(section));
            sum
        };
        let runs: Vec<Sums> = sections.chunks(length).map(run).collect();
        let Some(Scatter { covariance, freedom }) = sandwich(normal, &runs, hold) else { break };
        let own = widest.covariance.diagonal();
        let wider =
            covariance.diagonal().zip_map(&own, |runs, own| if own > 0.0 { (runs / own).max(1.0) } else { 1.0 });
        let widen = Matrix5::from_diagonal(&wider.map(f64::sqrt));
        widest.covariance = widen * widest.covariance * widen;
        widest.freedom =
            wider.zip_zip_map(&widest.freedom, &freedom, |by, own, runs| if by > 1.0 { runs } else { own });
        length *= 2;
    }
    Some(widest)
}

/// What the fit moves by without a profile: (N − N_i)⁻¹ G_i.
fn without(
    normal: &Matrix5<f64>,
    bread: &Matrix5<f64>,
    own: &Matrix5<f64>,
    pull: &Matrix5<f64>,
    gradient: &Vector5<f64>,
) -> Vector5<f64> {
    let first = bread * gradient;
    if pull.trace() < LEVERAGE_SMALL {
        let second = pull * first;
        return first + second + pull * second;
    }
    step::invert(&(normal - own)).map_or(first, |rest| rest * gradient)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_takes_a_profile_out_as_the_inverse_does() {
        let own = Matrix5::from_fn(|i, j| 0.01 / (1.0 + i as f64 + j as f64)) + Matrix5::identity() * 0.01;
        let (normal, gradient) = (Matrix5::identity() * 2.0, Vector5::new(1.0, -2.0, 0.5, 0.3, 1.0));
        let bread = normal.try_inverse().expect("regular");
        let series = without(&normal, &bread, &own, &(bread * own), &gradient);
        let exact = (normal - own).try_inverse().expect("regular") * gradient;
        assert!((series - exact).norm() < 1e-3 * exact.norm());
    }
}
