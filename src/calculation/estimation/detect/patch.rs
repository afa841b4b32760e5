//! The surfaces that a few points could lie on.
//!
//! For a given direction the least squares of ρ² − R² over the circle's centre and radius are linear, so a grid of
//! directions finds the cylinder without normals and without a start: on small patches as on whole rings, on six points as
//! on forty. Gauss-Newton steps on the distances follow, because ρ² − R² makes noisy short arcs too round.

use super::settle::{Radii, Settled, settle};
use super::surface::{self, Cylinder, Plane, Surface};
use nalgebra::{Matrix3, Vector3};

/// Directions over half of the sphere, times the points of the patch: 40 points are tried in directions about 18° apart;
/// fewer points have more cylinders that nearly pass them, and are tried more closely for the same work.
const TRIALS: usize = 2400;
/// The golden angle spreads them evenly.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// A patch with so much of its mean squared distance from its plane left says nothing of a curvature.
const ROUNDER: f64 = 0.7;
/// Starts that are refined, with directions more than 25° apart.
const STARTS: usize = 3;
const COS_OTHER: f64 = 0.9;
/// Rounds of re-weighting on a patch.
const ROUNDS: usize = 6;
/// The normal matrix of a circle is singular below: the points lie on a line.
const SINGULAR: f64 = 1e-12;

/// A plane through a patch and, unless the patch is flat, a few cylinders.
pub(super) fn surfaces(patch: &[Vector3<f64>], radii: Radii) -> Vec<Settled> {
    let Some(middle) = mean(patch) else { return Vec::new() };
    let moments: Matrix3<f64> = patch.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let Some(axes) = surface::principal(moments) else { return Vec::new() };
    let [.., normal] = axes;
    let plane = Plane { point: middle, normal };
    let off_plane = patch.iter().map(|p| (p - middle).dot(&normal).powi(2)).sum::<f64>() / patch.len() as f64;
    let mut found = vec![Settled { surface: Surface::Plane(plane), sigma: off_plane.sqrt() }];
    let grid = TRIALS / patch.len().max(1);
    let mut starts: Vec<(f64, Cylinder)> =
        directions(axes, grid).filter_map(|direction| algebraic(patch, middle, direction)).collect();
    starts.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut kept: Vec<Cylinder> = Vec::with_capacity(STARTS);
    for (squared, start) in starts {
        let is_other = |kept: &Cylinder| kept.direction.dot(&start.direction).abs() < COS_OTHER;
        if kept.len() < STARTS && squared < ROUNDER * off_plane && kept.iter().all(is_other) {
            kept.push(start);
        }
    }
    for start in kept {
        let start = Surface::Cylinder(with_radius_within(start, middle, radii));
        let window = 2.0 * patch.iter().map(|p| start.distance(p).abs()).fold(0.0, f64::max);
        found.extend(settle(start, patch, [window, 0.0], radii, ROUNDS));
    }
    found
}

fn mean(points: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    (!points.is_empty()).then(|| points.iter().sum::<Vector3<f64>>() / points.len() as f64)
}

/// The principal axes and a grid that is turned with them, so that a turned cloud gives the turned result.
fn directions([a, b, c]: [Vector3<f64>; 3], count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let grid = (0..count).map(move |i| {
        let height = (i as f64 + 0.5) / count as f64;
        let (width, turn) = ((1.0 - height * height).sqrt(), i as f64 * GOLDEN_ANGLE);
        a * (width * turn.cos()) + b * (width * turn.sin()) + c * height
    });
    [a, b, c].into_iter().chain(grid)
}

/// The cylinder along `direction` with the least squares of (ρ² − R²)/2R, which is near the distance, and their mean.
fn algebraic(patch: &[Vector3<f64>], middle: Vector3<f64>, direction: Vector3<f64>) -> Option<(f64, Cylinder)> {
    let [e, f] = surface::basis(&direction);
    let (mut uu, mut uv, mut vv, mut ur, mut vr, mut rr) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for point in patch {
        let from = point - middle;
        let (u, v) = (from.dot(&e), from.dot(&f));
        let r = u * u + v * v;
        uu += u * u;
        uv += u * v;
        vv += v * v;
        ur += u * r;
        vr += v * r;
        rr += r * r;
    }
    // ρ² − R² = r − 2 a u − 2 b v − c, with c = mean r because u and v have the mean 0.
    let determinant = uu * vv - uv * uv;
    if determinant <= SINGULAR * (uu + vv).powi(2) {
        return None;
    }
    let (a2, b2) = ((vv * ur - uv * vr) / determinant, (uu * vr - uv * ur) / determinant);
    let count = patch.len() as f64;
    let c = (uu + vv) / count;
    let rest = (rr / count - c * c - (a2 * ur + b2 * vr) / count).max(0.0);
    let radius_squared = c + 0.25 * (a2 * a2 + b2 * b2);
    let cylinder = Cylinder { point: middle + (e * a2 + f * b2) * 0.5, direction, radius: radius_squared.sqrt() };
    (rest.is_finite() && radius_squared > 0.0).then_some((rest / (4.0 * radius_squared), cylinder))
}

/// The cylinder with the nearest radius that is looked for, which still passes the points where it did.
pub(super) fn with_radius_within(cylinder: Cylinder, middle: Vector3<f64>, Radii([least, most]): Radii) -> Cylinder {
    let radius = cylinder.radius.clamp(least, most);
    let outward = middle - cylinder.based_at(&middle).point;
    let point = cylinder.point - outward * ((radius - cylinder.radius) / cylinder.radius);
    Cylinder { point, radius, ..cylinder }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn cylinder_of(surfaces: &[Settled]) -> Vec<Cylinder> {
        let cylinder = |settled: &Settled| match settled.surface {
            Surface::Cylinder(cylinder) => Some(cylinder),
            Surface::Plane(_) => None,
        };
        surfaces.iter().filter_map(cylinder).collect()
    }

    /// Points of a cylinder with the radius 2 along (1, 2, 2)/3 through (1, 0, −1).
    fn ring(count: usize, arc: f64, length: f64) -> Vec<Vector3<f64>> {
        let direction = Vector3::new(1.0, 2.0, 2.0) / 3.0;
        let [e, f] = surface::basis(&direction);
        (0..count)
            .map(|i| {
                let (angle, along) = (arc * i as f64 / count as f64, length * (i * 7 % count) as f64 / count as f64);
                Vector3::new(1.0, 0.0, -1.0) + (e * angle.cos() + f * angle.sin()) * 2.0 + direction * along
            })
            .collect()
    }

    #[test]
    fn finds_the_cylinder_of_exact_points() {
        for (count, arc, length) in [(8, TAU, 3.0), (40, 0.7, 1.5), (24, 2.0, 40.0), (30, TAU, 0.4)] {
            let found = cylinder_of(&surfaces(&ring(count, arc, length), Radii([0.0, f64::INFINITY])));
            let off = |c: &Cylinder| (c.radius - 2.0).abs() + c.direction.cross(&Vector3::new(1.0, 2.0, 2.0)).norm();
            let least = found.iter().map(off).fold(f64::INFINITY, f64::min);
            assert!(least < 1e-6, "{count} points over {arc} rad: {least}");
        }
    }

    #[test]
    fn a_known_radius_is_kept() {
        let found = cylinder_of(&surfaces(&ring(40, 0.7, 1.5), Radii([1.9, 1.9])));
        assert!(!found.is_empty() && found.iter().all(|c| (c.radius - 1.9).abs() < 1e-12), "{found:?}");
    }
}
