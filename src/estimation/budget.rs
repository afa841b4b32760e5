//! The uncertainty budget: lines of independent sources, each a covariance of its own, and what they make together (GUM,
//! JCGM 100, 5.1: independent contributions add as variances). Must not know where a line comes from.

use super::{Component, Uncertainty};
use crate::geometry::AxisLine;
use nalgebra::{Matrix5, Vector5};

/// What one source does to (deflection, pitch, y_ref, z_ref, radius), rad and mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    source: &'static str,
    covariance: Matrix5<f64>,
}

impl Line {
    /// Of the scatter that the data show.
    pub(super) const REPEATABILITY: &'static str = "repeatability";
    /// Of the bias of freely fitted sections.
    pub(super) const FIT_BIAS: &'static str = "fit_bias";
    /// Of a part that is no straight cylinder.
    pub(super) const FORM: &'static str = "form";
    /// Of layers that nobody can tell from the part.
    pub(super) const LAYERS: &'static str = "layers";
    /// Of a radius that is given.
    pub(super) const NOMINAL_RADIUS: &'static str = "nominal_radius";

    /// From the covariance of the slopes (p, q, y_ref, z_ref, radius) about `axis`.
    pub(super) fn of_slopes(source: &'static str, covariance: &Matrix5<f64>, axis: &AxisLine) -> Self {
        let [by_p, by_q] = [axis.p, axis.q].map(|slope| 1.0 / (1.0 + slope * slope));
        let to_angles = Matrix5::from_diagonal(&Vector5::new(by_p, by_q, 1.0, 1.0, 1.0));
        Self { source, covariance: to_angles * covariance * to_angles }
    }

    /// From one number whose standard uncertainty moves (p, q, y_ref, z_ref, radius) by `shift`, all at once.
    pub(super) fn of_shift(source: &'static str, shift: &Vector5<f64>, axis: &AxisLine) -> Self {
        Self::of_slopes(source, &(shift * shift.transpose()), axis)
    }

    fn standard(&self) -> [f64; 5] {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt()).into()
    }
}

impl Uncertainty {
    /// What the lines make together.
    pub(super) fn of(lines: &[Line]) -> Self {
        let covariance: Matrix5<f64> = lines.iter().map(|line| line.covariance).sum();
        let component = |line: &Line| Component { source: line.source.to_owned(), standard: line.standard() };
        Self { covariance: covariance.into(), budget: lines.iter().map(component).collect() }
    }

    /// The covariance of what is left when these of its lines are left out.
    pub(super) fn without(&self, lines: &[Line]) -> Matrix5<f64> {
        Matrix5::from(self.covariance) - lines.iter().map(|line| line.covariance).sum::<Matrix5<f64>>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn independent_lines_add_as_variances_and_slopes_become_angles() {
        let axis = AxisLine { p: 0.5, q: 0.0, y0: 0.0, z0: 0.0 };
        let scatter = Line { source: "repeatability", covariance: Matrix5::from_diagonal_element(9e-6) };
        let shift = Line::of_shift("nominal_radius", &Vector5::new(0.005, 0.0, 0.0, 0.004, 0.0), &axis);
        let scatter_alone = scatter.covariance;
        let uncertainty = Uncertainty::of(&[scatter, shift]);
        let Uncertainty { covariance, budget } = &uncertainty;
        // d atan(p)/dp = 1/(1 + p²) = 0.8, so 0.005 becomes 0.004; with 0.003 beside it 3-4-5 makes 0.005.
        assert!((budget[1].standard[0] - 0.004).abs() < 1e-12);
        assert!((covariance[0][0].sqrt() - 0.005).abs() < 1e-12);
        assert!((covariance[3][3].sqrt() - 0.005).abs() < 1e-12);
        assert!((covariance[0][3] - 0.004 * 0.004).abs() < 1e-12, "one number moves both");
        assert!((uncertainty.without(&[shift]) - scatter_alone).norm() < 1e-18);
    }
}
