//! The covariance of the joint fit, with the profile as the cluster.
//!
//! Points of one profile share errors (speckle, vibration), so a covariance that takes them as independent is wrong. The clustered
//! jackknife (n − 1)/n Σ_i δ_i δ_iᵀ, with δ_i = (N − N_i)⁻¹ G_i the change of the fit without profile i, assumes nothing about
//! points of the same profile. N_i is the sum of ψ′ J Jᵀ and G_i that of w·d·J over profile i, N the sum of all N_i. It is the
//! sandwich estimator whose residuals are corrected for the leverage of their own profile (Bell and McCaffrey's CR3). With few
//! profiles the interval is widened as by Student's t, with Satterthwaite's degrees of freedom for each parameter: the two ends of
//! a scan determine a slope, however many profiles lie between.
//!
//! With few profiles the variances are at least those of two components, the noise of points and the vibration of whole profiles,
//! each estimated from all profiles and widened for its degrees of freedom. The gradient of profile i has the covariance φ S_i + τ²
//! S_i P S_i: S_i is its part of the normal matrix in (y, z, R), φ the scatter of points including errors common to neighbouring
//! points, and τ the vibration, equal in y and in z (P leaves out R). The deviations of the profiles' own radii estimate φ, with n
//! − 1 degrees of freedom. The deviations of their own centres estimate φ and τ together, with 2n − 4 degrees of freedom. Only
//! directions in which the arc determines the centre count for τ: n − 2 degrees of freedom on a short arc.

use super::normal_equations::{self, RadiusConstraint, Sums};
use crate::estimation::statistics::{TWO_SIGMA, coverage_ratio};
use nalgebra::{Matrix2, Matrix3, Matrix5, Vector2, Vector3, Vector5};

/// Above this share of the total, the effect of removing a profile is calculated exactly; below, by the first terms of the series.
const LEVERAGE_SMALL: f64 = 0.1;
/// With fewer profiles the variance components are estimated as well.
const FEW: f64 = 20.0;
/// The same applies to a parameter that effectively depends on fewer profiles than this.
const FEW_EFFECTIVE: f64 = 10.0;
/// Parameters of an axis in one projection: degrees of freedom that the fit uses up.
const LINE: f64 = 2.0;

/// The covariance of (p, q, y_ref, z_ref, R), already widened for the degrees of freedom of its variances, and these degrees of
/// freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scatter {
    pub(super) covariance: Matrix5<f64>,
    pub(super) freedom: Vector5<f64>,
}

/// From the joint normal matrix and each profile's sums; `None` if the matrix is singular.
pub(super) fn sandwich(normal: &Matrix5<f64>, profiles: &[Sums], constraint: RadiusConstraint) -> Option<Scatter> {
    let bread = normal_equations::invert(normal)?;
    // A fixed radius neither contributes nor changes.
    let free = if matches!(constraint, RadiusConstraint::Fixed { .. }) {
        normal_equations::OTHERS
    } else {
        Vector5::repeat(1.0)
    };
    let mask = Matrix5::from_diagonal(&free);
    let clusters = || profiles.iter().filter(|profile| profile.weight > 0.0);
    let clusters_count = clusters().count() as f64;
    // Two profiles define a line whatever their errors, so only the remainders of their sums can be used.
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
        let (floor, floor_freedom) = variances(&bread, profiles, &free).unwrap_or((Vector5::zeros(), freedom));
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

/// The same for sections or slabs that were cut from a cloud. The profiles that the sensor took together, whose points share
/// errors, are then unknown and pass through several sections. So runs of 1, 2, 4, … neighbouring sections are the clusters in
/// turn, as long as enough of them remain, and for each parameter the largest variance is taken.
pub(super) fn over_runs(normal: &Matrix5<f64>, sections: &[Sums], constraint: RadiusConstraint) -> Option<Scatter> {
    let mut widest = sandwich(normal, sections, constraint)?;
    let sections: Vec<&Sums> = sections.iter().filter(|section| section.weight > 0.0).collect();
    let mut length = 2;
    while sections.len() as f64 >= FEW * length as f64 {
        let run = |run: &[&Sums]| {
            let mut sum = Sums::zero();
            run.iter().for_each(|section| sum.add(section));
            sum
        };
        let runs: Vec<Sums> = sections.chunks(length).map(run).collect();
        let Some(Scatter { covariance, freedom }) = sandwich(normal, &runs, constraint) else { break };
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

/// The change of the fit without a profile: (N − N_i)⁻¹ G_i.
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
    normal_equations::invert(&(normal - own)).map_or(first, |rest| rest * gradient)
}

/// Index of (y_ref, z_ref, R) among the parameters.
const SECTION: usize = 2;
/// The normal quantile that leaves out 1 in 10⁵, two-sided;
const FAR: f64 = 4.417;
/// the widened interval must not need more standard uncertainties than this to contain it.
const FAR_MAX: f64 = 5.0;
/// Fewer degrees of freedom count as this many.
const FREEDOM_MIN: f64 = 4.0;
/// Vibration is assumed if the variance of the centres exceeds the one that the radii suggest by this factor.
const VIBRATION_RATIO_MIN: f64 = 4.0;

/// Variances of (p, q, y_ref, z_ref, R), widened, and their degrees of freedom; `None` if the profiles are too few or each
/// determines too little.
pub(super) fn variances(
    bread: &Matrix5<f64>,
    profiles: &[Sums],
    free: &Vector5<f64>,
) -> Option<(Vector5<f64>, Vector5<f64>)> {
    let sections: Vec<Section> = profiles.iter().filter_map(Section::of).collect();
    let count = sections.len() as f64;
    let [freedom_radius, freedom_centre] = [count - 1.0, 2.0 * count - 4.0];
    if freedom_centre < 1.0 {
        return None;
    }
    let weight: f64 = sections.iter().map(|section| 1.0 / section.radius_variance).sum();
    let middle = sections.iter().map(|section| section.radius / section.radius_variance).sum::<f64>() / weight;
    let of_radius: f64 = sections.iter().map(|s| (s.radius - middle).powi(2) / s.radius_variance).sum();
    let of_centre: f64 = sections.iter().map(|section| section.centre).sum();
    let stiffness = sections.iter().map(|section| section.stiffness).sum::<f64>() * freedom_centre / (2.0 * count);
    let (noise, both) = (of_radius / freedom_radius, of_centre / freedom_centre);
    // Vibration shows in the directions in which a profile determines its centre well: one of two on a short arc.
    let squares: f64 = sections.iter().map(|section| section.stiffness_squares).sum();
    let shown = sections.iter().map(|section| section.stiffness.powi(2)).sum::<f64>() / (2.0 * squares);
    let freedom_vibration = shown * freedom_centre;
    let is_vibrating = both > VIBRATION_RATIO_MIN * noise;
    let (noise, freedom_noise, vibration) = if is_vibrating {
        (noise, freedom_radius, (both - noise) * freedom_centre / stiffness)
    } else {
        // The decision against vibration is based on at most these degrees of freedom.
        ((of_radius + of_centre) / (freedom_radius + freedom_centre), freedom_vibration, 0.0)
    };
    // The variances of the parameters by a unit of each component.
    let by_noise = bread.diagonal().component_mul(free);
    let mut by_vibration = Vector5::zeros();
    for profile in profiles.iter().filter(|profile| profile.weight > 0.0) {
        let effect = bread * profile.normal.fixed_columns::<2>(SECTION);
        by_vibration += effect.component_mul(&effect).column_sum().component_mul(free);
    }
    let (of_noise, of_vibration) = (by_noise * noise, by_vibration * vibration);
    // Satterthwaite's degrees of freedom.
    let freedom = of_noise.zip_map(&of_vibration, |of_noise, of_vibration| {
        let squared = of_noise.powi(2) / freedom_noise + of_vibration.powi(2) / freedom_vibration;
        let freedom = if squared > 0.0 { (of_noise + of_vibration).powi(2) / squared } else { freedom_vibration };
        freedom.max(1.0)
    });
    let variances =
        (of_noise + of_vibration).zip_map(&freedom, |variance, freedom| variance * widening(freedom).powi(2));
    Some((variances, freedom))
}

/// The deviation of one profile in its own section.
struct Section {
    radius: f64,
    /// For φ = 1.
    radius_variance: f64,
    /// gᵀ S⁻¹ g of its centre, whose mean is 2φ + τ² tr S.
    centre: f64,
    /// tr S,
    stiffness: f64,
    /// and tr S².
    stiffness_squares: f64,
}

impl Section {
    fn of(profile: &Sums) -> Option<Self> {
        let normal: Matrix3<f64> = profile.normal.fixed_view::<3, 3>(SECTION, SECTION).into_owned();
        let gradient: Vector3<f64> = profile.gradient.fixed_rows::<3>(SECTION).into_owned();
        let inverse = normal.cholesky()?.inverse();
        let shift: [f64; 3] = (inverse * gradient).into();
        let [.., radius_variance]: [f64; 3] = inverse.diagonal().into();
        let stiffness: Matrix2<f64> = normal.fixed_view::<2, 2>(0, 0).into_owned();
        let pull: Vector2<f64> = gradient.fixed_rows::<2>(0).into_owned();
        let centre = pull.dot(&stiffness.cholesky()?.solve(&pull));
        let [.., radius] = shift;
        let usable = radius_variance > 0.0 && radius.is_finite() && centre.is_finite();
        let stiffness_squares = stiffness.norm_squared();
        usable.then_some(Self { radius, radius_variance, centre, stiffness: stiffness.trace(), stiffness_squares })
    }
}

/// The factor by which the normal distribution's intervals of two and of five standard uncertainties must be widened.
fn widening(freedom: f64) -> f64 {
    let freedom = freedom.max(FREEDOM_MIN);
    coverage_ratio(freedom, TWO_SIGMA).max(coverage_ratio(freedom, FAR) * FAR / FAR_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_removes_a_profile_as_the_inverse_does() {
        let own = Matrix5::from_fn(|i, j| 0.01 / (1.0 + i as f64 + j as f64)) + Matrix5::identity() * 0.01;
        let (normal, gradient) = (Matrix5::identity() * 2.0, Vector5::new(1.0, -2.0, 0.5, 0.3, 1.0));
        let bread = normal.try_inverse().expect("regular");
        let series = without(&normal, &bread, &own, &(bread * own), &gradient);
        let exact = (normal - own).try_inverse().expect("regular") * gradient;
        assert!((series - exact).norm() < 1e-3 * exact.norm());
    }
}
