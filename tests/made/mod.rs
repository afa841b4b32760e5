//! Shared by the tests on synthetic parts: the number of parts, and the errors of a result. The truth comes from the
//! generator of the parts, never from an estimate.

pub(crate) mod any_direction;
pub(crate) mod uploaded;

use coaxis::estimation::Pose;
use coaxis::scan::synthetic::Truth;

/// A count from the environment, or the default of continuous integration.
pub(crate) fn count(variable: &str, default: u64) -> u64 {
    std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Errors of (deflection, pitch, y, z, radius) at the plane `x`, radians and mm.
pub(crate) fn errors(pose: &Pose, truth: &Truth, x: f64) -> [f64; 5] {
    let [y, z] = pose.axis.at(x);
    let slope = |degrees: f64| degrees.to_radians().tan();
    [
        pose.axis.deflection().radians() - truth.deflection_deg.to_radians(),
        pose.axis.pitch().radians() - truth.pitch_deg.to_radians(),
        y - truth.y_c0_mm - slope(truth.deflection_deg) * x,
        z - truth.z_c0_mm - slope(truth.pitch_deg) * x,
        pose.radius - truth.radius_mm,
    ]
}

/// Standard uncertainties of (deflection, pitch, y_ref, z_ref, radius), radians and mm.
pub(crate) fn standard(pose: &Pose) -> [f64; 5] {
    let [[p, ..], [_, q, ..], [_, _, y, ..], [_, _, _, z, _], [.., radius]] = pose.uncertainty.covariance;
    [p, q, y, z, radius].map(|variance| variance.max(0.0).sqrt())
}
