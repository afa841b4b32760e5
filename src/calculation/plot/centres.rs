//! The picture of the centres: the position of each profile's centre along x with the fitted axis (above), and its deviation from
//! the axis (below), in y and in z. If the scan is refused, or no profile has a centre, the picture shows the points of the scan
//! from above and from the side.
//!
//! A rejected centre may be tens of millimetres off while the valid ones scatter by hundredths, so the scales follow the valid
//! ones, and all others become arrows at the border.

use super::about_axis::{Names, names, pose};
use super::header::{BODY_TOP, MARGIN, Subject, page};
use super::marks::{Entry, Marks, Symbol, legend, stride};
use super::overlays::{self, Point};
use super::palette::{FAINT_INK, FITTED, VALID, reason_colour};
use super::panel::Panel;
use super::scale::{Range, fixed, half_width, quantile};
use super::svg::{Anchor, Area, Svg, Type};
use crate::estimation::{Estimate, Pose, Profile, Reason};
use crate::scan::Scan;

/// Largest number of markers of one kind on one panel.
const MARKS_MAX: usize = 2500;
/// Largest number of points on one panel.
const POINTS_MAX: usize = 4000;
/// Finest scale, ± mm: a finer one would show only rounding.
const DEVIATION_LEAST: f64 = 5e-4;

/// A profile's centre.
#[derive(Clone, Copy)]
struct Centre {
    x: f64,
    /// y and z, mm.
    at: [f64; 2],
    rejected: Option<Reason>,
}

/// One of the two directions of a centre that the picture shows.
#[derive(Clone, Copy)]
struct Direction {
    /// Its index in (y, z).
    index: usize,
    left: f64,
}

const DIRECTIONS: [Direction; 2] = [Direction { index: 0, left: 80.0 }, Direction { index: 1, left: 576.0 }];
const WIDTH: f64 = 400.0;
const TOP: f64 = BODY_TOP + 24.0;
const BOTTOM: f64 = 580.0;
const LEGEND: Area = Area::new(MARGIN, 626.0, 952.0, 60.0);

impl Direction {
    fn of(self, at: [f64; 2]) -> f64 {
        at.get(self.index).copied().unwrap_or(0.0)
    }

    fn name(self, names: Names) -> &'static str {
        if self.index == 0 { names.y } else { names.z }
    }

    fn area(self, top: f64, height: f64) -> Area {
        Area::new(self.left, top, WIDTH, height)
    }
}

/// The content of the picture.
struct Drawing<'a> {
    svg: Svg,
    names: Names,
    x: Range,
    pose: Option<&'a Pose>,
    centres: Vec<Centre>,
    points: Vec<Point>,
    /// Marks that lie off the scale of their panel.
    beyond: usize,
}

/// Draws the centres of the profiles, their axis and their deviation from it.
pub(super) fn centres(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let pose = pose(estimate);
    let centres: Vec<Centre> = estimate.profiles.iter().filter_map(centre).collect();
    let with_deviation = pose.is_some() && !centres.is_empty();
    let points = if with_deviation { Vec::new() } else { overlays::points(scan, estimate, POINTS_MAX) };
    let faces = pose.map(overlays::end_face_places).unwrap_or_default();
    let profiles = estimate.profiles.iter().map(|profile| profile.x);
    let x = Range::around(profiles.chain(points.iter().map(|point| point.at[0])).chain(faces)).padded(0.03);
    let (what, caption) = words(pose, &centres);
    let (svg, names) = (page(what, caption, estimate, subject), names(estimate));
    let mut drawing = Drawing { svg, names, x, pose, centres, points, beyond: 0 };
    for direction in DIRECTIONS {
        if with_deviation {
            drawing.trend(direction, direction.area(TOP, 150.0));
            drawing.deviation(direction, direction.area(TOP + 210.0, BOTTOM - TOP - 210.0));
        } else if drawing.centres.is_empty() {
            drawing.overview(direction, direction.area(TOP, BOTTOM - TOP));
        } else {
            drawing.overview(direction, direction.area(TOP, 168.0));
            drawing.trend(direction, direction.area(TOP + 238.0, BOTTOM - TOP - 238.0));
        }
    }
    let entries = drawing.entries(estimate, scan.points().len());
    legend(&mut drawing.svg, LEGEND, &entries);
    drawing.svg.finish()
}

fn words(pose: Option<&Pose>, centres: &[Centre]) -> (&'static str, &'static str) {
    match (pose, centres.is_empty()) {
        (Some(_), false) => {
            ("Profile centres", "centres of the fitted sections and the axis; the scales follow the valid profiles")
        }
        (Some(_), true) => ("Points and axis", "this method fits all points at once and gives profiles no centres"),
        (None, false) => {
            ("Points and profile centres", "no pose: the points of the scan and the centres of its fitted sections")
        }
        (None, true) => {
            ("Points of the scan", "no pose, and no profile has a centre: the points from above and from the side")
        }
    }
}

fn centre(profile: &Profile) -> Option<Centre> {
    let ellipse = profile.section?.ellipse;
    let at = [ellipse.centre_y, ellipse.centre_z];
    let finite = profile.x.is_finite() && at.iter().all(|v| v.is_finite());
    finite.then_some(Centre { x: profile.x, at, rejected: profile.rejected })
}

impl Drawing<'_> {
    /// The points of the scan along x, with the axis if there is one.
    fn overview(&mut self, direction: Direction, area: Area) {
        let name = direction.name(self.names);
        let value = |[_, y, z]: [f64; 3]| direction.of([y, z]);
        let mut values: Vec<f64> = self.points.iter().map(|point| value(point.at)).collect();
        let bulk = [0.005, 0.995].map(|part| quantile(&mut values, part).unwrap_or(0.0));
        let axis = self.pose.map(|pose| [self.x.lo, self.x.hi].map(|x| direction.of(pose.axis.at(x))));
        let range = Range::around(bulk.into_iter().chain(axis.into_iter().flatten())).padded(0.12);
        let panel = Panel::new(area, self.x, range);
        let side = if direction.index == 0 { "from above" } else { "from the side" };
        heading(&mut self.svg, area, &format!("Points {side}: {name} against {}", self.names.x), "");
        panel.draw(&mut self.svg, self.names.x_label, &format!("{name} (mm)"));
        self.beyond +=
            overlays::draw_points(&mut self.svg, &panel, &self.points, |point| [point.at[0], value(point.at)]);
        self.draw_axis(&panel, direction);
    }

    /// The centres along x and the axis.
    fn trend(&mut self, direction: Direction, area: Area) {
        let name = direction.name(self.names);
        let panel = Panel::new(area, self.x, self.trend_range(direction));
        let (words, x_label) = match self.pose {
            Some(_) => ("Centres and axis", ""),
            None => ("Centres", self.names.x_label),
        };
        heading(&mut self.svg, area, &format!("{words}: {name} against {}", self.names.x), "");
        panel.draw(&mut self.svg, x_label, &format!("{name} (mm)"));
        self.draw_marks(&panel, |centre| direction.of(centre.at));
        self.draw_axis(&panel, direction);
    }

    /// A range for the whole axis and the valid centres; without an axis, for most of the centres.
    fn trend_range(&self, direction: Direction) -> Range {
        let valid = || self.centres.iter().filter(|centre| centre.rejected.is_none());
        if let Some(pose) = self.pose {
            let off = |centre: &Centre| direction.of(centre.at) - direction.of(pose.axis.at(centre.x));
            let half = half_width(valid().map(off), DEVIATION_LEAST);
            let ends = [self.x.lo, self.x.hi].map(|x| direction.of(pose.axis.at(x)));
            return Range::around(ends.into_iter().flat_map(|v| [v - half, v + half])).padded(0.12);
        }
        let mut values: Vec<f64> = valid().map(|centre| direction.of(centre.at)).collect();
        if values.is_empty() {
            values = self.centres.iter().map(|centre| direction.of(centre.at)).collect();
        }
        let middle = quantile(&mut values, 0.5).unwrap_or(0.0);
        let half = half_width(values.iter().map(|v| v - middle), DEVIATION_LEAST);
        Range::new(middle - half, middle + half)
    }

    /// The deviations of the centres from the axis.
    fn deviation(&mut self, direction: Direction, area: Area) {
        let Some(pose) = self.pose else { return };
        let name = direction.name(self.names);
        let from_axis = |centre: &Centre| direction.of(centre.at) - direction.of(pose.axis.at(centre.x));
        let of_valid = self.centres.iter().filter(|centre| centre.rejected.is_none());
        let valid: Vec<f64> = of_valid.map(from_axis).collect();
        let panel = Panel::new(area, self.x, Range::about_zero(half_width(valid.iter().copied(), DEVIATION_LEAST)));
        let rms = (valid.iter().map(|v| v * v).sum::<f64>() / valid.len().max(1) as f64).sqrt();
        let note = if valid.is_empty() { String::new() } else { format!("RMS of valid: {} mm", fixed(rms, 4)) };
        heading(&mut self.svg, area, &format!("Centres relative to the axis: {name}"), &note);
        panel.draw(&mut self.svg, self.names.x_label, &format!("{name} of centre − {name} of axis (mm)"));
        let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1.2\"");
        self.svg.line(panel.place([self.x.lo, 0.0]), panel.place([self.x.hi, 0.0]), paint);
        self.draw_marks(&panel, from_axis);
        overlays::draw_end_faces_across(&mut self.svg, &panel, pose);
    }

    /// The axis and the end faces.
    fn draw_axis(&mut self, panel: &Panel, direction: Direction) {
        let Some(pose) = self.pose else { return };
        let place = |x: f64| panel.place([x, direction.of(pose.axis.at(x))]);
        let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1.2\"");
        self.svg.line(place(self.x.lo), place(self.x.hi), paint);
        overlays::draw_end_faces_across(&mut self.svg, panel, pose);
    }

    /// The markers of all kinds, with the few rejected ones on top.
    fn draw_marks(&mut self, panel: &Panel, value: impl Fn(&Centre) -> f64) {
        for kind in [None].into_iter().chain(Reason::ALL.map(Some)) {
            let (symbol, colour) = look(kind);
            let of_kind = || self.centres.iter().filter(|centre| centre.rejected == kind);
            let mut marks = Marks::new(symbol, colour);
            for centre in of_kind().step_by(stride(of_kind().count(), MARKS_MAX)) {
                marks.add(panel, [centre.x, value(centre)]);
            }
            self.beyond += marks.draw(&mut self.svg);
        }
    }

    /// The legend with the number of profiles of each kind, and of those without a centre to draw.
    fn entries(&self, estimate: &Estimate, points_count: usize) -> Vec<Entry> {
        let mut entries = Vec::new();
        for kind in [None].into_iter().chain(Reason::ALL.map(Some)).filter(|_| !self.centres.is_empty()) {
            let of_kind = || estimate.profiles.iter().filter(|profile| profile.rejected == kind);
            let (count, missing) = (of_kind().count(), of_kind().filter(|profile| centre(profile).is_none()).count());
            if count == 0 && kind.is_some() {
                continue;
            }
            let name = kind.map_or_else(|| "valid".to_owned(), |reason| format!("rejected, {}", reason.name()));
            let mut text = format!("{name}: {count}");
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
        if !self.points.is_empty() {
            entries.extend(overlays::point_entries(&self.points, points_count));
        }
        if let Some(pose) = self.pose {
            entries.push(Entry::new(Symbol::Stroke, FITTED, "fitted axis"));
            entries.extend(overlays::end_face_entries(pose));
        }
        entries.extend(overlays::off_scale_entry(self.beyond));
        entries
    }
}

/// The heading above a panel.
fn heading(svg: &mut Svg, area: Area, words: &str, note: &str) {
    svg.text([area.left, area.top - 8.0], Type::sized(12.0).bold(), words);
    let look = Type::sized(11.0).colour(FAINT_INK).anchor(Anchor::End);
    svg.text([area.right(), area.top - 8.0], look, note);
}

/// Shape and colour of the valid ones (`None`) and of each reason.
const fn look(kind: Option<Reason>) -> (Symbol, &'static str) {
    let Some(reason) = kind else {
        return (Symbol::Dot, VALID);
    };
    let symbol = match reason {
        Reason::OutsideParts | Reason::TooFewPoints => Symbol::Cross,
        Reason::NotConverged => Symbol::Plus,
        Reason::LowInlierRatio => Symbol::Ring,
        Reason::ArcTooShort => Symbol::Square,
        Reason::OffAxis => Symbol::Diamond,
    };
    (symbol, reason_colour(reason))
}
