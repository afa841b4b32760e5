//! How far a manipulator runs on after something has stuck: until that was noticed and the halt has arrived, and while it
//! brakes. Paths are planned so slow that neither the clamp's way nor its turn then exceeds what the arrangement allows.
//!
//! ```text
//! run-on of an axis = v · REACTION + v² / 2a
//! ```
//!
//! The cell supervises both manipulators between set-points and needs at most [`REACTION_S`] from the moment at which an axis
//! sticks until the others brake, provided that the devices answer within some milliseconds.

use super::arrangement::{Arrangement, Support};
use super::axes::{AxisLimits, Carrier, Pair, Position};
use super::course::Course;
use super::progress::Pace;
use super::refusal::MotionRefusal;

/// From the moment at which an axis sticks until the halt has arrived at the other devices, s: two readings of 25 ms each, an
/// answer, the halt's own way, and 40 ms for a device that starts or answers late.
const REACTION_S: f64 = 0.1;
/// What rounding may add to a run-on.
const SLACK: f64 = 1.0 + 1e-6;
/// Halvings after which double precision shows no difference any more.
const HALVINGS: usize = 52;

/// How far one manipulator runs on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RunOn {
    /// Of the clamp's centre, mm.
    pub(super) way_mm: f64,
    /// rad.
    pub(super) turn: f64,
}

impl RunOn {
    /// From these speeds.
    pub(super) fn from_speeds(support: &Support, speeds: &Position) -> Self {
        let run_on = speeds.map(|axis, speed| of_axis(*speed, support.limits.get(axis)));
        Self { way_mm: (run_on.x.powi(2) + run_on.y.powi(2) + run_on.z.powi(2)).sqrt(), turn: run_on.c }
    }
}

fn of_axis(speed: f64, limits: &AxisLimits) -> f64 {
    speed * REACTION_S + speed * speed / (2.0 * limits.acceleration)
}

/// Refuses speeds at which a manipulator would run on too far.
pub(super) fn check_run_on(arrangement: &Arrangement, speeds: &Pair<Position>) -> Result<(), MotionRefusal> {
    for (carrier, speeds) in speeds.iter() {
        let RunOn { way_mm, turn } = RunOn::from_speeds(arrangement.supports.get(carrier), speeds);
        let max_mm = arrangement.run_on_max_mm;
        if way_mm > max_mm * SLACK {
            return Err(MotionRefusal::RunsOn { carrier, run_on: way_mm, max: max_mm, unit: "mm" });
        }
        if turn > arrangement.twist_max * SLACK {
            let (run_on, max) = (turn.to_degrees(), arrangement.twist_max.to_degrees());
            return Err(MotionRefusal::RunsOn { carrier, run_on, max, unit: "deg" });
        }
    }
    Ok(())
}

/// The pace, no faster than the run-on allows. A run-on grows with the speed, so halving finds the greatest one.
pub(super) fn slowed(arrangement: &Arrangement, course: &Course, pace: &Pace) -> Pace {
    let allowed = |speed: f64| {
        let speeds = Pair::from_fn(|carrier: Carrier| course.speeds(carrier, speed));
        check_run_on(arrangement, &speeds).is_ok()
    };
    if allowed(pace.speed) {
        return *pace;
    }
    let (mut slow, mut fast) = (0.0, pace.speed);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (slow + fast);
        if allowed(middle) { slow = middle } else { fast = middle }
    }
    Pace { speed: slow / SLACK, ..*pace }
}
