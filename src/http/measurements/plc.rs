//! A measurement for a PLC: one flat object of integers, below 512 bytes, fixed keys in a fixed order. Angles in 10⁻⁶
//! degrees (`_udeg`), lengths in 10⁻⁶ metres (`_um`); null for what is not known. Must not know how it was made.

use super::document::MeasurementDocument;
use crate::estimation::{Outcome, Refusal};
use crate::service::{Measurement, Verdict};
use serde::Serialize;
use utoipa::ToSchema;

/// A measurement as integers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = PlcMeasurement)]
pub(in super::super) struct PlcDocument {
    /// Id of the measurement.
    id: String,
    /// 1 accepted, 2 refused.
    #[schema(minimum = 1, maximum = 2)]
    verdict_code: u8,
    /// 0 none, 1 too_few_profiles, 2 points_identical, 3 points_collinear, 4 too_few_valid_profiles,
    /// 5 axial_length_too_short, 6 sections_disagree, 7 no_cylinder, 8 two_cylinders, 9 pose_undetermined,
    /// 10 sections_not_round, 11 layers_undecided.
    #[schema(minimum = 0, maximum = 11)]
    refusal_code: u8,
    /// Warnings; read the whole document where there are any.
    warnings_count: u64,
    /// Rotation towards +Y, 10⁻⁶ degrees.
    deflection_udeg: Option<i64>,
    /// Rotation towards +Z, 10⁻⁶ degrees.
    pitch_udeg: Option<i64>,
    /// Where the axis meets x = 0, micrometres.
    y_c0_um: Option<i64>,
    /// Where the axis meets x = 0, micrometres.
    z_c0_um: Option<i64>,
    /// Mean x of what was used (valid profiles, or points on the part), micrometres.
    x_ref_um: Option<i64>,
    /// The axis there, micrometres.
    y_ref_um: Option<i64>,
    /// The axis there, micrometres.
    z_ref_um: Option<i64>,
    /// Radius, micrometres.
    radius_um: Option<i64>,
    /// Expanded uncertainty (k = 2) of the deflection, 10⁻⁶ degrees.
    u_deflection_udeg: Option<i64>,
    /// Of the pitch.
    u_pitch_udeg: Option<i64>,
    /// At the reference point, micrometres.
    u_y_ref_um: Option<i64>,
    /// At the reference point, micrometres.
    u_z_ref_um: Option<i64>,
    /// Profiles that passed.
    profiles_valid_count: u64,
    /// All profiles.
    profiles_total_count: u64,
}

impl From<&Measurement> for PlcDocument {
    fn from(measurement: &Measurement) -> Self {
        let document = MeasurementDocument::from(measurement);
        let (pose, known) = (document.pose.as_ref(), document.uncertainty.as_ref().map(|u| u.expanded));
        let micro = |value: f64| whole(value * 1e6);
        let um = |value: f64| whole(value * 1e3);
        Self {
            verdict_code: match measurement.verdict() {
                Verdict::Accepted => 1,
                Verdict::Refused => 2,
            },
            refusal_code: match &measurement.outcome {
                Outcome::Accepted(_) => 0,
                Outcome::Refused(refusal) => number_of(refusal),
            },
            warnings_count: u64::try_from(document.conditioning.warnings.len()).unwrap_or(u64::MAX),
            deflection_udeg: pose.and_then(|pose| micro(pose.deflection_deg)),
            pitch_udeg: pose.and_then(|pose| micro(pose.pitch_deg)),
            y_c0_um: pose.and_then(|pose| um(pose.y_c0_mm)),
            z_c0_um: pose.and_then(|pose| um(pose.z_c0_mm)),
            x_ref_um: pose.and_then(|pose| um(pose.x_ref_mm)),
            y_ref_um: pose.and_then(|pose| um(pose.y_ref_mm)),
            z_ref_um: pose.and_then(|pose| um(pose.z_ref_mm)),
            radius_um: pose.and_then(|pose| um(pose.radius_mm)),
            u_deflection_udeg: known.and_then(|known| micro(known.deflection_deg)),
            u_pitch_udeg: known.and_then(|known| micro(known.pitch_deg)),
            u_y_ref_um: known.and_then(|known| um(known.y_ref_mm)),
            u_z_ref_um: known.and_then(|known| um(known.z_ref_mm)),
            profiles_valid_count: document.profiles.valid_count,
            profiles_total_count: document.profiles.total_count,
            id: document.id,
        }
    }
}

const fn number_of(refusal: &Refusal) -> u8 {
    match refusal {
        Refusal::TooFewProfiles { .. } => 1,
        Refusal::PointsIdentical { .. } => 2,
        Refusal::PointsCollinear { .. } => 3,
        Refusal::TooFewValidProfiles { .. } => 4,
        Refusal::AxialLengthTooShort { .. } => 5,
        Refusal::SectionsDisagree { .. } => 6,
        Refusal::NoCylinder { .. } => 7,
        Refusal::TwoCylinders { .. } => 8,
        Refusal::LayersUndecided { .. } => 11,
        Refusal::PoseUndetermined { .. } => 9,
        Refusal::SectionsNotRound { .. } => 10,
    }
}

/// The nearest integer; `None` beyond what a 32-bit word holds, which is what a PLC reads it into.
fn whole(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked against the range of i32 in the same line")]
    (rounded.abs() <= f64::from(i32::MAX)).then_some(rounded as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_no_word_holds_is_unknown_not_cut() {
        assert_eq!(whole(-1.5), Some(-2));
        assert_eq!(whole(f64::from(i32::MAX)), Some(i64::from(i32::MAX)));
        assert_eq!(whole(f64::from(i32::MAX) + 1.0), None);
        assert_eq!(whole(f64::NAN), None);
    }
}
