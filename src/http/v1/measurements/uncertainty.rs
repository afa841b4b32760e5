//! The uncertainty of a pose in the units of the document: expanded and standard uncertainties, the covariance matrix they are
//! computed from, and the budget.

use crate::estimation::{COVERAGE_FACTOR, Component, Pose, Uncertainty};
use serde::Serialize;
use utoipa::ToSchema;

/// Rows and columns of the covariance matrix.
const ORDER: [&str; 5] = ["deflection_rad", "pitch_rad", "y_ref_mm", "z_ref_mm", "radius_mm"];

/// What the uncertainties include.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = UncertaintyScope)]
pub enum ScopeDocument {
    /// What the scan itself shows; no calibration is stated (`type_b`).
    Repeatability,
    /// That and the stated calibration.
    Combined,
}

/// Effective degrees of freedom of each standard uncertainty, combined over the budget by Welch-Satterthwaite (JCGM 100, G.4).
/// Null where infinite, and in measurements that were stored without them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = DegreesOfFreedom)]
pub struct DegreesOfFreedomDocument {
    /// Of the deflection.
    pub deflection: Option<f64>,
    /// Of the pitch.
    pub pitch: Option<f64>,
    /// Where the axis meets x = 0.
    pub y_c0: Option<f64>,
    /// Where the axis meets x = 0.
    pub z_c0: Option<f64>,
    /// At `x_ref_mm`.
    pub y_ref: Option<f64>,
    /// At `x_ref_mm`.
    pub z_ref: Option<f64>,
    /// Of the radius.
    pub radius: Option<f64>,
}

/// How well a pose is known. The values beside `coverage_factor` are expanded: that many standard uncertainties.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Uncertainty)]
pub struct UncertaintyDocument {
    /// Expanded uncertainty over standard uncertainty.
    #[schema(example = 2.0)]
    pub coverage_factor: f64,
    /// What the uncertainties include.
    pub scope: ScopeDocument,
    /// The expanded uncertainties.
    #[serde(flatten)]
    pub expanded: UncertaintiesDocument,
    /// The same at one standard deviation.
    pub standard: UncertaintiesDocument,
    /// Degrees of freedom of the standard uncertainties, which are already widened for them as Student's t requires: the coverage
    /// factor applies whatever they are.
    /// Null where the axis lies 60° or more from X.
    pub effective_degrees_of_freedom: Option<DegreesOfFreedomDocument>,
    /// What they come from; null where the axis lies 60° or more from X.
    pub covariance: Option<CovarianceDocument>,
    /// What they are made of.
    pub budget: Vec<ComponentDocument>,
}

/// An uncertainty of each number of the pose; null where the number is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = Uncertainties)]
pub struct UncertaintiesDocument {
    /// Of the direction of the axis, in the plane in which it is largest.
    pub axis_direction_deg: f64,
    /// Of the point of the axis, square to the axis, in the direction in which it is largest.
    pub axis_position_mm: f64,
    /// Of the deflection.
    pub deflection_deg: Option<f64>,
    /// Of the pitch.
    pub pitch_deg: Option<f64>,
    /// Where the axis meets x = 0; carries the lever arm from `x_ref_mm`.
    pub y_c0_mm: Option<f64>,
    /// Where the axis meets x = 0; carries the lever arm from `x_ref_mm`.
    pub z_c0_mm: Option<f64>,
    /// At `x_ref_mm`.
    pub y_ref_mm: Option<f64>,
    /// At `x_ref_mm`.
    pub z_ref_mm: Option<f64>,
    /// Of the radius.
    pub radius_mm: f64,
    /// Of x of the end face; null where there is none. The expanded one contains 95.45 %, and this half of it is below the
    /// standard deviation where the spacing of the profiles leaves x undetermined, which is no normal distribution.
    pub end_face_x_mm: Option<f64>,
    /// Of x of the far end face where both were asked for; null where there is none.
    pub far_end_face_x_mm: Option<f64>,
}

/// Variances and covariances.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Covariance)]
pub struct CovarianceDocument {
    /// The meaning of rows and columns.
    #[schema(value_type = Vec<String>)]
    pub order: [&'static str; 5],
    /// Row by row, in the units of `order` multiplied.
    #[schema(value_type = Vec<Vec<f64>>)]
    pub matrix: [[f64; 5]; 5],
}

/// One line of the budget: standard uncertainties; null where the number of the pose is.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = UncertaintyComponent)]
pub struct ComponentDocument {
    /// The contributions to the uncertainty.
    #[schema(example = "repeatability")]
    pub source: String,
    /// Of the direction of the axis; null in measurements that were stored without it.
    pub axis_direction_deg: Option<f64>,
    /// Of the point of the axis, square to the axis; null in measurements that were stored without it.
    pub axis_position_mm: Option<f64>,
    /// Of the deflection.
    pub deflection_deg: Option<f64>,
    /// Of the pitch.
    pub pitch_deg: Option<f64>,
    /// Where the axis meets x = 0; null, too, in measurements that were stored without it.
    pub y_c0_mm: Option<f64>,
    /// Where the axis meets x = 0; null, too, in measurements that were stored without it.
    pub z_c0_mm: Option<f64>,
    /// At `x_ref_mm`.
    pub y_ref_mm: Option<f64>,
    /// At `x_ref_mm`.
    pub z_ref_mm: Option<f64>,
    /// Of the radius.
    pub radius_mm: f64,
}

impl From<&Pose> for UncertaintyDocument {
    fn from(pose: &Pose) -> Self {
        let along_x = pose.on_rail().map(|found| Pose {
            axis: found.axis,
            x_ref: found.x_ref,
            uncertainty: found.uncertainty,
            ..pose.clone()
        });
        let standard = UncertaintiesDocument::standard(pose, along_x.as_ref());
        let lines = pose.uncertainty.budget.iter().enumerate().map(|(index, own)| {
            let line = along_x.as_ref().and_then(|along_x| along_x.uncertainty.budget.get(index));
            ComponentDocument::of(pose, own, line)
        });
        Self {
            coverage_factor: COVERAGE_FACTOR,
            scope: ScopeDocument::from(&pose.uncertainty),
            expanded: standard.times(COVERAGE_FACTOR),
            standard,
            effective_degrees_of_freedom: along_x
                .as_ref()
                .map(|pose| DegreesOfFreedomDocument::from(&pose.uncertainty)),
            covariance: along_x
                .as_ref()
                .map(|pose| CovarianceDocument { order: ORDER, matrix: pose.uncertainty.covariance }),
            budget: lines.collect(),
        }
    }
}

impl UncertaintiesDocument {
    /// `along_x` is the same pose, expressed by slopes and by the intersections with planes x = const.
    fn standard(pose: &Pose, along_x: Option<&Pose>) -> Self {
        let [axis_direction, axis_position_mm] = pose.axis_standard();
        let [.., [_, _, _, _, radius]] = pose.uncertainty.covariance;
        let variance = |index: usize| {
            let row = along_x?.uncertainty.covariance.get(index)?;
            row.get(index).copied()
        };
        let standard = |index: usize| variance(index).map(f64::sqrt);
        let at_origin = along_x.map(Pose::standard_at_origin);
        Self {
            axis_direction_deg: axis_direction.to_degrees(),
            axis_position_mm,
            deflection_deg: standard(0).map(f64::to_degrees),
            pitch_deg: standard(1).map(f64::to_degrees),
            y_c0_mm: at_origin.map(|[y, _]| y),
            z_c0_mm: at_origin.map(|[_, z]| z),
            y_ref_mm: standard(2),
            z_ref_mm: standard(3),
            radius_mm: radius.sqrt(),
            end_face_x_mm: pose.end_faces.asked_one().map(|face| face.x_standard),
            far_end_face_x_mm: pose.end_faces.other_one().map(|face| face.x_standard),
        }
    }

    fn times(self, factor: f64) -> Self {
        let times = |value: Option<f64>| value.map(|value| factor * value);
        Self {
            axis_direction_deg: factor * self.axis_direction_deg,
            axis_position_mm: factor * self.axis_position_mm,
            deflection_deg: times(self.deflection_deg),
            pitch_deg: times(self.pitch_deg),
            y_c0_mm: times(self.y_c0_mm),
            z_c0_mm: times(self.z_c0_mm),
            y_ref_mm: times(self.y_ref_mm),
            z_ref_mm: times(self.z_ref_mm),
            radius_mm: factor * self.radius_mm,
            end_face_x_mm: times(self.end_face_x_mm),
            far_end_face_x_mm: times(self.far_end_face_x_mm),
        }
    }
}

impl From<&Uncertainty> for ScopeDocument {
    fn from(uncertainty: &Uncertainty) -> Self {
        if uncertainty.includes_calibration() { Self::Combined } else { Self::Repeatability }
    }
}

impl From<&Uncertainty> for DegreesOfFreedomDocument {
    fn from(uncertainty: &Uncertainty) -> Self {
        let [deflection, pitch, y_ref, z_ref, radius] = uncertainty.effective_freedom;
        let [y_c0, z_c0] = uncertainty.effective_freedom_at_origin;
        Self { deflection, pitch, y_c0, z_c0, y_ref, z_ref, radius }
    }
}

impl ComponentDocument {
    /// A line of the budget, and the same line along X if the axis is nearly parallel to X.
    fn of(pose: &Pose, own: &Component, along_x: Option<&Component>) -> Self {
        let [.., radius_mm] = own.standard;
        let axis = own.covariance.as_ref().map(|covariance| pose.axis_standard_of(covariance));
        let at_origin = along_x.and_then(|line| line.standard_at_origin);
        let standard = |index: usize| along_x.and_then(|line| line.standard.get(index).copied());
        Self {
            source: own.source.clone(),
            axis_direction_deg: axis.map(|[direction, _]| direction.to_degrees()),
            axis_position_mm: axis.map(|[_, position]| position),
            deflection_deg: standard(0).map(f64::to_degrees),
            pitch_deg: standard(1).map(f64::to_degrees),
            y_c0_mm: at_origin.map(|[y, _]| y),
            z_c0_mm: at_origin.map(|[_, z]| z),
            y_ref_mm: standard(2),
            z_ref_mm: standard(3),
            radius_mm,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::{EndFaces, RadiusSource};
    use crate::geometry::AxisLine;

    fn uncertainty(covariance: [[f64; 5]; 5]) -> Uncertainty {
        Uncertainty {
            covariance,
            budget: Vec::new(),
            effective_freedom: [Some(8.0), None, None, None, None],
            effective_freedom_at_origin: [None; 2],
        }
    }

    /// A line through two points at x = 100 and x = 300 with independent standard uncertainties of 0.1 mm: at x_ref = 200 the
    /// position has 0.1/√2 mm, the slope 0.1·√2/200, and at x = 0 the propagation of uncertainty by hand gives
    /// y_0 = 1.5·y_100 − 0.5·y_300, so 0.1·√2.5 mm.
    #[test]
    fn the_lever_arm_is_propagated() {
        let (slope_u, y_u) = (0.1 * 2f64.sqrt() / 200.0, 0.1 / 2f64.sqrt());
        let mut covariance = [[0.0; 5]; 5];
        covariance[0][0] = slope_u * slope_u;
        covariance[2][2] = y_u * y_u;
        let axis = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };
        let (uncertainty, end_faces) = (uncertainty(covariance), EndFaces::default());
        let radius_source = RadiusSource::Fitted;
        let pose = Pose { axis, x_ref: 200.0, cut: None, radius: 1.0, radius_source, uncertainty, end_faces };
        let document = UncertaintyDocument::from(&pose);
        assert!((document.standard.y_c0_mm.expect("on the rail") - 0.1 * 2.5f64.sqrt()).abs() < 1e-12);
        assert!((document.expanded.y_c0_mm.expect("on the rail") - 0.2 * 2.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(document.scope, ScopeDocument::Repeatability);
        let freedom = serde_json::to_value(document.effective_degrees_of_freedom).expect("JSON");
        assert_eq!((&freedom["deflection"], &freedom["pitch"]), (&serde_json::json!(8.0), &serde_json::Value::Null));
    }

    /// The same two points with x_ref at 100, where slope and position share the error of the first point:
    /// cov = −0.1²/200. The uncertainty at x = 0 must not depend on the position of the reference.
    #[test]
    fn cross_terms_make_the_choice_of_the_reference_irrelevant() {
        let mut covariance = [[0.0; 5]; 5];
        covariance[0][0] = 2.0 * 0.01 / 40_000.0;
        covariance[2][2] = 0.01;
        (covariance[0][2], covariance[2][0]) = (-0.01 / 200.0, -0.01 / 200.0);
        let axis = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };
        let (uncertainty, end_faces) = (uncertainty(covariance), EndFaces::default());
        let radius_source = RadiusSource::Fitted;
        let pose = Pose { axis, x_ref: 100.0, cut: None, radius: 1.0, radius_source, uncertainty, end_faces };
        assert!(
            (UncertaintyDocument::from(&pose).standard.y_c0_mm.expect("on the rail") - 0.1 * 2.5f64.sqrt()).abs()
                < 1e-12
        );
    }
}
