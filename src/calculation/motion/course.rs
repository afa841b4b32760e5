//! The path of the eight axes and its timing.
//!
//! A [`Course`] is the path independent of time: every axis as a function of one progress s from 0 to 1, so that all arrive
//! together at any speed. There are two kinds:
//!
//! - [`Course::straight`]: every axis in proportion, for a raw move; the distance of the clamps may change along the course.
//! - [`Course::rigid`]: the middle of the clamps moves on a straight line, their line turns about it by the shortest rotation at a
//!   constant rate, their distance stays constant, and the turns change in proportion. Axes moving in proportion would shorten that
//!   distance: a line of length L that turns by θ becomes shorter by about L θ²/8 half-way (0.95 mm at 1000 mm and 5°), which would
//!   strain the part. Libraries that synchronise axes offer only straight paths; one of them is the reference for the durations in
//!   the tests.
//!
//! Both are base + slope·s + cos·cos θs + sin·sin θs for each axis, so the largest rates are known in closed form, not by sampling.
//!
//! [`Progress`] is s(t) from 0 to 1, from rest to rest, in the shortest time that the largest speed, acceleration and jerk of s
//! allow.
//!
//! ```text
//! jerk  +J  0  -J   0   -J  0  +J          tj  time at greatest jerk: the least of A/J, √(V/J), ∛(1/2J)
//! time  tj ta  tj  tv   tj ta  tj          ta  at greatest acceleration a = J tj;  tv  at greatest speed v = a (tj + ta)
//! ```
//!
//! The distance of both ramps is v (2 tj + ta), limited by V or by the total distance, whichever is less. The second half is the
//! first one in reverse.

use super::arrangement::Arrangement;
use super::axes::{Axes, Axis, AxisLimits, Carrier, Pair, Position};
use super::kinematics::{ClampLine, at_centre};
use nalgebra::Vector3;
use std::f64::consts::PI;

/// Travel below this, mm or rad, is rounding, and the axis stays.
const STILL: f64 = 1e-11;
/// Allowance for rounding, so that no speed exceeds its limit by its last digit.
const HEADROOM: f64 = 1.0 - 1e-9;

/// The curve of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Curve {
    base: f64,
    slope: f64,
    cos: f64,
    sin: f64,
}

/// The curves of all eight axes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Course {
    curves: Pair<Axes<Curve>>,
    /// The rotation of the clamps' line; rad, below π.
    angle: f64,
    from: Pair<Position>,
    to: Pair<Position>,
}

impl Course {
    /// The course that moves every axis in proportion.
    pub(super) fn straight(from: &Pair<Position>, to: &Pair<Position>) -> Self {
        let curves = from.map(|carrier, axes| axes.map(|axis, base| straight(*base, *to.get(carrier).get(axis))));
        Self { curves, angle: 0.0, from: *from, to: *to }.with_stills()
    }

    /// The course that moves the clamps' line as a rigid body. The distance of the clamps must be the same at both ends.
    pub(super) fn rigid(arrangement: &Arrangement, from: &Pair<Position>, to: &Pair<Position>) -> Self {
        let (here, there) = (ClampLine::new(arrangement, from), ClampLine::new(arrangement, to));
        let (u, v) = (here.direction, there.direction);
        let angle = u.cross(&v).norm().atan2(u.dot(&v));
        let across = (v - u * u.dot(&v)).try_normalize(1e-14).unwrap_or_else(Vector3::zeros);
        let curves = Pair::from_fn(|carrier| {
            let arm = match carrier {
                Carrier::M1 => -0.5 * here.distance,
                Carrier::M2 => 0.5 * here.distance,
            };
            let (start, end) = (from.get(carrier), to.get(carrier));
            let base = at_centre(arrangement.supports.get(carrier), &here.middle, 0.0);
            let slope = there.middle - here.middle;
            let (cos, sin) = (u * arm, across * arm);
            Axes {
                x: Curve { base: base.x, slope: slope.x, cos: cos.x, sin: sin.x },
                y: Curve { base: base.y, slope: slope.y, cos: cos.y, sin: sin.y },
                z: Curve { base: base.z, slope: slope.z, cos: cos.z, sin: sin.z },
                c: straight(start.c, end.c),
            }
        });
        Self { curves, angle, from: *from, to: *to }.with_stills()
    }

    /// Positions of the axes at s. Exact at both ends.
    pub(super) fn at(&self, s: f64) -> Pair<Position> {
        if s <= 0.0 {
            return self.from;
        }
        if s >= 1.0 {
            return self.to;
        }
        let (sin, cos) = (self.angle * s).sin_cos();
        self.curves.map(|_, axes| axes.map(|_, curve| curve.base + curve.slope * s + curve.cos * cos + curve.sin * sin))
    }

    /// Whether an axis of the manipulator moves.
    pub(super) fn moves(&self, carrier: Carrier, axis: Axis) -> bool {
        self.rates(carrier, axis)[0] > 0.0
    }

    /// The greatest pace at which no axis exceeds its speed (times `share`), acceleration or jerk. Not finite if nothing moves.
    ///
    /// By the chain rule, with d1, d2, d3 the greatest derivatives of an axis by s: speed d1 V, acceleration d2 V² + d1 A, jerk d3
    /// V³ + 3 d2 V A + d1 J. V, A, J start from the values that d1 alone allows; time is then stretched by 1/k so that the other
    /// terms stay within the limits.
    pub(super) fn pace(&self, limits: &Pair<Axes<AxisLimits>>, share: f64) -> Pace {
        let axes: Vec<_> = Carrier::ALL
            .into_iter()
            .flat_map(|carrier| Axis::ALL.map(|axis| (self.rates(carrier, axis), *limits.get(carrier).get(axis))))
            .filter(|(rates, _)| rates[0] > 0.0)
            .collect();
        let least = |of: &dyn Fn(&[f64; 3], &AxisLimits) -> f64| {
            axes.iter().map(|(rates, limits)| of(rates, limits)).fold(f64::INFINITY, f64::min)
        };
        let v = least(&|[d1, ..], limits| limits.speed * share * HEADROOM / d1);
        let a = least(&|[d1, ..], limits| limits.acceleration * HEADROOM / d1);
        let j = least(&|[d1, ..], limits| limits.jerk * HEADROOM / d1);
        let k = least(&|[d1, d2, d3], limits| {
            let acceleration = d2 * v * v + d1 * a;
            let jerk = d3 * v * v * v + 3.0 * d2 * v * a + d1 * j;
            (limits.acceleration / acceleration).sqrt().min((limits.jerk / jerk).cbrt())
        })
        .min(1.0);
        Pace { speed: v * k, acceleration: a * k * k, jerk: j * k * k * k }
    }

    /// Greatest speeds of a manipulator's axes when s changes at `speed`.
    pub(super) fn speeds(&self, carrier: Carrier, speed: f64) -> Position {
        Axes::from_fn(|axis| self.rates(carrier, axis)[0] * speed)
    }

    /// Greatest first, second and third derivative of an axis by s.
    fn rates(&self, carrier: Carrier, axis: Axis) -> [f64; 3] {
        let Curve { slope, cos, sin, .. } = *self.curves.get(carrier).get(axis);
        let w = self.angle;
        let greatest = |offset: f64, (low, high): (f64, f64)| (offset + low).abs().max((offset + high).abs());
        [
            greatest(slope, sinusoid_range(sin * w, -cos * w, w)),
            greatest(0.0, sinusoid_range(-cos * w * w, -sin * w * w, w)),
            greatest(0.0, sinusoid_range(-sin * w * w * w, cos * w * w * w, w)),
        ]
    }

    /// Removes travel that is only rounding.
    fn with_stills(mut self) -> Self {
        for carrier in Carrier::ALL {
            for axis in Axis::ALL {
                if self.rates(carrier, axis)[0] < STILL {
                    let base = *self.from.get(carrier).get(axis);
                    *self.curves.get_mut(carrier).get_mut(axis) = Curve { base, ..Curve::default() };
                    *self.to.get_mut(carrier).get_mut(axis) = base;
                }
            }
        }
        self
    }
}

fn straight(from: f64, to: f64) -> Curve {
    Curve { base: from, slope: to - from, ..Curve::default() }
}

/// Least and greatest value of a cos φ + b sin φ for φ from 0 to `end`, below π.
fn sinusoid_range(a: f64, b: f64, end: f64) -> (f64, f64) {
    let (sin, cos) = end.sin_cos();
    let last = a * cos + b * sin;
    let (mut low, mut high) = (a.min(last), a.max(last));
    let crest = b.atan2(a);
    if (0.0..=end).contains(&crest) {
        high = a.hypot(b);
    }
    if (0.0..=end).contains(&(crest + PI)) {
        low = -a.hypot(b);
    }
    (low, high)
}

/// Greatest rates of s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace {
    /// ds/dt, 1/s.
    pub(super) speed: f64,
    /// d²s/dt², 1/s².
    pub(super) acceleration: f64,
    /// d³s/dt³, 1/s³.
    pub(super) jerk: f64,
}

/// The profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Progress {
    jerk: f64,
    jerk_time: f64,
    steady_time: f64,
    cruise_time: f64,
}

impl Progress {
    /// The fastest profile. All three rates are above zero.
    pub(super) fn new(pace: &Pace) -> Self {
        let Pace { speed, acceleration, jerk } = *pace;
        let jerk_time = (acceleration / jerk).min((speed / jerk).sqrt()).min((0.5 / jerk).cbrt());
        let reached = jerk * jerk_time;
        let to_speed = speed / reached - jerk_time;
        let to_half = 0.5 * ((jerk_time * jerk_time + 4.0 / reached).sqrt() - 3.0 * jerk_time);
        let steady_time = to_speed.min(to_half).max(0.0);
        let ramp = 2.0 * jerk_time + steady_time;
        let cruise_time = (1.0 / (reached * (jerk_time + steady_time)) - ramp).max(0.0);
        Self { jerk, jerk_time, steady_time, cruise_time }
    }

    /// From start to end, s.
    pub(super) fn duration(&self) -> f64 {
        2.0 * self.ramp() + self.cruise_time
    }

    /// The time at which s is reached.
    pub(super) fn time_at(&self, s: f64) -> f64 {
        if s > 0.5 {
            return self.duration() - self.time_at(1.0 - s);
        }
        // s increases with time, so bisection finds it; fifty halvings exhaust double precision.
        let (mut early, mut late) = (0.0, 0.5 * self.duration());
        for _ in 0..52 {
            let middle = 0.5 * (early + late);
            if self.first_half(middle) < s { early = middle } else { late = middle }
        }
        0.5 * (early + late)
    }

    /// s at a time.
    #[cfg(test)]
    pub(super) fn at(&self, time: f64) -> f64 {
        let left = self.duration() - time;
        if time <= left { self.first_half(time) } else { 1.0 - self.first_half(left) }
    }

    fn ramp(&self) -> f64 {
        2.0 * self.jerk_time + self.steady_time
    }

    fn first_half(&self, time: f64) -> f64 {
        let (j, tj, ta) = (self.jerk, self.jerk_time, self.steady_time);
        let top = j * tj * (tj + ta);
        let ramp_way = 0.5 * top * self.ramp();
        let left = self.ramp() - time;
        if time <= tj {
            j * time * time * time / 6.0
        } else if left >= tj {
            let since = time - tj;
            j * tj * (tj * tj / 6.0 + 0.5 * tj * since + 0.5 * since * since)
        } else if left >= 0.0 {
            ramp_way - top * left + j * left * left * left / 6.0
        } else {
            ramp_way - top * left
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rsruckig::prelude::*;

    /// The duration of the same motion by an independent time-optimal planner.
    fn duration_by_ruckig(pace: &Pace) -> f64 {
        let mut solver = Ruckig::<1, ThrowErrorHandler>::new(None, 0.01);
        let mut input = InputParameter::<1>::new(None);
        input.target_position[0] = 1.0;
        input.max_velocity[0] = pace.speed;
        input.max_acceleration[0] = pace.acceleration;
        input.max_jerk[0] = pace.jerk;
        let mut trajectory = Trajectory::new(None);
        solver.calculate(&input, &mut trajectory).expect("a motion from rest to rest has a solution");
        trajectory.get_duration()
    }

    fn paces() -> impl Strategy<Value = Pace> {
        // Over six decades each, so that every phase is sometimes present and sometimes absent.
        (-3.0..3.0, -3.0..3.0, -3.0..3.0).prop_map(|(v, a, j): (f64, f64, f64)| Pace {
            speed: 10f64.powf(v),
            acceleration: 10f64.powf(a),
            jerk: 10f64.powf(j),
        })
    }

    proptest! {
        #![proptest_config(crate::motion::tests::fixed())]

        #[test]
        fn no_motion_within_the_rates_is_faster(pace in paces()) {
            let (ours, theirs) = (Progress::new(&pace).duration(), duration_by_ruckig(&pace));
            prop_assert!((ours / theirs - 1.0).abs() < 1e-7, "{ours} s, {theirs} s");
        }

        #[test]
        fn it_starts_and_ends_at_rest_and_keeps_its_rates(pace in paces()) {
            let progress = Progress::new(&pace);
            let (duration, n) = (progress.duration(), 2000);
            let h = duration / f64::from(n);
            let s = |i: i32| progress.at(duration * f64::from(i) / f64::from(n));
            prop_assert!(s(0) == 0.0 && s(n) == 1.0);
            // From rest, the first step is limited by the jerk alone.
            let first = pace.jerk * h * h * h / 6.0 * (1.0 + 1e-9) + 1e-15;
            prop_assert!(s(1) <= first && 1.0 - s(n - 1) <= first, "not at rest at its ends");
            for i in 0..n {
                // Differences of values that are accurate to 1e-15.
                let speed = (s(i + 1) - s(i)) / h;
                prop_assert!(speed >= 0.0 && speed <= pace.speed * (1.0 + 1e-9) + 1e-15 / h);
                if i > 0 {
                    let acceleration = (s(i + 1) - 2.0 * s(i) + s(i - 1)) / (h * h);
                    prop_assert!(acceleration.abs() <= pace.acceleration * (1.0 + 1e-6) + 4e-15 / (h * h));
                }
                if i > 0 && i + 2 <= n {
                    let jerk = (s(i + 2) - 3.0 * s(i + 1) + 3.0 * s(i) - s(i - 1)) / (h * h * h);
                    prop_assert!(jerk.abs() <= pace.jerk * (1.0 + 1e-6) + 8e-15 / (h * h * h));
                }
            }
        }

        #[test]
        fn the_progress_at_the_time_of_a_position_is_that_position(pace in paces(), s in 0.0..=1.0) {
            let progress = Progress::new(&pace);
            prop_assert!((progress.at(progress.time_at(s)) - s).abs() < 1e-12);
        }
    }
}
