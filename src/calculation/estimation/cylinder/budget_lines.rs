//! The lines of the uncertainty budget of a cylinder fit: scatter, the nominal radius, the curvature of the surface, layers, the
//! resolution of the coordinates, calibration (`type_b`), and the form of the part.
//!
//! Sensor linearity: shifting a point by δ in z changes its distance by ∂d/∂z·δ = −b·δ with b = ∂d/∂z_ref. The estimating equation
//! Σ w·d·J = 0 then moves the parameters by −B Σ ψ′ J (−b δ) = B Σ ψ′ J b δ, B the inverse of Σ ψ′ J Jᵀ.
//!
//! Resolution: all points in one cell of the lattice of coordinates share the rounding error of that cell.
//!
//! Form: the part may be tapered or bent. A cylinder fit to a cone that is scanned from one side gives a wrong pitch with a small
//! scatter, so a taper and a bow are estimated together with the five parameters. A significant one gives a warning, and its effect
//! on the pose is a line of the budget. With ξ = (x − x_ref)/L the distance of the extended model is d − τ·ξ for a radius that
//! grows by τ over L, and an axis displaced by κ·ξ² describes a bow. Its rows are J₈ = J·A_i, A_i = [1 | ξ e_R | ξ² e_y | ξ² e_z],
//! so the sums of profile i become A_iᵀ N_i A_i and A_iᵀ g_i. One Gauss-Newton step gives the three form parameters and the change
//! of the five others.

use super::normal_equations::{self, RadiusConstraint, Sums};
use super::patches::{self, Near, Surface};
use super::sample::rounding_standard;
use super::solve::Solution;
use crate::estimation::budget::Line;
use crate::estimation::settings::Settings;
use crate::estimation::statistics;
use crate::estimation::type_b::{Found, Influence, PatchInfluence, Patches};
use crate::estimation::warning::Warning;
use crate::scan::{Scan, Station};
use nalgebra::{Matrix5, SMatrix, SVector, Vector5};
use std::collections::HashMap;

/// Index of y_ref among the parameters; z_ref follows it.
const Y_REF: usize = 2;
const RADIUS: usize = 4;
/// A share of the variance below which a contribution is negligible.
const CURVATURE_MIN: f64 = 1e-3;

/// The lines for the scatter of the data and for the nominal radius.
pub(super) fn from_data(solution: &Solution, constraint: RadiusConstraint, settings: &Settings) -> Vec<Line> {
    let axis = solution.cylinder.axis();
    let repeatability =
        Line::of_slopes(Line::REPEATABILITY, &solution.covariance, &axis).with_freedom(solution.freedom);
    let radius =
        by_radius(solution, constraint, settings).map(|shift| Line::of_shift(Line::NOMINAL_RADIUS, &shift, &axis));
    [Some(repeatability), radius].into_iter().flatten().collect()
}

/// The effect of the curvature of the surface: noise σ along the surface puts points outside by σ²/2R on average, whatever their
/// number. The scan does not show how much of the noise lies along the surface, so the line states the full amount, where it is
/// significant.
pub(super) fn from_curvature(solution: &Solution, constraint: RadiusConstraint) -> Option<Line> {
    let shift = if_outside(solution, constraint)? * (solution.sigma.powi(2) / (2.0 * solution.cylinder.radius));
    let matters = |(shift, variance): (&f64, &f64)| shift * shift > CURVATURE_MIN * variance;
    let counts = shift.iter().zip(solution.covariance.diagonal().iter()).any(matters);
    counts.then(|| Line::of_shift(Line::FIT_BIAS, &shift, &solution.cylinder.axis()))
}

/// The change of the parameters if all points lie outside the surface by 1 mm, as on a larger radius: a free radius absorbs all of
/// it; with a fixed radius the other parameters change.
fn if_outside(solution: &Solution, constraint: RadiusConstraint) -> Option<Vector5<f64>> {
    match constraint {
        RadiusConstraint::Fixed { .. } => {
            Some(-with_radius(solution, constraint)?.component_mul(&normal_equations::OTHERS))
        }
        RadiusConstraint::Free | RadiusConstraint::Prior { .. } => {
            Some(solution.bread(constraint)? * solution.total().normal.column(RADIUS))
        }
    }
}

/// Errors common to neighbouring parts of the surface.
pub(super) fn from_layers(solution: &Solution) -> Option<Line> {
    solution.field.map(|field| Line::of_slopes(Line::LAYERS, &field, &solution.cylinder.axis()))
}

/// The effect of the resolution of the coordinates, if they lie on a lattice.
pub(super) fn from_resolution(scan: &Scan, solution: &Solution, constraint: RadiusConstraint) -> Option<Line> {
    let used = vec![true; scan.stations().len()];
    let reach = statistics::TUKEY_C * solution.sigma;
    let surface = (rounding_standard(scan.lattice()) > 0.0)
        .then(|| patches::look(scan, &used, &solution.cylinder, reach))
        .flatten()?;
    let covariance = resolution_covariance(&surface, scan.lattice(), solution, constraint)?;
    Some(Line::of_slopes(Line::RESOLUTION, &covariance, &solution.cylinder.axis()))
}

/// The effects of the stage, the sensor and the temperature.
pub(super) fn from_calibration(
    scan: &Scan,
    solution: &Solution,
    constraint: RadiusConstraint,
    settings: &Settings,
) -> Vec<Line> {
    let cylinder = &solution.cylinder;
    let found = Found { axis: cylinder.axis(), x_ref: cylinder.x_ref, radius: cylinder.radius, origin: scan.origin() };
    let patches = match settings.type_b.sensor_linearity_mm > 0.0 {
        true => patch_influences(scan, solution, constraint),
        false => Vec::new(),
    };
    settings.type_b.lines(&found, &influences(scan, solution, constraint), &patches)
}

/// The change of (p, q, y_ref, z_ref, R) if the nominal radius is off by its standard uncertainty.
///
/// With a fixed radius the others change by −B N e_R and R itself by 1. As a prior its effect is B e_R σ²/σ_R².
fn by_radius(solution: &Solution, constraint: RadiusConstraint, settings: &Settings) -> Option<Vector5<f64>> {
    match constraint {
        RadiusConstraint::Free => None,
        RadiusConstraint::Fixed { .. } => Some(with_radius(solution, constraint)? * settings.radius_sigma_mm?),
        RadiusConstraint::Prior { sigma, .. } => {
            Some(solution.bread(constraint)?.column(RADIUS) * (solution.sigma.powi(2) / sigma))
        }
    }
}

/// The change of the other parameters if R is 1 mm larger: −B N e_R.
fn with_radius(solution: &Solution, constraint: RadiusConstraint) -> Option<Vector5<f64>> {
    let pull =
        solution.bread(constraint)? * solution.total().normal.column(RADIUS).component_mul(&normal_equations::OTHERS);
    Some(Vector5::ith(RADIUS, 1.0) - pull.component_mul(&normal_equations::OTHERS))
}

fn influences(scan: &Scan, solution: &Solution, constraint: RadiusConstraint) -> Vec<Influence> {
    let Some(bread) = solution.bread(constraint) else { return Vec::new() };
    let influence = |(station, sums): (&Station, &Sums)| {
        let shift = sums.normal.fixed_columns::<2>(Y_REF);
        let mut effect = bread * shift;
        if matches!(constraint, RadiusConstraint::Fixed { .. }) {
            effect.fill_row(RADIUS, 0.0);
        }
        Influence { x: station.x, effect }
    };
    let serves = |(_, sums): &(&Station, &Sums)| sums.weight > 0.0;
    scan.stations().iter().zip(&solution.profiles).filter(serves).map(influence).collect()
}

/// The change of the gradient by a shift of the points of a patch: of all of them by 1 mm, and of each in proportion to its z.
#[derive(Debug, Clone, Copy, Default)]
struct Shift {
    all: Vector5<f64>,
    by_z: Vector5<f64>,
    /// Sum of z, mm, and number of points.
    z: f64,
    count: f64,
}

/// The response to each patch; empty if the scan has none.
fn patch_influences(scan: &Scan, solution: &Solution, constraint: RadiusConstraint) -> Vec<PatchInfluence> {
    patch_responses(scan, solution, constraint).unwrap_or_default()
}

fn patch_responses(scan: &Scan, solution: &Solution, constraint: RadiusConstraint) -> Option<Vec<PatchInfluence>> {
    let cut_off = statistics::cut_off_squared(solution.sigma);
    let used: Vec<bool> = solution.profiles.iter().map(|sums| sums.weight > 0.0).collect();
    let surface = patches::look(scan, &used, &solution.cylinder, cut_off.sqrt())?;
    let patches = Patches::over(surface.near.iter().map(|point| point.y))?;
    let stands_for = surface.thinned() as f64;
    let (mut sums, mut shifts) = (Sums::zero(), vec![Shift::default(); Patches::count()]);
    for point in &surface.near {
        let Near { y, z, d, .. } = *point;
        let response = solution.cylinder.slice(point.x).response(y, z);
        let (row, b) = (response.row(), response.b);
        let bend = stands_for * statistics::weight_slope(d * d, cut_off);
        sums.normal += row * row.transpose() * bend;
        if let Some(shift) = shifts.get_mut(patches.index(y)) {
            shift.all += row * (bend * b);
            shift.by_z += row * (bend * b * z);
            (shift.z, shift.count) = (shift.z + z, shift.count + 1.0);
        }
    }
    // The inverse over the same points, so that a shift of all patches is exactly a shift of z_ref.
    let bread = normal_equations::invert(
        &normal_equations::system(&sums, constraint, solution.sigma, solution.cylinder.radius).0,
    )?;
    let effect = |shift: Vector5<f64>| {
        let mut effect = bread * shift;
        if matches!(constraint, RadiusConstraint::Fixed { .. }) {
            effect.fill_row(RADIUS, 0.0);
        }
        effect
    };
    let effects = |Shift { all, by_z, z, count }: Shift| [effect(all), effect(by_z - all * (z / f64::max(count, 1.0)))];
    Some(patches.influences(shifts.into_iter().map(effects).collect()))
}

/// The covariance of (p, q, y_ref, z_ref, R) for errors that are independent between cells and shared by all points of a cell;
/// `None` if the coordinates lie on no lattice.
fn resolution_covariance(
    surface: &Surface,
    steps: [f64; 3],
    solution: &Solution,
    constraint: RadiusConstraint,
) -> Option<Matrix5<f64>> {
    let standard = rounding_standard(steps);
    let [_, step_y, step_z] = steps;
    if standard <= 0.0 {
        return None;
    }
    let cut_off = statistics::cut_off_squared(solution.sigma);
    let (mut cells, mut whole) = (HashMap::<[i64; 2], Vector5<f64>>::new(), Sums::zero());
    for point in surface.near.iter().filter(|point| point.d * point.d < cut_off) {
        let response = solution.cylinder.slice(point.x).response(point.y, point.z);
        let row = response.row();
        let weight = statistics::weight(response.d * response.d, cut_off);
        whole.normal += row * row.transpose() * weight;
        let cell = [(point.y / step_y).round() as i64, (point.z / step_z).round() as i64];
        *cells.entry(cell).or_default() += row * weight;
    }
    // Each point represents those that were not examined, so that a prior weighs as it does in the fit.
    let stands_for = surface.thinned() as f64;
    whole.normal *= stands_for;
    cells.values_mut().for_each(|pull| *pull *= stands_for);
    let (normal, _) = normal_equations::system(&whole, constraint, solution.sigma, solution.cylinder.radius);
    let bread = normal_equations::invert(&normal)?;
    let mask = if matches!(constraint, RadiusConstraint::Fixed { .. }) {
        normal_equations::OTHERS
    } else {
        Vector5::repeat(1.0)
    };
    // The fixed order makes the sum the same in every run.
    let mut cells: Vec<([i64; 2], Vector5<f64>)> = cells.into_iter().collect();
    cells.sort_unstable_by_key(|(cell, _)| *cell);
    let scatter: Matrix5<f64> = cells
        .iter()
        .map(|(_, pull)| {
            let shift = bread * pull.component_mul(&mask);
            shift * shift.transpose()
        })
        .sum();
    Some(scatter * (standard * standard))
}

/// The form deviations of the part that the scan shows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Form {
    /// The change of (p, q, y_ref, z_ref, R) if the form parameters are free.
    pub(super) shift: Vector5<f64>,
    /// One for each significant form deviation.
    pub(super) warnings: Vec<Warning>,
}

type Matrix8 = SMatrix<f64, 8, 8>;
type Vector8 = SVector<f64, 8>;
type Extension = SMatrix<f64, 5, 8>;

const TAPER: usize = 5;
const BOW_Y: usize = 6;
const BOW_Z: usize = 7;
/// A form deviation of at least this many standard uncertainties is significant.
const SIGNIFICANT: f64 = 5.0;
/// With fewer profiles a form deviation cannot be distinguished from their scatter.
const PROFILES_MIN: usize = 20;

/// The form deviations, if any is significant.
pub(super) fn form(scan: &Scan, solution: &Solution, constraint: RadiusConstraint) -> Option<Form> {
    let cylinder = &solution.cylinder;
    let serving = || scan.stations().iter().zip(&solution.profiles).filter(|(_, sums)| sums.weight > 0.0);
    let half = serving().map(|(station, _)| (station.x - cylinder.x_ref).abs()).fold(0.0, f64::max);
    if serving().count() < PROFILES_MIN || half <= 0.0 {
        return None;
    }
    let (mut normal, mut gradient, mut meat) = (Matrix8::zeros(), Vector8::zeros(), Matrix8::zeros());
    for (station, sums) in serving() {
        let extension = extension((station.x - cylinder.x_ref) / half, constraint);
        let g = extension.tr_mul(&sums.gradient);
        normal += extension.tr_mul(&(sums.normal * extension));
        meat += g * g.transpose();
        gradient += g;
    }
    let (known, pull) = match constraint {
        RadiusConstraint::Free => (0.0, 0.0),
        RadiusConstraint::Fixed { .. } => (1.0, 0.0),
        RadiusConstraint::Prior { radius, sigma } => {
            let stiffness = (solution.sigma / sigma).powi(2);
            (stiffness, stiffness * (cylinder.radius - radius))
        }
    };
    normal += Matrix8::from_diagonal(&(Vector8::ith(RADIUS, known)));
    gradient += Vector8::ith(RADIUS, pull);
    let bread = inverse(&normal)?;
    let step = -bread * gradient;
    let standard = (bread * meat * bread.transpose()).diagonal().map(|variance| variance.max(0.0).sqrt());
    let floor = f64::EPSILON * 1e4 * cylinder.radius;
    let found = |index: usize| {
        let (size, u) = (*step.get(index)?, *standard.get(index)?);
        (size.abs() > (SIGNIFICANT * u).max(floor)).then_some(size)
    };
    let taper = found(TAPER)
        .map(|size| Warning::Tapered { taper_deg: (size / half).atan().to_degrees(), radius_change_mm: 2.0 * size });
    let bow = [found(BOW_Y), found(BOW_Z)];
    let bent = bow.iter().flatten().next().map(|_| {
        let sagitta_mm = bow.map(|size| size.unwrap_or(0.0)).iter().fold(0.0, |sum: f64, size| sum.hypot(*size));
        Warning::Bent { sagitta_mm }
    });
    let warnings: Vec<Warning> = [taper, bent].into_iter().flatten().collect();
    if warnings.is_empty() {
        return None;
    }
    // Only significant form parameters stay free: the others would move the pose by their own noise.
    let is_free = |index: usize| index <= RADIUS || found(index).is_some();
    let free = Matrix8::from_diagonal(&Vector8::from_fn(|index, _| if is_free(index) { 1.0 } else { 0.0 }));
    let significant = free * normal * free + (Matrix8::identity() - free);
    let step = -inverse(&significant)? * free * gradient;
    Some(Form { shift: step.fixed_rows::<5>(0).into_owned(), warnings })
}

/// A_i; a fixed radius has no column.
fn extension(place: f64, constraint: RadiusConstraint) -> Extension {
    let mut extension = Extension::identity();
    if matches!(constraint, RadiusConstraint::Fixed { .. }) {
        extension.fill_column(RADIUS, 0.0);
    }
    for (row, column, factor) in [(RADIUS, TAPER, place), (2, BOW_Y, place * place), (3, BOW_Z, place * place)] {
        if let Some(entry) = extension.get_mut((row, column)) {
            *entry = factor;
        }
    }
    extension
}

/// The inverse, scaled by the diagonal so that millimetres and slopes have equal weight.
fn inverse(normal: &Matrix8) -> Option<Matrix8> {
    let scale = Matrix8::from_diagonal(&normal.diagonal().map(|v| v.sqrt().recip()));
    let inverse = scale * (scale * normal * scale).cholesky()?.inverse() * scale;
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::Progress;
    use crate::estimation::cylinder::search;
    use crate::scan::synthetic::Part;
    use crate::scan::synthetic::make;

    /// A very wide prior leaves the radius free, and a very narrow one fixes it.
    #[test]
    fn points_outside_make_a_free_radius_larger_and_move_the_axis_of_a_fixed_one() {
        let part = Part { profiles_count: 40, points_count: 80, arc_deg: 90.0, ..Part::smooth(3) };
        let (scan, _) = make(&part).expect("a part");
        let used = vec![true; scan.stations().len()];
        let found = search::search(&scan, &used, &Settings::default(), None, &Progress::default());
        let solution = found.expect("a cylinder");
        let radius = solution.cylinder.radius;
        let shift = |constraint: RadiusConstraint| if_outside(&solution, constraint).expect("regular");
        let [free, fixed] = [RadiusConstraint::Free, RadiusConstraint::Fixed { radius }].map(shift);
        assert!((free - Vector5::ith(RADIUS, 1.0)).norm() < 1e-9, "{free}");
        // Scanned from above over 90°, depth and radius are correlated: with all points 1 mm outside, z moves by 1 mm and more.
        assert!(fixed[RADIUS] == 0.0 && fixed[3] > 1.0 && fixed[3] < 1.5, "{fixed}");
        let [loose, tight] = [1e3, 1e-6].map(|sigma| shift(RadiusConstraint::Prior { radius, sigma }));
        assert!((loose - free).norm() < 1e-4 && (tight - fixed).norm() < 1e-4, "{loose} {tight}");
    }
}
