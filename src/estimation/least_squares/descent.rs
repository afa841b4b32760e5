//! From a start to the minimum of the sum of squared distances, down to the rounding of the numbers.

use super::axis::{Cylinder, Sums};
use super::points::Points;

/// Rounds of a descent; one that needs more creeps along a valley that another start leaves sooner.
const ROUNDS_MAX: usize = 100;
/// Rounds of Newton's method at the end; each doubles the number of right digits.
const NEWTON_MAX: usize = 12;
/// A step of this size has three right digits, so that Newton's method needs no more damping.
const NEAR: f64 = 1e-3;
const DAMPING_START: f64 = 1e-3;
const DAMPING_MAX: f64 = 1e12;

/// A minimum and the sums there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) cylinder: Cylinder,
    pub(super) sums: Sums,
}

/// Descends by Newton's method, damped as by Levenberg and Marquardt.
pub(super) fn descend(points: &Points<'_>, start: &Cylinder) -> Option<Minimum> {
    let mut at = Minimum { cylinder: *start, sums: start.sums(points) };
    let mut damping = DAMPING_START;
    for _ in 0..ROUNDS_MAX {
        if damping <= DAMPING_START && at.sums.step(0.0).is_some_and(|step| at.cylinder.size_of(&step) < NEAR) {
            break;
        }
        let step = at.sums.step(damping);
        let trial = step
            .and_then(|step| at.cylinder.moved(&step))
            .map(|cylinder| Minimum { cylinder, sums: cylinder.sums(points) });
        match trial.filter(|trial| trial.sums.squares < at.sums.squares) {
            Some(better) => {
                at = better;
                damping *= 0.1;
            }
            None if damping > DAMPING_MAX => break,
            None => damping *= 10.0,
        }
    }
    polish(points, at)
}

/// Newton's steps until they get no smaller: what is left is the rounding of the gradient. The sum of squares is flat there
/// and its rounding would stop them at half the digits.
fn polish(points: &Points<'_>, mut at: Minimum) -> Option<Minimum> {
    let mut last = 2.0 * NEAR;
    for _ in 0..NEWTON_MAX {
        let Some(step) = at.sums.step(0.0) else { break };
        let size = at.cylinder.size_of(&step);
        if size >= 0.5 * last {
            break;
        }
        let Some(cylinder) = at.cylinder.moved(&step) else { break };
        at = Minimum { cylinder, sums: cylinder.sums(points) };
        last = size;
        if size < f64::EPSILON {
            break;
        }
    }
    at.sums.squares.is_finite().then_some(at)
}
