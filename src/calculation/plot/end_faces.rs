//! The end faces that were found, on panels that show x.

use super::about_axis::Cylinder;
use super::legend::Entry;
use super::marks::{Symbol, polyline};
use super::palette::END_FACE;
use super::panel::Panel;
use super::result::{end_faces, x_of};
use super::svg::Svg;
use crate::estimation::Pose;

/// Where the axis meets the end faces, x in mm.
pub(super) fn places(pose: &Pose) -> Vec<f64> {
    end_faces(pose).iter().map(|(_, face)| face.centre[0]).collect()
}

/// Lines across a panel at the x where the axis meets the end faces.
pub(super) fn draw_across(svg: &mut Svg, panel: &Panel, pose: &Pose) {
    for x in places(pose).into_iter().filter(|x| panel.x.contains(*x)) {
        svg.line(panel.place([x, panel.y.lo]), panel.place([x, panel.y.hi]), Symbol::Dashes.paint(END_FACE));
    }
}

/// The edges of the end faces on a panel that shows degrees around the axis against x.
pub(super) fn draw_around(svg: &mut Svg, panel: &Panel, pose: &Pose) {
    const STEPS: i32 = 90;
    let cylinder = Cylinder::of(pose);
    for centre_x in places(pose) {
        let edge = (0..=STEPS).map(|step| panel.y.lo + panel.y.width() * f64::from(step) / f64::from(STEPS));
        let edge = edge.map(|degrees| [cylinder.x_of_plane(centre_x, degrees.to_radians()), degrees]);
        let line = polyline(edge.filter(|[x, _]| panel.x.contains(*x)).map(|place| panel.place(place)));
        svg.path(&line, Symbol::Dashes.paint(END_FACE));
    }
}

/// Their entries of the legend, with their x.
pub(super) fn entries(pose: &Pose) -> impl Iterator<Item = Entry> {
    let entry = |name: &str, x: String| Entry::new(Symbol::Dashes, END_FACE, format!("{name}, on the axis at x = {x}"));
    end_faces(pose).into_iter().map(move |(name, face)| entry(name, x_of(&face)))
}
