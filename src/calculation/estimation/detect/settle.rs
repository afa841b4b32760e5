//! The surfaces on which a few points could lie ([`surfaces`]), and robust least squares of one surface from a start nearby
//! ([`settle`]): Gauss-Newton steps with Tukey's weights, whose window shrinks to the scatter of the points on the surface.
//!
//! For a given direction the least squares of ρ² − R² over the circle's centre and radius are linear. A grid of directions
//! therefore finds the cylinder without normals and without a start, on small patches and on full rings, from six points or from
//! forty. Gauss-Newton steps on the distances follow, because ρ² − R² gives noisy short arcs too small a radius.

use super::surface::{self, Cylinder, Plane, Surface};
use crate::estimation::statistics;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

type Matrix5 = SMatrix<f64, 5, 5>;
type Vector5 = SVector<f64, 5>;

/// Least and largest radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Radii(pub(super) [f64; 2]);

/// A surface with the scatter of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Settled {
    pub(super) surface: Surface,
    /// Robust standard deviation of the points on it.
    pub(super) sigma: f64,
}

/// The window never shrinks faster than this in one round, so that the fit can follow.
const SHRINK: f64 = 0.5;
/// Number of parameters of the fit.
const PARAMETERS: f64 = 5.0;
/// A step below this share of its own standard deviation ends the iteration.
const SETTLED: f64 = 1e-3;
/// A scatter below this share of the size of the cloud is rounding.
const SCATTER_FLOOR: f64 = 1e-12;
/// Damping relative to the diagonal of the normal matrix: larger than rounding, smaller than for the worst conditioned arcs.
const DAMPING: f64 = 1e-11;

/// The normal equations of the points within `window` of a cylinder.
struct Equations {
    normal: Matrix5,
    gradient: Vector5,
    basis: [Vector3<f64>; 2],
    /// Weighted mean of the points.
    middle: Vector3<f64>,
}

impl Equations {
    fn of(cylinder: &Cylinder, points: &[Vector3<f64>], window: f64) -> Self {
        let [e, f] = cylinder.basis();
        let (mut normal, mut gradient) = (Matrix5::zeros(), Vector5::zeros());
        let cut_off_squared = window * window;
        let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
        for point in points {
            let from = point - cylinder.point;
            let (u, v) = (from.dot(&e), from.dot(&f));
            let rho = (u * u + v * v).sqrt();
            let distance = rho - cylinder.radius;
            let weight = statistics::weight(distance * distance, cut_off_squared);
            // NaN compares false: a point on the axis or far away is ignored.
            if weight > 0.0 && rho > 0.0 {
                let along = from.dot(&cylinder.direction);
                let (c, s) = (u / rho, v / rho);
                let row = Vector5::new(-c * along, -s * along, -c, -s, -1.0);
                let weighted = row * weight;
                normal.ger(1.0, &weighted, &row, 1.0);
                gradient += weighted * distance;
                sum += from * weight;
                weights += weight;
            }
        }
        Self { normal, gradient, basis: [e, f], middle: cylinder.point + sum / weights }
    }

    /// The least-squares step, with the radius free as long as it stays within bounds.
    fn step(&self, radius: f64, Radii([least, most]): Radii) -> Option<Vector5> {
        if least < most {
            let free = solve(&self.normal, &self.gradient)?;
            let [.., grown]: [f64; 5] = free.into();
            if (least..=most).contains(&(radius + grown)) {
                return Some(free);
            }
            return self.step_to(radius, if radius + grown < least { least } else { most });
        }
        self.step_to(radius, least)
    }

    /// The step that gives the radius `wanted`. A unit equation replaces that of the radius.
    fn step_to(&self, radius: f64, wanted: f64) -> Option<Vector5> {
        let grown = wanted - radius;
        let mut gradient = self.gradient + self.normal.column(4) * grown;
        let mut normal = self.normal;
        normal.fill_row(4, 0.0);
        normal.fill_column(4, 0.0);
        *normal.get_mut((4, 4))? = 1.0;
        *gradient.get_mut(4)? = -grown;
        solve(&normal, &gradient)
    }
}

/// −N⁻¹ g, scaled by the diagonal so that lengths and angles have equal weight.
fn solve(normal: &Matrix5, gradient: &Vector5) -> Option<Vector5> {
    let scale = normal.diagonal().map(|v| v.sqrt().recip());
    let scaled = Matrix5::from_diagonal(&scale) * normal * Matrix5::from_diagonal(&scale);
    let damped = scaled + Matrix5::identity() * DAMPING;
    let step = -damped.cholesky()?.solve(&gradient.component_mul(&scale)).component_mul(&scale);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Settles from `start`, beginning with the points within the wider of two windows. The other window is the narrowest to which it
/// shrinks: as many points as parameters can be fitted exactly and would seem to have no scatter.
pub(super) fn settle(
    start: Surface,
    points: &[Vector3<f64>],
    [widest, narrowest]: [f64; 2],
    radii: Radii,
    rounds: usize,
) -> Option<Settled> {
    let (mut surface, mut window) = (start, widest);
    let mut sigma = window / statistics::TUKEY_C;
    let (mut squared, mut scratch) = (Vec::with_capacity(points.len()), Vec::new());
    for _ in 0..rounds {
        let moved = match &mut surface {
            Surface::Plane(plane) => {
                let cut_off_squared = window * window;
                let old = *plane;
                let weighted = points.iter().map(|point| {
                    let distance = (point - old.point).dot(&old.normal);
                    (statistics::weight(distance * distance, cut_off_squared), *point)
                });
                let new = Plane::through(weighted.filter(|(weight, _)| *weight > 0.0))?;
                *plane = new;
                // The change in units of the scatter, about the middle of the cloud, over the size of the cloud.
                let turned = new.normal.cross(&old.normal).norm() + (new.point - old.point).dot(&new.normal).abs();
                turned * (points.len() as f64).sqrt()
            }
            Surface::Cylinder(cylinder) => {
                let equations = Equations::of(cylinder, points, window);
                let step = equations.step(cylinder.radius, radii)?;
                // Rotations about the middle of the points and shifts are nearly independent.
                *cylinder = cylinder.moved(equations.basis, &step)?.based_at(&equations.middle);
                (equations.normal * step).dot(&step).abs().sqrt()
            }
        };
        squared.clear();
        let near = points.iter().map(|point| surface.distance(point).powi(2));
        squared.extend(near.filter(|squared| *squared < window * window));
        let count = squared.len() as f64;
        let freed = count / (count - PARAMETERS).max(1.0);
        sigma = (statistics::sigma(&squared, &mut scratch) * freed.sqrt()).max(SCATTER_FLOOR);
        let wanted = (statistics::TUKEY_C * sigma).max(window * SHRINK).max(narrowest).min(window);
        let settled = moved < SETTLED * sigma && window - wanted < SETTLED * window;
        window = wanted;
        if settled {
            break;
        }
    }
    Some(Settled { surface, sigma })
}

/// Number of directions over half of the sphere, times the points of the patch: 40 points are tested in directions about 18° apart.
/// Fewer points allow more cylinders that nearly fit and are tested more densely at the same cost.
const TRIALS: usize = 2400;
/// The golden angle spreads them evenly.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// A patch does not show a curvature if a cylinder leaves a larger share of its mean squared distance from a plane.
const ROUNDER: f64 = 0.7;
/// Starts that are refined, with directions more than 25° apart.
const STARTS: usize = 3;
const COS_OTHER: f64 = 0.9;
/// Rounds of re-weighting on a patch.
const ROUNDS: usize = 6;
/// Below this the normal matrix of a circle is singular: the points lie on a line.
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

/// The principal axes and a grid that rotates with them, so that a rotated cloud gives the rotated result.
fn directions([a, b, c]: [Vector3<f64>; 3], count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let grid = (0..count).map(move |i| {
        let height = (i as f64 + 0.5) / count as f64;
        let (width, turn) = ((1.0 - height * height).sqrt(), i as f64 * GOLDEN_ANGLE);
        a * (width * turn.cos()) + b * (width * turn.sin()) + c * height
    });
    [a, b, c].into_iter().chain(grid)
}

/// The cylinder along `direction` with the least squares of (ρ² − R²)/2R, which approximates the distance, and their mean.
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

/// The cylinder with the nearest allowed radius that still passes through the points.
pub(super) fn with_radius_within(cylinder: Cylinder, middle: Vector3<f64>, Radii([least, most]): Radii) -> Cylinder {
    let radius = cylinder.radius.clamp(least, most);
    let outward = middle - cylinder.based_at(&middle).point;
    let point = cylinder.point - outward * ((radius - cylinder.radius) / cylinder.radius);
    Cylinder { point, radius, ..cylinder }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The change of a point's distance for a small step of each parameter.
    #[test]
    fn the_normal_equations_contain_the_derivatives_of_the_distance() {
        let direction = Vector3::new(2.0, -3.0, 6.0) / 7.0;
        let cylinder = Cylinder { point: Vector3::new(0.3, 0.1, -0.2), direction, radius: 0.4 };
        let point = Vector3::new(0.7, 0.9, 0.2);
        let distance = cylinder.distance(&point);
        let equations = Equations::of(&cylinder, &[point], 1e6);
        for index in 0..5 {
            let step = Vector5::ith(index, 1e-6);
            let moved = |step: &Vector5| cylinder.moved(equations.basis, step).expect("valid").distance(&point);
            let slope = (moved(&step) - moved(&-step)) / 2e-6;
            let expected = equations.gradient[index] / distance;
            assert!((slope - expected).abs() < 1e-6, "{index}: {slope} {expected}");
        }
    }

    #[test]
    fn a_radius_out_of_bounds_ends_at_the_bound() {
        let truth = Cylinder { point: Vector3::zeros(), direction: Vector3::z(), radius: 1.0 };
        let points: Vec<Vector3<f64>> =
            (0..60).map(f64::from).map(|i| Vector3::new(i.cos(), i.sin(), 0.1 * i)).collect();
        let found = settle(Surface::Cylinder(truth), &points, [2.0, 0.0], Radii([1.1, 1.2]), 20).expect("settles");
        assert!(matches!(found.surface, Surface::Cylinder(Cylinder { radius: 1.1, .. })), "{found:?}");
    }
}

#[cfg(test)]
mod patch_tests {
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
