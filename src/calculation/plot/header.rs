//! The text above every picture: its content and subject; date and method of the measurement; the result with its uncertainty, or
//! the reason why there is none; and a line about the picture itself.
//!
//! The result is stated in the coordinates of the scan, whatever frame a picture uses, and every number is rounded to its expanded
//! uncertainty. Text is wrapped into lines.

use super::about_axis::names;
use super::palette::{EXCLUDED, FAINT_INK};
use super::scale::fixed;
use super::svg::{Area, Svg, Type, WIDTH};
use crate::estimation::{COVERAGE_FACTOR, EndFace, Estimate, Method, OnRail, Outcome, Pose, RadiusSource};
use jiff::Timestamp;

/// The subject of a picture besides the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Subject<'a> {
    /// The measured object, e.g. the id of the measurement or the name of the file; any text.
    pub title: &'a str,
    /// Time of the measurement, if known.
    pub measured_at: Option<Timestamp>,
    /// Name of the recipe, if there is one.
    pub recipe: Option<&'a str>,
    /// The software that measured, if known.
    pub software: Option<&'a str>,
    /// The setting `epsilon_mm` of the estimation.
    pub epsilon_mm: f64,
    /// Index in the scan of the profile for the picture `section`; `None` takes the valid one nearest to the middle, or the middle
    /// one if none is valid.
    pub profile: Option<usize>,
    /// Number of the first profile of the scan in results; 0 except for a part of a scan.
    pub first_profile: usize,
}

/// Upper edge of the picture below the text, pixels.
pub(super) const BODY_TOP: f64 = 140.0;

const ROOM: f64 = WIDTH - 2.0 * MARGIN;
const LINE: f64 = 16.0;
/// Largest number of lines of the result or of the refusal, with remarks about them, and of lines about the picture.
const LINES_MAX: usize = 3;
const CAPTION_LINES_MAX: usize = 2;
const SMALL: Type = Type::sized(12.0);
const BETWEEN: &str = " · ";

/// Opens a page with its text.
pub(super) fn page(what: &str, caption: &str, estimate: &Estimate, subject: &Subject<'_>) -> Svg {
    let heading = format!("{what}{BETWEEN}{}", subject.title);
    let (lines, colour) = match &estimate.outcome {
        Outcome::Accepted(pose) => {
            let mut lines = in_lines(SMALL, result(pose).iter().map(String::as_str), BETWEEN, ROOM, LINES_MAX - 1);
            lines.push(about_uncertainty(pose));
            (lines, SMALL.colour)
        }
        Outcome::Refused(refusal) => {
            let words = format!("Refused ({}): {refusal}.", refusal.code());
            (in_lines(SMALL, words.split_whitespace(), " ", ROOM, LINES_MAX), EXCLUDED)
        }
    };
    let caption = match names(estimate).remark {
        Some(remark) => format!("{caption}{BETWEEN}{remark}"),
        None => caption.to_owned(),
    };
    let origin = origin(estimate, subject).join(BETWEEN);
    let mut svg = Svg::new(&heading, &format!("{what}. {origin}. {} {caption}", lines.join(" ")));
    let large = Type::sized(16.0).bold();
    svg.text([MARGIN, 27.0], large, &large.fitted(&heading, ROOM));
    let faint = SMALL.colour(FAINT_INK);
    svg.text([MARGIN, 46.0], faint, &faint.fitted(&origin, ROOM));
    let mut y = 46.0 + LINE;
    for line in &lines {
        svg.text([MARGIN, y], SMALL.colour(colour), &SMALL.fitted(line, ROOM));
        y += LINE;
    }
    for line in in_lines(faint, caption.split(BETWEEN), BETWEEN, ROOM, CAPTION_LINES_MAX) {
        svg.text([MARGIN, y], faint, &faint.fitted(&line, ROOM));
        y += LINE;
    }
    svg
}

/// Date and method of the measurement, as far as known.
fn origin(estimate: &Estimate, subject: &Subject<'_>) -> Vec<String> {
    let mut words = Vec::new();
    words.extend(subject.measured_at.map(|at| format!("measured {}", at.strftime("%Y-%m-%d %H:%M:%S UTC"))));
    words.extend(subject.recipe.map(|recipe| format!("recipe {recipe}")));
    words.push(format!("method {}", estimate.method.name()));
    // `least_squares` gives no verdicts on profiles.
    if !estimate.profiles.is_empty() && estimate.method != Method::LeastSquares {
        let valid_count = estimate.profiles.iter().filter(|profile| profile.rejected.is_none()).count();
        words.push(format!("{valid_count} of {} profiles valid", estimate.profiles.len()));
    }
    words.extend(subject.software.map(str::to_owned));
    words
}

/// Left and right margin of the text, pixels.
pub(super) const MARGIN: f64 = 24.0;

/// Writes `text` into `area` in as many lines as needed; returns the lower edge of the last one.
pub(super) fn paragraph(svg: &mut Svg, area: Area, look: Type, text: &str) -> f64 {
    let mut y = area.top + look.size;
    for line in in_lines(look, text.split_whitespace(), " ", area.width, usize::MAX) {
        svg.text([area.left, y], look, &line);
        y += 1.45 * look.size;
    }
    y
}

/// Divides text into lines of this width; text that does not fit into `most` lines is cut off with an ellipsis.
pub(super) fn in_lines<'a>(
    look: Type,
    pieces: impl Iterator<Item = &'a str>,
    between: &str,
    width: f64,
    most: usize,
) -> Vec<String> {
    let mut lines = Vec::new();
    let mut line = String::new();
    for piece in pieces {
        let longer = if line.is_empty() { piece.to_owned() } else { format!("{line}{between}{piece}") };
        if look.width_of(&longer) <= width || line.is_empty() {
            line = longer;
        } else {
            lines.push(std::mem::replace(&mut line, piece.to_owned()));
        }
    }
    lines.push(line);
    if lines.len() > most {
        lines.truncate(most);
        if let Some(last) = lines.last_mut() {
            last.push_str(" …");
        }
    }
    lines
}

/// Largest number of decimals, and the least uncertainty that is written with its digits.
const DECIMALS_MAX: i32 = 6;
const LEAST: f64 = 1e-6;
/// Decimals of a number without an uncertainty.
const DECIMALS: usize = 4;

/// The numbers of a pose.
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

/// The meaning of the numbers after ±.
pub(super) fn about_uncertainty(pose: &Pose) -> String {
    let scope = if pose.uncertainty.includes_calibration() {
        "of repeatability and calibration"
    } else {
        "of the repeatability alone: the calibration is not stated (type_b)"
    };
    format!("±: expanded uncertainty U = k·u with k = {COVERAGE_FACTOR} (about 95 %), {scope}")
}

/// For an axis near X: its slopes, and its intersection with x = 0.
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

/// For an axis in any direction: a point of it, and its direction.
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

/// `value ± U` with its unit, both rounded to two digits of U (JCGM 100, 7.2.6); the value alone without an uncertainty.
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

/// Number of decimals for two digits of an uncertainty; `None` if the uncertainty is zero or invalid.
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
mod notice_tests {
    use super::*;

    #[test]
    fn text_is_wrapped_between_words_and_none_is_lost() {
        let look = Type::sized(12.0);
        let text = "only 2 of 120 profiles are valid, 3 are needed; see the profiles for each reason";
        let lines = |most| in_lines(look, text.split_whitespace(), " ", 200.0, most);
        let all = lines(usize::MAX);
        assert!(all.len() > 2 && all.iter().all(|line| look.width_of(line) <= 200.0));
        assert_eq!(all.join(" "), text);
        assert_eq!(lines(1), [format!("{} …", all[0])]);
    }
}

#[cfg(test)]
mod result_tests {
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
