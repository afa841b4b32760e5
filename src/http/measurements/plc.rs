//! A measurement for a PLC: one flat object of integers, below 512 bytes, fixed keys in a fixed order. Angles in 10⁻⁶
//! degrees (`_udeg`), lengths in 10⁻⁶ metres (`_um`); null for what is not known, for a value of more than nine digits (1 km,
//! 1000°) and for an uncertainty of more than eight.

use super::document::PoseDocument;
use super::parts::pose;
use super::uncertainty::{ScopeDocument, UncertaintyDocument};
use crate::estimation::Refusal;
use crate::service::{Chosen, Measurement};
use serde::Serialize;
use utoipa::ToSchema;

/// Nine digits fit the signed 32-bit word that a PLC reads the value into, and keep the longest view below 512 bytes.
const VALUE_MAX: i32 = 999_999_999;
/// 100 m or 100°: an uncertainty beyond this is as good as none.
const UNCERTAINTY_MAX: i32 = 99_999_999;

/// A measurement as integers; of several parts one of them.
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
    /// 10 sections_not_round, 11 parts_count_differs, 12 window_empty, 13 layers_undecided, 14 profiles_not_planar,
    /// 15 points_undetermined, 16 several_cylinders, 17 axis_not_along_rail, 18 travel_missing.
    #[schema(minimum = 0, maximum = 18)]
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
    /// Where the axis meets the end face (the near one where both were asked for), micrometres.
    end_face_x_um: Option<i64>,
    /// Expanded uncertainty (k = 2) of the deflection, 10⁻⁶ degrees, rounded up.
    u_deflection_udeg: Option<i64>,
    /// Of the pitch.
    u_pitch_udeg: Option<i64>,
    /// At the reference point, micrometres.
    u_y_ref_um: Option<i64>,
    /// At the reference point, micrometres.
    u_z_ref_um: Option<i64>,
    /// What the uncertainties include: 1 the repeatability alone, since no calibration is stated (`type_b`), 2 both.
    #[schema(minimum = 1, maximum = 2)]
    u_scope_code: Option<u8>,
    /// Profiles that passed.
    profiles_valid_count: u64,
    /// All profiles.
    profiles_total_count: u64,
    /// Number of the part that is shown, from 1; 0 where the scan was refused before it had parts.
    part: u64,
    /// How many parts there are to be shown.
    parts_count: u64,
}

impl PlcDocument {
    /// The part that was chosen, or all of the scan where there are none.
    pub(super) fn new(measurement: &Measurement, chosen: Chosen<'_>) -> Self {
        let (finding, tally, part) = match chosen {
            Chosen::Whole(finding) => (Some(finding), &measurement.tally, 1),
            Chosen::Part(part, number) => (Some(&part.finding), &part.tally, number),
            Chosen::None(_) => (None, &measurement.tally, 0),
        };
        let refusal = match chosen {
            Chosen::None(refusal) => Some(refusal),
            Chosen::Whole(_) | Chosen::Part(..) => finding.and_then(|finding| finding.refusal()),
        };
        let pose = finding.and_then(pose);
        let uncertainty = pose.map(UncertaintyDocument::from);
        let known = uncertainty.as_ref().map(|uncertainty| uncertainty.expanded);
        let pose = pose.map(PoseDocument::from);
        let (micro, um) = (|value: f64| whole(value * 1e6, VALUE_MAX), |value: f64| whole(value * 1e3, VALUE_MAX));
        // Rounded up, so that no uncertainty becomes none.
        let up_micro = |value: f64| whole((value * 1e6).ceil(), UNCERTAINTY_MAX);
        let up_um = |value: f64| whole((value * 1e3).ceil(), UNCERTAINTY_MAX);
        let wide = |count: usize| u64::try_from(count).unwrap_or(u64::MAX);
        Self {
            id: measurement.id.clone(),
            verdict_code: if refusal.is_none() { 1 } else { 2 },
            refusal_code: refusal.map_or(0, number_of),
            warnings_count: finding.map_or(0, |finding| wide(finding.conditioning.warnings.len())),
            deflection_udeg: pose.as_ref().and_then(|pose| micro(pose.deflection_deg?)),
            pitch_udeg: pose.as_ref().and_then(|pose| micro(pose.pitch_deg?)),
            y_c0_um: pose.as_ref().and_then(|pose| um(pose.y_c0_mm?)),
            z_c0_um: pose.as_ref().and_then(|pose| um(pose.z_c0_mm?)),
            x_ref_um: pose.as_ref().and_then(|pose| um(pose.x_ref_mm?)),
            y_ref_um: pose.as_ref().and_then(|pose| um(pose.y_ref_mm?)),
            z_ref_um: pose.as_ref().and_then(|pose| um(pose.z_ref_mm?)),
            radius_um: pose.as_ref().and_then(|pose| um(pose.radius_mm)),
            end_face_x_um: pose.as_ref().and_then(|pose| um(pose.end_face?.x_mm)),
            u_deflection_udeg: known.and_then(|known| up_micro(known.deflection_deg?)),
            u_pitch_udeg: known.and_then(|known| up_micro(known.pitch_deg?)),
            u_y_ref_um: known.and_then(|known| up_um(known.y_ref_mm?)),
            u_z_ref_um: known.and_then(|known| up_um(known.z_ref_mm?)),
            u_scope_code: uncertainty.map(|uncertainty| match uncertainty.scope {
                ScopeDocument::Repeatability => 1,
                ScopeDocument::Combined => 2,
            }),
            profiles_valid_count: tally.valid_count,
            profiles_total_count: tally.total_count,
            part: wide(part),
            parts_count: wide(measurement.findings.parts().map_or(1, <[_]>::len)),
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
        Refusal::PoseUndetermined { .. } => 9,
        Refusal::SectionsNotRound { .. } => 10,
        Refusal::PartsCountDiffers { .. } => 11,
        Refusal::WindowEmpty { .. } => 12,
        Refusal::LayersUndecided { .. } => 13,
        Refusal::ProfilesNotPlanar { .. } => 14,
        Refusal::PointsUndetermined { .. } => 15,
        Refusal::SeveralCylinders { .. } => 16,
        Refusal::AxisNotAlongRail { .. } => 17,
        Refusal::TravelMissing { .. } => 18,
    }
}

/// The nearest integer; `None` beyond `most`.
fn whole(value: f64, most: i32) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked against an i32 in the same line")]
    (rounded.abs() <= f64::from(most)).then_some(rounded as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_view_stays_below_512_bytes() {
        let (length, uncertainty) = (Some(-i64::from(VALUE_MAX)), Some(i64::from(UNCERTAINTY_MAX)));
        // Where the axis lies farther from X the slopes are null.
        let angle = Some(-60_000_000);
        let view = PlcDocument {
            id: "m-0199f0c8-0000-7000-8000-000000000000".to_owned(),
            verdict_code: 1,
            refusal_code: 0,
            warnings_count: 20,
            deflection_udeg: angle,
            pitch_udeg: angle,
            y_c0_um: length,
            z_c0_um: length,
            x_ref_um: length,
            y_ref_um: length,
            z_ref_um: length,
            radius_um: Some(i64::from(VALUE_MAX)),
            end_face_x_um: length,
            u_deflection_udeg: uncertainty,
            u_pitch_udeg: uncertainty,
            u_y_ref_um: uncertainty,
            u_z_ref_um: uncertainty,
            u_scope_code: Some(2),
            profiles_valid_count: 100_000,
            profiles_total_count: 100_000,
            part: 16,
            parts_count: 16,
        };
        let bytes_count = serde_json::to_vec(&view).expect("JSON").len();
        assert!(bytes_count < 512, "{bytes_count}");
    }

    #[test]
    fn a_value_of_too_many_digits_is_unknown_not_cut() {
        assert_eq!(whole(-1.5, VALUE_MAX), Some(-2));
        assert_eq!(whole(999_999_999.4, VALUE_MAX), Some(999_999_999));
        assert_eq!(whole(999_999_999.5, VALUE_MAX), None);
        assert_eq!(whole(f64::NAN, VALUE_MAX), None);
    }
}
