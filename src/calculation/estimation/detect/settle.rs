//! Robust least squares of one surface from a start nearby: Gauss-Newton steps with Tukey's weights, whose window shrinks
//! to the scatter of the points on the surface.

use super::surface::{Cylinder, Plane, Surface};
use crate::estimation::robust;
use nalgebra::{SMatrix, SVector, Vector3};

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
/// Parameters that the points are fitted by.
const PARAMETERS: f64 = 5.0;
/// Steps below this share of their own standard deviation change nothing any more.
const SETTLED: f64 = 1e-3;
/// A scatter below this share of the size of the cloud is rounding.
const SCATTER_FLOOR: f64 = 1e-12;
/// Damping relative to the diagonal of the normal matrix: more than rounding, less than the worst conditioned arcs.
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
            let weight = robust::weight(distance * distance, cut_off_squared);
            // NaN compares false: a point on the axis or far away does not count.
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

    /// The step to the least squares, with the radius free as long as it stays within bounds.
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

    /// The step at whose end the radius is `wanted`. A unit equation takes the place of the radius's own.
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

/// −N⁻¹ g, scaled by the diagonal so that lengths and angles weigh alike.
fn solve(normal: &Matrix5, gradient: &Vector5) -> Option<Vector5> {
    let scale = normal.diagonal().map(|v| v.sqrt().recip());
    let scaled = Matrix5::from_diagonal(&scale) * normal * Matrix5::from_diagonal(&scale);
    let damped = scaled + Matrix5::identity() * DAMPING;
    let step = -damped.cholesky()?.solve(&gradient.component_mul(&scale)).component_mul(&scale);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Settles from `start`, first with the points within the wider of two windows. The other one is the narrowest to which it
/// shrinks: as many points as parameters can be met exactly, and would seem to have no scatter.
pub(super) fn settle(
    start: Surface,
    points: &[Vector3<f64>],
    [widest, narrowest]: [f64; 2],
    radii: Radii,
    rounds: usize,
) -> Option<Settled> {
    let (mut surface, mut window) = (start, widest);
    let mut sigma = window / robust::TUKEY_C;
    let (mut squared, mut scratch) = (Vec::with_capacity(points.len()), Vec::new());
    for _ in 0..rounds {
        let moved = match &mut surface {
            Surface::Plane(plane) => {
                let cut_off_squared = window * window;
                let old = *plane;
                let weighted = points.iter().map(|point| {
                    let distance = (point - old.point).dot(&old.normal);
                    (robust::weight(distance * distance, cut_off_squared), *point)
                });
                let new = Plane::through(weighted.filter(|(weight, _)| *weight > 0.0))?;
                *plane = new;
                // In units of the scatter, about the middle of the cloud, as far as its size.
                let turned = new.normal.cross(&old.normal).norm() + (new.point - old.point).dot(&new.normal).abs();
                turned * (points.len() as f64).sqrt()
            }
            Surface::Cylinder(cylinder) => {
                let equations = Equations::of(cylinder, points, window);
                let step = equations.step(cylinder.radius, radii)?;
                // Turns about the middle of the points and shifts are nearly independent.
                *cylinder = cylinder.moved(equations.basis, &step)?.based_at(&equations.middle);
                (equations.normal * step).dot(&step).abs().sqrt()
            }
        };
        squared.clear();
        let near = points.iter().map(|point| surface.distance(point).powi(2));
        squared.extend(near.filter(|squared| *squared < window * window));
        let count = squared.len() as f64;
        let freed = count / (count - PARAMETERS).max(1.0);
        sigma = (robust::sigma(&squared, &mut scratch) * freed.sqrt()).max(SCATTER_FLOOR);
        let wanted = (robust::TUKEY_C * sigma).max(window * SHRINK).max(narrowest).min(window);
        let settled = moved < SETTLED * sigma && window - wanted < SETTLED * window;
        window = wanted;
        if settled {
            break;
        }
    }
    Some(Settled { surface, sigma })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The change of a point's distance for a small step of each parameter.
    #[test]
    fn the_normal_equations_hold_the_derivatives_of_the_distance() {
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
