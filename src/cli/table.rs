//! A measurement as a table for a person at a terminal.

use crate::http::{
    MeasurementDocument, PoseDocument, ReasonDocument, ScopeDocument, TallyDocument, UncertaintyDocument, VerdictName,
};
use std::fmt::Write;

/// The table of one measurement.
pub(super) fn table(name: &str, document: &MeasurementDocument) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_table(&mut text, name, document);
    text
}

fn write_table(text: &mut String, name: &str, document: &MeasurementDocument) -> std::fmt::Result {
    let verdict = verdict_in_words(document.verdict);
    writeln!(text, "{name}: {verdict} ({}, {} ms)", document.method, document.duration_ms)?;
    let parts = document.parts.as_deref().unwrap_or_default();
    for part in parts {
        let verdict = verdict_in_words(part.verdict);
        writeln!(text, "  part {} from x = {} mm to {} mm: {verdict}", part.name, part.x_min_mm, part.x_max_mm)?;
        write_pose(text, part.pose.as_ref().zip(part.uncertainty.as_ref()))?;
        write_profiles(text, &part.profiles)?;
        write_reasons(text, part.refusal.as_ref(), &part.conditioning.warnings)?;
    }
    if parts.is_empty() {
        write_pose(text, document.pose.as_ref().zip(document.uncertainty.as_ref()))?;
        write_profiles(text, &document.profiles)?;
        let warnings = document.conditioning.as_ref().map(|conditioning| conditioning.warnings.as_slice());
        return write_reasons(text, document.refusal.as_ref(), warnings.unwrap_or_default());
    }
    let outside_count = document.profiles.rejected.get("outside_parts").copied().unwrap_or(0);
    writeln!(text, "  outside the parts: {outside_count} of {} profiles", document.profiles.total_count)
}

const fn verdict_in_words(verdict: VerdictName) -> &'static str {
    match verdict {
        VerdictName::Accepted => "accepted",
        VerdictName::Refused => "REFUSED",
    }
}

fn write_pose(text: &mut String, found: Option<(&PoseDocument, &UncertaintyDocument)>) -> std::fmt::Result {
    let Some((pose, uncertainty)) = found else { return Ok(()) };
    let expanded = &uncertainty.expanded;
    let rows = [
        ("deflection", pose.deflection_deg, expanded.deflection_deg, "°"),
        ("pitch", pose.pitch_deg, expanded.pitch_deg, "°"),
        ("y at x = 0", pose.y_c0_mm, expanded.y_c0_mm, "mm"),
        ("z at x = 0", pose.z_c0_mm, expanded.z_c0_mm, "mm"),
        ("y at x_ref", pose.y_ref_mm, expanded.y_ref_mm, "mm"),
        ("z at x_ref", pose.z_ref_mm, expanded.z_ref_mm, "mm"),
        ("radius", Some(pose.radius_mm), Some(expanded.radius_mm), "mm"),
    ];
    let [px, py, pz] = pose.axis.point_mm;
    let [dx, dy, dz] = pose.axis.direction;
    let (position, direction) = (expanded.axis_position_mm, expanded.axis_direction_deg);
    writeln!(text, "  axis         ({px:.4}, {py:.4}, {pz:.4}) mm ± {position:.4} mm square to it")?;
    writeln!(text, "  direction    ({dx:.6}, {dy:.6}, {dz:.6}) ± {direction:.4} °")?;
    for (quantity, value, half_width, unit) in rows {
        let (Some(value), Some(half_width)) = (value, half_width) else { continue };
        writeln!(text, "  {quantity:<12} {value:>12.4} ± {half_width:.4} {unit}")?;
    }
    let ends = [
        ("end face x", pose.end_face, expanded.end_face_x_mm),
        ("far end x", pose.far_end_face, expanded.far_end_face_x_mm),
    ];
    for (quantity, face, half_width) in ends {
        let (Some(face), Some(half_width)) = (face, half_width) else { continue };
        let (x, y, z) = (face.x_mm, face.y_mm, face.z_mm);
        writeln!(text, "  {quantity:<12} {x:>12.4} ± {half_width:.4} mm, there y {y:.4}, z {z:.4}")?;
    }
    let scope = match uncertainty.scope {
        ScopeDocument::Repeatability => " of the repeatability alone; calibration is not stated (type_b)",
        ScopeDocument::Combined => "",
    };
    if let Some(x_ref_mm) = pose.x_ref_mm {
        writeln!(text, "  x_ref        {x_ref_mm:>12.4} mm")?;
    }
    writeln!(text, "  ± is the expanded uncertainty, k = 2{scope}")
}

fn write_profiles(text: &mut String, counts: &TallyDocument) -> std::fmt::Result {
    let rejected: Vec<String> = counts.rejected.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    let rejected = if rejected.is_empty() { "none rejected".to_owned() } else { rejected.join(", ") };
    writeln!(text, "  profiles     {} of {} valid; {rejected}", counts.valid_count, counts.total_count)
}

fn write_reasons(text: &mut String, refusal: Option<&ReasonDocument>, warnings: &[ReasonDocument]) -> std::fmt::Result {
    let said = refusal.into_iter().map(|refusal| ("refused", refusal));
    for (kind, reason) in said.chain(warnings.iter().map(|warning| ("warning", warning))) {
        writeln!(text, "  {kind:<12} {}: {}", reason.code, reason.detail)?;
    }
    Ok(())
}
