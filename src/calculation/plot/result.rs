//! The result of a measurement in words: every number with its expanded uncertainty, rounded to that. In the coordinates of the
//! scan, whatever frame a picture uses.

use super::ticks::fixed;
use crate::estimation::{COVERAGE_FACTOR, EndFace, OnRail, Pose, RadiusSource};

/// Most decimals of a number, and what an uncertainty is at least to be written with its digits.
const DECIMALS_MAX: i32 = 6;
const LEAST: f64 = 1e-6;
/// Decimals of a number without an uncertainty.
const DECIMALS: usize = 4;

/// The numbers of a pose, one after the other.
pub(super) fn result(pose: &Pose) -> Vec<String> {
    let mut words = match pose.on_rail() {
        Some(found) => line(pose, &found),
        None => axis(pose),
    };
    let source = match pose.radius_source {
        RadiusSource::Fitted => "",
        RadiusSource::Nominal => " (nominal)",
        RadiusSource::Prior => " (fitted with a prior)",
    };
    words.push(format!("radius{source} {}", radius(pose)));
    words.extend(end_faces(pose).into_iter().map(|(name, face)| format!("{name} at x = {}", x_of(&face))));
    words
}

/// The radius with its uncertainty.
pub(super) fn radius(pose: &Pose) -> String {
    let [.., [_, _, _, _, variance]] = pose.uncertainty.covariance;
    quantity(pose.radius, variance.sqrt(), "mm")
}

/// The x of an end face with its uncertainty.
pub(super) fn x_of(face: &EndFace) -> String {
    let [x, ..] = face.centre;
    quantity(x, face.x_standard, "mm")
}

/// The end faces that were found, by name.
pub(super) fn end_faces(pose: &Pose) -> Vec<(&'static str, EndFace)> {
    let faces = [("near end face", pose.end_faces.near), ("far end face", pose.end_faces.far)];
    let faces = faces.into_iter().filter_map(|(name, face)| Some((name, face?)));
    faces.filter(|(_, face)| face.centre.iter().all(|v| v.is_finite())).collect()
}

/// What the numbers behind ± are.
pub(super) fn about_uncertainty(pose: &Pose) -> String {
    let scope = if pose.uncertainty.includes_calibration() {
        "of repeatability and calibration"
    } else {
        "of the repeatability alone: the calibration is not stated (type_b)"
    };
    format!("±: expanded uncertainty U = k·u with k = {COVERAGE_FACTOR} (about 95 %), {scope}")
}

/// Of an axis near X: its slopes, and where it meets x = 0.
fn line(pose: &Pose, found: &OnRail) -> Vec<String> {
    let OnRail { axis, x_ref, uncertainty } = found;
    let [[deflection, ..], [_, pitch, ..], ..] = uncertainty.covariance;
    let on_rail = Pose { axis: *axis, x_ref: *x_ref, uncertainty: uncertainty.clone(), ..pose.clone() };
    let [y, z] = on_rail.standard_at_origin();
    let angle = |angle: f64, variance: f64| quantity(angle, variance.sqrt().to_degrees(), "°");
    vec![
        format!("deflection {}", angle(axis.deflection().degrees(), deflection)),
        format!("pitch {}", angle(axis.pitch().degrees(), pitch)),
        format!("y at x = 0: {}", quantity(axis.y0, y, "mm")),
        format!("z at x = 0: {}", quantity(axis.z0, z, "mm")),
    ]
}

/// Of an axis in any direction: a point of it, and its direction.
fn axis(pose: &Pose) -> Vec<String> {
    let axis = pose.axis_in_scan();
    let [direction, position] = pose.axis_standard();
    let listed = |values: [f64; 3], decimals: usize| values.map(|value| fixed(value, decimals)).join(", ");
    let expanded = |standard: f64, unit: &str| {
        let half_width = COVERAGE_FACTOR * standard;
        decimals_of(half_width).map_or_else(String::new, |decimals| format!(" ± {}{unit}", fixed(half_width, decimals)))
    };
    let decimals = decimals_of(COVERAGE_FACTOR * position).unwrap_or(DECIMALS);
    vec![
        format!(
            "axis through ({}) mm{} perpendicular to it",
            listed(axis.point_mm, decimals),
            expanded(position, " mm")
        ),
        format!("direction ({}){}", listed(axis.direction, 6), expanded(direction.to_degrees(), "°")),
    ]
}

/// `value ± U` with its unit, both rounded to two digits of U (JCGM 100, 7.2.6); the value alone where there is no
/// uncertainty.
fn quantity(value: f64, standard: f64, unit: &str) -> String {
    let space = if unit == "°" { "" } else { " " };
    let half_width = COVERAGE_FACTOR * standard;
    match decimals_of(half_width) {
        Some(decimals) if half_width < LEAST => {
            format!("{}{space}{unit} (U < {LEAST:.6}{space}{unit})", fixed(value, decimals))
        }
        Some(decimals) => format!("({} ± {}){space}{unit}", fixed(value, decimals), fixed(half_width, decimals)),
        None => format!("{}{space}{unit}", fixed(value, DECIMALS)),
    }
}

/// Decimals that show two digits of an uncertainty; `None` where it is none.
fn decimals_of(half_width: f64) -> Option<usize> {
    if !(half_width.is_finite() && half_width > 0.0) {
        return None;
    }
    let places = |value: f64| 1 - value.log10().floor() as i32;
    let decimals = places(half_width).clamp(0, DECIMALS_MAX);
    // 0.0997 is written 0.10.
    let step = 10f64.powi(-decimals);
    let rounded = ((half_width / step).round() * step * (1.0 + 1e-9)).max(step);
    usize::try_from(places(rounded).clamp(0, decimals)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_to_two_digits_of_their_uncertainty() {
        assert_eq!(quantity(200.001_234, 0.000_62, "mm"), "(200.0012 ± 0.0012) mm");
        assert_eq!(quantity(-0.357_458, 0.000_08, "°"), "(−0.35746 ± 0.00016)°");
        assert_eq!(quantity(12.345, 0.049_85, "mm"), "(12.35 ± 0.10) mm");
        assert_eq!(quantity(1234.6, 63.0, "mm"), "(1235 ± 126) mm");
        assert_eq!(quantity(1.0, 1e-9, "mm"), "1.000000 mm (U < 0.000001 mm)");
        assert_eq!([0.0, f64::NAN].map(|none| quantity(1.0, none, "mm")), ["1.0000 mm", "1.0000 mm"]);
    }
}
