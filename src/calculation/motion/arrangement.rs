//! The arrangement of the two manipulators relative to each other and to the part: their positions, the limits of each axis, and
//! the limits of strain of the part between them. It comes from the configuration and is checked once by [`Arrangement::check`].

use super::axes::{Axes, Axis, AxisLimits, Carrier, Pair};
use serde::{Deserialize, Serialize};

/// Largest plausible length, mm: beyond it, double precision no longer resolves the nanometre.
const LENGTH_MAX_MM: f64 = 1e5;
/// Least value of a number that must not be zero.
const POSITIVE_MIN: f64 = 1e-9;
/// Greatest speed, acceleration and jerk, in each axis' own units.
const RATE_MAX: f64 = 1e9;

/// One manipulator: a clamp whose centre is moved by three axes and which is turned by a fourth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Position of the clamp's centre in the rail frame when x, y and z are zero; mm.
    pub mount_mm: [f64; 3],
    /// The limits of its axes.
    pub limits: Axes<AxisLimits>,
    /// Extent of its body along x, on both sides of the clamp's centre; mm.
    pub half_span_mm: f64,
}

/// Both manipulators with the part between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arrangement {
    /// Each manipulator.
    pub supports: Pair<Support>,
    /// Largest change of the distance of the clamps' centres during a motion, relative to its start; mm.
    pub strain_max_mm: f64,
    /// Largest change of the difference of the two turns during a motion, |Δc1 − Δc2|; rad.
    pub twist_max: f64,
    /// Largest run-on of a clamp after an axis of either manipulator has stuck; mm. Its turn may run on by `twist_max`.
    pub run_on_max_mm: f64,
    /// Least clearance along x between the bodies of the two; mm.
    pub clearance_min_mm: f64,
    /// Largest distance from its target at which an axis counts as settled; mm, rad.
    pub settle_tolerance: Axes<f64>,
}

/// Why an arrangement cannot be used. Values are in mm and degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ArrangementError {
    /// A number is NaN or out of range.
    #[error("{field} is {value}; it must be from {least} to {most} {unit}")]
    OutOfRange {
        /// The field, with its path from the arrangement: `supports.m1.limits.x.speed`.
        field: String,
        /// Its value.
        value: f64,
        /// Least value.
        least: f64,
        /// Greatest value.
        most: f64,
        /// Unit of the three numbers; per second, s², s³ for a rate.
        unit: &'static str,
    },
    /// An axis has no travel.
    #[error("{field}: the lower limit {lower} {unit} must be below the upper limit {upper} {unit}")]
    LimitsReversed {
        /// The axis, with its path from the arrangement.
        field: String,
        /// Its lower limit.
        lower: f64,
        /// Its upper limit.
        upper: f64,
        /// mm or deg.
        unit: &'static str,
    },
}

impl Arrangement {
    /// Checks the range of every number.
    ///
    /// # Errors
    /// The first field that is out of range, by name.
    pub fn check(&self) -> Result<(), ArrangementError> {
        for (carrier, support) in self.supports.iter() {
            support.check(carrier)?;
        }
        within("strain_max", self.strain_max_mm, POSITIVE_MIN, LENGTH_MAX_MM, Axis::X)?;
        within("twist_max", self.twist_max, POSITIVE_MIN, LENGTH_MAX_MM, Axis::C)?;
        within("run_on_max", self.run_on_max_mm, POSITIVE_MIN, LENGTH_MAX_MM, Axis::X)?;
        within("clearance_min", self.clearance_min_mm, 0.0, LENGTH_MAX_MM, Axis::X)?;
        for (axis, tolerance) in self.settle_tolerance.iter() {
            within(&format!("settle_tolerance.{}", axis.name()), *tolerance, POSITIVE_MIN, LENGTH_MAX_MM, axis)?;
        }
        Ok(())
    }
}

impl Support {
    fn check(&self, carrier: Carrier) -> Result<(), ArrangementError> {
        let name = format!("supports.{}", carrier.name());
        for (axis, value) in [Axis::X, Axis::Y, Axis::Z].into_iter().zip(self.mount_mm) {
            within(&format!("{name}.mount.{}", axis.name()), value, -LENGTH_MAX_MM, LENGTH_MAX_MM, axis)?;
        }
        within(&format!("{name}.half_span"), self.half_span_mm, 0.0, LENGTH_MAX_MM, Axis::X)?;
        for (axis, limits) in self.limits.iter() {
            check_limits(&format!("{name}.limits.{}", axis.name()), axis, limits)?;
        }
        Ok(())
    }
}

fn check_limits(name: &str, axis: Axis, limits: &AxisLimits) -> Result<(), ArrangementError> {
    let AxisLimits { lower, upper, speed, acceleration, jerk, step } = *limits;
    for (what, value, least, most) in [
        ("lower", lower, -LENGTH_MAX_MM, LENGTH_MAX_MM),
        ("upper", upper, -LENGTH_MAX_MM, LENGTH_MAX_MM),
        ("speed", speed, POSITIVE_MIN, RATE_MAX),
        ("acceleration", acceleration, POSITIVE_MIN, RATE_MAX),
        ("jerk", jerk, POSITIVE_MIN, RATE_MAX),
        ("step", step, POSITIVE_MIN, LENGTH_MAX_MM),
    ] {
        within(&format!("{name}.{what}"), value, least, most, axis)?;
    }
    if lower < upper {
        return Ok(());
    }
    let (lower, upper, unit) = (axis.outside(lower), axis.outside(upper), axis.unit());
    Err(ArrangementError::LimitsReversed { field: name.to_owned(), lower, upper, unit })
}

/// NaN is refused as well. `axis` decides the unit of the message.
fn within(field: &str, value: f64, least: f64, most: f64, axis: Axis) -> Result<(), ArrangementError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let (value, least, most) = (axis.outside(value), axis.outside(least), axis.outside(most));
    Err(ArrangementError::OutOfRange { field: field.to_owned(), value, least, most, unit: axis.unit() })
}
