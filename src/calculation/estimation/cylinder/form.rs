//! Whether the part is the straight cylinder that was fitted to it: a taper and a bow are asked for beside the five parameters.
//! What a cylinder fit makes of a cone seen from one side is a wrong pitch with a small scatter, so a form that is significant
//! is said, and what it does to the pose goes into the budget. In: each profile's sums of the fit, since both forms depend on
//! the profile only.
//!
//! With ξ = (x − x_ref)/L the distance of the extended model is d − τ·ξ for a radius that grows by τ over L, and that of an
//! axis displaced by κ·ξ² for a bow. Its rows are J₈ = J·A_i, A_i = [1 | ξ e_R | ξ² e_y | ξ² e_z], so the sums of profile i
//! become A_iᵀ N_i A_i and A_iᵀ g_i. One Gauss-Newton step tells the three and how the five would move with them.

use super::solve::Solution;
use super::step::Hold;
use crate::estimation::warning::Warning;
use crate::scan::Scan;
use nalgebra::{SMatrix, SVector, Vector5};

/// The form of the part as far as it shows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Form {
    /// How (p, q, y_ref, z_ref, R) would move with the form set free.
    pub(super) shift: Vector5<f64>,
    /// One for each form that is significant.
    pub(super) warnings: Vec<Warning>,
}

type Matrix8 = SMatrix<f64, 8, 8>;
type Vector8 = SVector<f64, 8>;
type Extension = SMatrix<f64, 5, 8>;

const RADIUS: usize = 4;
const TAPER: usize = 5;
const BOW_Y: usize = 6;
const BOW_Z: usize = 7;
/// A form that is this many of its standard uncertainties is none of chance.
const SIGNIFICANT: f64 = 5.0;
/// Fewer profiles cannot tell a form from their scatter.
const PROFILES_MIN: usize = 20;

/// The form, where one is significant.
pub(super) fn form(scan: &Scan, solution: &Solution, hold: Hold) -> Option<Form> {
    let cylinder = &solution.cylinder;
    let serving = || scan.stations().iter().zip(&solution.profiles).filter(|(_, sums)| sums.weight > 0.0);
    let half = serving().map(|(station, _)| (station.x - cylinder.x_ref).abs()).fold(0.0, f64::max);
    if serving().count() < PROFILES_MIN || half <= 0.0 {
        return None;
    }
    let (mut normal, mut gradient, mut meat) = (Matrix8::zeros(), Vector8::zeros(), Matrix8::zeros());
    for (station, sums) in serving() {
        let extension = extension((station.x - cylinder.x_ref) / half, hold);
        let g = extension.tr_mul(&sums.gradient);
        normal += extension.tr_mul(&(sums.normal * extension));
        meat += g * g.transpose();
        gradient += g;
    }
    let (known, pull) = match hold {
        Hold::Free => (0.0, 0.0),
        Hold::Fixed { .. } => (1.0, 0.0),
        Hold::Prior { radius, sigma } => {
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
    // A form that is not significant is none: set free beside one that is, it would move the pose by its own noise.
    let is_free = |index: usize| index <= RADIUS || found(index).is_some();
    let free = Matrix8::from_diagonal(&Vector8::from_fn(|index, _| if is_free(index) { 1.0 } else { 0.0 }));
    let significant = free * normal * free + (Matrix8::identity() - free);
    let step = -inverse(&significant)? * free * gradient;
    Some(Form { shift: step.fixed_rows::<5>(0).into_owned(), warnings })
}

/// A_i; a fixed radius has no column of its own.
fn extension(place: f64, hold: Hold) -> Extension {
    let mut extension = Extension::identity();
    if matches!(hold, Hold::Fixed { .. }) {
        extension.fill_column(RADIUS, 0.0);
    }
    for (row, column, factor) in [(RADIUS, TAPER, place), (2, BOW_Y, place * place), (3, BOW_Z, place * place)] {
        if let Some(entry) = extension.get_mut((row, column)) {
            *entry = factor;
        }
    }
    extension
}

/// The inverse, scaled by the diagonal so that millimetres and slopes weigh alike.
fn inverse(normal: &Matrix8) -> Option<Matrix8> {
    let scale = Matrix8::from_diagonal(&normal.diagonal().map(|v| v.sqrt().recip()));
    let inverse = scale * (scale * normal * scale).cholesky()?.inverse() * scale;
    inverse.iter().all(|v| v.is_finite()).then_some(inverse)
}
