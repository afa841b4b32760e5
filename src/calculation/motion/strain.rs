//! The strain of the part by a step from one set-point to the next, and by a manipulator that runs on after the other has stuck.
//!
//! A step changes the distance of the clamps and the difference of their turns. Devices do not start at the same moment, and one
//! may stop while the other continues. So a step is also examined with every axis independently anywhere between its two ends. The
//! difference of the two centres is then anywhere in a box, whose nearest and farthest point from zero follow in closed form: no
//! order of arrival can strain the part more.
//!
//! After an axis has stuck, the others run on until the cell has detected it and the halt has arrived, and while they brake. The
//! speeds of a path are planned so that neither the distance nor the turn of the clamps then changes by more than the arrangement
//! allows:
//!
//! ```text
//! run-on of an axis = v · REACTION + v² / 2a
//! ```
//!
//! The cell supervises both manipulators between set-points. From the moment at which an axis sticks until the others brake it
//! needs at most [`REACTION_S`], provided that the devices answer within some milliseconds.

use super::arrangement::{Arrangement, Support};
use super::axes::{AxisLimits, Carrier, Pair, Position};
use super::course::{Course, Pace};
use super::kinematics::clamp_centre;
use super::refusal::MotionRefusal;
use nalgebra::Vector3;

/// An interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub(super) least: f64,
    pub(super) most: f64,
}

impl Range {
    fn of(a: f64, b: f64) -> Self {
        Self { least: a.min(b), most: a.max(b) }
    }

    /// The range of the difference self - other.
    fn minus(self, other: Self) -> Self {
        Self { least: self.least - other.most, most: self.most - other.least }
    }

    /// Squares of the least and the greatest absolute value.
    fn squares(self) -> (f64, f64) {
        let (a, b) = (self.least * self.least, self.most * self.most);
        let holds_zero = self.least <= 0.0 && self.most >= 0.0;
        (if holds_zero { 0.0 } else { a.min(b) }, a.max(b))
    }

    /// The largest excess of `wider` on either side.
    fn exceeded_by(self, wider: Self) -> f64 {
        (wider.most - self.most).max(self.least - wider.least)
    }

    /// Largest difference from a value.
    pub(super) fn away_from(self, value: f64) -> f64 {
        (self.most - value).max(value - self.least)
    }
}

/// A step between two set-points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    start: Pair<Position>,
    end: Pair<Position>,
    /// The clamps' centres at both ends.
    centres: [Pair<Vector3<f64>>; 2],
}

impl Step {
    pub(super) fn new(arrangement: &Arrangement, start: &Pair<Position>, end: &Pair<Position>) -> Self {
        let centres =
            [start, end].map(|at| arrangement.supports.map(|carrier, support| clamp_centre(support, at.get(carrier))));
        Self { start: *start, end: *end, centres }
    }

    /// Distance of the clamps while all axes move together, mm. The difference of the centres then moves along a line: it is
    /// farthest at an end, and nearest at the foot of the perpendicular.
    pub(super) fn distance(&self) -> Range {
        let [a, b] = self.centres.map(|centres| centres.m2 - centres.m1);
        let way = b - a;
        let foot = -a.dot(&way) / way.norm_squared();
        let mut range = Range::of(a.norm(), b.norm());
        if foot > 0.0 && foot < 1.0 {
            range.least = range.least.min((a + way * foot).norm());
        }
        range
    }

    /// c1 - c2 while all axes go together, rad.
    pub(super) fn twist(&self) -> Range {
        Range::of(self.start.m1.c - self.start.m2.c, self.end.m1.c - self.end.m2.c)
    }

    /// The largest excess of the distance of the clamps over that of the two set-points if axes arrive late, mm.
    pub(super) fn distance_lead(&self) -> f64 {
        let [a, b] = &self.centres;
        let axis = |of: fn(&Vector3<f64>) -> f64| {
            Range::of(of(&a.m2), of(&b.m2)).minus(Range::of(of(&a.m1), of(&b.m1))).squares()
        };
        let (x, y, z) = (axis(|v| v.x), axis(|v| v.y), axis(|v| v.z));
        let apart = Range { least: (x.0 + y.0 + z.0).sqrt(), most: (x.1 + y.1 + z.1).sqrt() };
        Range::of((a.m2 - a.m1).norm(), (b.m2 - b.m1).norm()).exceeded_by(apart)
    }

    /// The largest excess of c1 - c2 over that of the two set-points if an axis arrives late, rad.
    pub(super) fn twist_lead(&self) -> f64 {
        let apart = Range::of(self.start.m1.c, self.end.m1.c).minus(Range::of(self.start.m2.c, self.end.m2.c));
        self.twist().exceeded_by(apart)
    }

    /// Least clearance along x between the bodies for any order of arrival; mm.
    pub(super) fn gap(&self, arrangement: &Arrangement) -> f64 {
        let [a, b] = &self.centres;
        let spans = arrangement.supports.m1.half_span_mm + arrangement.supports.m2.half_span_mm;
        a.m2.x.min(b.m2.x) - a.m1.x.max(b.m1.x) - spans
    }
}

/// Time from the moment at which an axis sticks until the halt has arrived at the other devices, s: two readings of 25 ms each, an
/// answer, the transmission of the halt, and 40 ms for a device that starts or answers late.
const REACTION_S: f64 = 0.1;
/// Allowance for rounding of a run-on.
const SLACK: f64 = 1.0 + 1e-6;
/// Number of halvings that exhausts double precision.
const HALVINGS: usize = 52;

/// The run-on of one manipulator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RunOn {
    /// Travel of the clamp's centre, mm.
    pub(super) way_mm: f64,
    /// Rotation, rad.
    pub(super) turn: f64,
}

impl RunOn {
    /// The run-on from these speeds.
    pub(super) fn from_speeds(support: &Support, speeds: &Position) -> Self {
        let run_on = speeds.map(|axis, speed| of_axis(*speed, support.limits.get(axis)));
        Self { way_mm: (run_on.x.powi(2) + run_on.y.powi(2) + run_on.z.powi(2)).sqrt(), turn: run_on.c }
    }
}

fn of_axis(speed: f64, limits: &AxisLimits) -> f64 {
    speed * REACTION_S + speed * speed / (2.0 * limits.acceleration)
}

/// Refuses speeds at which the run-on of a manipulator would exceed its limit.
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

/// The pace, reduced so that the run-on stays within its limit. The run-on increases with the speed, so bisection finds the
/// greatest pace.
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
