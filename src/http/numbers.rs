//! Numbers on the wire: those of requests within bounds beyond which nothing can be meant, those of answers rounded to what can
//! be meant.

use super::problem::{Code, Problem};
use crate::service::plain;

/// Longest length of a request, mm, whichever way.
pub(super) const LENGTH_MAX_MM: f64 = 100_000.0;
/// Largest turn of a request, degrees, whichever way.
pub(super) const TURN_MAX_DEG: f64 = 3_600.0;
/// Largest tilt of an axis that is asked for, degrees, whichever way: at a right angle it would meet no plane x = 0.
pub(super) const TILT_MAX_DEG: f64 = 45.0;

/// Numbers of an answer are multiples of this: a nanometre, or a millionth of a degree.
const STEPS_PER_UNIT: f64 = 1e6;

/// A number of a request, named as in its document, that is no larger than `most`, whichever way.
///
/// # Errors
/// [`Code::OptionInvalid`] with the bounds.
pub(super) fn within(field: &str, value: f64, most: f64) -> Result<f64, Problem> {
    if value.abs() <= most {
        return Ok(value);
    }
    let detail = format!("{field} must be between {} and {most}, got {}", -most, plain(value));
    Err(Problem::new(Code::OptionInvalid, detail)
        .with("field", field)
        .with("value", value)
        .with("least", -most)
        .with("most", most))
}

/// A length in mm, or a turn in degrees, as answers have it.
pub(super) const fn rounded(value: f64) -> f64 {
    let steps = (value * STEPS_PER_UNIT).round() / STEPS_PER_UNIT;
    // No zero has a sign.
    steps + 0.0
}

/// A turn in rad as answers have it, in degrees.
pub(super) const fn degrees(turn: f64) -> f64 {
    rounded(turn.to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_of_an_answer_has_six_digits_behind_the_point() {
        assert_eq!(degrees(0.3_f64.to_radians()), 0.3);
        assert_eq!(rounded(1.0 / 3.0), 0.333_333);
        assert!(rounded(-1e-9).is_sign_positive());
    }

    #[test]
    fn what_is_beyond_its_bounds_is_refused_and_so_is_what_is_no_number() {
        assert!(within("x_mm", -5.0, 5.0).is_ok());
        assert!(within("x_mm", 5.1, 5.0).is_err() && within("x_mm", f64::NAN, 5.0).is_err());
    }
}
