//! A measurement for a PLC: one flat object of integers, below 1024 bytes, fixed keys in a fixed order. Angles in 10⁻⁶
//! degrees (`_udeg`), lengths in 10⁻⁶ metres (`_um`); null for unknown values, for a value of more than nine digits (1 km,
//! 1000°) and for an uncertainty of more than eight. The tables of the codes are in docs/plc.md.

use super::document::{PoseDocument, pose};
use super::uncertainty::{ScopeDocument, UncertaintyDocument};
use crate::estimation::{Refusal, Warning};
use crate::service::{Chosen, Measurement};
use serde::Serialize;
use utoipa::ToSchema;

/// Nine digits fit the signed 32-bit word into which a PLC reads the value, and keep the longest view below 1024 bytes.
const VALUE_MAX: i32 = 999_999_999;
/// 100 m or 100°: a greater uncertainty is useless.
const UNCERTAINTY_MAX: i32 = 99_999_999;

/// A measurement as integers; of several parts one of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = PlcMeasurement)]
pub(in crate::http) struct PlcDocument {
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
    /// Expanded uncertainty (k = 2) of y where the axis meets x = 0, micrometres, rounded up as all that follow.
    u_y_c0_um: Option<i64>,
    /// Of z there.
    u_z_c0_um: Option<i64>,
    /// Of the radius.
    u_radius_um: Option<i64>,
    /// One bit for each kind of warning, see docs/plc.md: 1 short_arc, 2 radius_differs, 4 on_some_profiles,
    /// 8 missing_values, 16 repeated_profiles, 32 axis_not_along_rail, 64 concave_towards_sensor, 128 tapered, 256 bent,
    /// 512 not_robust, 1024 calibration_not_stated, 2048 end_face_not_seen.
    warnings_mask: u32,
    /// The end face whose x is `end_face_x_um`: where the axis meets it, micrometres.
    end_face_y_um: Option<i64>,
    /// The same.
    end_face_z_um: Option<i64>,
    /// Expanded uncertainty of `end_face_x_um`.
    u_end_face_x_um: Option<i64>,
    /// Where the axis meets the far end face where both were asked for, micrometres.
    far_end_face_x_um: Option<i64>,
    /// The same.
    far_end_face_y_um: Option<i64>,
    /// The same.
    far_end_face_z_um: Option<i64>,
    /// Expanded uncertainty of `far_end_face_x_um`.
    u_far_end_face_x_um: Option<i64>,
}

impl PlcDocument {
    /// The selected part, or the complete scan if there are no parts.
    pub(in crate::http) fn new(measurement: &Measurement, chosen: Chosen<'_>) -> Self {
        let (finding, tally, part) = match chosen {
            Chosen::Whole(finding) => (Some(finding), &measurement.counts, 1),
            Chosen::Part(part, number) => (Some(&part.finding), &part.counts, number),
            Chosen::None(_) => (None, &measurement.counts, 0),
        };
        let refusal = match chosen {
            Chosen::None(refusal) => Some(refusal),
            Chosen::Whole(_) | Chosen::Part(..) => finding.and_then(|finding| finding.refusal()),
        };
        let pose = finding.and_then(pose);
        let uncertainty = pose.map(UncertaintyDocument::from);
        let known = uncertainty.as_ref().map(|uncertainty| uncertainty.expanded);
        let pose = pose.map(PoseDocument::from);
        let end_face = pose.as_ref().and_then(|pose| pose.end_face);
        let far_end_face = pose.as_ref().and_then(|pose| pose.far_end_face);
        let (micro, um) = (|value: f64| whole(value * 1e6, VALUE_MAX), |value: f64| whole(value * 1e3, VALUE_MAX));
        // Rounded up, so that no uncertainty becomes zero.
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
            end_face_x_um: end_face.and_then(|face| um(face.x_mm)),
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
            parts_count: wide(measurement.result.parts().map_or(1, <[_]>::len)),
            u_y_c0_um: known.and_then(|known| up_um(known.y_c0_mm?)),
            u_z_c0_um: known.and_then(|known| up_um(known.z_c0_mm?)),
            u_radius_um: known.and_then(|known| up_um(known.radius_mm)),
            warnings_mask: finding.map_or(0, |finding| mask_of(&finding.conditioning.warnings)),
            end_face_y_um: end_face.and_then(|face| um(face.y_mm)),
            end_face_z_um: end_face.and_then(|face| um(face.z_mm)),
            u_end_face_x_um: known.and_then(|known| up_um(known.end_face_x_mm?)),
            far_end_face_x_um: far_end_face.and_then(|face| um(face.x_mm)),
            far_end_face_y_um: far_end_face.and_then(|face| um(face.y_mm)),
            far_end_face_z_um: far_end_face.and_then(|face| um(face.z_mm)),
            u_far_end_face_x_um: known.and_then(|known| up_um(known.far_end_face_x_mm?)),
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

/// The bits of all kinds of warnings.
fn mask_of(warnings: &[Warning]) -> u32 {
    warnings.iter().map(|warning| 1 << bit_of(warning)).fold(0, |mask, bit: u32| mask | bit)
}

/// Bits are never reassigned, because PLC programs contain them.
const fn bit_of(warning: &Warning) -> u8 {
    match warning {
        Warning::ShortArc { .. } => 0,
        Warning::RadiusDiffers { .. } => 1,
        Warning::OnSomeProfiles { .. } => 2,
        Warning::MissingValues { .. } => 3,
        Warning::RepeatedProfiles { .. } => 4,
        Warning::AxisNotAlongRail { .. } => 5,
        Warning::ConcaveTowardsSensor => 6,
        Warning::Tapered { .. } => 7,
        Warning::Bent { .. } => 8,
        Warning::NotRobust => 9,
        Warning::CalibrationNotStated => 10,
        Warning::EndFaceNotSeen { .. } => 11,
    }
}

/// The nearest integer; `None` if it is greater than `most`.
fn whole(value: f64, most: i32) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked against an i32 in the same line")]
    (rounded.abs() <= f64::from(most)).then_some(rounded as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::End;

    #[test]
    fn the_longest_view_stays_below_1024_bytes() {
        let (length, uncertainty) = (Some(-i64::from(VALUE_MAX)), Some(i64::from(UNCERTAINTY_MAX)));
        // If the axis is at a larger angle to X, the slopes are null.
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
            u_y_c0_um: uncertainty,
            u_z_c0_um: uncertainty,
            u_radius_um: uncertainty,
            warnings_mask: u32::MAX,
            end_face_y_um: length,
            end_face_z_um: length,
            u_end_face_x_um: uncertainty,
            far_end_face_x_um: length,
            far_end_face_y_um: length,
            far_end_face_z_um: length,
            u_far_end_face_x_um: uncertainty,
        };
        let bytes_count = serde_json::to_vec(&view).expect("JSON").len();
        assert!(bytes_count < 1024, "{bytes_count}");
    }

    #[test]
    fn a_value_of_too_many_digits_is_null_not_truncated() {
        assert_eq!(whole(-1.5, VALUE_MAX), Some(-2));
        assert_eq!(whole(999_999_999.4, VALUE_MAX), Some(999_999_999));
        assert_eq!(whole(999_999_999.5, VALUE_MAX), None);
        assert_eq!(whole(f64::NAN, VALUE_MAX), None);
    }

    #[test]
    fn each_kind_of_warning_has_its_own_bit() {
        let arc = Warning::ShortArc { arc_deg: 90.0 };
        let not_seen = Warning::EndFaceNotSeen { end: End::Near };
        assert_eq!(mask_of(&[]), 0);
        assert_eq!(mask_of(&[arc, Warning::NotRobust, Warning::NotRobust, not_seen]), 1 + 512 + 2048);
    }

    #[test]
    fn the_tables_of_the_documentation_match_the_view() {
        let page = include_str!("../../../../docs/plc.md");
        let field = |name: &str| {
            let document = crate::http::openapi_json().expect("a document");
            let document: serde_json::Value = serde_json::from_str(&document).expect("JSON");
            let pointer = format!("/components/schemas/PlcMeasurement/properties/{name}/description");
            document.pointer(&pointer).and_then(serde_json::Value::as_str).expect("described").to_owned()
        };
        for name in ["refusal_code", "warnings_mask"] {
            let text = field(name);
            let mut words = text.split_whitespace().peekable();
            while let Some(word) = words.next() {
                let Ok(number) = word.parse::<u32>() else { continue };
                let code = words.peek().expect("a name").trim_end_matches([',', '.', ':']);
                assert!(page.contains(&format!("| {number} | `{code}` |")), "{name}: {number} {code}");
            }
        }
    }
}
