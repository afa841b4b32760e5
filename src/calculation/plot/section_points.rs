//! The points of one profile against a section: residual, weight, direction, kind.

use super::about_axis::Cylinder;
use super::marks::Symbol;
use super::palette::{EXCLUDED, INLIER, OUTLIER, VALID};
use crate::estimation::{Method, TUKEY_C};
use crate::geometry::SectionEllipse;

/// What the points of a profile are compared with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference {
    pub(super) ellipse: SectionEllipse,
    /// The cylinder that was fitted to all profiles, where `ellipse` is a section of it; distances are then those from its
    /// surface, as in the fit.
    pub(super) cylinder: Option<Cylinder>,
    /// Robust standard deviation of the residuals, mm.
    pub(super) sigma: f64,
    /// Distance below which a point is an inlier, mm; infinite where the method distinguishes none.
    pub(super) limit: f64,
}

/// A point and its place relative to the reference.
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

/// Inlier or outlier, and how much weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// One of all points, which have equal weights and no verdict.
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
    // An exact profile has no spread; its points are no outliers for that.
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
                // Along the axis into the plane of the profile, which leaves the distance from the axis as it is.
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

/// F/|∇F| with F = (u/a)² + (v/b)² − 1 in the ellipse's own axes, mm; not finite in its centre.
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

    /// Two points of one generating line lie at the same place of the profile, and at the same distance.
    #[test]
    fn points_beside_the_plane_of_their_profile_are_moved_along_the_axis() {
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
