//! The picture of one profile: its points with the fitted section in true proportion (left). A noise of hundredths is invisible on
//! a radius of hundreds, so the right side shows the distances from the section against direction with the band of the inliers.
//! Without a section the right side shows the points, each coordinate at its own scale.
//!
//! The points are compared with the reference of the verdict: the section of the common cylinder or the ellipse of the profile,
//! with the inlier limit that the verdict used.

use super::about_axis::{Cylinder, Names, Status, names, pose, status};
use super::grid::{Seen, turned_into};
use super::header::{BODY_TOP, MARGIN, Subject, end_faces, page, paragraph};
use super::marks::{Entry, Marks, Symbol, legend, polyline, stride};
use super::overlays::off_scale_entry;
use super::palette::{BAND, EXCLUDED, FAINT_INK, FITTED, INLIER, OUTLIER, VALID};
use super::panel::Panel;
use super::scale::{Range, fixed, quantile};
use super::svg::{Area, Svg, Type};
use crate::estimation::{Estimate, Method, Profile, Section, TUKEY_C};
use crate::geometry::SectionEllipse;
use crate::scan::{Scan, Station};

/// Largest number of markers of one kind on one panel.
const MARKS_MAX: usize = 2000;
const SHAPE: Area = Area::new(84.0, BODY_TOP + 10.0, 400.0, 440.0);
const RESIDUALS: Area = Area::new(580.0, BODY_TOP + 10.0, 396.0, 440.0);
const LEGEND: Area = Area::new(MARGIN, 634.0, 952.0, 60.0);

/// Draws one profile: the one that the subject names, otherwise the valid one nearest to the middle, otherwise the middle one.
pub(super) fn section(scan: &Scan, estimate: &Estimate, subject: &Subject<'_>) -> String {
    let index = subject.profile.unwrap_or_else(|| middle_profile(scan, estimate));
    let Some(&station) = scan.stations().get(index) else {
        let count = scan.stations().len();
        let mut svg = page("Section", &format!("no profile {index}"), estimate, subject);
        let words = format!("The scan has {count} profiles, numbered from 0; there is no profile {index}.");
        paragraph(&mut svg, Area::new(120.0, 280.0, 760.0, 100.0), Type::sized(16.0), &words);
        return svg.finish();
    };
    let points: Vec<[f64; 3]> = scan.points_of(&station).collect();
    let profile = estimate.profiles.get(index);
    let reference = reference(estimate, profile, station, subject.epsilon_mm);
    let names = names(estimate);
    let what = format!("Section at {} = {} mm, {}", names.x, fixed(station.x, 2), verdict(estimate, profile));
    let place = place(scan, index, subject.first_profile, points.len());
    let caption = [place, about(profile, reference.as_ref()), beyond_end(estimate, station.x)].concat();
    let mut svg = page(&what, &caption, estimate, subject);
    match reference {
        Some(reference) => {
            let points = judge(&points, station.x, &reference, estimate.method);
            let beyond = draw_shape(&mut svg, names, &reference.ellipse, &points)
                + draw_residuals(&mut svg, names, &reference, &points);
            legend(&mut svg, LEGEND, &entries(&points, &reference, subject.epsilon_mm, beyond));
        }
        None => draw_points(&mut svg, names, &points),
    }
    svg.finish()
}

fn middle_profile(scan: &Scan, estimate: &Estimate) -> usize {
    let stations = scan.stations();
    let ends = stations.first().zip(stations.last()).map(|(first, last)| (first.x + last.x) / 2.0);
    let middle = ends.unwrap_or(0.0);
    let from_middle = |index: &usize| stations.get(*index).map_or(f64::MAX, |station| (station.x - middle).abs());
    (0..stations.len())
        .filter(|&index| status(estimate, index) != Status::Rejected)
        .min_by(|a, b| from_middle(a).total_cmp(&from_middle(b)))
        .unwrap_or(stations.len() / 2)
}

/// The reference that decided on the profile; `None` if it has no section that can be drawn.
fn reference(estimate: &Estimate, profile: Option<&Profile>, station: Station, epsilon_mm: f64) -> Option<Reference> {
    let own = profile.and_then(|profile| profile.section);
    let cylinder = match estimate.method {
        Method::Cylinder | Method::LeastSquares => pose(estimate).map(Cylinder::of),
        Method::SectionLine | Method::SectionLinePlain => None,
    };
    let ellipse = match cylinder {
        Some(Cylinder { axis, radius }) => axis.section(radius, station.x),
        None => own?.ellipse,
    };
    let sigma = own.map(|section| section.sigma).or_else(|| Some(estimate.residuals?.sigma)).unwrap_or(0.0);
    let limit = estimate.method.inlier_limit_mm(epsilon_mm, sigma);
    drawable(&ellipse).then_some(Reference { ellipse, cylinder, sigma, limit })
}

fn drawable(ellipse: &SectionEllipse) -> bool {
    let SectionEllipse { centre_y, centre_z, semi_major, semi_minor, rotation } = *ellipse;
    let lengths = [centre_y, centre_z, semi_major, semi_minor];
    lengths.iter().all(|v| v.abs() < 1e100) && rotation.radians().is_finite() && semi_minor > 0.0 && semi_major > 0.0
}

fn verdict(estimate: &Estimate, profile: Option<&Profile>) -> String {
    match profile.map(|profile| profile.rejected) {
        Some(Some(reason)) => format!("rejected: {}", reason.name()),
        Some(None) if estimate.method == Method::LeastSquares => "used without a verdict".to_owned(),
        Some(None) => "valid".to_owned(),
        None => "not evaluated".to_owned(),
    }
}

fn place(scan: &Scan, index: usize, first: usize, points_count: usize) -> String {
    let last = first + scan.stations().len().saturating_sub(1);
    format!("profile {} ({first} to {last}) · {points_count} points", first + index)
}

/// The section in numbers.
fn about(profile: Option<&Profile>, reference: Option<&Reference>) -> String {
    let own = profile.and_then(|profile| profile.section);
    let Some(Reference { ellipse, cylinder, sigma, .. }) = reference else {
        return " · without a section that they could be compared with".to_owned();
    };
    let what = if cylinder.is_some() { "section of the fitted cylinder" } else { "fitted ellipse" };
    let share = own.map_or_else(String::new, |Section { inlier_ratio, arc, .. }| {
        format!(" · inliers {} % over {}°", fixed(100.0 * inlier_ratio, 1), fixed(arc.degrees(), 1))
    });
    format!(
        " · {what}: centre ({}, {}) mm, semi-axes a = {} mm, b = {} mm · robust σ {} mm{share}",
        fixed(ellipse.centre_y, 3),
        fixed(ellipse.centre_z, 3),
        fixed(ellipse.semi_major, 3),
        fixed(ellipse.semi_minor, 3),
        fixed(*sigma, 4),
    )
}

/// Remark if the axis has already left the part in this plane.
fn beyond_end(estimate: &Estimate, x: f64) -> String {
    let Some(pose) = pose(estimate) else { return String::new() };
    let is_beyond = |centre_x: f64, near: bool| if near { x < centre_x } else { x > centre_x };
    let faces = end_faces(pose).into_iter();
    let beyond = faces.filter(|(name, face)| is_beyond(face.centre[0], name.starts_with("near")));
    beyond.map(|(name, _)| format!(" · beyond the {name}")).collect()
}

/// The points and their section in true proportion.
fn draw_shape(svg: &mut Svg, names: Names, ellipse: &SectionEllipse, points: &[Judged]) -> usize {
    let panel = shape_panel(ellipse, points);
    panel.draw(svg, &format!("{} (mm)", names.y), &format!("{} (mm)", names.z));
    let seen = Seen::new(points.iter().filter(|p| p.kind != Kind::Excluded).map(|p| p.degrees));
    let beyond = draw_marks(svg, &panel, points, |point| point.at);
    svg.clipped("section-shape", panel.area, |svg| {
        let arc = |from: f64, to: f64| ellipse_arc(&panel, ellipse, from, to);
        let arcs = seen.arcs();
        let after = arcs.iter().skip(1).map(|[from, _]| *from).chain(arcs.first().map(|[from, _]| from + 360.0));
        for ([from, to], next) in arcs.iter().zip(after) {
            svg.path(&arc(*from, *to), format_args!("fill=\"none\" stroke=\"{FITTED}\" stroke-width=\"0.8\""));
            let paint = format!("fill=\"none\" stroke=\"{FAINT_INK}\" stroke-width=\"1\" stroke-dasharray=\"5 4\"");
            if next - to > 0.0 && to - from < 360.0 {
                svg.path(&arc(*to, if next < *to { next + 360.0 } else { next }), paint);
            }
        }
    });
    let centre = [ellipse.centre_y, ellipse.centre_z];
    if panel.x.contains(centre[0]) && panel.y.contains(centre[1]) {
        Symbol::Plus.draw(svg, panel.place(centre), FITTED);
    }
    panel.frame(svg);
    beyond
}

/// The complete ellipse, or only the points if the ellipse is far larger (a line that was fitted as an arc).
fn shape_panel(ellipse: &SectionEllipse, points: &[Judged]) -> Panel {
    let y = Range::around(points.iter().map(|point| point.at[0]));
    let z = Range::around(points.iter().map(|point| point.at[1]));
    let extent = y.width().max(z.width());
    if points.len() > 1 && ellipse.semi_major > 5.0 * extent {
        return Panel::equal(SHAPE, [y.middle(), z.middle()], 0.6 * extent);
    }
    Panel::equal(SHAPE, [ellipse.centre_y, ellipse.centre_z], 1.15 * ellipse.semi_major)
}

/// The ellipse between two directions from its centre, degrees.
fn ellipse_arc(panel: &Panel, ellipse: &SectionEllipse, from: f64, to: f64) -> String {
    let steps = ((to - from).abs().ceil() as i32).clamp(2, 360);
    let direction = |step: i32| (from + (to - from) * f64::from(step) / f64::from(steps)).to_radians();
    polyline((0..=steps).map(|step| {
        // The parameter angle whose point lies in this direction.
        let (sin, cos) = (direction(step) - ellipse.rotation.radians()).sin_cos();
        let parameter = (sin * ellipse.semi_major).atan2(cos * ellipse.semi_minor);
        panel.place(ellipse.point(parameter))
    }))
}

/// The distances against direction, in millimetres, with the band of the inliers.
fn draw_residuals(svg: &mut Svg, names: Names, reference: &Reference, points: &[Judged]) -> usize {
    let Reference { cylinder, sigma, limit, .. } = *reference;
    let window = Seen::new(points.iter().map(|point| point.degrees)).window();
    let band = Some(limit).filter(|limit| limit.is_finite() && *limit > 0.0);
    let half = band.map_or(0.0, |limit| 2.2 * limit).max(5.0 * sigma);
    let panel = Panel::new(RESIDUALS, window.padded(0.03), Range::about_zero(half));
    if let Some(limit) = band {
        let [left, top] = panel.place([panel.x.lo, limit]);
        let [_, bottom] = panel.place([panel.x.lo, -limit]);
        svg.rect(Area::new(left, top, panel.area.width, bottom - top), format_args!("fill=\"{BAND}\""));
    }
    let x_label =
        format!("direction from the centre, 0° = +{}, 90° = +{} (°)", names.y.to_uppercase(), names.z.to_uppercase());
    let surface = if cylinder.is_some() { "fitted cylinder" } else { "fitted ellipse" };
    panel.draw(svg, &x_label, &format!("distance from the {surface}, positive outside (mm)"));
    let beyond = draw_marks(svg, &panel, points, |point| [turned_into(point.degrees, window.lo), point.residual]);
    let paint = format!("stroke=\"{FITTED}\" stroke-width=\"1\"");
    svg.line(panel.place([panel.x.lo, 0.0]), panel.place([panel.x.hi, 0.0]), paint);
    for side in band.into_iter().flat_map(|limit| [limit, -limit]) {
        let paint = format!("stroke=\"{VALID}\" stroke-width=\"0.8\" stroke-dasharray=\"5 4\"");
        svg.line(panel.place([panel.x.lo, side]), panel.place([panel.x.hi, side]), paint);
    }
    beyond
}

/// Draws the points by kind, the rare ones on top; returns how many lie beyond the border.
fn draw_marks(svg: &mut Svg, panel: &Panel, points: &[Judged], values: impl Fn(&Judged) -> [f64; 2]) -> usize {
    let mut beyond = 0;
    for kind in Kind::ALL {
        let (symbol, colour) = kind.look();
        let of_kind = || points.iter().filter(|point| point.kind == kind);
        let mut marks = Marks::new(symbol, colour);
        for point in of_kind().step_by(stride(of_kind().count(), MARKS_MAX)) {
            marks.add(panel, values(point));
        }
        beyond += marks.draw(svg);
    }
    beyond
}

fn entries(points: &[Judged], reference: &Reference, epsilon: f64, beyond: usize) -> Vec<Entry> {
    let mut entries = Vec::new();
    for kind in Kind::ALL {
        let count = points.iter().filter(|point| point.kind == kind).count();
        if count > 0 {
            let every = stride(count, MARKS_MAX);
            let drawn = if every > 1 { format!(" (1 in {every} drawn)") } else { String::new() };
            let (symbol, colour) = kind.look();
            entries.push(Entry::new(symbol, colour, format!("{}: {count}{drawn}", kind.words())));
        }
    }
    entries.push(Entry::new(Symbol::Stroke, FITTED, "section, observed arc"));
    entries.push(Entry::new(Symbol::Dashes, FAINT_INK, "section, not observed"));
    entries.push(Entry::new(Symbol::Plus, FITTED, "its centre"));
    let Reference { limit, sigma, .. } = *reference;
    if limit.is_finite() {
        let why = if limit > epsilon {
            format!("{} σ, more than ε = {} mm", fixed(limit / sigma, 2), fixed(epsilon, 4))
        } else {
            "ε".to_owned()
        };
        entries.push(Entry::new(Symbol::Field, BAND, format!("inliers: nearer than {} mm ({why})", fixed(limit, 4))));
    }
    entries.extend(off_scale_entry(beyond));
    entries
}

/// The points alone: in true proportion, and each coordinate at its own scale.
fn draw_points(svg: &mut Svg, names: Names, points: &[[f64; 3]]) {
    let points: Vec<[f64; 2]> = points.iter().map(|[_, y, z]| [*y, *z]).collect();
    let own_scale = |coordinate: fn(&[f64; 2]) -> f64| {
        let mut values: Vec<f64> = points.iter().map(coordinate).collect();
        let [lo, hi] = [0.005, 0.995].map(|part| quantile(&mut values, part).unwrap_or(0.0));
        Range::new(lo, hi).padded(0.08)
    };
    let stretched = Panel::new(RESIDUALS, own_scale(|[y, _]| *y), own_scale(|[_, z]| *z));
    let mut beyond = 0;
    for panel in [Panel::around(SHAPE, &points), stretched] {
        panel.draw(svg, &format!("{} (mm)", names.y), &format!("{} (mm)", names.z));
        let mut marks = Marks::new(Symbol::Dot, VALID);
        for point in points.iter().step_by(stride(points.len(), MARKS_MAX)) {
            marks.add(&panel, *point);
        }
        beyond += marks.draw(svg);
    }
    let words = "points of the profile: left in true proportion, right each coordinate at its own scale";
    let entries: Vec<Entry> =
        [Entry::new(Symbol::Dot, VALID, words)].into_iter().chain(off_scale_entry(beyond)).collect();
    legend(svg, LEGEND, &entries);
}

/// The reference that the points of a profile are compared with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference {
    pub(super) ellipse: SectionEllipse,
    /// The cylinder that was fitted to all profiles, if `ellipse` is a section of it; distances are then those from its surface, as
    /// in the fit.
    pub(super) cylinder: Option<Cylinder>,
    /// Robust standard deviation of the residuals, mm.
    pub(super) sigma: f64,
    /// Distance below which a point is an inlier, mm; infinite if the method distinguishes none.
    pub(super) limit: f64,
}

/// A point and its position relative to the reference.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged {
    /// y and z in the plane of the profile, mm.
    pub(super) at: [f64; 2],
    /// Distance from the reference, outside positive, mm.
    pub(super) residual: f64,
    /// Direction from the centre, from +Y towards +Z, degrees.
    pub(super) degrees: f64,
    pub(super) kind: Kind,
}

/// Inlier or outlier, and its weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A point of a method with equal weights and without verdicts.
    Equal,
    /// Inlier, weight above 0.75.
    InlierHeavy,
    /// Inlier, weight 0.25 to 0.75.
    InlierMedium,
    /// Inlier, weight below 0.25.
    InlierLight,
    /// Outlier with a weight.
    Outlier,
    /// Outlier, weight 0.
    Excluded,
}

impl Kind {
    pub(super) const ALL: [Self; 6] =
        [Self::Equal, Self::InlierHeavy, Self::InlierMedium, Self::InlierLight, Self::Outlier, Self::Excluded];

    fn of(distance: f64, limit: f64, weight: f64) -> Self {
        match (distance < limit, weight) {
            _ if limit.is_infinite() => Self::Equal,
            (true, 0.75..) => Self::InlierHeavy,
            (true, 0.25..) => Self::InlierMedium,
            (true, _) => Self::InlierLight,
            (false, weight) if weight > 0.0 => Self::Outlier,
            (false, _) => Self::Excluded,
        }
    }

    pub(super) const fn words(self) -> &'static str {
        match self {
            Self::Equal => "points, equal weights",
            Self::InlierHeavy => "inliers, weight above 0.75",
            Self::InlierMedium => "inliers, weight 0.25 to 0.75",
            Self::InlierLight => "inliers, weight below 0.25",
            Self::Outlier => "outliers, weight above 0",
            Self::Excluded => "outliers, weight 0",
        }
    }

    pub(super) const fn look(self) -> (Symbol, &'static str) {
        let [light, medium, _] = INLIER;
        match self {
            Self::Equal | Self::InlierHeavy => (Symbol::Dot, VALID),
            Self::InlierMedium => (Symbol::Dot, medium),
            Self::InlierLight => (Symbol::Dot, light),
            Self::Outlier => (Symbol::Diamond, OUTLIER),
            Self::Excluded => (Symbol::Cross, EXCLUDED),
        }
    }
}

/// Compares every point of the profile at `x` with the reference. A method without re-weighting gives every point the weight 1.
pub(super) fn judge(points: &[[f64; 3]], x: f64, reference: &Reference, method: Method) -> Vec<Judged> {
    // An exact profile has no spread, but its points are not outliers.
    let reach = (TUKEY_C * reference.sigma).max(1e-9);
    let weight = |r: f64| match method {
        Method::SectionLine | Method::Cylinder if r.abs() < reach => (1.0 - (r / reach).powi(2)).powi(2),
        Method::SectionLine | Method::Cylinder => 0.0,
        Method::SectionLinePlain | Method::LeastSquares => 1.0,
    };
    let ellipse = &reference.ellipse;
    let judged = points.iter().map(|&[own_x, y, z]| {
        let (at, residual) = match &reference.cylinder {
            Some(cylinder) => {
                // The point is moved along the axis into the plane of the profile, which leaves its distance from the axis
                // unchanged.
                let step = own_x - x;
                let at = [y - cylinder.axis.p * step, z - cylinder.axis.q * step];
                (at, cylinder.polar([own_x, y, z]).distance - cylinder.radius)
            }
            None => ([y, z], first_order_distance(ellipse, [y, z])),
        };
        let degrees = (at[1] - ellipse.centre_z).atan2(at[0] - ellipse.centre_y).to_degrees();
        Judged { at, residual, degrees, kind: Kind::of(residual.abs(), reference.limit, weight(residual)) }
    });
    judged.filter(|point| point.residual.is_finite()).collect()
}

/// F/|∇F| with F = (u/a)² + (v/b)² − 1 in the ellipse's own axes, mm; not finite at its centre.
fn first_order_distance(ellipse: &SectionEllipse, [y, z]: [f64; 2]) -> f64 {
    let (sin, cos) = ellipse.rotation.radians().sin_cos();
    let (dy, dz) = (y - ellipse.centre_y, z - ellipse.centre_z);
    let (u, v) = ((dy * cos + dz * sin) / ellipse.semi_major, (dz * cos - dy * sin) / ellipse.semi_minor);
    let slope = 2.0 * (u / ellipse.semi_major).hypot(v / ellipse.semi_minor);
    (u * u + v * v - 1.0) / slope
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Angle, AxisLine};

    const ELLIPSE: SectionEllipse = SectionEllipse {
        centre_y: 3.0,
        centre_z: -2.0,
        semi_major: 201.0,
        semi_minor: 200.0,
        rotation: Angle::from_degrees(30.0),
    };

    #[test]
    fn the_residual_is_a_distance_with_a_sign() {
        for i in 0..12 {
            let [y, z] = ELLIPSE.point(f64::from(i) * 0.5);
            let outwards = |share: f64| [3.0 + (y - 3.0) * share, -2.0 + (z + 2.0) * share];
            assert!(first_order_distance(&ELLIPSE, [y, z]).abs() < 1e-9);
            // A thousandth of the radius further out is about 0.2 mm.
            assert!((first_order_distance(&ELLIPSE, outwards(1.001)) - 0.2).abs() < 2e-3);
            assert!((first_order_distance(&ELLIPSE, outwards(0.999)) + 0.2).abs() < 2e-3);
        }
    }

    /// Two points of one generating line have the same position in the profile and the same distance.
    #[test]
    fn points_outside_the_plane_of_their_profile_are_moved_along_the_axis() {
        let cylinder = Cylinder { axis: AxisLine { p: 0.1, q: -0.2, y0: 1.0, z0: 2.0 }, radius: 50.0 };
        let ellipse = cylinder.axis.section(50.2, 30.0);
        let [y, z] = ellipse.point(1.0);
        let reference = Reference { ellipse, cylinder: Some(cylinder), sigma: 0.05, limit: 0.111 };
        let points = [[30.0, y, z], [35.0, y + 0.5, z - 1.0]];
        let judged = judge(&points, 30.0, &reference, Method::Cylinder);
        for point in judged {
            assert!((point.at[0] - y).abs() < 1e-12 && (point.at[1] - z).abs() < 1e-12);
            assert!((point.residual - 0.2).abs() < 1e-9, "{point:?}");
        }
    }

    #[test]
    fn kinds_follow_distance_and_weight() {
        let kind = |distance: f64, method: Method| {
            let limit = method.inlier_limit_mm(0.111, 0.05);
            let reference = Reference { ellipse: ELLIPSE, cylinder: None, sigma: 0.05, limit };
            let z = ELLIPSE.point(0.0)[1];
            let [y, z] = [ELLIPSE.point(0.0)[0] + distance * 30f64.to_radians().cos(), z + distance * 0.5];
            judge(&[[7.0, y, z]], 7.0, &reference, method)[0].kind
        };
        // The reach is 4.6851 · 0.05 = 0.234 mm; at 0.1 mm the weight is (1 − 0.182)² = 0.67.
        let kinds = [0.01, 0.1, 0.15, 0.3].map(|d| kind(d, Method::SectionLine));
        assert_eq!(kinds, [Kind::InlierHeavy, Kind::InlierMedium, Kind::Outlier, Kind::Excluded]);
        assert_eq!(kind(0.3, Method::SectionLinePlain), Kind::Outlier);
        assert_eq!(kind(0.3, Method::LeastSquares), Kind::Equal);
    }
}
