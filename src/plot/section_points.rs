//! The points of one profile as its ellipse sees them: residual, weight, direction, kind. Must not know pictures.

use super::marks::Symbol;
use super::palette::{EXCLUDED, INNER, OUTER, VALID};
use crate::estimation::{Method, Section};
use crate::geometry::SectionEllipse;

/// Tukey's constant: 95 % efficiency under normal noise.
const TUKEY: f64 = 4.6851;

/// A point and what the ellipse makes of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged {
    /// y and z, mm.
    pub(super) at: [f64; 2],
    /// First-order distance from the ellipse, outside positive, mm.
    pub(super) residual: f64,
    /// Direction from the centre, from +Y towards +Z, degrees.
    pub(super) degrees: f64,
    pub(super) kind: Kind,
}

/// Inner or outer, and how much weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Nearer than ε, weight above 0.75.
    InnerHeavy,
    /// Nearer than ε, weight 0.25 to 0.75.
    InnerMedium,
    /// Nearer than ε, weight below 0.25.
    InnerLight,
    /// Not nearer than ε, with a weight.
    Outer,
    /// Not nearer than ε, weight 0.
    Excluded,
}

impl Kind {
    pub(super) const ALL: [Self; 5] =
        [Self::InnerHeavy, Self::InnerMedium, Self::InnerLight, Self::Outer, Self::Excluded];

    fn of(inner: bool, weight: f64) -> Self {
        match (inner, weight) {
            (true, 0.75..) => Self::InnerHeavy,
            (true, 0.25..) => Self::InnerMedium,
            (true, _) => Self::InnerLight,
            (false, weight) if weight > 0.0 => Self::Outer,
            (false, _) => Self::Excluded,
        }
    }

    pub(super) const fn words(self) -> &'static str {
        match self {
            Self::InnerHeavy => "inner, weight above 0.75",
            Self::InnerMedium => "inner, weight 0.25 to 0.75",
            Self::InnerLight => "inner, weight below 0.25",
            Self::Outer => "outer, with a weight",
            Self::Excluded => "outer, weight 0",
        }
    }

    pub(super) const fn look(self) -> (Symbol, &'static str) {
        let [light, medium, _] = INNER;
        match self {
            Self::InnerHeavy => (Symbol::Dot, VALID),
            Self::InnerMedium => (Symbol::Dot, medium),
            Self::InnerLight => (Symbol::Dot, light),
            Self::Outer => (Symbol::Diamond, OUTER),
            Self::Excluded => (Symbol::Cross, EXCLUDED),
        }
    }
}

/// Judges every point of a profile. A method without re-weighting gives every point the weight 1.
pub(super) fn judge(y: &[f64], z: &[f64], section: &Section, epsilon: f64, method: Method) -> Vec<Judged> {
    // An exact profile has no spread; its points are no outliers for that.
    let reach = (TUKEY * section.sigma).max(1e-9);
    let weight = |r: f64| match method {
        Method::SectionLine | Method::Cylinder | Method::LeastSquares if r.abs() < reach => {
            (1.0 - (r / reach).powi(2)).powi(2)
        }
        Method::SectionLine | Method::Cylinder | Method::LeastSquares => 0.0,
        Method::SectionLinePlain => 1.0,
    };
    let judged = y.iter().zip(z).map(|(&y, &z)| {
        let residual = first_order_distance(&section.ellipse, [y, z]);
        let degrees = (z - section.ellipse.centre_z).atan2(y - section.ellipse.centre_y).to_degrees();
        Judged { at: [y, z], residual, degrees, kind: Kind::of(residual.abs() < epsilon, weight(residual)) }
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
    use crate::geometry::Angle;

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

    #[test]
    fn kinds_follow_distance_and_weight() {
        let section = Section {
            ellipse: ELLIPSE,
            sigma: 0.05,
            inlier_ratio: 1.0,
            rms: 0.05,
            arc: Angle::default(),
            iterations_count: 3,
        };
        let kind = |distance: f64, method: Method| {
            let z = ELLIPSE.point(0.0)[1];
            let [y, z] = [ELLIPSE.point(0.0)[0] + distance * 30f64.to_radians().cos(), z + distance * 0.5];
            judge(&[y], &[z], &section, 0.111, method)[0].kind
        };
        // The reach is 4.6851 · 0.05 = 0.234 mm; at 0.1 mm the weight is (1 − 0.182)² = 0.67.
        let kinds = [0.01, 0.1, 0.15, 0.3].map(|d| kind(d, Method::SectionLine));
        assert_eq!(kinds, [Kind::InnerHeavy, Kind::InnerMedium, Kind::Outer, Kind::Excluded]);
        assert_eq!(kind(0.3, Method::SectionLinePlain), Kind::Outer);
    }
}
