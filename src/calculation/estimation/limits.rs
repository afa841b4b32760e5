//! What is known too badly to be a result: the complete uncertainty against what is allowed.

use super::estimate::Uncertainty;
use super::refusal::Refusal;
use super::settings::Settings;

/// Standard uncertainty of a position that is allowed where nobody says, relative to the radius: a hundredth is far more than
/// what a useful scan leaves open, whatever the size of the part.
const POSITION_SHARE: f64 = 0.01;

/// The refusal where the angles or the position at the reference point are known worse than is allowed.
pub(super) fn undetermined(uncertainty: &Uncertainty, radius: f64, settings: &Settings) -> Option<Refusal> {
    let [[deflection, ..], [_, pitch, ..], [_, _, y, ..], [_, _, _, z, _], _] = uncertainty.covariance;
    let (angle_deg, position_mm) = (deflection.max(pitch).sqrt().to_degrees(), y.max(z).sqrt());
    let angle_max_deg = settings.angle_uncertainty_max_deg;
    let position_max_mm = settings.position_uncertainty_max_mm.unwrap_or(POSITION_SHARE * radius);
    // Written so that NaN is undetermined, too.
    let is_known = angle_deg <= angle_max_deg && position_mm <= position_max_mm;
    (!is_known).then_some(Refusal::PoseUndetermined { angle_deg, angle_max_deg, position_mm, position_max_mm })
}
