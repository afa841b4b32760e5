//! The scan as seen along the axis towards one end: planes outward, points as places on the cylinder, and an offset turned
//! back into the point where the axis meets the end plane. Must not know how an end is told.
//!
//! With dx = x − x_ref, u and w from the axis in the plane of the profile and n² = 1 + p² + q² a point lies at
//! t = ±(n·dx + (p·u + q·w)/n), outward; ρ² = u² + w² − (p·u + q·w)²/n² is its squared distance from the axis.

use super::offset::Offset;
use super::sway::Sway;
use crate::estimation::conclude::median;
use crate::estimation::{End, Pose};
use crate::geometry::AxisLine;
use crate::scan::{Scan, Station};
use nalgebra::{Matrix5, Vector4, Vector5};
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

/// Steps from plane to plane whose mean is taken; and nearer than this share of what they are on average, the stage stood.
const STEPS: usize = 4;
const STANDING_SHARE: f64 = 0.01;

/// A profile's plane; one that holds no point has an empty range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plane {
    pub(super) x: f64,
    /// Where the axis is in it, outward from the reference point, mm.
    pub(super) ahead: f64,
    points: Range<usize>,
}

/// A point as a place on the cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Glimpse {
    /// Position of its plane among those looked at.
    pub(super) plane: usize,
    /// Outward along the axis, mm.
    pub(super) t: f64,
    /// The same of the surface in its direction, which its noise across the surface does not touch.
    pub(super) of_surface: f64,
    /// About the axis, from +Z towards +Y, radians.
    pub(super) angle: f64,
    /// Above the surface, mm.
    pub(super) height: f64,
}

/// The direction of looking.
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

    /// The planes from the reference outward, those without a point among them.
    pub(super) fn planes_outward(&self, scan: &Scan) -> Vec<Plane> {
        let full = scan.stations().iter().map(|s| Plane { x: s.x, ahead: self.ahead(s.x), points: s.start..s.end });
        let blank = scan.blanks().iter().map(|x| Plane { x: *x, ahead: self.ahead(*x), points: 0..0 });
        let mut planes: Vec<Plane> = full.chain(blank).filter(|plane| plane.ahead >= 0.0).collect();
        planes.sort_by(|a, b| a.ahead.total_cmp(&b.ahead));
        planes
    }

    /// Where the axis is in the plane at `x`, outward from the reference point, mm.
    fn ahead(&self, x: f64) -> f64 {
        self.side * self.n * (x - self.x_ref)
    }

    /// The points of the planes, at most as many of each, at a regular stride.
    pub(super) fn look(&self, scan: &Scan, planes: &[Plane], points_max: usize) -> Vec<Glimpse> {
        let mut glimpses = Vec::new();
        for (index, plane) in planes.iter().enumerate() {
            let stride = plane.points.len().div_ceil(points_max).max(1);
            let station = Station { x: plane.x, start: plane.points.start, end: plane.points.end };
            let points = plane.points.clone().step_by(stride).filter_map(|point| scan.point(&station, point));
            glimpses.extend(points.map(|point| self.glimpse(index, point)));
        }
        glimpses
    }

    fn glimpse(&self, index: usize, [x, y, z]: [f64; 3]) -> Glimpse {
        let AxisLine { p, q, .. } = self.axis;
        let [axis_y, axis_z] = self.axis.at(x);
        let ahead = self.ahead(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let along = (p * u + q * w) / self.n;
        let distance = (u * u + w * w - along * along).max(0.0).sqrt();
        let [t, of_surface] =
            [along, along * self.radius / distance.max(f64::MIN_POSITIVE)].map(|along| ahead + self.side * along);
        Glimpse { plane: index, t, of_surface, angle: u.atan2(w), height: distance - self.radius }
    }

    /// How far ahead of its plane, along the axis, the surface lies in a direction about the axis.
    pub(super) fn lead(&self, angle: f64) -> f64 {
        let [u, w] = self.place(angle);
        self.side * (self.axis.p * u + self.axis.q * w) / self.n
    }

    /// By how much that grows per millimetre about the axis.
    pub(super) fn slope(&self, angle: f64) -> f64 {
        self.lead(angle + FRAC_PI_2) / self.radius
    }

    /// The radius of the cylinder, mm.
    pub(super) const fn radius(&self) -> f64 {
        self.radius
    }

    /// The surface in a direction about the axis, in the plane of a profile, from the axis.
    fn place(&self, angle: f64) -> [f64; 2] {
        let (sin, cos) = angle.sin_cos();
        let along = (self.axis.p * sin + self.axis.q * cos) / self.n;
        let reach = self.radius / (1.0 - along * along).sqrt();
        [reach * sin, reach * cos]
    }

    /// The point where the axis meets the plane at an offset.
    pub(super) fn point(&self, offset: &Offset) -> [f64; 3] {
        let x = self.x_at(offset.at.mean());
        let [y, z] = self.axis.at(x);
        [x, y, z]
    }

    /// How columns in these directions move with the pose about a place along the axis.
    pub(super) fn sway(&self, pose: &Matrix5<f64>, angles: impl Iterator<Item = f64>, t: f64) -> Option<Sway> {
        let covariance = pose.fixed_view::<4, 4>(0, 0).into_owned();
        let x = self.x_at(t);
        let derivatives: Vec<_> = angles.map(|angle| self.side * self.n * self.by_pose(x, angle)).collect();
        Sway::of(&derivatives, covariance)
    }

    /// The largest standard deviation by which the pose leaves open how high the surface is there.
    pub(super) fn height_open(&self, pose: &Matrix5<f64>, angles: impl Iterator<Item = f64>, t: f64) -> f64 {
        let AxisLine { p, q, .. } = self.axis;
        let dx = self.x_at(t) - self.x_ref;
        let variance = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let by = Vector5::new(sin * dx * (1.0 + p * p), cos * dx * (1.0 + q * q), sin, cos, 1.0);
            by.dot(&(pose * by))
        };
        angles.map(variance).fold(0.0, f64::max).sqrt()
    }

    /// Where the axis is at a place along it.
    fn x_at(&self, t: f64) -> f64 {
        self.x_ref + self.side * t / self.n
    }

    /// Half of the half-width along x that holds 95.45 %, with this variance of x beside what the offset leaves open.
    pub(super) fn half_of_expanded(&self, offset: &Offset, variance: f64) -> f64 {
        let normal = offset.normal + self.n * self.n * variance;
        (offset.at.half_of_expanded(normal.sqrt()) + offset.untold) / self.n
    }

    /// The point's x by (deflection, pitch, y_ref, z_ref) where the edge is seen in one direction about the axis.
    ///
    /// The edge E is what stays where it is when the axis is taken to be another: the point's x = x_E + (p·u + q·w)/n²,
    /// u = y_E − y_ref − p·dx, w = z_E − z_ref − q·dx, has the derivatives (u − p·dx)/n² − 2p(p·u + q·w)/n⁴ by p, −p/n² by
    /// y_ref, and likewise by q and z_ref.
    fn by_pose(&self, x: f64, angle: f64) -> Vector4<f64> {
        let AxisLine { p, q, .. } = self.axis;
        let n2 = self.n * self.n;
        let [u, w] = self.place(angle);
        let along = p * u + q * w;
        let dx = x - along / n2 - self.x_ref;
        // The slopes' derivatives by the angles are 1 + p² and 1 + q².
        Vector4::new(
            ((u - p * dx) / n2 - 2.0 * p * along / (n2 * n2)) * (1.0 + p * p),
            ((w - q * dx) / n2 - 2.0 * q * along / (n2 * n2)) * (1.0 + q * q),
            -p / n2,
            -q / n2,
        )
    }
}

/// Usual distance of neighbouring planes along the axis, mm: the median of the mean over a few steps, since planes may come
/// in pairs; `None` below two planes.
pub(super) fn spacing(planes: &[Plane]) -> Option<f64> {
    let range = planes.last()?.ahead - planes.first()?.ahead;
    let apart = STANDING_SHARE * range / planes.len() as f64;
    let mut places: Vec<f64> = planes.iter().map(|plane| plane.ahead).collect();
    places.dedup_by(|next, place| *next - *place < apart);
    let steps_count = STEPS.min(places.len().checked_sub(1)?);
    let run = |places: &[f64]| Some((places.last()? - places.first()?) / steps_count as f64);
    median(places.windows(1 + steps_count).filter_map(run)).filter(|spacing| *spacing > 0.0)
}

/// At most `most` of the planes, at a regular stride.
pub(super) fn thin(planes: &[Plane], most: usize) -> Vec<Plane> {
    planes.iter().step_by(planes.len().div_ceil(most).max(1)).cloned().collect()
}
