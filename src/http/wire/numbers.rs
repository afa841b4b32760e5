//! Numbers, times and positions of axes on the wire. Numbers of requests are checked against physical bounds, those of answers
//! are rounded to their significant digits. Times are UTC with microseconds, the resolution of the store. Lengths are in
//! millimetres, angles in degrees, with the unit in every name.

use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize, Serializer};
use utoipa::ToSchema;

use crate::motion::{Axes, Axis, AxisTravel, Carrier, Pair, Plan};
use crate::service::plain;

use super::problem::{Code, Problem};

/// Maximum absolute value of a length in a request, mm.
pub(in crate::http) const LENGTH_MAX_MM: f64 = 100_000.0;
/// Maximum absolute value of a rotation in a request, degrees.
pub(in crate::http) const TURN_MAX_DEG: f64 = 3_600.0;
/// Maximum absolute tilt of a requested axis, degrees: at a right angle it would not intersect the plane x = 0.
pub(in crate::http) const TILT_MAX_DEG: f64 = 45.0;

/// Numbers of an answer are multiples of this: a nanometre, or a millionth of a degree.
const STEPS_PER_UNIT: f64 = 1e6;

/// Checks that the absolute value of a number of a request, named as in its document, is at most `most`.
///
/// # Errors
/// [`Code::OptionInvalid`] with the bounds.
pub(in crate::http) fn within(field: &str, value: f64, most: f64) -> Result<f64, Problem> {
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

/// A length in mm, or a rotation in degrees, rounded for an answer.
pub(in crate::http) const fn rounded(value: f64) -> f64 {
    let steps = (value * STEPS_PER_UNIT).round() / STEPS_PER_UNIT;
    // Converts −0 to 0.
    steps + 0.0
}

/// A rotation in rad, converted to degrees for an answer.
pub(in crate::http) const fn degrees(turn: f64) -> f64 {
    rounded(turn.to_degrees())
}

pub(in crate::http) fn ms(span: Duration) -> u64 {
    u64::try_from(span.as_millis()).unwrap_or(u64::MAX)
}

/// A value from 0 to 1 in thousandths.
pub(in crate::http) fn permille(progress: f64) -> u16 {
    // The value is between 0 and 1000, so the cast is exact.
    (progress.clamp(0.0, 1.0) * 1000.0) as u16
}

/// A time.
pub(in crate::http) fn time<S: Serializer>(time: &Timestamp, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{time:.6}"))
}

/// A time that may be absent.
#[expect(clippy::ref_option, reason = "serde requires this signature")]
pub(in crate::http) fn optional<S: Serializer>(at: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    match at {
        Some(at) => time(at, serializer),
        None => serializer.serialize_none(),
    }
}

/// Targets of one manipulator; an axis that is not named stays.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = AxisTargets)]
pub(in crate::http) struct TargetsDocument {
    /// Along the rail.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    x_mm: Option<f64>,
    /// Across.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    y_mm: Option<f64>,
    /// Up.
    #[schema(minimum = -100000.0, maximum = 100000.0)]
    z_mm: Option<f64>,
    /// The turn, from +Y towards +Z.
    #[schema(minimum = -3600.0, maximum = 3600.0)]
    c_deg: Option<f64>,
}

impl TargetsDocument {
    /// The targets of this manipulator; `None` if there are none.
    ///
    /// # Errors
    /// `option_invalid` if one is out of range.
    pub(in crate::http) fn targets(self, carrier: Carrier) -> Result<Option<Axes<Option<f64>>>, Problem> {
        let Self { x_mm, y_mm, z_mm, c_deg } = self;
        let target = |name: &str, value: Option<f64>, most: f64| {
            value.map(|value| within(&format!("{}.{name}", carrier.name()), value, most)).transpose()
        };
        let axes = Axes {
            x: target("x_mm", x_mm, LENGTH_MAX_MM)?,
            y: target("y_mm", y_mm, LENGTH_MAX_MM)?,
            z: target("z_mm", z_mm, LENGTH_MAX_MM)?,
            c: target("c_deg", c_deg, TURN_MAX_DEG)?.map(f64::to_radians),
        };
        Ok((axes != Axes::default()).then_some(axes))
    }
}

/// The travel of each axis of both manipulators.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = Travels)]
pub(in crate::http) struct TravelsDocument {
    /// The manipulator at the smaller x.
    m1: ManipulatorTravelDocument,
    /// The manipulator at the greater x.
    m2: ManipulatorTravelDocument,
}

/// The travel of each axis of a manipulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = ManipulatorTravel)]
pub(in crate::http) struct ManipulatorTravelDocument {
    /// Whether anything is sent to it.
    moves: bool,
    /// Along the rail.
    x: LinearTravelDocument,
    /// Across.
    y: LinearTravelDocument,
    /// Up.
    z: LinearTravelDocument,
    /// The turn.
    c: TurnTravelDocument,
}

/// The way of a linear axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = LinearTravel)]
pub(in crate::http) struct LinearTravelDocument {
    /// Where it starts.
    from_mm: f64,
    /// Where it ends.
    to_mm: f64,
    /// How far it goes.
    travel_mm: f64,
    /// How far it is from its nearest limit in the end.
    margin_mm: f64,
}

/// The way of the turning axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = TurnTravel)]
pub(in crate::http) struct TurnTravelDocument {
    /// Where it starts.
    from_deg: f64,
    /// Where it ends.
    to_deg: f64,
    /// How far it turns.
    travel_deg: f64,
    /// How far it is from its nearest limit in the end.
    margin_deg: f64,
}

impl From<&Plan> for TravelsDocument {
    fn from(plan: &Plan) -> Self {
        let Pair { m1, m2 } = plan.axes.map(|carrier, axes| ManipulatorTravelDocument {
            moves: *plan.path.moves.get(carrier),
            x: linear(axes.get(Axis::X)),
            y: linear(axes.get(Axis::Y)),
            z: linear(axes.get(Axis::Z)),
            c: turn(axes.get(Axis::C)),
        });
        Self { m1, m2 }
    }
}

const fn linear(way: &AxisTravel) -> LinearTravelDocument {
    let AxisTravel { from, to, travel, margin } = *way;
    LinearTravelDocument {
        from_mm: rounded(from),
        to_mm: rounded(to),
        travel_mm: rounded(travel),
        margin_mm: rounded(margin),
    }
}

const fn turn(way: &AxisTravel) -> TurnTravelDocument {
    let AxisTravel { from, to, travel, margin } = *way;
    TurnTravelDocument {
        from_deg: degrees(from),
        to_deg: degrees(to),
        travel_deg: degrees(travel),
        margin_deg: degrees(margin),
    }
}

/// The manipulator of this id.
pub(in crate::http) fn carrier(id: &str) -> Option<Carrier> {
    Carrier::ALL.into_iter().find(|carrier| carrier.name() == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_of_an_answer_has_six_decimals() {
        assert_eq!(degrees(0.3_f64.to_radians()), 0.3);
        assert_eq!(rounded(1.0 / 3.0), 0.333_333);
        assert!(rounded(-1e-9).is_sign_positive());
    }

    #[test]
    fn a_value_out_of_range_or_not_finite_is_refused() {
        assert!(within("x_mm", -5.0, 5.0).is_ok());
        assert!(within("x_mm", 5.1, 5.0).is_err() && within("x_mm", f64::NAN, 5.0).is_err());
    }
}

#[cfg(test)]
mod times_tests {
    use super::*;

    #[test]
    fn a_time_always_has_six_decimals_of_the_second() {
        for (text, expected) in [
            ("2026-01-02T03:04:05Z", "\"2026-01-02T03:04:05.000000Z\""),
            ("2026-01-02T03:04:05.12Z", "\"2026-01-02T03:04:05.120000Z\""),
            ("2026-01-02T03:04:05.123456Z", "\"2026-01-02T03:04:05.123456Z\""),
        ] {
            let mut written = Vec::new();
            let mut serializer = serde_json::Serializer::new(&mut written);
            time(&text.parse().expect("a time"), &mut serializer).expect("written");
            assert_eq!(String::from_utf8(written).expect("text"), expected);
        }
    }
}
