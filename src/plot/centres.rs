//! The picture of the centres: where each profile's centre lies along x with the fitted axis (above), and how far it
//! lies from the axis (below), in y and in z. Must not know the points of the scan.
//!
//! A rejected centre may lie tens of millimetres away while the valid ones scatter by hundredths, so the scales follow
//! the valid ones and everything else becomes an arrow at the border.

use super::Subject;
use super::about_axis::pose;
use super::area::Area;
use super::legend::{Entry, legend};
use super::marks::{Marks, Symbol, stride};
use super::notice::{MARGIN, page, paragraph};
use super::palette::{EXCLUDED, FAINT_INK, FITTED, VALID, reason_colour};
use super::panel::Panel;
use super::spread::{half_width, quantile};
use super::svg::{Anchor, Svg, Type};
use super::ticks::{Range, fixed};
use crate::estimation::{Estimate, Outcome, Pose, Profile, Reason};

/// Most markers of one kind on one panel.
const MARKS_MAX: usize = 2500;
/// The scale never gets finer than ± this, mm: below it one would look at rounding.
const DEVIATION_LEAST: f64 = 5e-4;

/// A profile's centre.
#[derive(Clone, Copy)]
struct Centre {
    x: f64,
    /// y and z, mm.
    at: [f64; 2],
    rejected: Option<Reason>,
}

/// One of the two directions in which a centre is looked at.
#[derive(Clone, Copy)]
struct Direction {
    name: &'static str,
    /// Its place in (y, z).
    index: usize,
    left: f64,
}

const DIRECTIONS: [Direction; 2] =
    [Direction { name: "y", index: 0, left: 80.0 }, Direction { name: "z", index: 1, left: 576.0 }];
const WIDTH: f64 = 400.0;

impl Direction {
    fn of(self, at: [f64; 2]) -> f64 {
        at.get(self.index).copied().unwrap_or(0.0)
    }
}

/// Draws the centres of the profiles, their axis and their deviation from it.
pub(super) fn centres(estimate: &Estimate, subject: &Subject<'_>) -> String {
    let centres: Vec<Centre> = estimate.profiles.iter().filter_map(centre).collect();
    let x = Range::around(estimate.profiles.iter().map(|profile| profile.x)).padded(0.03);
    let mut svg = page("Profile centres", subject.title, &caption(estimate));
    let mut beyond = 0;
    match &estimate.outcome {
        Outcome::Accepted(pose) => {
            if !pose.uncertainty.includes_calibration() {
                let words = "calibration not stated: the uncertainty covers the repeatability alone";
                svg.text([MARGIN, 67.0], Type::sized(11.0).colour(FAINT_INK), words);
            }
            for direction in DIRECTIONS {
                beyond +=
                    trend(&mut svg, direction, Area::new(direction.left, 92.0, WIDTH, 150.0), x, &centres, Some(pose));
                beyond += deviation(&mut svg, direction, x, &centres, pose);
            }
        }
        Outcome::Refused(refusal) => {
            let look = Type::sized(13.0).colour(EXCLUDED);
            let words = format!("Refused ({}): {refusal}.", refusal.code());
            let end = paragraph(&mut svg, Area::new(MARGIN, 64.0, 952.0, 60.0), look, &words);
            if centres.is_empty() {
                let words = "No profile has a centre that could be drawn.";
                paragraph(&mut svg, Area::new(MARGIN, 280.0, 952.0, 40.0), Type::sized(16.0), words);
            } else {
                for direction in DIRECTIONS {
                    let area = Area::new(direction.left, end + 32.0, WIDTH, 496.0 - end - 32.0);
                    beyond += trend(&mut svg, direction, area, x, &centres, None);
                }
            }
        }
    }
    legend(&mut svg, Area::new(MARGIN, 548.0, 952.0, 40.0), &entries(estimate, beyond));
    svg.finish()
}

fn centre(profile: &Profile) -> Option<Centre> {
    let ellipse = profile.section?.ellipse;
    let at = [ellipse.centre_y, ellipse.centre_z];
    let finite = profile.x.is_finite() && at.iter().all(|v| v.is_finite());
    finite.then_some(Centre { x: profile.x, at, rejected: profile.rejected })
}

/// The pose in a line of words.
fn caption(estimate: &Estimate) -> String {
    let valid = estimate.profiles.iter().filter(|profile| profile.rejected.is_none()).count();
    let counts = format!("{valid} of {} profiles valid", estimate.profiles.len());
    let Some(Pose { axis, radius, .. }) = pose(estimate) else {
        return format!("no pose · {counts} · {}", estimate.method.name());
    };
    format!(
        "deflection {}° · pitch {}° · y_c0 {} mm · z_c0 {} mm · radius {} mm · {counts} · {}",
        fixed(axis.deflection().degrees(), 4),
        fixed(axis.pitch().degrees(), 4),
        fixed(axis.y0, 3),
        fixed(axis.z0, 3),
        fixed(*radius, 3),
        estimate.method.name()
    )
}

/// The centres along x and the axis; returns how many lie off the scale.
fn trend(svg: &mut Svg, direction: Direction, area: Area, x: Range, centres: &[Centre], pose: Option<&Pose>) -> usize {
    let line = |x: f64| pose.map(|pose| direction.of(pose.axis.at(x)));
    let panel = Panel::new(area, x, trend_range(direction, x, centres, pose));
    let words = if pose.is_some() { "Centres and axis" } else { "Centres" };
    heading(svg, area, &format!("{words}, X{}", direction.name.to_uppercase()), "");
    panel.draw(svg, if pose.is_some() { "" } else { "x (mm)" }, &format!("{} (mm)", direction.name));
    let beyond = marks(svg, &panel, centres, |centre| direction.of(centre.at));
    if let (Some(from), Some(to)) = (line(x.lo), line(x.hi)) {
        let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1.2\"");
        svg.line(panel.place([x.lo, from]), panel.place([x.hi, to]), paint);
    }
    beyond
}

/// Room for the whole axis and the valid centres; where there is no axis, for most of the centres.
fn trend_range(direction: Direction, x: Range, centres: &[Centre], pose: Option<&Pose>) -> Range {
    let valid = || centres.iter().filter(|centre| centre.rejected.is_none());
    if let Some(pose) = pose {
        let half = half_width(valid().map(|c| direction.of(c.at) - direction.of(pose.axis.at(c.x))), DEVIATION_LEAST);
        let ends = [x.lo, x.hi].map(|x| direction.of(pose.axis.at(x)));
        return Range::around(ends.into_iter().flat_map(|v| [v - half, v + half])).padded(0.12);
    }
    let mut values: Vec<f64> = valid().map(|centre| direction.of(centre.at)).collect();
    if values.is_empty() {
        values = centres.iter().map(|centre| direction.of(centre.at)).collect();
    }
    let middle = quantile(&mut values, 0.5).unwrap_or(0.0);
    let half = half_width(values.iter().map(|v| v - middle), DEVIATION_LEAST);
    Range::new(middle - half, middle + half)
}

/// How far the centres lie from the axis; returns how many lie off the scale.
fn deviation(svg: &mut Svg, direction: Direction, x: Range, centres: &[Centre], pose: &Pose) -> usize {
    let from_axis = |centre: &Centre| direction.of(centre.at) - direction.of(pose.axis.at(centre.x));
    let valid: Vec<f64> = centres.iter().filter(|centre| centre.rejected.is_none()).map(from_axis).collect();
    let area = Area::new(direction.left, 300.0, WIDTH, 196.0);
    let panel = Panel::new(area, x, Range::about_zero(half_width(valid.iter().copied(), DEVIATION_LEAST)));
    let rms = (valid.iter().map(|v| v * v).sum::<f64>() / valid.len().max(1) as f64).sqrt();
    let note = if valid.is_empty() { String::new() } else { format!("rms of the valid {} mm", fixed(rms, 4)) };
    heading(svg, area, &format!("Deviation from the axis in {}", direction.name), &note);
    panel.draw(svg, "x (mm)", &format!("{} less axis (mm)", direction.name));
    let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1.2\"");
    svg.line(panel.place([x.lo, 0.0]), panel.place([x.hi, 0.0]), paint);
    marks(svg, &panel, centres, from_axis)
}

/// What a panel shows, above it; arrows of what lies beyond the border keep clear of it.
fn heading(svg: &mut Svg, area: Area, words: &str, note: &str) {
    svg.text([area.left, area.top - 12.0], Type::sized(12.0).bold(), words);
    let look = Type::sized(11.0).colour(FAINT_INK).anchor(Anchor::End);
    svg.text([area.right(), area.top - 12.0], look, note);
}

/// The markers of all kinds, the rejected ones on top because they are few; returns how many lie off the scale.
fn marks(svg: &mut Svg, panel: &Panel, centres: &[Centre], value: impl Fn(&Centre) -> f64) -> usize {
    let mut beyond = 0;
    for kind in [None].into_iter().chain(Reason::ALL.map(Some)) {
        let (symbol, colour) = look(kind);
        let of_kind = || centres.iter().filter(|centre| centre.rejected == kind);
        let mut marks = Marks::new(symbol, colour);
        for centre in of_kind().step_by(stride(of_kind().count(), MARKS_MAX)) {
            marks.add(panel, [centre.x, value(centre)]);
        }
        beyond += marks.draw(svg);
    }
    beyond
}

/// Shape and colour of the valid ones (`None`) and of each reason.
const fn look(kind: Option<Reason>) -> (Symbol, &'static str) {
    let Some(reason) = kind else {
        return (Symbol::Dot, VALID);
    };
    let symbol = match reason {
        Reason::OutsideParts | Reason::TooFewPoints => Symbol::Cross,
        Reason::NotConverged => Symbol::Plus,
        Reason::LowInlierRatio => Symbol::Triangle,
        Reason::ArcTooShort => Symbol::Square,
        Reason::OffAxis => Symbol::Diamond,
    };
    (symbol, reason_colour(reason))
}

/// The legend with how many of each kind there are, and how many of them have no centre to be drawn.
fn entries(estimate: &Estimate, beyond: usize) -> Vec<Entry> {
    let mut entries = Vec::new();
    for kind in [None].into_iter().chain(Reason::ALL.map(Some)) {
        let of_kind = || estimate.profiles.iter().filter(|profile| profile.rejected == kind);
        let (count, missing) = (of_kind().count(), of_kind().filter(|profile| centre(profile).is_none()).count());
        if count == 0 && kind.is_some() {
            continue;
        }
        let mut text = format!("{}: {count}", kind.map_or("valid", Reason::name));
        if missing > 0 {
            text += &format!(" ({missing} without centre)");
        }
        let every = stride(count - missing, MARKS_MAX);
        if every > 1 {
            text += &format!(" (1 in {every} drawn)");
        }
        let (symbol, colour) = look(kind);
        entries.push(Entry::new(symbol, colour, text));
    }
    if pose(estimate).is_some() {
        entries.push(Entry::new(Symbol::Stroke, FITTED, "fitted axis"));
    }
    if beyond > 0 {
        entries.push(Entry::new(Symbol::Arrow, FAINT_INK, "off the scale"));
    }
    entries
}
