//! The way that the eight axes take, apart from time: every axis as a function of one progress s from 0 to 1, so that all
//! arrive together whatever the pace.
//!
//! Two ways:
//!
//! - [`Course::straight`]: every axis in proportion. What a raw move asks for; the distance of the clamps is what it then is.
//! - [`Course::rigid`]: the middle of the clamps goes straight, their line turns by the shortest way about it at a constant
//!   rate, their distance stays, and the turns go in proportion. Straight axes would cut the corner: a line of length L that
//!   turns by θ would come short by about L θ²/8 half-way (0.95 mm at 1000 mm and 5°), which the part would have to bear.
//!   Libraries that synchronise axes know such straight ways only; one of them judges our times in the tests of
//!   [`super::progress`].
//!
//! Both are base + slope·s + cos·cos θs + sin·sin θs for each axis, so greatest rates are known in closed form, not by sampling.

use super::arrangement::Arrangement;
use super::axes::{Axes, Axis, AxisLimits, Carrier, Pair, Position};
use super::kinematics::{ClampLine, at_centre};
use super::progress::Pace;
use nalgebra::Vector3;
use std::f64::consts::PI;

/// An axis that would go less, mm or rad, stays: it is rounding.
const STILL: f64 = 1e-11;
/// What rounding may add to a speed, so that no speed is above its limit by its last digit.
const HEADROOM: f64 = 1.0 - 1e-9;

/// One axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Curve {
    base: f64,
    slope: f64,
    cos: f64,
    sin: f64,
}

/// All eight.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Course {
    curves: Pair<Axes<Curve>>,
    /// By how much the clamps' line turns; rad, below π.
    angle: f64,
    from: Pair<Position>,
    to: Pair<Position>,
}

impl Course {
    /// Every axis in proportion.
    pub(super) fn straight(from: &Pair<Position>, to: &Pair<Position>) -> Self {
        let curves = from.map(|carrier, axes| axes.map(|axis, base| straight(*base, *to.get(carrier).get(axis))));
        Self { curves, angle: 0.0, from: *from, to: *to }.with_stills()
    }

    /// The clamps' line as a rigid body. The distance of the clamps must be the same at both ends.
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

    /// Where the axes are at s. Exact at both ends.
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

    /// Whether an axis goes anywhere.
    pub(super) fn moves(&self, carrier: Carrier, axis: Axis) -> bool {
        self.rates(carrier, axis)[0] > 0.0
    }

    /// The greatest pace at which no axis is beyond its speed (times `share`), acceleration or jerk. Not finite where nothing
    /// moves.
    ///
    /// By the chain rule, with d1, d2, d3 the greatest derivatives of an axis by s: speed d1 V, acceleration d2 V² + d1 A, jerk
    /// d3 V³ + 3 d2 V A + d1 J. V, A, J start from what d1 alone allows; time is then stretched by 1/k so that the rest fits.
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

    /// Greatest speeds of a manipulator's axes where s goes at `speed`.
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

    /// Takes what is only rounding out of it.
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
