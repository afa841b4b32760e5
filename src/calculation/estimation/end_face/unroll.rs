//! Unrolls the cylinder about the pose: a point becomes an angle about the axis, a position along it and a height above the
//! surface. Positions grow outward, towards the end that is sought, from the reference point of the pose.
//!
//! With dx = x − x_ref, u and w from the axis in the plane of the profile and n² = 1 + p² + q² a point lies at t = ±(n·dx + (p·u +
//! q·w)/n); its squared distance from the axis is u² + w² − (p·u + q·w)²/n².

use crate::estimation::estimate::Pose;
use crate::estimation::settings::End;
use crate::estimation::statistics::median;
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};
use nalgebra::{Matrix5, Vector4, Vector5};
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

/// Number of steps from plane to plane that are averaged: some sensors alternate between two or three heads.
const STEPS: usize = 4;
/// A step below this share of the mean step means that the stage stood still.
const STANDING_SHARE: f64 = 0.01;

/// The plane of a profile; one without points has an empty range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plane {
    pub(super) x: f64,
    /// Intersection with the axis, mm along the axis.
    pub(super) t: f64,
    pub(super) points: Range<usize>,
}

/// A point in cylinder coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unrolled {
    /// Index of its plane.
    pub(super) plane: usize,
    /// Position along the axis, mm.
    pub(super) t: f64,
    /// The position at which its line of sight meets the surface; noise across the surface does not change it.
    pub(super) t_on_surface: f64,
    /// About the axis, from +Z towards +Y, radians.
    pub(super) angle: f64,
    /// Above the surface, mm.
    pub(super) height: f64,
}

/// The cylinder coordinates of a pose, outward towards one end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    axis: AxisLine,
    x_ref: f64,
    radius: f64,
    /// |(1, p, q)|.
    n: f64,
    /// −1 towards smaller x, 1 towards larger.
    side: f64,
}

impl View {
    pub(super) fn new(pose: &Pose, end: End) -> Self {
        let AxisLine { p, q, .. } = pose.axis;
        let side = match end {
            End::Near => -1.0,
            End::Far => 1.0,
        };
        Self { axis: pose.axis, x_ref: pose.x_ref, radius: pose.radius, n: (1.0 + p * p + q * q).sqrt(), side }
    }

    /// The planes from the reference point outward, including those of profiles without points.
    pub(super) fn planes_outward(&self, scan: &Scan) -> Vec<Plane> {
        let plane = |x: f64, points: Range<usize>| Plane { x, t: self.plane_at(x), points };
        let full = scan.stations().iter().map(|station| plane(station.x, station.start..station.end));
        let blank = scan.blanks().iter().map(|x| plane(*x, 0..0));
        let mut planes: Vec<Plane> = full.chain(blank).filter(|plane| plane.t >= 0.0).collect();
        planes.sort_by(|a, b| a.t.total_cmp(&b.t));
        planes
    }

    /// Intersection of the axis with the plane at `x`.
    fn plane_at(&self, x: f64) -> f64 {
        self.side * self.n * (x - self.x_ref)
    }

    /// The points of the planes, at most `points_max` of each at a regular stride.
    pub(super) fn unroll(&self, scan: &Scan, planes: &[Plane], points_max: usize) -> Vec<Unrolled> {
        let mut unrolled = Vec::new();
        for (index, plane) in planes.iter().enumerate() {
            let stride = plane.points.len().div_ceil(points_max).max(1);
            let station = Station { x: plane.x, start: plane.points.start, end: plane.points.end };
            let points = plane.points.clone().step_by(stride).filter_map(|point| scan.point(&station, point));
            unrolled.extend(points.map(|point| self.point(index, point)));
        }
        unrolled
    }

    fn point(&self, plane: usize, [x, y, z]: [f64; 3]) -> Unrolled {
        let AxisLine { p, q, .. } = self.axis;
        let [axis_y, axis_z] = self.axis.at(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let along = (p * u + q * w) / self.n;
        let distance = (u * u + w * w - along * along).max(0.0).sqrt();
        let on_surface = along * self.radius / distance.max(f64::MIN_POSITIVE);
        let [t, t_on_surface] = [along, on_surface].map(|along| self.plane_at(x) + self.side * along);
        Unrolled { plane, t, t_on_surface, angle: u.atan2(w), height: distance - self.radius }
    }

    /// Lead of the surface over its plane in a direction about the axis, mm along the axis.
    fn lead(&self, angle: f64) -> f64 {
        let [u, w] = self.surface(angle);
        self.side * (self.axis.p * u + self.axis.q * w) / self.n
    }

    /// The surface in a direction about the axis, relative to the axis in the plane of a profile.
    fn surface(&self, angle: f64) -> [f64; 2] {
        let (sin, cos) = angle.sin_cos();
        let along = (self.axis.p * sin + self.axis.q * cos) / self.n;
        let reach = self.radius / (1.0 - along * along).sqrt();
        [reach * sin, reach * cos]
    }

    fn x_at(&self, t: f64) -> f64 {
        self.x_ref + self.side * t / self.n
    }

    /// The point of the axis at a position along it.
    pub(super) fn axis_at(&self, t: f64) -> [f64; 3] {
        let x = self.x_at(t);
        let [y, z] = self.axis.at(x);
        [x, y, z]
    }

    /// Ratio of a length along x to the length along the axis.
    pub(super) fn x_by_t(&self) -> f64 {
        self.n.recip()
    }

    /// The largest standard deviation, over the columns, of the height of the surface at a position due to the pose.
    pub(super) fn height_uncertainty(&self, pose: &Matrix5<f64>, columns: &Columns, t: f64) -> f64 {
        let AxisLine { p, q, .. } = self.axis;
        let dx = self.x_at(t) - self.x_ref;
        let variance = |column: &Column| {
            let (sin, cos) = column.angle.sin_cos();
            let by = Vector5::new(sin * dx * (1.0 + p * p), cos * dx * (1.0 + q * q), sin, cos, 1.0);
            by.dot(&(pose * by))
        };
        columns.all.iter().map(variance).fold(0.0, f64::max).sqrt()
    }

    /// Derivatives of the position of an edge along the axis, in one direction about it, by (deflection, pitch, y_ref, z_ref).
    ///
    /// The edge E stays fixed if the axis changes: x = x_E + (p·u + q·w)/n² with u = y_E − y_ref − p·dx and w = z_E − z_ref − q·dx
    /// has the derivatives (u − p·dx)/n² − 2p(p·u + q·w)/n⁴ by p, −p/n² by y_ref, and likewise by q and z_ref.
    pub(super) fn edge_by_pose(&self, angle: f64, t: f64) -> Vector4<f64> {
        let AxisLine { p, q, .. } = self.axis;
        let n2 = self.n * self.n;
        let [u, w] = self.surface(angle);
        let along = p * u + q * w;
        let dx = self.x_at(t) - along / n2 - self.x_ref;
        // The derivatives of the slopes by the angles are 1 + p² and 1 + q².
        let x_by_pose = Vector4::new(
            ((u - p * dx) / n2 - 2.0 * p * along / (n2 * n2)) * (1.0 + p * p),
            ((w - q * dx) / n2 - 2.0 * q * along / (n2 * n2)) * (1.0 + q * q),
            -p / n2,
            -q / n2,
        );
        x_by_pose * self.side * self.n
    }
}

/// Usual distance between neighbouring planes along the axis, mm: the median of the mean over a few steps; `None` for fewer than
/// two planes.
pub(super) fn spacing(planes: &[Plane]) -> Option<f64> {
    let range = planes.last()?.t - planes.first()?.t;
    let standing = STANDING_SHARE * range / planes.len() as f64;
    let mut places: Vec<f64> = planes.iter().map(|plane| plane.t).collect();
    places.dedup_by(|next, place| *next - *place < standing);
    let steps_count = STEPS.min(places.len().checked_sub(1)?);
    let mean_step = |places: &[f64]| Some((places.last()? - places.first()?) / steps_count as f64);
    median(places.windows(1 + steps_count).filter_map(mean_step)).filter(|spacing| *spacing > 0.0)
}

/// At most `planes_max` of the planes, at a regular stride.
pub(super) fn thin(planes: &[Plane], planes_max: usize) -> Vec<Plane> {
    planes.iter().step_by(planes.len().div_ceil(planes_max).max(1)).cloned().collect()
}

/// Divides the angles about the axis into columns that contain equally many points of the part.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    /// The angle at which each column except the first begins, radians.
    pub(super) bounds: Vec<f64>,
    /// In order of their angle.
    pub(super) all: Vec<Column>,
    pub(super) radius: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    /// Median direction of its points, radians.
    pub(super) angle: f64,
    /// Lead of the surface over its plane, mm along the axis.
    pub(super) lead: f64,
    /// Change of the lead per millimetre about the axis, and per millimetre away from it.
    pub(super) slope: [f64; 2],
    /// The column beside it with a smaller lead.
    pub(super) before: Option<usize>,
    /// Whether the lead grows with the angle: the part has two flanks where the sign changes.
    pub(super) rising: bool,
}

impl Columns {
    /// `None` if there are fewer points than columns.
    pub(super) fn of(mut angles: Vec<f64>, columns_count: usize, view: &View) -> Option<Self> {
        if columns_count == 0 || angles.len() < columns_count {
            return None;
        }
        angles.sort_by(f64::total_cmp);
        let at = |share: f64| angles.get((share * angles.len() as f64 / columns_count as f64) as usize).copied();
        let bound = |index: usize| {
            let upper = index * angles.len() / columns_count;
            Some(0.5 * (angles.get(upper.checked_sub(1)?)? + angles.get(upper)?))
        };
        let angle: Vec<f64> = (0..columns_count).filter_map(|index| at(index as f64 + 0.5)).collect();
        let leads: Vec<f64> = angle.iter().map(|angle| view.lead(*angle)).collect();
        let column = |(index, (&angle, &lead)): (usize, (&f64, &f64))| {
            let beside = [index.checked_sub(1), Some(index + 1)].into_iter().flatten();
            let earlier = |other: &usize| leads.get(*other).is_some_and(|of_other| (*of_other, *other) < (lead, index));
            let before = beside.into_iter().find(earlier);
            let rising = before.map_or(index + 1 < leads.len(), |before| before < index);
            let slope = [view.lead(angle + FRAC_PI_2) / view.radius, lead / view.radius];
            Column { angle, lead, slope, before, rising }
        };
        let all = angle.iter().zip(&leads).enumerate().map(column).collect();
        Some(Self { bounds: (1..columns_count).filter_map(bound).collect(), all, radius: view.radius })
    }

    /// Index of the column that contains a direction.
    pub(super) fn index_of(&self, angle: f64) -> usize {
        self.bounds.partition_point(|bound| *bound <= angle)
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    /// Least and largest lead, mm.
    pub(super) fn leads(&self) -> [f64; 2] {
        let leads = self.all.iter().map(|column| column.lead);
        leads.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], lead| [least.min(lead), most.max(lead)])
    }

    /// Mean step from one column to the next along the axis, mm.
    pub(super) fn mean_step(&self) -> f64 {
        let pairs = self.all.windows(2).filter_map(|pair| Some((pair.last()?.lead - pair.first()?.lead).abs()));
        pairs.sum::<f64>() / self.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: View = View {
        axis: AxisLine { p: 0.05, q: -0.07, y0: 3.0, z0: -2.0 },
        x_ref: 10.0,
        radius: 20.0,
        n: 1.003_693,
        side: 1.0,
    };

    /// A point 0.5 mm off the surface along its line of sight.
    #[test]
    fn noise_across_the_surface_does_not_move_the_position_on_it() {
        let [y, z] = VIEW.axis.at(30.0);
        let [u, w] = VIEW.surface(0.6);
        let [on, off] = [1.0, 1.025].map(|share| VIEW.point(0, [30.0, y + share * u, z + share * w]));
        assert!((on.height.abs() < 1e-4) && (off.height - 0.5).abs() < 1e-4, "{on:?} {off:?}");
        assert!((on.t - VIEW.plane_at(30.0) - VIEW.lead(0.6)).abs() < 1e-4, "{on:?}");
        assert!((off.t_on_surface - on.t).abs() < 1e-6 && (off.t - on.t).abs() > 0.01, "{on:?} {off:?}");
    }
}
