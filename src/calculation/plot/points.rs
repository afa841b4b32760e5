//! Points of the scan on a panel, in the colours of the verdicts on their profiles, with their entries of the legend.

use super::about_axis::{Status, status, thinned};
use super::legend::Entry;
use super::marks::{Marks, Symbol};
use super::palette::{INK, REJECTED, UNJUDGED, VALID};
use super::panel::Panel;
use super::svg::Svg;
use crate::estimation::Estimate;
use crate::scan::Scan;

/// A point of the scan and the verdict on its profile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) at: [f64; 3],
    pub(super) status: Status,
}

/// The rejected ones first, so that the others are drawn over them.
const KINDS: [(Status, &str, &str); 3] = [
    (Status::Rejected, REJECTED, "points of rejected profiles"),
    (Status::Unjudged, UNJUDGED, "points of the scan"),
    (Status::Valid, VALID, "points of valid profiles"),
];

/// At most about `most` points of the scan.
pub(super) fn points(scan: &Scan, estimate: &Estimate, most: usize) -> Vec<Point> {
    thinned(scan, most).map(|(index, at)| Point { at, status: status(estimate, index) }).collect()
}

/// Draws points where `place` puts them; returns how many lie off the scale.
pub(super) fn draw(svg: &mut Svg, panel: &Panel, points: &[Point], place: impl Fn(&Point) -> [f64; 2]) -> usize {
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
pub(super) fn entries(points: &[Point], total: usize) -> Vec<Entry> {
    let occurs = |status: Status| points.iter().any(|point| point.status == status);
    let kinds = KINDS.iter().rev().filter(|(status, ..)| occurs(*status));
    let mut entries: Vec<Entry> = kinds.map(|(_, colour, words)| Entry::new(Symbol::Dot, colour, *words)).collect();
    if total > points.len() {
        entries.push(Entry::remark(format!("1 point in {} drawn", total.div_ceil(points.len().max(1)))));
    }
    entries
}

/// The entry of the arrows, where there are any.
pub(super) fn off_scale(count: usize) -> Option<Entry> {
    (count > 0).then(|| Entry::new(Symbol::Arrow, INK, "off scale, in the colour of its kind"))
}
