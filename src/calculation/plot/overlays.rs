//! Marks that several pictures share: the points of the scan, in the colours of the verdicts on their profiles, and the detected
//! end faces, with their entries in the legend.

use super::about_axis::{Cylinder, Status, status, thinned};
use super::header::{end_faces, x_of};
use super::marks::{Entry, Marks, Symbol, polyline};
use super::palette::{END_FACE, INK, REJECTED, UNJUDGED, VALID};
use super::panel::Panel;
use super::svg::Svg;
use crate::estimation::{Estimate, Pose};
use crate::scan::Scan;

/// A point of the scan and the verdict on its profile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) at: [f64; 3],
    pub(super) status: Status,
}

/// The rejected ones come first, so that the others are drawn over them.
const KINDS: [(Status, &str, &str); 3] = [
    (Status::Rejected, REJECTED, "points of rejected profiles"),
    (Status::Unjudged, UNJUDGED, "points of the scan"),
    (Status::Valid, VALID, "points of valid profiles"),
];

/// At most about `most` points of the scan.
pub(super) fn points(scan: &Scan, estimate: &Estimate, most: usize) -> Vec<Point> {
    thinned(scan, most).map(|(index, at)| Point { at, status: status(estimate, index) }).collect()
}

/// Draws points at the positions from `place`; returns how many lie off the scale.
pub(super) fn draw_points(svg: &mut Svg, panel: &Panel, points: &[Point], place: impl Fn(&Point) -> [f64; 2]) -> usize {
    let symbol = if points.len() > 1000 { Symbol::Speck } else { Symbol::Dot };
    let mut beyond = 0;
    for (status, colour, _) in KINDS {
        let mut marks = Marks::new(symbol, colour);
        for point in points.iter().filter(|point| point.status == status) {
            marks.add(panel, place(point));
        }
        beyond += marks.draw(svg);
    }
    beyond
}

/// The legend of points that were drawn out of `total`.
pub(super) fn point_entries(points: &[Point], total: usize) -> Vec<Entry> {
    let occurs = |status: Status| points.iter().any(|point| point.status == status);
    let kinds = KINDS.iter().rev().filter(|(status, ..)| occurs(*status));
    let mut entries: Vec<Entry> = kinds.map(|(_, colour, words)| Entry::new(Symbol::Dot, colour, *words)).collect();
    if total > points.len() {
        entries.push(Entry::remark(format!("1 point in {} drawn", total.div_ceil(points.len().max(1)))));
    }
    entries
}

/// The entry of the arrows, if there are any.
pub(super) fn off_scale_entry(count: usize) -> Option<Entry> {
    (count > 0).then(|| Entry::new(Symbol::Arrow, INK, "off scale, in the colour of its kind"))
}

/// Intersections of the axis with the end faces, x in mm.
pub(super) fn end_face_places(pose: &Pose) -> Vec<f64> {
    end_faces(pose).iter().map(|(_, face)| face.centre[0]).collect()
}

/// Lines across a panel at the x of the intersections of the axis with the end faces.
pub(super) fn draw_end_faces_across(svg: &mut Svg, panel: &Panel, pose: &Pose) {
    for x in end_face_places(pose).into_iter().filter(|x| panel.x.contains(*x)) {
        svg.line(panel.place([x, panel.y.lo]), panel.place([x, panel.y.hi]), Symbol::Dashes.paint(END_FACE));
    }
}

/// The edges of the end faces on a panel that shows degrees around the axis against x.
pub(super) fn draw_end_faces_around(svg: &mut Svg, panel: &Panel, pose: &Pose) {
    const STEPS: i32 = 90;
    let cylinder = Cylinder::of(pose);
    for centre_x in end_face_places(pose) {
        let edge = (0..=STEPS).map(|step| panel.y.lo + panel.y.width() * f64::from(step) / f64::from(STEPS));
        let edge = edge.map(|degrees| [cylinder.x_of_plane(centre_x, degrees.to_radians()), degrees]);
        let line = polyline(edge.filter(|[x, _]| panel.x.contains(*x)).map(|place| panel.place(place)));
        svg.path(&line, Symbol::Dashes.paint(END_FACE));
    }
}

/// Their entries of the legend, with their x.
pub(super) fn end_face_entries(pose: &Pose) -> impl Iterator<Item = Entry> {
    let entry = |name: &str, x: String| Entry::new(Symbol::Dashes, END_FACE, format!("{name}, on the axis at x = {x}"));
    end_faces(pose).into_iter().map(move |(name, face)| entry(name, x_of(&face)))
}
