//! What few profiles say together: the noise of points and the vibration of whole profiles, each found from all of them. In:
//! the sums of the profiles at the fit. Out: the variances of the parameters that those two make, widened for how few degrees
//! of freedom they rest on.
//!
//! The gradient of profile i has the covariance φ S_i + τ² S_i P S_i: S_i is its part of the normal matrix in (y, z, R), φ the
//! scatter of points with what neighbours share, and τ the vibration, alike in y and in z (P leaves out R). What each profile's
//! own radius is off by tells φ, with n − 1 degrees of freedom; what its own centre is off by tells φ and τ together, with
//! 2n − 4, of which those count for τ in which the arc shows the centre: n − 2 on a short one.

use super::sums::Sums;
use crate::estimation::student::{TWO_SIGMA, coverage_ratio};
use nalgebra::{Matrix2, Matrix3, Matrix5, Vector2, Vector3, Vector5};

/// Where (y_ref, z_ref, R) begin among the parameters.
const SECTION: usize = 2;
/// The normal quantile of all but 1 in 10⁵, two-sided,
const FAR: f64 = 4.417;
/// is to be no more than this many standard uncertainties away.
const FAR_MAX: f64 = 5.0;
/// Fewer degrees of freedom are counted as so many: nothing is known then.
const FREEDOM_MIN: f64 = 4.0;
/// Vibration is told from the points' noise where centres are off by so many times the variance that radii make likely.
const TOLD: f64 = 4.0;

/// Variances of (p, q, y_ref, z_ref, R), widened, and their degrees of freedom; `None` where the profiles are too few or show too
/// little each.
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
    // Vibration shows in the directions in which a profile knows its centre well, on a short arc one of two.
    let squares: f64 = sections.iter().map(|section| section.stiffness_squares).sum();
    let shown = sections.iter().map(|section| section.stiffness.powi(2)).sum::<f64>() / (2.0 * squares);
    let freedom_vibration = shown * freedom_centre;
    let told = both > TOLD * noise;
    let (noise, freedom_noise, vibration) = if told {
        (noise, freedom_radius, (both - noise) * freedom_centre / stiffness)
    } else {
        // That there is none rests on no more than these.
        ((of_radius + of_centre) / (freedom_radius + freedom_centre), freedom_vibration, 0.0)
    };
    // What a unit of each does to the parameters.
    let by_noise = bread.diagonal().component_mul(free);
    let mut by_vibration = Vector5::zeros();
    for profile in profiles.iter().filter(|profile| profile.weight > 0.0) {
        let effect = bread * profile.normal.fixed_columns::<2>(SECTION);
        by_vibration += effect.component_mul(&effect).column_sum().component_mul(free);
    }
    let (of_noise, of_vibration) = (by_noise * noise, by_vibration * vibration);
    // Satterthwaite's.
    let freedom = of_noise.zip_map(&of_vibration, |of_noise, of_vibration| {
        let squared = of_noise.powi(2) / freedom_noise + of_vibration.powi(2) / freedom_vibration;
        let freedom = if squared > 0.0 { (of_noise + of_vibration).powi(2) / squared } else { freedom_vibration };
        freedom.max(1.0)
    });
    let variances =
        (of_noise + of_vibration).zip_map(&freedom, |variance, freedom| variance * widening(freedom).powi(2));
    Some((variances, freedom))
}

/// What one profile is off by, in its own section.
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

/// How much wider than the normal distribution's both the interval of two standard uncertainties and that of five have to be.
fn widening(freedom: f64) -> f64 {
    let freedom = freedom.max(FREEDOM_MIN);
    coverage_ratio(freedom, TWO_SIGMA).max(coverage_ratio(freedom, FAR) * FAR / FAR_MAX)
}
