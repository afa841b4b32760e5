//! The uncertainty budget: its lines, each the covariance from one independent source, and their combination (GUM, JCGM 100, 5.1:
//! independent contributions add as variances; G.4: their degrees of freedom combine by Welch-Satterthwaite).
//!
//! The axis meets x = 0 at y_c0 = y_ref − x_ref·tan β. The variance of y_c0 is var y_ref + j²·var β + 2·j·cov(β, y_ref) with j =
//! ∂y_c0/∂β = −x_ref·(1 + tan² β); likewise for z_c0 with the pitch.

use super::estimate::{Component, Pose, Uncertainty};
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Vector5};

/// Coverage factor k: the expanded uncertainty is k standard uncertainties and covers about 95 % of errors.
pub const COVERAGE_FACTOR: f64 = 2.0;

/// The covariance of (deflection, pitch, y_ref, z_ref, radius) from one source, rad and mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    source: &'static str,
    covariance: Matrix5<f64>,
    /// Degrees of freedom of each variance; infinite for a variance that does not come from repeated observations.
    freedom: Vector5<f64>,
}

impl Line {
    /// Scatter of the data.
    pub(super) const REPEATABILITY: &'static str = "repeatability";
    /// Bias of freely fitted sections.
    pub(super) const FIT_BIAS: &'static str = "fit_bias";
    /// Deviation of the part from a straight cylinder.
    pub(super) const FORM: &'static str = "form";
    /// Layers that cannot be distinguished from the part.
    pub(super) const LAYERS: &'static str = "layers";
    /// Resolution of the coordinates.
    pub(super) const RESOLUTION: &'static str = "resolution";
    /// Uncertainty of the nominal radius.
    pub(super) const NOMINAL_RADIUS: &'static str = "nominal_radius";
    /// Straightness of the stage's travel.
    pub(super) const STAGE_STRAIGHTNESS: &'static str = "stage_straightness";
    /// Linearity of the sensor's distance scale along the laser line.
    pub(super) const SENSOR_LINEARITY: &'static str = "sensor_linearity";
    /// Position and rotation of the sensor in the rail frame.
    pub(super) const SENSOR_EXTRINSICS: &'static str = "sensor_extrinsics";
    /// Thermal expansion of the part.
    pub(super) const TEMPERATURE: &'static str = "temperature";

    /// The lines that come from calibration.
    const CALIBRATION: [&'static str; 4] =
        [Self::STAGE_STRAIGHTNESS, Self::SENSOR_LINEARITY, Self::SENSOR_EXTRINSICS, Self::TEMPERATURE];

    /// The line from the covariance of the slopes (p, q, y_ref, z_ref, radius) about `axis`.
    pub(super) fn of_slopes(source: &'static str, covariance: &Matrix5<f64>, axis: &AxisLine) -> Self {
        let [by_p, by_q] = [axis.p, axis.q].map(|slope| 1.0 / (1.0 + slope * slope));
        let to_angles = Matrix5::from_diagonal(&Vector5::new(by_p, by_q, 1.0, 1.0, 1.0));
        Self { source, covariance: to_angles * covariance * to_angles, freedom: Vector5::repeat(f64::INFINITY) }
    }

    /// The line from one quantity whose standard uncertainty moves (p, q, y_ref, z_ref, radius) together by `shift`.
    pub(super) fn of_shift(source: &'static str, shift: &Vector5<f64>, axis: &AxisLine) -> Self {
        Self::of_slopes(source, &(shift * shift.transpose()), axis)
    }

    /// The same line with these degrees of freedom, for variances that come from repeated observations.
    pub(super) fn with_freedom(self, freedom: Vector5<f64>) -> Self {
        Self { freedom, ..self }
    }

    fn standard(&self) -> [f64; 5] {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into()
    }
}

/// Sensitivity of y_c0 to the deflection and of z_c0 to the pitch.
fn levers(axis: &AxisLine, x_ref: f64) -> [f64; 2] {
    [axis.p, axis.q].map(|slope| -x_ref * (1.0 + slope * slope))
}

/// Standard uncertainties of y_c0 and z_c0.
fn standard_at_origin(covariance: [[f64; 5]; 5], axis: &AxisLine, x_ref: f64) -> [f64; 2] {
    let [[deflection, _, deflection_y, ..], [_, pitch, _, pitch_z, _], [_, _, y, ..], [_, _, _, z, _], _] = covariance;
    let [by_deflection, by_pitch] = levers(axis, x_ref);
    // Rounding can make the sum slightly negative where the terms nearly cancel.
    let standard =
        |j: f64, angle: f64, position: f64, both: f64| (position + j * j * angle + 2.0 * j * both).max(0.0).sqrt();
    [standard(by_deflection, deflection, y, deflection_y), standard(by_pitch, pitch, z, pitch_z)]
}

/// Welch-Satterthwaite's effective degrees of freedom of a sum of variances; `None` where infinite.
///
/// Satterthwaite's ν = 2 E²/Var applies to the sum as stated, so variances that Student's t has widened enter widened.
fn effective_freedom(variances: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let sum: f64 = variances.clone().map(|(variance, _)| variance).sum();
    let scatter: f64 = variances.map(|(variance, freedom)| variance * variance / freedom).sum();
    let freedom = sum * sum / scatter;
    (scatter > 0.0 && freedom.is_finite()).then_some(freedom)
}

/// The combined covariance of independent lines.
pub(super) fn combined(lines: &[Line]) -> [[f64; 5]; 5] {
    lines.iter().map(|line| line.covariance).sum::<Matrix5<f64>>().into()
}

impl Uncertainty {
    /// The same line for other parameters, which follow from these by `jacobian`, about another axis. Each new parameter gets the
    /// degrees of freedom of the parameter on which it depends most.
    pub(super) fn transformed(&self, jacobian: &Matrix5<f64>, axis: &AxisLine, x_ref: f64) -> Self {
        let turned = |own: [[f64; 5]; 5]| jacobian * Matrix5::from(own) * jacobian.transpose();
        let component = |own: &Component| {
            let covariance = own.covariance.map(turned);
            let standard = covariance
                .map_or([0.0; 5], |covariance| covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into());
            let standard_at_origin = covariance.map(|covariance| standard_at_origin(covariance.into(), axis, x_ref));
            let covariance = covariance.map(Into::into);
            Component { source: own.source.clone(), covariance, standard, standard_at_origin }
        };
        let freedom = |row: usize| {
            let own = (0..5).max_by(|a, b| {
                let share = |column: usize| {
                    let variance = self.covariance.get(column).and_then(|row| row.get(column)).copied().unwrap_or(0.0);
                    jacobian.get((row, column)).map_or(0.0, |by| by * by * variance)
                };
                share(*a).total_cmp(&share(*b))
            });
            own.and_then(|own| self.effective_freedom.get(own).copied().flatten())
        };
        let effective_freedom: [Option<f64>; 5] = std::array::from_fn(freedom);
        let [deflection, pitch, ..] = effective_freedom;
        Self {
            covariance: turned(self.covariance).into(),
            budget: self.budget.iter().map(component).collect(),
            effective_freedom,
            effective_freedom_at_origin: [deflection, pitch],
        }
    }

    /// Combines the lines for an axis whose position is stated at `x_ref`.
    pub(super) fn of(lines: &[Line], axis: &AxisLine, x_ref: f64) -> Self {
        let component = |line: &Line| Component {
            source: line.source.to_owned(),
            covariance: Some(line.covariance.into()),
            standard: line.standard(),
            standard_at_origin: Some(standard_at_origin(line.covariance.into(), axis, x_ref)),
        };
        let terms = |index: usize, factor: f64| {
            let term = move |line: &Line| {
                let variance = line.covariance.diagonal().get(index).map_or(0.0, |variance| variance.max(0.0));
                (factor * factor * variance, line.freedom.get(index).copied().unwrap_or(f64::INFINITY))
            };
            lines.iter().map(term)
        };
        let [by_deflection, by_pitch] = levers(axis, x_ref);
        Self {
            covariance: combined(lines),
            budget: lines.iter().map(component).collect(),
            effective_freedom: [0, 1, 2, 3, 4].map(|index| effective_freedom(terms(index, 1.0))),
            // Position and angle are nearly uncorrelated at x_ref, so they count as two independent contributions.
            effective_freedom_at_origin: [(0, by_deflection, 2), (1, by_pitch, 3)]
                .map(|(angle, lever, position)| effective_freedom(terms(angle, lever).chain(terms(position, 1.0)))),
        }
    }

    /// The covariance without these of its lines.
    pub(super) fn without(&self, lines: &[Line]) -> Matrix5<f64> {
        Matrix5::from(self.covariance) - Matrix5::from(combined(lines))
    }

    /// Whether the budget has a line from calibration (`type_b`). Without one it covers only the errors that the scan itself shows.
    #[must_use]
    pub fn includes_calibration(&self) -> bool {
        self.budget.iter().any(|line| Line::CALIBRATION.contains(&line.source.as_str()))
    }
}

impl Pose {
    /// Standard uncertainties of y and z of the intersection of the axis with x = 0, mm.
    #[must_use]
    pub fn standard_at_origin(&self) -> [f64; 2] {
        standard_at_origin(self.uncertainty.covariance, &self.axis, self.x_ref)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn independent_lines_add_as_variances_and_slopes_become_angles() {
        let axis = AxisLine { p: 0.5, q: 0.0, y0: 0.0, z0: 0.0 };
        let freedom = Vector5::repeat(7.0);
        let scatter = Line { source: "repeatability", covariance: Matrix5::from_diagonal_element(9e-6), freedom };
        let shift = Line::of_shift("nominal_radius", &Vector5::new(0.005, 0.0, 0.0, 0.004, 0.0), &axis);
        let scatter_alone = scatter.covariance;
        let uncertainty = Uncertainty::of(&[scatter, shift], &axis, 10.0);
        let Uncertainty { covariance, budget, .. } = &uncertainty;
        // d atan(p)/dp = 1/(1 + p²) = 0.8, so 0.005 becomes 0.004; combined with 0.003 that is 0.005.
        assert!((budget[1].standard[0] - 0.004).abs() < 1e-12);
        assert!((covariance[0][0].sqrt() - 0.005).abs() < 1e-12);
        assert!((covariance[3][3].sqrt() - 0.005).abs() < 1e-12);
        assert!((covariance[0][3] - 0.004 * 0.004).abs() < 1e-12, "both parameters depend on one quantity");
        assert!((uncertainty.without(&[shift]) - scatter_alone).norm() < 1e-18);
    }

    #[test]
    fn degrees_of_freedom_combine_as_in_the_example_of_the_gum() {
        // JCGM 100, H.1.6: standard uncertainties of 25, 9.7, 2.9 and 16.6 nm with 18, 25.6, 50 and 2 degrees of freedom
        // together have 16.7.
        let lines =
            [(25.0, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0)].map(|(u, freedom): (f64, f64)| (u * u, freedom));
        let freedom = effective_freedom(lines.into_iter()).expect("finite");
        assert!((freedom - 16.7).abs() < 0.1, "{freedom}");
        assert_eq!(effective_freedom([(1.0, f64::INFINITY)].into_iter()), None);
        assert_eq!(effective_freedom([(0.0, 3.0)].into_iter()), None);
    }

    #[test]
    fn every_line_states_its_contribution_at_the_origin() {
        // A line through two points at x = 100 and 300, each known to 0.1 mm: 0.1·√2.5 mm at x = 0 (1.5² + 0.5² = 2.5).
        let axis = AxisLine { p: 0.0, q: 0.0, y0: 0.0, z0: 0.0 };
        let variances = Vector5::new(0.01 * 2.0 / 40_000.0, 0.0, 0.005, 0.0, 0.0);
        let freedom = Vector5::repeat(8.0);
        let scatter =
            Line::of_slopes(Line::REPEATABILITY, &Matrix5::from_diagonal(&variances), &axis).with_freedom(freedom);
        let moved = Line::of_shift(Line::SENSOR_EXTRINSICS, &Vector5::new(0.0, 0.0, 0.3, 0.4, 0.0), &axis);
        let uncertainty = Uncertainty::of(&[scatter, moved], &axis, 200.0);
        let at_origin = uncertainty.budget.iter().map(|line| line.standard_at_origin.expect("two numbers"));
        for (found, expected) in at_origin.flatten().zip([0.1 * 2.5f64.sqrt(), 0.0, 0.3, 0.4]) {
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
        // (0.02 + 0.005 + 0.09)² / ((0.02² + 0.005²)/8), mm⁴.
        let freedom = uncertainty.effective_freedom_at_origin[0].expect("finite");
        assert!((freedom - 0.115f64.powi(2) / (4.25e-4 / 8.0)).abs() < 1e-6, "{freedom}");
        assert_eq!(uncertainty.effective_freedom_at_origin[1], None);
        assert!(uncertainty.includes_calibration() && !Uncertainty::of(&[scatter], &axis, 0.0).includes_calibration());
    }
}
