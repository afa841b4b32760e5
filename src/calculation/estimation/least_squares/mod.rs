//! The method `least_squares`: the Gaussian associated cylinder of all points of a scan, without rejection of points.

mod cylinder;
mod fit;
mod points;
mod starts;

pub use fit::{GaussianCylinder, LeastSquaresError, basis, least_squares_cylinder};

use super::budget::Line;
use super::estimate::{Conditioning, EndFaces, Estimate, Outcome, Pose, Profile, RadiusSource, Residuals, Uncertainty};
use super::progress::Progress;
use super::refusal::Refusal;
use super::section_cut::SectionCut;
use super::settings::Settings;
use super::warning::Warning;
use super::{checks, type_b};
use crate::geometry::{Axis, AxisLine};
use crate::scan::{Scan, Station};
use fit::cylinder_of;
use nalgebra::{Matrix3, Matrix5, Vector3, Vector5};

/// The complete measurement.
pub(super) fn measure(scan: &Scan, settings: &Settings, progress: &Progress) -> Estimate {
    let points: Vec<[f64; 3]> = scan.stations().iter().flat_map(|station| scan.points_of(station)).collect();
    let (outcome, residuals, axial_length) = match cylinder_of(&points, progress) {
        Err(error) => {
            let refusal = Refusal::PointsUndetermined { points_count: points.len(), detail: error.to_string() };
            (Outcome::Refused(refusal), None, 0.0)
        }
        Ok(found) => {
            let extent = extent(&points, &found);
            let residuals = Residuals { sigma: found.sigma, inlier_ratio: 1.0 };
            (outcome(&found, points.len(), extent, settings), Some(residuals), extent[1] - extent[0])
        }
    };
    let is_silent = settings.type_b.is_stated() || matches!(outcome, Outcome::Refused(_));
    let warnings = if is_silent { Vec::new() } else { vec![Warning::CalibrationNotStated] };
    let conditioning = Conditioning { arc: None, axial_length, warnings };
    let profiles = scan.stations().iter().map(unjudged).collect();
    Estimate { method: settings.method, outcome, profiles, conditioning, residuals }
}

/// A profile of which all points are used.
fn unjudged(station: &Station) -> Profile {
    let points_count = station.end - station.start;
    Profile { x: station.x, points_count, rejected: None, section: None, offset: None }
}

fn outcome(found: &GaussianCylinder, points_count: usize, extent: [f64; 2], settings: &Settings) -> Outcome {
    let axis = Axis { point_mm: found.point, direction: found.direction };
    let cut = SectionCut::about(&axis, found.radius, extent);
    let Some((cut, covariance)) = cut.and_then(|cut| Some((cut, in_frame(found, &cut)?))) else {
        return Outcome::Refused(Refusal::NoCylinder { nominal_radius_mm: settings.nominal_radius_mm });
    };
    let along_x = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };
    let freedom = (points_count as f64 - 5.0).max(1.0);
    let repeatability =
        Line::of_slopes(Line::REPEATABILITY, &covariance, &along_x).with_freedom(Vector5::repeat(freedom));
    let rotation = cut.frame.rotation().unwrap_or_else(|_| Matrix3::identity());
    let origin = (rotation * -Vector3::from(cut.frame.origin_mm)).into();
    let in_cut = type_b::Found { axis: along_x, x_ref: 0.0, radius: found.radius, origin };
    let lines: Vec<Line> = std::iter::once(repeatability).chain(settings.type_b.of_whole_scan(&in_cut)).collect();
    let uncertainty = Uncertainty::of(&lines, &along_x, 0.0);
    if let Some(refusal) = checks::undetermined(&uncertainty, found.radius, settings) {
        return Outcome::Refused(refusal);
    }
    Outcome::Accepted(Box::new(Pose {
        axis: along_x,
        x_ref: 0.0,
        cut: Some(cut),
        radius: found.radius,
        radius_source: RadiusSource::Fitted,
        uncertainty,
        end_faces: EndFaces::default(),
    }))
}

/// The interval of the points along the axis, from its point, mm.
fn extent(points: &[[f64; 3]], found: &GaussianCylinder) -> [f64; 2] {
    let (origin, direction) = (Vector3::from(found.point), Vector3::from(found.direction));
    let ends = |[first, last]: [f64; 2], point: &[f64; 3]| {
        let along = (Vector3::from(*point) - origin).dot(&direction);
        [first.min(along), last.max(along)]
    };
    points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], ends)
}

/// The covariance in the axes y and z of a frame along the axis.
fn in_frame(found: &GaussianCylinder, cut: &SectionCut) -> Option<Matrix5<f64>> {
    let rotation = cut.frame.rotation().ok()?;
    let [first, second] = basis(found.direction).map(|axis| rotation * Vector3::from(axis));
    #[rustfmt::skip]
    let turn = Matrix5::new(
        first.y, second.y, 0.0, 0.0, 0.0,
        first.z, second.z, 0.0, 0.0, 0.0,
        0.0, 0.0, first.y, second.y, 0.0,
        0.0, 0.0, first.z, second.z, 0.0,
        0.0, 0.0, 0.0, 0.0, 1.0,
    );
    Some(turn * Matrix5::from(found.covariance) * turn.transpose())
}
