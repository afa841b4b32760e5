//! The result of an estimation: the pose or the reason why there is none, and the verdict on every profile. The structure is stored
//! unchanged. A pose in the frame of its sections can be converted into the coordinates of the scan.

use super::refusal::{Reason, Refusal};
use super::section_cut::SectionCut;
use super::settings::{EndFaceRule, Method};
use super::warning::Warning;
use crate::geometry::{Angle, Axis, AxisLine, SectionEllipse};
use nalgebra::{Matrix2, Matrix3, Matrix5, Vector3, Vector5};
use serde::{Deserialize, Serialize};

/// The result of one estimation; a refusal is a result too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The method.
    pub method: Method,
    /// The pose, or the reason why there is none.
    pub outcome: Outcome,
    /// One entry a profile, in station order.
    pub profiles: Vec<Profile>,
    /// How well the geometry of the scan determines a pose.
    pub conditioning: Conditioning,
    /// Residuals of the points of the valid profiles about their sections, or of all fitted profiles if none of those behind a pose
    /// is valid; `None` if there are none.
    pub residuals: Option<Residuals>,
}

/// Accepted with a pose, or refused with a reason.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The pose can be used.
    Accepted(Box<Pose>),
    /// There is no pose; the reason.
    Refused(Refusal),
}

/// The pose of the part's axis in the rail frame. The scan does not show the roll, so it is absent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The axis.
    pub axis: AxisLine,
    /// Mean x of the profiles used, mm: there the uncertainty of the position is smallest and nearly uncorrelated with the angles.
    pub x_ref: f64,
    /// How the points were cut into sections perpendicular to the axis, if the profiles of the scan could not be used; axis,
    /// position and uncertainty are then in the frame of the cut, and otherwise in the rail frame.
    #[serde(default)]
    pub cut: Option<SectionCut>,
    /// Radius of the part, mm.
    pub radius: f64,
    /// The source of the radius.
    pub radius_source: RadiusSource,
    /// The uncertainty of the pose.
    pub uncertainty: Uncertainty,
    /// Intersections of the axis with the part's end planes, if requested and observed.
    #[serde(default)]
    pub end_faces: EndFaces,
}

/// The end faces of a part.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EndFaces {
    /// The requested value.
    pub asked: EndFaceRule,
    /// The one at the smaller x; `None` if it was not requested or not observed.
    pub near: Option<EndFace>,
    /// The one at the larger x; `None` if it was not requested or not observed.
    pub far: Option<EndFace>,
}

impl EndFaces {
    /// The end face that was requested; the near one if both were.
    #[must_use]
    pub fn asked_one(&self) -> Option<EndFace> {
        match self.asked {
            EndFaceRule::None => None,
            EndFaceRule::Near | EndFaceRule::Both => self.near,
            EndFaceRule::Far => self.far,
        }
    }

    /// The far end face if both were requested.
    #[must_use]
    pub fn other_one(&self) -> Option<EndFace> {
        self.far.filter(|_| self.asked == EndFaceRule::Both)
    }
}

/// Intersection of the axis with an end plane, which is assumed perpendicular to it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EndFace {
    /// The point, mm.
    pub centre: [f64; 3],
    /// Uncertainty of its x, mm, from the plane's offset along the axis and from the pose together. Twice this contains 95.45 % of
    /// the distribution, as two standard uncertainties do of a normal one. The contribution of the profile spacing is uniform, and
    /// its standard deviation is a fifth larger than this.
    pub x_standard: f64,
}

/// The source of a radius.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RadiusSource {
    /// Fitted to the data alone.
    Fitted,
    /// Fixed at the nominal value.
    Nominal,
    /// Fitted to the data with the nominal radius as a prior.
    Prior,
}

/// Covariance of (deflection, pitch, y_ref, z_ref, radius) in radians and millimetres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// The combined covariance matrix, rows and columns in the order above.
    pub covariance: [[f64; 5]; 5],
    /// The lines of the budget.
    pub budget: Vec<Component>,
    /// Degrees of freedom of the standard uncertainties in the order above, combined over the budget by Welch-Satterthwaite (JCGM
    /// 100, G.4); `None` if infinite, and in results that were stored without them. The covariance is already widened for them.
    #[serde(default)]
    pub effective_freedom: [Option<f64>; 5],
    /// The same for y and z of the intersection of the axis with x = 0.
    #[serde(default)]
    pub effective_freedom_at_origin: [Option<f64>; 2],
}

/// One line of the uncertainty budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Component {
    /// The source of the uncertainty, e.g. `repeatability`.
    pub source: String,
    /// Its covariance of (deflection, pitch, y_ref, z_ref, radius); `None` in results that were stored without it.
    #[serde(default)]
    pub covariance: Option<[[f64; 5]; 5]>,
    /// Standard uncertainties of (deflection, pitch, y_ref, z_ref, radius) in radians and millimetres.
    pub standard: [f64; 5],
    /// Standard uncertainties of y and z of the intersection of the axis with x = 0, mm; `None` in results that were stored without
    /// them.
    #[serde(default)]
    pub standard_at_origin: Option<[f64; 2]>,
}

/// The verdict on one profile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Its plane, mm.
    pub x: f64,
    /// Its number of points.
    pub points_count: usize,
    /// Why it was rejected; `None` for a valid profile.
    pub rejected: Option<Reason>,
    /// Its fitted section; `None` if no ellipse could be fitted.
    pub section: Option<Section>,
    /// Distance of its centre from the axis, mm; `None` without a section or an axis.
    pub offset: Option<f64>,
}

/// The fitted section of a profile and the residuals of its points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// The ellipse.
    pub ellipse: SectionEllipse,
    /// Robust spread of the residuals, 1.4826 times their median absolute value, mm.
    pub sigma: f64,
    /// Share of the points nearer than ε.
    pub inlier_ratio: f64,
    /// Root mean square residual of the inliers, mm; 0 without inliers.
    pub rms: f64,
    /// Angle that the inliers span, about the centre.
    pub arc: Angle,
    /// Number of fits.
    pub iterations_count: u32,
}

/// How well the geometry of the scan determines a pose, over the valid profiles (over all if none is valid).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditioning {
    /// Median arc of the sections; `None` without a section.
    pub arc: Option<Angle>,
    /// Span along x, mm.
    pub axial_length: f64,
    /// Reasons why the pose is less certain than its stated uncertainty.
    pub warnings: Vec<Warning>,
}

/// The residuals of the points of the valid profiles about their sections.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// Median of the sections' robust spreads, mm.
    pub sigma: f64,
    /// Share of inliers among all points of the valid profiles.
    pub inlier_ratio: f64,
}

/// The pose in the coordinates of the scan, expressed by slopes and by the intersections of the axis with planes x = const.
#[derive(Debug, Clone, PartialEq)]
pub struct OnRail {
    /// The axis.
    pub axis: AxisLine,
    /// The x of the point of the axis with the smallest uncertainty, mm.
    pub x_ref: f64,
    /// The uncertainty of deflection, pitch, y_ref, z_ref and radius.
    pub uncertainty: Uncertainty,
}

impl Pose {
    /// The axis in the coordinates of the scan, with the point of smallest uncertainty.
    #[must_use]
    pub fn axis_in_scan(&self) -> Axis {
        let [y, z] = self.axis.at(self.x_ref);
        let (rotation, origin) = self.placement();
        let point = origin + rotation * Vector3::new(self.x_ref, y, z);
        let direction = rotation * Vector3::from(self.axis.direction());
        Axis { point_mm: point.into(), direction: direction.normalize().into() }
    }

    /// The pose expressed by slopes and by the intersections of the axis with planes x = const of the scan; `None` if the axis lies
    /// too far from X.
    #[must_use]
    pub fn on_rail(&self) -> Option<OnRail> {
        if self.cut.is_none() {
            return Some(OnRail { axis: self.axis, x_ref: self.x_ref, uncertainty: self.uncertainty.clone() });
        }
        let placed = self.axis_in_scan();
        let axis = placed.line()?;
        let [x_ref, ..] = placed.point_mm;
        let uncertainty = self.uncertainty.transformed(&self.jacobian(&axis), &axis, x_ref);
        Some(OnRail { axis, x_ref, uncertainty })
    }

    /// Standard uncertainties perpendicular to the axis, in the direction in which each is largest: of its direction, rad, and of
    /// its point of smallest uncertainty, mm.
    #[must_use]
    pub fn axis_standard(&self) -> [f64; 2] {
        self.axis_standard_of(&self.uncertainty.covariance)
    }

    /// The same from one line of the budget.
    #[must_use]
    pub fn axis_standard_of(&self, covariance: &[[f64; 5]; 5]) -> [f64; 2] {
        let [by_p, by_q] = [self.axis.p, self.axis.q];
        // Perpendicular to the axis a change in y counts by the sine of the angle between Y and the axis; likewise a change in z,
        // and both combined. Slopes relative to the axis are small in its own frame, and within tilt_max_deg on the rail.
        let n2 = 1.0 + by_p * by_p + by_q * by_q;
        let square = Matrix2::new(1.0 + by_q * by_q, -by_p * by_q, -by_p * by_q, 1.0 + by_p * by_p) / n2;
        let covariance = Matrix5::from(*covariance);
        let to_slopes = Matrix2::new(1.0 + by_p * by_p, 0.0, 0.0, 1.0 + by_q * by_q);
        let turn = to_slopes * covariance.fixed_view::<2, 2>(0, 0) * to_slopes / n2;
        let shift = covariance.fixed_view::<2, 2>(2, 2).into_owned();
        [turn, shift].map(|own| {
            // The largest eigenvalue of M·C, where the length of (u, w) perpendicular to the axis is (u, w) M (u, w)ᵀ.
            let product = square * own;
            let (half, determinant) = (0.5 * product.trace(), product.determinant());
            (half + (half * half - determinant).max(0.0).sqrt()).max(0.0).sqrt()
        })
    }

    /// The Jacobian of (deflection, pitch, y_ref, z_ref, radius) of `axis`, in the coordinates of the scan, by those of the pose.
    ///
    /// A change moves the point of the axis by δP and turns the direction T = (1, p, q) by δT. In the new frame, in whose X
    /// direction T has the component T_x, the slopes change by (δT_y − p′ δT_x)/T_x, and the point of the axis in the plane x =
    /// x_ref by δP_y − p′ δP_x; likewise z with q′.
    fn jacobian(&self, axis: &AxisLine) -> Matrix5<f64> {
        let (rotation, _) = self.placement();
        let [by_p, by_q] = [self.axis.p, self.axis.q].map(|slope| 1.0 + slope * slope);
        let tangent = rotation * Vector3::new(1.0, self.axis.p, self.axis.q);
        let [to_deflection, to_pitch] = [axis.p, axis.q].map(|slope| 1.0 / (1.0 + slope * slope));
        let column = |point: Vector3<f64>, turn: Vector3<f64>, radius: f64| {
            Vector5::new(
                to_deflection * (turn.y - axis.p * turn.x) / tangent.x,
                to_pitch * (turn.z - axis.q * turn.x) / tangent.x,
                point.y - axis.p * point.x,
                point.z - axis.q * point.x,
                radius,
            )
        };
        let (zero, y, z) = (Vector3::zeros(), rotation * Vector3::y(), rotation * Vector3::z());
        Matrix5::from_columns(&[
            column(zero, y * by_p, 0.0),
            column(zero, z * by_q, 0.0),
            column(y, zero, 0.0),
            column(z, zero, 0.0),
            column(zero, zero, 1.0),
        ])
    }

    /// The rotation from the frame of the pose into the coordinates of the scan, and the origin of that frame there.
    fn placement(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let frame = self.cut.as_ref().map(|cut| cut.frame);
        let rotation = frame.and_then(|frame| frame.rotation().ok()).map_or_else(Matrix3::identity, |r| r.transpose());
        (rotation, frame.map_or_else(Vector3::zeros, |frame| Vector3::from(frame.origin_mm)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_that_was_stored_before_there_were_end_faces_and_degrees_of_freedom_is_read() {
        let text = r#"{"axis": {"p": 0.0, "q": 0.0, "y0": 1.0, "z0": 2.0}, "x_ref": 3.0, "radius": 4.0,
            "radius_source": "fitted", "uncertainty": {"covariance": [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0], [0, 0, 0, 0, 0]],
            "budget": [{"source": "repeatability", "standard": [0, 0, 0, 0, 0]}]}}"#;
        let pose: Pose = serde_json::from_str(text).expect("an old row");
        assert_eq!(pose.end_faces, EndFaces::default());
        assert_eq!(pose.uncertainty.effective_freedom, [None; 5]);
        assert_eq!(pose.uncertainty.budget[0].standard_at_origin, None);
    }
}

#[cfg(test)]
mod placed_tests {
    use super::*;
    use crate::estimation::section_cut::SectionCut;
    use crate::estimation::{EndFaces, RadiusSource};

    fn pose(axis: AxisLine, cut: Option<SectionCut>) -> Pose {
        let uncertainty = Uncertainty::of(&[], &axis, 30.0);
        let (radius_source, end_faces) = (RadiusSource::Fitted, EndFaces::default());
        Pose { axis, x_ref: 30.0, cut, radius: 20.0, radius_source, uncertainty, end_faces }
    }

    #[test]
    fn the_jacobian_equals_finite_differences_in_the_coordinates_of_the_scan() {
        let tilted = Axis { point_mm: [100.0, -20.0, 7.0], direction: [0.8, 0.36, -0.48] };
        let cut = SectionCut::about(&tilted, 20.0, [0.0, 60.0]);
        let line = AxisLine::through([30.0, 1.0, -2.0], 0.05, -0.03);
        let here = pose(line, cut);
        let found = here.on_rail().expect("36 degrees from X");
        let values = |pose: &Pose| {
            let axis = pose.axis_in_scan().line().expect("near X");
            let [y, z] = axis.at(found.x_ref);
            Vector5::new(axis.deflection().radians(), axis.pitch().radians(), y, z, pose.radius)
        };
        for index in 0..5 {
            let moved = |by: f64| {
                let step = Vector5::ith(index, by);
                let angles = [line.p.atan() + step[0], line.q.atan() + step[1]];
                let [y, z] = line.at(30.0);
                let axis = AxisLine::through([30.0, y + step[2], z + step[3]], angles[0].tan(), angles[1].tan());
                values(&Pose { radius: 20.0 + step[4], ..pose(axis, cut) })
            };
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - here.jacobian(&found.axis).column(index)).norm() < 1e-6, "{index}");
        }
    }

    #[test]
    fn a_pose_in_the_rail_frame_is_unchanged() {
        let line = AxisLine { p: 0.1, q: 0.2, y0: 1.0, z0: 2.0 };
        let found = pose(line, None).on_rail().expect("on the rail");
        assert_eq!((found.axis, found.x_ref), (line, 30.0));
    }
}
