//! The truth of a synthetic scan, and the Cramér-Rao bound of the pose from the points that lie on the part, for independent normal
//! noise along the surface normal. [`placed`] moves scan and truth as a rigid body into the coordinates of another instrument, as
//! an unorganised cloud.
//!
//! The bound does not apply to scans with sensor errors, encoder noise or rounding, which make a pose less certain than the bound,
//! nor to heavy tails, for which an estimator can be more precise.

use super::part::Part;
use crate::geometry::{Axis, AxisLine, Frame, FrameError};
use crate::scan::columns::Columns;
use crate::scan::{Grouping, Scan, ScanError, Station};
use nalgebra::{Matrix3, Matrix5, Vector3, Vector5};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// The true values of a synthetic scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Number of simulated profiles.
    pub profiles_count: usize,
    /// Points a profile before drop-outs.
    pub points_per_profile_count: usize,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Standard deviation of the noise in y and in z, mm.
    pub noise_sigma_mm: f64,
    /// atan p, degrees.
    pub deflection_deg: f64,
    /// atan q, degrees.
    pub pitch_deg: f64,
    /// y of the intersection of the axis with x = 0, mm.
    pub y_c0_mm: f64,
    /// z of the intersection of the axis with x = 0, mm.
    pub z_c0_mm: f64,
    /// Middle of the profiles, mm.
    pub x_ref_mm: f64,
    /// y of the axis at `x_ref_mm`, mm.
    pub y_ref_mm: f64,
    /// z of the axis at `x_ref_mm`, mm.
    pub z_ref_mm: f64,
    /// Lower bounds of the standard deviations of any unbiased estimator; `None` without noise.
    pub bound: Option<Bound>,
    /// Intersection of the axis with the near end plane, mm; `None` if the part continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub near_end_face_mm: Option<[f64; 3]>,
    /// Intersection of the axis with the far end plane, mm; `None` if the part continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub far_end_face_mm: Option<[f64; 3]>,
    /// Share of each profile's points that lie on the part.
    pub inner_ratio_per_profile: Vec<f64>,
    #[serde(skip)]
    information: Matrix5<f64>,
}

/// Cramér-Rao bounds of the pose with the radius free.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bound {
    /// Bound of the deflection, degrees.
    pub deflection_deg: f64,
    /// Bound of the pitch, degrees.
    pub pitch_deg: f64,
    /// Bound of y at x_ref, mm.
    pub y_ref_mm: f64,
    /// Bound of z at x_ref, mm.
    pub z_ref_mm: f64,
    /// Bound of the radius, mm.
    pub radius_mm: f64,
}

impl Truth {
    /// The axis.
    #[must_use]
    pub fn axis(&self) -> AxisLine {
        let slope = |degrees: f64| degrees.to_radians().tan();
        let (p, q) = (slope(self.deflection_deg), slope(self.pitch_deg));
        AxisLine { p, q, y0: self.y_c0_mm, z0: self.z_c0_mm }
    }

    pub(super) fn begin(part: &Part) -> Self {
        let x_ref_mm = part.x_start_mm + part.length_mm / 2.0;
        let [y_ref_mm, z_ref_mm] = part.axis.at(x_ref_mm);
        Self {
            profiles_count: part.profiles_count,
            points_per_profile_count: part.points_count,
            radius_mm: part.radius_mm,
            noise_sigma_mm: part.noise_sigma_mm,
            deflection_deg: part.axis.deflection().degrees(),
            pitch_deg: part.axis.pitch().degrees(),
            y_c0_mm: part.axis.y0,
            z_c0_mm: part.axis.z0,
            x_ref_mm,
            y_ref_mm,
            z_ref_mm,
            bound: None,
            near_end_face_mm: part.edges.near.map(|edge| edge.centre(&part.axis)),
            far_end_face_mm: part.edges.far.map(|edge| edge.centre(&part.axis)),
            inner_ratio_per_profile: Vec::with_capacity(part.profiles_count),
            information: Matrix5::zeros(),
        }
    }

    /// Adds the information of a point on the surface about (p, q, y_ref, z_ref, R): the derivatives of its distance from the
    /// cylinder are ∂d/∂y_ref = −(u − p·s)/ρ, ∂d/∂z_ref = −(w − q·s)/ρ, those by the slopes are the same times (dx + s), ∂d/∂R =
    /// −1.
    pub(super) fn add_inner_point(&mut self, part: &Part, [x, y, z]: [f64; 3]) {
        let (p, q, dx) = (part.axis.p, part.axis.q, x - self.x_ref_mm);
        let [axis_y, axis_z] = part.axis.at(x);
        let (u, w) = (y - axis_y, z - axis_z);
        let s = (p * u + q * w) / (1.0 + p * p + q * q);
        let (by_y, by_z) = (-(u - p * s) / part.radius_mm, -(w - q * s) / part.radius_mm);
        let row = Vector5::new(by_y * (dx + s), by_z * (dx + s), by_y, by_z, -1.0);
        self.information += row * row.transpose();
    }

    pub(super) fn end_profile(&mut self, inner_count: usize, points_count: usize) {
        self.inner_ratio_per_profile.push(inner_count as f64 / points_count.max(1) as f64);
    }

    pub(super) fn end(mut self, part: &Part) -> Self {
        self.bound = self.information.try_inverse().filter(|_| part.noise_sigma_mm > 0.0).map(|inverse| {
            let standard = inverse.diagonal().map(|variance| variance.sqrt() * part.noise_sigma_mm);
            let [p, q, y_ref_mm, z_ref_mm, radius_mm] = standard.into();
            Bound {
                deflection_deg: f64::to_degrees(p / (1.0 + part.axis.p.powi(2))),
                pitch_deg: f64::to_degrees(q / (1.0 + part.axis.q.powi(2))),
                y_ref_mm,
                z_ref_mm,
                radius_mm,
            }
        });
        self
    }
}

/// The truth of a moved scan, in its coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlacedTruth {
    /// The axis; its point is the one at `x_ref_mm` of the original scan.
    pub axis: Axis,
    /// Radius, mm.
    pub radius_mm: f64,
    /// Standard deviation of the noise of the original scan, in y and in z, mm.
    pub noise_sigma_mm: f64,
    /// Intersection of the axis with the near end plane, mm; `None` if the part continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub near_end_face_mm: Option<[f64; 3]>,
    /// Intersection of the axis with the far end plane, mm; `None` if the part continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub far_end_face_mm: Option<[f64; 3]>,
    /// The rail frame in the coordinates of the moved scan: declared in a recipe, it reverses the motion.
    pub frame: Frame,
    /// The truth in the rail frame.
    pub in_rail_frame: Truth,
}

/// Why a scan cannot be moved.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlacementError {
    /// The frame is invalid.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A coordinate becomes infinite.
    #[error(transparent)]
    Scan(#[from] ScanError),
}

/// The scan with its rail frame at `frame`, as a cloud: the points are not grouped into profiles, and with a seed they are in
/// random order.
///
/// # Errors
/// [`PlacementError`] if the frame is invalid or a point becomes infinite.
pub fn placed(scan: &Scan, frame: &Frame, shuffle_seed: Option<u64>) -> Result<Scan, PlacementError> {
    let motion = Motion::new(frame)?;
    let before = scan.stations().iter().flat_map(|station| scan.points_of(station));
    let mut points: Vec<[f64; 3]> = before.map(|point| motion.of_point(point)).collect();
    if let Some(seed) = shuffle_seed {
        points.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
    }
    Ok(cloud(&points)?)
}

impl Truth {
    /// The truth of the scan with its rail frame at `frame`.
    ///
    /// # Errors
    /// [`FrameError`] if the frame is invalid.
    pub fn placed(&self, frame: &Frame) -> Result<PlacedTruth, FrameError> {
        let motion = Motion::new(frame)?;
        let point_mm = motion.of_point([self.x_ref_mm, self.y_ref_mm, self.z_ref_mm]);
        Ok(PlacedTruth {
            axis: Axis { point_mm, direction: motion.of_direction(self.axis().direction()) },
            radius_mm: self.radius_mm,
            noise_sigma_mm: self.noise_sigma_mm,
            near_end_face_mm: self.near_end_face_mm.map(|point| motion.of_point(point)),
            far_end_face_mm: self.far_end_face_mm.map(|point| motion.of_point(point)),
            frame: *frame,
            in_rail_frame: self.clone(),
        })
    }
}

/// The rigid motion that maps the rail frame to another frame.
struct Motion {
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
}

impl Motion {
    fn new(frame: &Frame) -> Result<Self, FrameError> {
        Ok(Self { rotation: frame.rotation()?.transpose(), origin: Vector3::from(frame.origin_mm) })
    }

    fn of_point(&self, point: [f64; 3]) -> [f64; 3] {
        (self.origin + self.rotation * Vector3::from(point)).into()
    }

    fn of_direction(&self, direction: [f64; 3]) -> [f64; 3] {
        (self.rotation * Vector3::from(direction)).into()
    }
}

/// All points in one group, in their order.
fn cloud(points: &[[f64; 3]]) -> Result<Scan, ScanError> {
    let column = |axis: usize| points.iter().filter_map(|point| point.get(axis).copied()).collect::<Vec<f64>>();
    let own_x = column(0);
    let mut sorted = own_x.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let x = sorted.get(sorted.len() / 2).copied().ok_or(ScanError::Empty)?;
    let station = Station { x, start: 0, end: points.len() };
    let scan = Scan::new(vec![station], Columns::F64 { y: column(1), z: column(2) }, "synthetic".to_owned())?;
    Ok(scan.with_own_x(own_x)?.with_grouping(Grouping::Chosen))
}

/// A frame with a random orientation, uniformly distributed, and its origin within `reach_mm` of the old one along each axis.
#[must_use]
pub fn random_frame(seed: u64, reach_mm: f64) -> Frame {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut direction = || -> [f64; 3] { std::array::from_fn(|_| StandardNormal.sample(&mut chance)) };
    let (x_axis, z_axis) = (direction(), direction());
    let origin_mm = std::array::from_fn(|_| reach_mm * (2.0 * chance.random::<f64>() - 1.0));
    Frame { origin_mm, x_axis, z_axis }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::decode::Request;
    use crate::scan::decode::{Format, Limits, decode};
    use crate::scan::encode::encode;
    use crate::scan::slice::{SliceRequest, slice};
    use crate::scan::synthetic::{Edge, Edges, Part, make};

    fn part() -> Part {
        let far = Some(Edge { x_mm: 790.0, ..Edge::default() });
        let edges = Edges { near: None, far };
        Part { noise_sigma_mm: 0.0, profiles_count: 20, points_count: 50, edges, ..Part::smooth(1) }
    }

    #[test]
    fn the_moved_points_lie_on_the_moved_cylinder() {
        let part = part();
        let (scan, truth) = make(&part).expect("a scan");
        for seed in 0..20 {
            let frame = random_frame(seed, 1000.0);
            let cloud = placed(&scan, &frame, Some(seed)).expect("a frame");
            let placed = truth.placed(&frame).expect("a frame");
            assert_eq!((cloud.points().len(), cloud.grouping()), (scan.points().len(), Grouping::Chosen));
            for point in cloud.points_of(&cloud.stations()[0]) {
                assert!((placed.axis.distance(point) - 200.0).abs() < 1e-9);
            }
            let far = placed.far_end_face_mm.expect("an end");
            let [x, ..] = truth.far_end_face_mm.expect("an end");
            let along = (x - truth.x_ref_mm) * (1.0 + part.axis.p.powi(2) + part.axis.q.powi(2)).sqrt();
            let from_point: Vec<f64> = (0..3).map(|i| far[i] - placed.axis.point_mm[i]).collect();
            let seen: f64 = (0..3).map(|i| from_point[i] * placed.axis.direction[i]).sum();
            assert!((seen - along).abs() < 1e-9 && placed.axis.distance(far) < 1e-9);
        }
    }

    #[test]
    fn the_declared_frame_restores_the_points_in_their_order() {
        let (scan, truth) = make(&part()).expect("a scan");
        let frame = random_frame(3, 500.0);
        let cloud = placed(&scan, &frame, None).expect("a frame");
        let rotation = truth.placed(&frame).expect("a frame").frame.rotation().expect("a frame");
        let before = scan.stations().iter().flat_map(|station| scan.points_of(station));
        for (before, point) in before.zip(cloud.points_of(&cloud.stations()[0])) {
            let back = rotation * (Vector3::from(point) - Vector3::from(frame.origin_mm));
            assert!((back - Vector3::from(before)).norm() < 1e-9);
        }
    }

    #[test]
    fn a_shuffled_cloud_contains_the_same_points_in_another_order() {
        let (scan, _) = make(&part()).expect("a scan");
        let cloud = |shuffle| {
            let cloud = placed(&scan, &random_frame(3, 500.0), shuffle).expect("a frame");
            cloud.points_of(&cloud.stations()[0]).map(|point| point.map(f64::to_bits)).collect::<Vec<_>>()
        };
        let (mut plain, mut shuffled) = (cloud(None), cloud(Some(1)));
        assert!(plain != shuffled && shuffled == cloud(Some(1)));
        plain.sort_unstable();
        shuffled.sort_unstable();
        assert_eq!(plain, shuffled);
    }

    #[test]
    fn files_of_a_moved_scan_are_read_as_clouds() {
        let (scan, _) = make(&Part { points_count: 200, ..part() }).expect("a scan");
        let cloud = placed(&scan, &random_frame(3, 500.0), Some(1)).expect("a frame");
        let limits = Limits::default();
        for format in [Format::Csv, Format::Ply, Format::Pcd, Format::Npy, Format::Npz] {
            let mut bytes = Vec::new();
            encode(&cloud, format, &mut bytes).expect("writes to memory");
            let request = Request::new(&limits);
            let read = decode(format, &mut &*bytes, &request).expect("it reads");
            let read = slice(read, &SliceRequest::default(), &limits).expect("it slices");
            assert_eq!((read.grouping(), read.points().len()), (Grouping::Chosen, cloud.points().len()), "{format}");
        }
    }

    #[test]
    fn random_frames_point_in_all_directions() {
        // The component of a direction along X is uniform from −1 to 1: its mean of 2000 scatters by √(1/3/2000) = 0.013, and
        // that of its square, with variance 4/45, by 0.0067 about 1/3.
        let along: Vec<f64> = (0..2000)
            .map(|seed| {
                let frame = random_frame(seed, 1.0);
                Vector3::from(frame.x_axis).normalize().x
            })
            .collect();
        let mean = |of: fn(f64) -> f64| along.iter().map(|x| of(*x)).sum::<f64>() / 2000.0;
        assert!(mean(|x| x).abs() < 4.0 * 0.013 && (mean(|x| x * x) - 1.0 / 3.0).abs() < 4.0 * 0.0067);
    }
}
