//! From a start to the minimum of the sum of squared distances, down to the rounding of the numbers.

use super::axis::{Cylinder, Sums};
use super::points::Points;
use crate::estimation::progress::Progress;

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
    /// The size of the next step, which was not worth taking: of the order of rounding at a minimum that is determined.
    pub(super) step: f64,
}

impl Minimum {
    fn new(cylinder: Cylinder, points: &Points<'_>) -> Self {
        let sums = cylinder.sums(points);
        let step = sums.step(0.0).map_or(f64::INFINITY, |step| cylinder.size_of(&step));
        Self { cylinder, sums, step }
    }

    fn after(&self, damping: f64, points: &Points<'_>) -> Option<Self> {
        let step = self.sums.step(damping)?;
        Some(Self::new(self.cylinder.moved(&step)?, points))
    }
}

/// Descends by Newton's method, damped as by Levenberg and Marquardt.
pub(super) fn descend(points: &Points<'_>, start: &Cylinder, progress: &Progress) -> Option<Minimum> {
    let mut at = Minimum::new(*start, points);
    let mut damping = DAMPING_START;
    for _ in 0..ROUNDS_MAX {
        if progress.is_stopped() {
            return None;
        }
        if damping <= DAMPING_START && at.step < NEAR {
            break;
        }
        match at.after(damping, points).filter(|trial| trial.sums.squares < at.sums.squares) {
            Some(better) => {
                at = better;
                damping *= 0.1;
            }
            None if damping > DAMPING_MAX => break,
            None => damping *= 10.0,
        }
    }
    let at = polish(points, at);
    at.sums.squares.is_finite().then_some(at)
}

/// Newton's steps until they get no smaller: what is left is the rounding of the gradient. The sum of squares is flat there
/// and its rounding would stop them at half the digits.
fn polish(points: &Points<'_>, mut at: Minimum) -> Minimum {
    let mut last = 2.0 * NEAR;
    for _ in 0..NEWTON_MAX {
        if at.step >= 0.5 * last || at.step < f64::EPSILON {
            break;
        }
        last = at.step;
        let Some(next) = at.after(0.0, points) else { break };
        at = next;
    }
    at
}
