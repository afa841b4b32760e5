//! From a rough cylinder to the nearest fit of a sample whose noise is known: like settling, but the window shrinks to what the
//! noise says and not to what the points say, so that two surfaces a few noises apart are not taken for one rough one.

use super::model::Cylinder;
use super::sample::Sample;
use super::settle::{Settled, total};
use super::step::{self, Hold};

/// Half of the window in units of the noise: narrower than Tukey's for efficiency, since only a choice hangs on it.
pub(super) const WINDOW: f64 = 3.0;
const ROUNDS_MAX: usize = 40;
/// The window shrinks by this in one round.
const SHRINK: f64 = 0.7;
/// A step below this share of its own standard deviation is none.
const SETTLED: f64 = 1e-3;

/// Narrows from `start`, first looking at points within `window` mm of it, to the noise `sigma`.
pub(super) fn narrow(sample: &Sample, start: Cylinder, window: f64, sigma: f64, hold: Hold) -> Option<Settled> {
    let (mut cylinder, mut window, least) = (start, window, WINDOW * sigma);
    for _ in 0..ROUNDS_MAX {
        let sums = total(sample, &cylinder, window);
        let (normal, gradient) = step::system(&sums, hold, sigma, cylinder.radius);
        let step = step::solve(&normal, &gradient)?;
        cylinder = cylinder.moved(&step)?;
        let moved = (normal * step).dot(&step).abs().sqrt();
        if moved < SETTLED * sigma && window <= least {
            break;
        }
        window = (SHRINK * window).max(least);
    }
    Some(Settled { cylinder, sigma })
}
