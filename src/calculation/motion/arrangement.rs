//! What the two manipulators are to each other and to the part: where they stand, what each axis can do, and the limits of strain of the part
//! between them. Comes from the configuration, checked once by [`Arrangement::check`].

use super::axes::{Axes, Axis, AxisLimits, Carrier, Pair};
use serde::{Deserialize, Serialize};

/// Longest length that is taken for meant, mm: beyond, double precision no longer resolves the nanometre.
const LENGTH_MAX_MM: f64 = 1e5;
/// Least value of what must not be zero.
const POSITIVE_MIN: f64 = 1e-9;
/// Greatest speed, acceleration and jerk, in each axis' own units.
const RATE_MAX: f64 = 1e9;

/// One manipulator as its part sees it: a clamp whose centre three axes carry, and a fourth that turns.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Support {
    /// Where the clamp's centre is in the rail frame when x, y and z are zero; mm.
    pub mount_mm: [f64; 3],
    /// The limits of its axes.
    pub limits: Axes<AxisLimits>,
    /// How far its body reaches along x, on both sides of the clamp's centre; mm.
    pub half_span_mm: f64,
}

/// Both manipulators with the part between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arrangement {
    /// Each manipulator.
    pub supports: Pair<Support>,
    /// By how much a motion may change the distance of the clamps' centres from what it was at its start; mm.
    pub strain_max_mm: f64,
    /// By how much a motion may change the difference of the two turns, |Δc1 − Δc2|; rad.
    pub twist_max: f64,
    /// How far a clamp may run on after an axis of either manipulator has stuck; mm. Its turn may run on by `twist_max`.
    pub run_on_max_mm: f64,
    /// Least clearance along x between the bodies of the two; mm.
    pub clearance_min_mm: f64,
    /// How near to where it should be an axis counts as there; mm, rad.
    pub settle_tolerance: Axes<f64>,
}

/// Why an arrangement cannot be used. Values as the edges know them: mm and degrees.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ArrangementError {
    /// A number is none, or makes no sense.
    #[error("{field} is {value}; it must be from {least} to {most} {unit}")]
    OutOfRange {
        /// Which, with its path from the arrangement: `supports.m1.limits.x.speed`.
        field: String,
        /// Its value.
        value: f64,
        /// Least value.
        least: f64,
        /// Greatest value.
        most: f64,
        /// Of the three numbers; per second, s², s³ where the field is a rate.
        unit: &'static str,
    },
    /// An axis has no travel.
    #[error("{field}: the lower limit {lower} {unit} must be below the upper limit {upper} {unit}")]
    LimitsReversed {
        /// Which axis, with its path from the arrangement.
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
    /// Says whether every number makes sense.
    ///
    /// # Errors
    /// The first field that does not, by name.
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

/// Refuses NaN, too. `axis` decides the unit of the message.
fn within(field: &str, value: f64, least: f64, most: f64, axis: Axis) -> Result<(), ArrangementError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    let (value, least, most) = (axis.outside(value), axis.outside(least), axis.outside(most));
    Err(ArrangementError::OutOfRange { field: field.to_owned(), value, least, most, unit: axis.unit() })
}
