//! How well a solution is known: the lines of its budget.

use super::linearity;
use super::patches;
use super::resolution;
use super::solve::Solution;
use super::step::{self, Hold};
use super::sums::Sums;
use crate::estimation::budget::Line;
use crate::estimation::robust;
use crate::estimation::settings::Settings;
use crate::estimation::type_b::{Found, Influence};
use crate::scan::{Scan, Station};
use nalgebra::Vector5;

/// Where y_ref and, behind it, z_ref stand among the parameters.
const Y_REF: usize = 2;
const RADIUS: usize = 4;
/// A share of the variance that nobody sees beside it.
const CURVATURE_MIN: f64 = 1e-3;

/// What the data say, and what is known of the radius.
pub(super) fn from_data(solution: &Solution, hold: Hold, settings: &Settings) -> Vec<Line> {
    let axis = solution.cylinder.axis();
    let repeatability =
        Line::of_slopes(Line::REPEATABILITY, &solution.covariance, &axis).with_freedom(solution.freedom);
    let radius = by_radius(solution, hold, settings).map(|shift| Line::of_shift(Line::NOMINAL_RADIUS, &shift, &axis));
    [Some(repeatability), radius].into_iter().flatten().collect()
}

/// What the curvature of the surface does to it: noise σ along the surface puts points outside by σ²/2R on average, whatever
/// their number. How much of the noise lies along the surface cannot be seen, so this is stated in full, where it matters.
pub(super) fn from_curvature(solution: &Solution, hold: Hold) -> Option<Line> {
    let shift = if_outside(solution, hold)? * (solution.sigma.powi(2) / (2.0 * solution.cylinder.radius));
    let matters = |(shift, variance): (&f64, &f64)| shift * shift > CURVATURE_MIN * variance;
    let counts = shift.iter().zip(solution.covariance.diagonal().iter()).any(matters);
    counts.then(|| Line::of_shift(Line::FIT_BIAS, &shift, &solution.cylinder.axis()))
}

/// How the parameters move where all points lie outside of the surface by 1 mm, as they do on a larger radius: a free one takes
/// up all of it, and with a fixed one the others follow.
fn if_outside(solution: &Solution, hold: Hold) -> Option<Vector5<f64>> {
    match hold {
        Hold::Fixed { .. } => Some(-with_radius(solution, hold)?.component_mul(&step::OTHERS)),
        Hold::Free | Hold::Prior { .. } => Some(solution.bread(hold)? * solution.total().normal.column(RADIUS)),
    }
}

/// What neighbouring parts of the surface share.
pub(super) fn from_layers(solution: &Solution) -> Option<Line> {
    solution.field.map(|field| Line::of_slopes(Line::LAYERS, &field, &solution.cylinder.axis()))
}

/// What the resolution of the coordinates does, where they lie on a lattice.
pub(super) fn from_resolution(scan: &Scan, solution: &Solution, hold: Hold) -> Option<Line> {
    let used = vec![true; scan.stations().len()];
    let reach = robust::TUKEY_C * solution.sigma;
    let surface = (resolution::standard(scan.lattice()) > 0.0)
        .then(|| patches::look(scan, &used, &solution.cylinder, reach))
        .flatten()?;
    let covariance = resolution::covariance(&surface, scan.lattice(), solution, hold)?;
    Some(Line::of_slopes(Line::RESOLUTION, &covariance, &solution.cylinder.axis()))
}

/// What the stage, the sensor and the temperature do to it.
pub(super) fn from_calibration(scan: &Scan, solution: &Solution, hold: Hold, settings: &Settings) -> Vec<Line> {
    let cylinder = &solution.cylinder;
    let found = Found { axis: cylinder.axis(), x_ref: cylinder.x_ref, radius: cylinder.radius, origin: scan.origin() };
    let patches = match settings.type_b.sensor_linearity_mm > 0.0 {
        true => linearity::influences(scan, solution, hold),
        false => Vec::new(),
    };
    settings.type_b.lines(&found, &influences(scan, solution, hold), &patches)
}

/// What a nominal radius that is off by its standard uncertainty does to (p, q, y_ref, z_ref, R).
///
/// Fixed, the others follow as −B N e_R and R itself by 1. As a prior it pulls with its stiffness: B e_R σ²/σ_R².
fn by_radius(solution: &Solution, hold: Hold, settings: &Settings) -> Option<Vector5<f64>> {
    match hold {
        Hold::Free => None,
        Hold::Fixed { .. } => Some(with_radius(solution, hold)? * settings.radius_sigma_mm?),
        Hold::Prior { sigma, .. } => Some(solution.bread(hold)?.column(RADIUS) * (solution.sigma.powi(2) / sigma)),
    }
}

/// How the others follow where R is 1 mm larger than it is: −B N e_R.
fn with_radius(solution: &Solution, hold: Hold) -> Option<Vector5<f64>> {
    let pull = solution.bread(hold)? * solution.total().normal.column(RADIUS).component_mul(&step::OTHERS);
    Some(Vector5::ith(RADIUS, 1.0) - pull.component_mul(&step::OTHERS))
}

fn influences(scan: &Scan, solution: &Solution, hold: Hold) -> Vec<Influence> {
    let Some(bread) = solution.bread(hold) else { return Vec::new() };
    let influence = |(station, sums): (&Station, &Sums)| {
        let shift = sums.normal.fixed_columns::<2>(Y_REF);
        let mut effect = bread * shift;
        if matches!(hold, Hold::Fixed { .. }) {
            effect.fill_row(RADIUS, 0.0);
        }
        Influence { x: station.x, effect }
    };
    let serves = |(_, sums): &(&Station, &Sums)| sums.weight > 0.0;
    scan.stations().iter().zip(&solution.profiles).filter(serves).map(influence).collect()
}

#[cfg(test)]
mod tests {
    use super::super::search;
    use super::*;
    use crate::estimation::Progress;
    use crate::scan::synthetic::{Part, make};

    /// A prior that says nothing leaves the radius free, and one that leaves nothing open fixes it.
    #[test]
    fn points_outside_make_a_free_radius_larger_and_move_the_axis_of_a_fixed_one() {
        let part = Part { profiles_count: 40, points_count: 80, arc_deg: 90.0, ..Part::smooth(3) };
        let (scan, _) = make(&part).expect("a part");
        let used = vec![true; scan.stations().len()];
        let found = search::search(&scan, &used, &Settings::default(), None, &Progress::default());
        let solution = found.expect("a cylinder");
        let radius = solution.cylinder.radius;
        let shift = |hold: Hold| if_outside(&solution, hold).expect("regular");
        let [free, fixed] = [Hold::Free, Hold::Fixed { radius }].map(shift);
        assert!((free - Vector5::ith(RADIUS, 1.0)).norm() < 1e-9, "{free}");
        // Seen from above over 90°, depth stands for radius: with 1 mm outside, z moves by 1 mm and more.
        assert!(fixed[RADIUS] == 0.0 && fixed[3] > 1.0 && fixed[3] < 1.5, "{fixed}");
        let [loose, tight] = [1e3, 1e-6].map(|sigma| shift(Hold::Prior { radius, sigma }));
        assert!((loose - free).norm() < 1e-4 && (tight - fixed).norm() < 1e-4, "{loose} {tight}");
    }
}
